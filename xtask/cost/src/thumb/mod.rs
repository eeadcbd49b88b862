//! Decodes Thumb-2 as far as cost, control flow and stack need it (ARM DDI 0403E.e, chapter A5).
//!
//! Not a disassembler: an operand that matters to none of the three is left out.

mod encoding;
mod table;
#[cfg(test)]
mod tests;

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
