//! Decodes Thumb-2 as far as cost, control flow and stack need it (ARM DDI 0403E.e, chapter A5).
//!
//! Not a disassembler: an operand that matters to none of the three is left out.

mod table;

use table::{Kind, NARROW, Row, WIDE};

/// A set of registers: bits 0 to 15 the core's, bits 32 to 63 the single-precision ones.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Registers(pub(crate) u64);

pub(crate) const SP: u32 = 13;
pub(crate) const LR: u32 = 14;
pub(crate) const PC: u32 = 15;

impl Registers {
    pub(crate) const NONE: Self = Self(0);

    pub(crate) fn core(number: u32) -> Self {
        Self(1 << (number & 15))
    }

    /// `count` single registers from `first` on.
    fn singles(first: u32, count: u32) -> Self {
        (first..first + count).fold(Self::NONE, |set, n| set | Self(1 << (32 + (n & 31))))
    }

    fn has(self, number: u32) -> bool {
        self.0 >> number & 1 == 1
    }

    pub(crate) fn meets(self, other: Self) -> bool {
        self.0 & other.0 != 0
    }
}

impl std::ops::BitOr for Registers {
    type Output = Self;

    fn bitor(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

/// Cost class of an instruction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Class {
    /// Integer arithmetic, moves, multiplications, hints.
    Alu,
    /// One register from memory.
    Load,
    /// One register to memory; `indexed` by a register.
    Store { indexed: bool },
    /// `words` words to or from memory.
    Multiple { words: u32 },
    /// Jumps, calls and returns through a register.
    Branch,
    /// Branch through a table of offsets.
    TableBranch,
    /// SDIV, UDIV.
    Divide,
    /// MSR, MRS and barriers.
    System,
    /// Float arithmetic whose result is late: add, subtract, multiply, convert.
    FloatArithmetic,
    /// Float multiply-accumulate, fused or not, and its accumulator.
    FloatAccumulate { accumulator: Registers },
    /// VDIV, VSQRT.
    FloatDivide,
    /// Other float instructions: moves, sign, comparison.
    FloatMove,
    /// Two words between core and float registers.
    FloatMovePair,
    /// Start of a block of `count` conditional instructions.
    IfThen { count: u32 },
    /// Not in the table, or never executed.
    Undefined,
}

/// Where control may go.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Flow {
    /// On to the next instruction.
    Next,
    /// To the target, always.
    Jump(u32),
    /// To the target or on.
    Branch(u32),
    /// Into a function and back.
    Call(u32),
    /// Into a function that the code does not fix.
    CallIndirect,
    /// To an address that the code does not fix.
    JumpIndirect,
    /// Through the table of offsets (of two bytes or one) at the address in register `base`; that of the program counter is
    /// behind the instruction.
    Table { halfwords: bool, base: u32 },
    /// To the caller, or out of an exception.
    Return,
    /// Nowhere: permanently undefined.
    Stop,
}

/// Change of the stack pointer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Stack {
    /// None.
    Kept,
    /// So many bytes, down if negative.
    Moved(i32),
    /// Not fixed by the code.
    Lost,
}

/// One decoded instruction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Instruction {
    /// Bytes.
    pub(crate) size: u32,
    pub(crate) class: Class,
    pub(crate) reads: Registers,
    pub(crate) writes: Registers,
    pub(crate) flow: Flow,
    pub(crate) stack: Stack,
}

/// Whether an instruction that begins with `first` has a second halfword.
pub(crate) fn is_wide(first: u16) -> bool {
    first >> 11 >= 0b11101
}

/// The instruction at `address`; `second` is ignored by a short one.
pub(crate) fn decode(address: u32, first: u16, second: u16) -> Instruction {
    let (rows, word, bits) = if is_wide(first) {
        (WIDE, u32::from(first) << 16 | u32::from(second), 32)
    } else {
        (NARROW, u32::from(first), 16)
    };
    let undefined = Instruction {
        size: bits / 8,
        class: Class::Undefined,
        reads: Registers::NONE,
        writes: Registers::NONE,
        flow: Flow::Stop,
        stack: Stack::Kept,
    };
    let mut encodings = rows.iter().map(|row| Encoding { row, word, bits });
    match encodings.find(Encoding::fits) {
        Some(encoding) if encoding.is_defined() => encoding.build(address, undefined),
        _ => undefined,
    }
}

