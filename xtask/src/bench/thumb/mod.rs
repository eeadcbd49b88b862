//! Decodes Thumb-2 as far as cost, control flow and stack need it (ARM DDI 0403E.e, chapter A5).
//!
//! Not a disassembler: an operand that matters to none of the three is left out.

mod float;
mod narrow;
#[cfg(test)]
mod tests;
mod wide;

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
    pub(crate) fn singles(first: u32, count: u32) -> Self {
        (first..first + count).fold(Self::NONE, |set, n| set | Self(1 << (32 + (n & 31))))
    }

    /// The core registers of a transfer list.
    pub(crate) fn list(bits: u32) -> Self {
        Self(u64::from(bits & 0xFFFF))
    }

    pub(crate) fn has(self, number: u32) -> bool {
        self.0 >> number & 1 == 1
    }

    pub(crate) fn meets(self, other: Self) -> bool {
        self.0 & other.0 != 0
    }

    pub(crate) fn count(self) -> u32 {
        self.0.count_ones()
    }
}

impl std::ops::BitOr for Registers {
    type Output = Self;

    fn bitor(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

/// What an instruction costs by.
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
    /// Not known to this decoder, or never executed.
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
    /// Into a function known only when it runs.
    CallIndirect,
    /// To an address known only when it runs.
    JumpIndirect,
    /// Through the table of offsets (of two bytes or one) behind the instruction.
    Table { halfwords: bool },
    /// To the caller, or out of an exception.
    Return,
    /// Nowhere: permanently undefined.
    Stop,
}

/// What happens to the stack pointer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Stack {
    /// It stays.
    Kept,
    /// It moves by so many bytes, down if negative.
    Moved(i32),
    /// It becomes anything.
    Lost,
}

/// Where a single load reads: base register (the program counter counts as aligned), index and shift, offset.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Address {
    pub(crate) base: u32,
    pub(crate) index: Option<(u32, u32)>,
    pub(crate) offset: i32,
}

/// One decoded instruction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Instruction {
    pub(crate) name: &'static str,
    /// Bytes.
    pub(crate) size: u32,
    pub(crate) class: Class,
    pub(crate) reads: Registers,
    pub(crate) writes: Registers,
    pub(crate) flow: Flow,
    pub(crate) stack: Stack,
    /// Of single loads only.
    pub(crate) address: Option<Address>,
}

impl Instruction {
    fn new(name: &'static str, class: Class, reads: Registers, writes: Registers) -> Self {
        let stack = if writes.has(SP) {
            Stack::Lost
        } else {
            Stack::Kept
        };
        Self {
            name,
            size: 4,
            class,
            reads,
            writes,
            flow: Flow::Next,
            stack,
            address: None,
        }
    }

    fn alu(name: &'static str, reads: Registers, writes: Registers) -> Self {
        let flow = if writes.has(PC) {
            Flow::JumpIndirect
        } else {
            Flow::Next
        };
        Self {
            flow,
            ..Self::new(name, Class::Alu, reads, writes)
        }
    }

    fn flow(name: &'static str, reads: Registers, flow: Flow) -> Self {
        let writes = match flow {
            Flow::Call(_) | Flow::CallIndirect => Registers::core(LR),
            _ => Registers::NONE,
        };
        Self {
            flow,
            ..Self::new(name, Class::Branch, reads, writes)
        }
    }

    fn undefined() -> Self {
        Self {
            flow: Flow::Stop,
            ..Self::new("udf", Class::Undefined, Registers::NONE, Registers::NONE)
        }
    }

    /// The same with the stack pointer moved by `bytes`.
    fn moving_stack(self, bytes: i32) -> Self {
        Self {
            stack: Stack::Moved(bytes),
            ..self
        }
    }

    /// A single load or store of core register `target`; `written_back` to the base by `offset` or not at all.
    fn single(
        name: &'static str,
        load: bool,
        target: u32,
        address: Address,
        written_back: Option<i32>,
    ) -> Self {
        let index = address
            .index
            .map_or(Registers::NONE, |(index, _)| Registers::core(index));
        let base = Registers::core(address.base);
        let target_set = Registers::core(target);
        let back = written_back.map_or(Registers::NONE, |_| base);
        let instruction = if load {
            Self {
                address: Some(address),
                ..Self::new(name, Class::Load, base | index, target_set | back)
            }
        } else {
            let class = Class::Store {
                indexed: address.index.is_some(),
            };
            Self::new(name, class, base | index | target_set, back)
        };
        let flow = match (load && target == PC, address.base == SP) {
            (true, true) => Flow::Return,
            (true, false) => Flow::JumpIndirect,
            (false, _) => Flow::Next,
        };
        let instruction = Self {
            flow,
            ..instruction
        };
        match written_back {
            Some(bytes) if address.base == SP => instruction.moving_stack(bytes),
            _ => instruction,
        }
    }

    /// A transfer of the core registers `list` from or to memory at `base`.
    fn multiple(
        name: &'static str,
        load: bool,
        base: u32,
        list: u32,
        written_back: bool,
        down: bool,
    ) -> Self {
        let set = Registers::list(list);
        let base_set = Registers::core(base);
        let back = if written_back {
            base_set
        } else {
            Registers::NONE
        };
        let words = set.count();
        let (reads, writes) = if load {
            (base_set, set | back)
        } else {
            (base_set | set, back)
        };
        let returns = load && set.has(PC);
        let instruction = Self {
            flow: if returns { Flow::Return } else { Flow::Next },
            ..Self::new(name, Class::Multiple { words }, reads, writes)
        };
        if base == SP && written_back {
            let bytes = 4 * words as i32;
            instruction.moving_stack(if down { -bytes } else { bytes })
        } else {
            instruction
        }
    }
}

/// Whether an instruction that begins with `first` has a second halfword.
pub(crate) fn is_wide(first: u16) -> bool {
    first >> 11 >= 0b11101
}

/// The instruction at `address`; `second` is ignored by a short one.
pub(crate) fn decode(address: u32, first: u16, second: u16) -> Instruction {
    let (first, second) = (u32::from(first), u32::from(second));
    if !is_wide(first as u16) {
        return Instruction {
            size: 2,
            ..narrow::decode(address, first)
        };
    }
    if first & 0xEC00 == 0xEC00 {
        return float::decode(first, second);
    }
    wide::decode(address, first, second)
}

/// Bit field of `word` from bit `low`, `width` bits wide.
fn field(word: u32, low: u32, width: u32) -> u32 {
    word >> low & ((1 << width) - 1)
}

fn bit(word: u32, number: u32) -> bool {
    word >> number & 1 == 1
}

/// `value` of `width` bits as a signed number.
fn signed(value: u32, width: u32) -> i32 {
    let shift = 32 - width;
    ((value << shift) as i32) >> shift
}
