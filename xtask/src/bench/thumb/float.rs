//! The floating-point extension, single precision (DDI 0403E.e, A6.4 to A6.6).

use super::{Address, Class, Instruction, PC, Registers, SP, bit, field};

const NONE: Registers = Registers::NONE;

pub(super) fn decode(first: u32, second: u32) -> Instruction {
    let coprocessor = field(second, 8, 4);
    if !matches!(coprocessor, 10 | 11) || bit(first, 12) {
        return Instruction::undefined();
    }
    let double = coprocessor == 11;
    if first & 0xFFE0 == 0xEC40 {
        return pair(first, second, double);
    }
    match (field(first, 8, 2), bit(second, 4)) {
        (0 | 1, _) => memory(first, second, double),
        (2, false) => arithmetic(first, second, double),
        (2, true) => transfer(first, second),
        _ => Instruction::undefined(),
    }
}

/// The register of a four-bit field and its one-bit extension.
fn register(four: u32, one: u32, double: bool) -> Registers {
    if double {
        Registers::singles(2 * (one << 4 | four), 2)
    } else {
        Registers::singles(four << 1 | one, 1)
    }
}

fn pair(first: u32, second: u32, double: bool) -> Instruction {
    let core = Registers::core(field(second, 12, 4)) | Registers::core(field(first, 0, 4));
    let (four, one) = (field(second, 0, 4), field(second, 5, 1));
    let float = if double {
        register(four, one, true)
    } else {
        Registers::singles(four << 1 | one, 2)
    };
    let (reads, writes) = if bit(first, 4) {
        (float, core)
    } else {
        (core, float)
    };
    Instruction::new("vmov", Class::FloatMovePair, reads, writes)
}

fn memory(first: u32, second: u32, double: bool) -> Instruction {
    let (before, up, back, load) = (bit(first, 8), bit(first, 7), bit(first, 5), bit(first, 4));
    let base = field(first, 0, 4);
    let base_set = Registers::core(base);
    let (four, one) = (field(second, 12, 4), field(first, 6, 1));
    let eight = field(second, 0, 8);
    if before && !back {
        let target = register(four, one, double);
        let offset = if up {
            4 * eight as i32
        } else {
            -4 * (eight as i32)
        };
        return if load {
            Instruction {
                address: Some(Address {
                    base,
                    index: None,
                    offset,
                }),
                ..Instruction::new("vldr", Class::Load, base_set, target)
            }
        } else {
            // The wait for the float register makes it as slow as an indexed store.
            let class = Class::Store { indexed: true };
            Instruction::new("vstr", class, base_set | target, NONE)
        };
    }
    let words = if double { eight & !1 } else { eight };
    let start = if double {
        2 * (one << 4 | four)
    } else {
        four << 1 | one
    };
    let list = Registers::singles(start, words.min(32));
    let written = if back { base_set } else { NONE };
    let stacked = base == SP && back && before != load;
    let (name, reads, writes) = match (load, stacked) {
        (true, true) => ("vpop", base_set, list | written),
        (true, false) => ("vldm", base_set, list | written),
        (false, true) => ("vpush", base_set | list, written),
        (false, false) => ("vstm", base_set | list, written),
    };
    let instruction = Instruction::new(name, Class::Multiple { words }, reads, writes);
    if base == SP && back {
        let bytes = 4 * words as i32;
        return instruction.moving_stack(if before { -bytes } else { bytes });
    }
    instruction
}

fn arithmetic(first: u32, second: u32, double: bool) -> Instruction {
    let d = register(field(second, 12, 4), field(first, 6, 1), double);
    let n = register(field(first, 0, 4), field(second, 7, 1), double);
    let m = register(field(second, 0, 4), field(second, 5, 1), double);
    let negate = bit(second, 6);
    let operation = field(first, 7, 1) << 2 | field(first, 4, 2);
    let accumulate = |name| {
        let class = Class::FloatAccumulate { accumulator: d };
        Instruction::new(name, class, d | n | m, d)
    };
    let simple = |name| Instruction::new(name, Class::FloatArithmetic, n | m, d);
    match (operation, negate) {
        (0, false) => accumulate("vmla"),
        (0, true) => accumulate("vmls"),
        (1, false) => accumulate("vnmls"),
        (1, true) => accumulate("vnmla"),
        (2, false) => simple("vmul"),
        (2, true) => simple("vnmul"),
        (3, false) => simple("vadd"),
        (3, true) => simple("vsub"),
        (4, false) => Instruction::new("vdiv", Class::FloatDivide, n | m, d),
        (5, false) => accumulate("vfnms"),
        (5, true) => accumulate("vfnma"),
        (6, false) => accumulate("vfma"),
        (6, true) => accumulate("vfms"),
        (7, false) => Instruction::new("vmov", Class::FloatMove, NONE, d),
        (7, true) => unary(first, second, d, m),
        _ => Instruction::undefined(),
    }
}

fn unary(first: u32, second: u32, d: Registers, m: Registers) -> Instruction {
    let moved = |name| Instruction::new(name, Class::FloatMove, m, d);
    let converted = |reads| Instruction::new("vcvt", Class::FloatArithmetic, reads, d);
    match (field(first, 0, 4), bit(second, 7)) {
        (0, false) => moved("vmov"),
        (0, true) => moved("vabs"),
        (1, false) => moved("vneg"),
        (1, true) => Instruction::new("vsqrt", Class::FloatDivide, m, d),
        (4, _) => Instruction::new("vcmp", Class::FloatMove, d | m, NONE),
        (5, _) => Instruction::new("vcmp", Class::FloatMove, d, NONE),
        (2 | 3 | 7 | 8 | 12 | 13, _) => converted(m),
        // Fixed point, in place.
        (10 | 11 | 14 | 15, _) => converted(d),
        _ => Instruction::undefined(),
    }
}

fn transfer(first: u32, second: u32) -> Instruction {
    let to_core = bit(first, 4);
    let number = field(second, 12, 4);
    let moved = |reads, writes| Instruction::new("vmov", Class::FloatMove, reads, writes);
    match field(first, 5, 3) {
        0 => {
            let core = Registers::core(number);
            let float = register(field(first, 0, 4), field(second, 7, 1), false);
            if to_core {
                moved(float, core)
            } else {
                moved(core, float)
            }
        }
        7 if to_core => {
            // Register 15 stands for the flags.
            let core = if number == PC {
                NONE
            } else {
                Registers::core(number)
            };
            Instruction::new("vmrs", Class::FloatMove, NONE, core)
        }
        7 => Instruction::new("vmsr", Class::FloatMove, Registers::core(number), NONE),
        _ => Instruction::undefined(),
    }
}