/// An instruction beside its row of the table.
struct Encoding {
    row: &'static Row,
    word: u32,
    bits: u32,
}

impl Encoding {
    /// The letters of the pattern, each with its bit.
    fn letters(&self) -> impl Iterator<Item = (u8, u32)> {
        let letters = self.row.0.bytes().filter(|&letter| letter != b' ');
        letters.zip((0..self.bits).rev().map(|bit| self.word >> bit & 1))
    }

    fn fits(&self) -> bool {
        self.letters()
            .all(|(letter, bit)| !matches!((letter, bit), (b'0', 1) | (b'1', 0)))
    }

    /// Value and bits of a field, if the pattern has it.
    fn find(&self, name: u8) -> Option<(u32, u32)> {
        let bits = self.letters().filter(|&(letter, _)| letter == name);
        bits.fold(None, |field, (_, bit)| {
            let (value, width) = field.unwrap_or((0, 0));
            Some((value << 1 | bit, width + 1))
        })
    }

    /// Value of a field; 0 if the pattern does not have it.
    fn field(&self, name: u8) -> u32 {
        self.find(name).map_or(0, |(value, _)| value)
    }

    /// Whether the row has a name for field `o`.
    fn is_defined(&self) -> bool {
        let name = self.row.1.split(' ').nth(self.field(b'o') as usize);
        name.is_some_and(|name| name != "-")
    }

    /// The number of a core register in the table's notation, `None` of a float one.
    fn number(&self, register: &str) -> Option<u32> {
        match *register.as_bytes() {
            [letter] => Some(self.field(letter.to_ascii_lowercase())),
            [b's', b'p'] => Some(SP),
            [b'l', b'r'] => Some(LR),
            [b'p', b'c'] => Some(PC),
            _ => None,
        }
    }

    /// The set of one register in the table's notation.
    fn register(&self, register: &str) -> Registers {
        match self.number(register) {
            Some(PC) if register.starts_with(|c: char| c.is_ascii_uppercase()) => Registers::NONE,
            Some(number) => Registers::core(number),
            None => {
                let (first, words) = self.float(register.as_bytes()[1]);
                Registers::singles(first, if register.starts_with('2') { 2 } else { words })
            }
        }
    }

    fn set(&self, registers: &'static str) -> Registers {
        let all = registers.split_whitespace();
        all.fold(Registers::NONE, |set, one| set | self.register(one))
    }

    /// First single register and words of a float register: four bits and one more, which comes first in a double.
    fn float(&self, letter: u8) -> (u32, u32) {
        let (four, one) = (self.field(letter), self.field(letter.to_ascii_uppercase()));
        match self.field(b'z') {
            0 => (four << 1 | one, 1),
            _ => (2 * (one << 4 | four), 2),
        }
    }

    /// Bytes from the base: `i` times `scale`, down if there is a `u` of 0.
    fn offset(&self, scale: i32) -> i32 {
        let bytes = scale * self.field(b'i') as i32;
        match self.find(b'u') {
            Some((0, _)) => -bytes,
            _ => bytes,
        }
    }

