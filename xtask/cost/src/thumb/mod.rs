//! Decodes Thumb-2 as far as cost, control flow and stack need it (ARM DDI 0403E.e, chapter A5).
//!
//! Not a disassembler: an operand that matters to none of the three is left out.

mod encoding;
mod table;

use encoding::Encoding;
use table::{NARROW, WIDE};

/// A set of registers: bits 0 to 15 the core's, bits 32 to 63 the single-precision ones.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Registers(pub(crate) u64);

pub(crate) const SP: u32 = 13;
pub(crate) const LR: u32 = 14;
pub(crate) const PC: u32 = 15;

impl Registers {
    pub(crate) const NONE: Self = Self(0);

    fn core(number: u32) -> Self {
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
    /// Through the table of offsets (of two bytes or one) behind the instruction.
    Table { halfwords: bool },
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
        for (first, second, flow) in [
            (0xF7FF, 0xFFFE, Flow::Call(0x0800_4000)),          // bl .
            (0xE7FE, 0, Flow::Jump(0x0800_4000)),               // b .
            (0xD0FE, 0, Flow::Branch(0x0800_4000)),             // beq .
            (0xF43F, 0xAFFE, Flow::Branch(0x0800_4000)),        // beq.w .
            (0xB100, 0, Flow::Branch(0x0800_4004)),             // cbz r0, .+4
            (0x4770, 0, Flow::Return),                          // bx lr
            (0xBD80, 0, Flow::Return),                          // pop {r7, pc}
            (0x4790, 0, Flow::CallIndirect),                    // blx r2
            (0x4710, 0, Flow::JumpIndirect),                    // bx r2
            (0xE8DF, 0xF000, Flow::Table { halfwords: false }), // tbb [pc, r0]
            (0xE8DF, 0xF011, Flow::Table { halfwords: true }),  // tbh [pc, r1, lsl #1]
            (0xDEFE, 0, Flow::Stop),                            // udf #254
        ] {
            assert_eq!(decode(0x0800_4000, first, second).flow, flow, "{first:04x}");
        }
    }
}
