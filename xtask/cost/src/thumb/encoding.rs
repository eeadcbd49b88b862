//! The fields of an encoding, and the instruction that its row of the table makes of them.

use super::table::{Kind, Row};
use super::{Class, Flow, Instruction, LR, PC, Registers, SP, Stack};

/// An instruction beside its row of the table.
pub(super) struct Encoding {
    pub(super) row: &'static Row,
    pub(super) word: u32,
    pub(super) bits: u32,
}

impl Encoding {
    /// The letters of the pattern, each with its bit.
    fn letters(&self) -> impl Iterator<Item = (u8, u32)> {
        let letters = self.row.0.bytes().filter(|&letter| letter != b' ');
        letters.zip((0..self.bits).rev().map(|bit| self.word >> bit & 1))
    }

    pub(super) fn fits(&self) -> bool {
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
    pub(super) fn is_defined(&self) -> bool {
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

    pub(super) fn build(&self, address: u32, undefined: Instruction) -> Instruction {
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
                (made.class, made.flow) = (Class::TableBranch, Flow::Table { halfwords });
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