    fn build(&self, address: u32, undefined: Instruction) -> Instruction {
        let &(_, _, kind, reads, writes) = self.row;
        let base = reads.split_whitespace().next();
        let base = base.and_then(|base| self.number(base)).unwrap_or(0);
        let back = self.field(b'w') == 1;
        let mut made = Instruction {
            class: Class::Branch,
            reads: self.set(reads),
            writes: self.set(writes),
            flow: Flow::Next,
            ..undefined
        };
        // The base is written back with this movement.
        let mut moved = None;
        match kind {
            Kind::Plain(class) => {
                made.class = class;
                if class == Class::Alu && made.writes.has(PC) {
                    made.flow = Flow::JumpIndirect;
                }
            }
            Kind::Accumulate => {
                let accumulator = made.writes;
                made.class = Class::FloatAccumulate { accumulator };
            }
            Kind::Sp(scale) => {
                made.class = Class::Alu;
                moved = Some(self.offset(scale));
            }
            Kind::Expanded(sign) => {
                made.class = Class::Alu;
                moved = Some(sign * expand(self.field(b'i')) as i32);
            }
            Kind::Load(scale) => {
                made.class = Class::Load;
                made.flow = match (made.writes.has(PC), base == SP) {
                    (true, true) => Flow::Return,
                    (true, false) => Flow::JumpIndirect,
                    (false, _) => Flow::Next,
                };
                moved = back.then_some(self.offset(scale));
            }
            Kind::Store => {
                let indexed = reads.split_whitespace().count() == 3;
                made.class = Class::Store { indexed };
                moved = back.then_some(self.offset(1));
            }
            Kind::Dual => {
                made.class = Class::Multiple { words: 2 };
                moved = back.then_some(self.offset(4));
            }
            Kind::Multiple(load) => {
                let (set, words) = self.list(load);
                let listed = load && base != SP && set.has(base);
                let down = self.find(b'u').map_or(!load, |(up, _)| up == 0);
                // A short load that lists its base does not write it back.
                let back = self.find(b'w').map_or(!listed, |(w, _)| w == 1);
                let bytes = 4 * words as i32;
                moved = back.then_some(if down { -bytes } else { bytes });
                made.class = Class::Multiple { words };
                if load {
                    made.writes = set;
                    if set.has(PC) {
                        made.flow = Flow::Return;
                    }
                } else {
                    made.reads = made.reads | set;
                }
            }
            Kind::Goes(flow) => made.flow = flow,
            Kind::Near(flow) => {
                let (value, bits) = self.find(b'i').unwrap_or_default();
                made.flow = flow(relative(address, 2 * signed(value, bits)));
            }
            Kind::Compare => {
                made.flow = Flow::Branch(relative(address, 2 * self.field(b'i') as i32));
            }
            Kind::Conditional => {
                let high = self.field(b's') << 19 | self.field(b'k') << 18 | self.field(b'j') << 17;
                let distance = 2 * signed(high | self.field(b'i'), 20);
                made.flow = Flow::Branch(relative(address, distance));
            }
            Kind::Far(flow) => {
                let sign = self.field(b's');
                let [one, two] = [b'j', b'k'].map(|name| 1 ^ self.field(name) ^ sign);
                let high = sign << 23 | one << 22 | two << 21;
                made.flow = flow(relative(address, 2 * signed(high | self.field(b'i'), 24)));
            }
            Kind::Table => {
                let halfwords = self.field(b'h') == 1;
                let base = self.field(b'n');
                let flow = Flow::Table { halfwords, base };
                (made.class, made.flow) = (Class::TableBranch, flow);
            }
            Kind::IfThen => {
                let count = 4 - self.field(b'i').trailing_zeros();
                made.class = Class::IfThen { count };
            }
        }
        if moved.is_some() {
            made.writes = made.writes | Registers::core(base);
        }
        made.stack = match moved {
            Some(bytes) if base == SP => Stack::Moved(bytes),
            _ if made.writes.has(SP) => Stack::Lost,
            _ => Stack::Kept,
        };
        made
    }

    /// The registers of a transfer, and its words.
    fn list(&self, load: bool) -> (Registers, u32) {
        if self.find(b'z').is_some() {
            let (first, words) = self.float(b'd');
            let count = self.field(b'i') & !(words - 1);
            return (Registers::singles(first, count.min(32)), count);
        }
        let extra = self.field(b'r') << if load { PC } else { LR };
        let set = Registers(u64::from(self.field(b'l') | extra));
        (set, set.0.count_ones())
    }
}

/// A modified immediate (DDI 0403E.e, A5.3.2).
fn expand(twelve: u32) -> u32 {
    let byte = twelve & 0xFF;
    match twelve >> 8 {
        0 => byte,
        1 => byte << 16 | byte,
        2 => byte << 24 | byte << 8,
        3 => byte << 24 | byte << 16 | byte << 8 | byte,
        _ => (0x80 | byte & 0x7F).rotate_right(twelve >> 7),
    }
}

