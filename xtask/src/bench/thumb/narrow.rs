//! Instructions of one halfword (DDI 0403E.e, A5.2).

use super::{Address, Class, Flow, Instruction, LR, PC, Registers, SP, bit, field, signed};

const NONE: Registers = Registers::NONE;

pub(super) fn decode(address: u32, w: u32) -> Instruction {
    let low = |at| Registers::core(field(w, at, 3));
    match w >> 12 {
        0x0 | 0x1 => {
            let name = match field(w, 11, 2) {
                0 if field(w, 6, 5) == 0 => "mov",
                0 => "lsl",
                1 => "lsr",
                2 => "asr",
                _ if bit(w, 9) => "sub",
                _ => "add",
            };
            let by_register = field(w, 11, 2) == 3 && !bit(w, 10);
            let second = if by_register { low(6) } else { NONE };
            Instruction::alu(name, low(3) | second, low(0))
        }
        0x2 | 0x3 => match field(w, 11, 2) {
            0 => Instruction::alu("mov", NONE, low(8)),
            1 => Instruction::alu("cmp", low(8), NONE),
            2 => Instruction::alu("add", low(8), low(8)),
            _ => Instruction::alu("sub", low(8), low(8)),
        },
        0x4 => match field(w, 10, 2) {
            0 => low_registers(w),
            1 => high_registers(w),
            _ => {
                let place = Address {
                    base: PC,
                    index: None,
                    offset: 4 * field(w, 0, 8) as i32,
                };
                Instruction::single("ldr", true, field(w, 8, 3), place, None)
            }
        },
        0x5 => {
            let names = [
                "str", "strh", "strb", "ldrsb", "ldr", "ldrh", "ldrb", "ldrsh",
            ];
            let operation = field(w, 9, 3);
            let place = Address {
                base: field(w, 3, 3),
                index: Some((field(w, 6, 3), 0)),
                offset: 0,
            };
            let name = names[operation as usize];
            Instruction::single(name, operation >= 3, field(w, 0, 3), place, None)
        }
        0x6..=0x8 => {
            let load = bit(w, 11);
            let (name, scale) = match (w >> 12, load) {
                (0x6, false) => ("str", 4),
                (0x6, true) => ("ldr", 4),
                (0x7, false) => ("strb", 1),
                (0x7, true) => ("ldrb", 1),
                (_, false) => ("strh", 2),
                (_, true) => ("ldrh", 2),
            };
            let place = Address {
                base: field(w, 3, 3),
                index: None,
                offset: scale * field(w, 6, 5) as i32,
            };
            Instruction::single(name, load, field(w, 0, 3), place, None)
        }
        0x9 => {
            let load = bit(w, 11);
            let place = Address {
                base: SP,
                index: None,
                offset: 4 * field(w, 0, 8) as i32,
            };
            let name = if load { "ldr" } else { "str" };
            Instruction::single(name, load, field(w, 8, 3), place, None)
        }
        0xA if bit(w, 11) => Instruction::alu("add", Registers::core(SP), low(8)),
        0xA => Instruction::alu("adr", Registers::core(PC), low(8)),
        0xB => miscellaneous(address, w),
        0xC => {
            let load = bit(w, 11);
            let (base, list) = (field(w, 8, 3), field(w, 0, 8));
            let name = if load { "ldm" } else { "stm" };
            // A load that lists its base does not write it back.
            let written_back = !(load && bit(list, base));
            Instruction::multiple(name, load, base, list, written_back, false)
        }
        0xD => match field(w, 8, 4) {
            14 => Instruction::undefined(),
            15 => Instruction::alu("svc", NONE, NONE),
            _ => {
                let target = relative(address, signed(field(w, 0, 8), 8) * 2);
                Instruction::flow("bcc", NONE, Flow::Branch(target))
            }
        },
        _ => {
            let target = relative(address, signed(field(w, 0, 11), 11) * 2);
            Instruction::flow("b", NONE, Flow::Jump(target))
        }
    }
}

/// Target of a branch at `address`: the program counter reads four bytes ahead.
pub(super) fn relative(address: u32, offset: i32) -> u32 {
    address.wrapping_add(4).wrapping_add_signed(offset)
}

fn low_registers(w: u32) -> Instruction {
    const NAMES: [&str; 16] = [
        "and", "eor", "lsl", "lsr", "asr", "adc", "sbc", "ror", "tst", "rsb", "cmp", "cmn", "orr",
        "mul", "bic", "mvn",
    ];
    let operation = field(w, 6, 4);
    let (rd, rm) = (
        Registers::core(field(w, 0, 3)),
        Registers::core(field(w, 3, 3)),
    );
    let name = NAMES[operation as usize];
    match name {
        "tst" | "cmp" | "cmn" => Instruction::alu(name, rd | rm, NONE),
        "rsb" | "mvn" => Instruction::alu(name, rm, rd),
        _ => Instruction::alu(name, rd | rm, rd),
    }
}

fn high_registers(w: u32) -> Instruction {
    let number = field(w, 0, 3) | field(w, 7, 1) << 3;
    let (rd, rm) = (Registers::core(number), Registers::core(field(w, 3, 4)));
    match field(w, 8, 2) {
        0 => Instruction::alu("add", rd | rm, rd),
        1 => Instruction::alu("cmp", rd | rm, NONE),
        2 => Instruction::alu("mov", rm, rd),
        _ if bit(w, 7) => Instruction::flow("blx", rm, Flow::CallIndirect),
        _ if rm.has(LR) => Instruction::flow("bx", rm, Flow::Return),
        _ => Instruction::flow("bx", rm, Flow::JumpIndirect),
    }
}

fn miscellaneous(address: u32, w: u32) -> Instruction {
    let low = |at| Registers::core(field(w, at, 3));
    let sp = Registers::core(SP);
    match field(w, 8, 4) {
        0 => {
            let bytes = 4 * field(w, 0, 7) as i32;
            if bit(w, 7) {
                Instruction::alu("sub", sp, sp).moving_stack(-bytes)
            } else {
                Instruction::alu("add", sp, sp).moving_stack(bytes)
            }
        }
        1 | 3 | 9 | 11 => {
            let offset = field(w, 3, 5) << 1 | field(w, 9, 1) << 6;
            let target = relative(address, offset as i32);
            let name = if bit(w, 11) { "cbnz" } else { "cbz" };
            Instruction::flow(name, low(0), Flow::Branch(target))
        }
        2 => {
            let names = ["sxth", "sxtb", "uxth", "uxtb"];
            Instruction::alu(names[field(w, 6, 2) as usize], low(3), low(0))
        }
        4 | 5 => {
            let list = field(w, 0, 8) | field(w, 8, 1) << LR;
            Instruction::multiple("push", false, SP, list, true, true)
        }
        10 => Instruction::alu("rev", low(3), low(0)),
        12 | 13 => {
            let list = field(w, 0, 8) | field(w, 8, 1) << PC;
            Instruction::multiple("pop", true, SP, list, true, false)
        }
        14 => Instruction::alu("bkpt", NONE, NONE),
        15 if field(w, 0, 4) != 0 => {
            let count = 4 - field(w, 0, 4).trailing_zeros();
            Instruction::new("it", Class::IfThen { count }, NONE, NONE)
        }
        15 => Instruction::alu("nop", NONE, NONE),
        6 => Instruction::alu("cps", NONE, NONE),
        _ => Instruction::undefined(),
    }
}