/// Target of a branch at `address`: the program counter reads four bytes ahead.
fn relative(address: u32, offset: i32) -> u32 {
    address.wrapping_add(4).wrapping_add_signed(offset)
}

/// `value` of `bits` bits as a signed number.
fn signed(value: u32, bits: u32) -> i32 {
    let shift = 32 - bits;
    ((value << shift) as i32) >> shift
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every encoding of `capstone.txt`, decoded: its line, the instruction, the registers it should read and write.
    fn vectors() -> impl Iterator<Item = (&'static str, Instruction, Registers, Registers)> {
        let lines = include_str!("capstone.txt").lines();
        lines.filter(|line| !line.starts_with('#')).map(|line| {
            let mut words = line.split(' ');
            let mut number = || u64::from_str_radix(words.next().unwrap(), 16).unwrap();
            let (first, second) = (number() as u16, number() as u16);
            // Away from zero, so that branches backwards have a target.
            let instruction = decode(0x0800_4000, first, second);
            (line, instruction, Registers(number()), Registers(number()))
        })
    }

    #[test]
    fn registers_are_those_of_an_independent_decoder() {
        let program_counter = Registers::core(PC);
        let without = |set: Registers| Registers(set.0 & !program_counter.0);
        assert!(vectors().count() > 100);
        for (line, instruction, reads, writes) in vectors() {
            assert_eq!(without(instruction.reads), reads, "{line}");
            assert_eq!(without(instruction.writes), writes, "{line}");
        }
    }

    #[test]
    fn the_stack_moves_by_what_is_pushed_and_popped() {
        for (first, second, stack) in [
            (0xB5F0, 0, Stack::Moved(-20)),       // push {r4-r7, lr}
            (0xE92D, 0x0F80, Stack::Moved(-20)),  // push.w {r7-r11}
            (0xED2D, 0x8B10, Stack::Moved(-64)),  // vpush {d8-d15}
            (0xB082, 0, Stack::Moved(-8)),        // sub sp, #8
            (0xF5AD, 0x7D00, Stack::Moved(-512)), // sub.w sp, sp, #512
            (0xF84D, 0xBD04, Stack::Moved(-4)),   // str fp, [sp, #-4]!
            (0xF85D, 0xBB04, Stack::Moved(4)),    // ldr fp, [sp], #4
            (0xECBD, 0x8B10, Stack::Moved(64)),   // vpop {d8-d15}
            (0xBDF0, 0, Stack::Moved(20)),        // pop {r4-r7, pc}
            (0x46A5, 0, Stack::Lost),             // mov sp, r4
            (0x9001, 0, Stack::Kept),             // str r0, [sp, #4]
        ] {
            assert_eq!(decode(0, first, second).stack, stack, "{first:04x}");
        }
    }

    #[test]
    fn control_goes_where_the_encoding_says() {
        let table = |halfwords, base| Flow::Table { halfwords, base };
        for (first, second, flow) in [
            (0xF7FF, 0xFFFE, Flow::Call(0x0800_4000)),   // bl .
            (0xE7FE, 0, Flow::Jump(0x0800_4000)),        // b .
            (0xD0FE, 0, Flow::Branch(0x0800_4000)),      // beq .
            (0xF43F, 0xAFFE, Flow::Branch(0x0800_4000)), // beq.w .
            (0xB100, 0, Flow::Branch(0x0800_4004)),      // cbz r0, .+4
            (0x4770, 0, Flow::Return),                   // bx lr
            (0xBD80, 0, Flow::Return),                   // pop {r7, pc}
            (0x4790, 0, Flow::CallIndirect),             // blx r2
            (0x4710, 0, Flow::JumpIndirect),             // bx r2
            (0xE8DF, 0xF000, table(false, 15)),          // tbb [pc, r0]
            (0xE8DF, 0xF011, table(true, 15)),           // tbh [pc, r1, lsl #1]
            (0xE8D3, 0xF012, table(true, 3)),            // tbh [r3, r2, lsl #1]
            (0xDEFE, 0, Flow::Stop),                     // udf #254
        ] {
            assert_eq!(decode(0x0800_4000, first, second).flow, flow, "{first:04x}");
        }
    }
}
