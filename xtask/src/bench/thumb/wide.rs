//! Instructions of two halfwords, floating point apart (DDI 0403E.e, A5.3).

use super::narrow::relative;
use super::{Address, Class, Flow, Instruction, PC, Registers, SP, bit, field, signed};

const NONE: Registers = Registers::NONE;

pub(super) fn decode(address: u32, first: u32, second: u32) -> Instruction {
    match first >> 9 {
        0b111_0100 if bit(first, 6) => dual_or_exclusive(first, second),
        0b111_0100 => multiple(first, second),
        0b111_0101 => data_processing(first, second, Some(field(second, 0, 4))),
        0b111_1000..=0b111_1011 if bit(second, 15) => branch(address, first, second),
        0b111_1001 | 0b111_1011 => plain_immediate(first, second),
        0b111_1000 | 0b111_1010 => data_processing(first, second, None),
        0b111_1100 => single(first, second),
        _ if bit(first, 8) => multiply(first, second),
        _ => registers_only(first, second),
    }
}

/// Register `number`, or none for the program counter where it stands for "no operand".
fn operand(number: u32) -> Registers {
    if number == PC {
        NONE
    } else {
        Registers::core(number)
    }
}

fn multiple(first: u32, second: u32) -> Instruction {
    let (load, back, down) = (bit(first, 4), bit(first, 5), field(first, 7, 2) == 2);
    let base = field(first, 0, 4);
    let name = match (load, base == SP && back && down != load) {
        (true, true) => "pop",
        (false, true) => "push",
        (true, false) => "ldm",
        (false, false) => "stm",
    };
    Instruction::multiple(name, load, base, second, back, down)
}

fn dual_or_exclusive(first: u32, second: u32) -> Instruction {
    let base = field(first, 0, 4);
    let (before, up, back, load) = (bit(first, 8), bit(first, 7), bit(first, 5), bit(first, 4));
    let base_set = Registers::core(base);
    if before || back {
        let pair = Registers::core(field(second, 12, 4)) | Registers::core(field(second, 8, 4));
        let written = if back { base_set } else { NONE };
        let class = Class::Multiple { words: 2 };
        let instruction = if load {
            Instruction::new("ldrd", class, base_set, pair | written)
        } else {
            Instruction::new("strd", class, base_set | pair, written)
        };
        let bytes = 4 * field(second, 0, 8) as i32;
        return if back && base == SP {
            instruction.moving_stack(if up { bytes } else { -bytes })
        } else {
            instruction
        };
    }
    let place = |offset| Address {
        base,
        index: None,
        offset,
    };
    let target = field(second, 12, 4);
    match (field(first, 7, 2), load, field(second, 4, 4)) {
        (0, true, _) => {
            let offset = 4 * field(second, 0, 8) as i32;
            Instruction::single("ldrex", true, target, place(offset), None)
        }
        (1, true, half @ (0 | 1)) => {
            let reads = base_set | Registers::core(field(second, 0, 4));
            let halfwords = half == 1;
            Instruction {
                flow: Flow::Table { halfwords },
                ..Instruction::new("tb", Class::TableBranch, reads, NONE)
            }
        }
        (1, true, _) => Instruction::single("ldrex", true, target, place(0), None),
        (kind, ..) => {
            // The outcome goes to another field in the byte and halfword forms.
            let status = field(second, if kind == 0 { 8 } else { 0 }, 4);
            let class = Class::Store { indexed: false };
            let reads = base_set | Registers::core(target);
            Instruction::new("strex", class, reads, Registers::core(status))
        }
    }
}

/// Arithmetic of a register with an immediate or with shifted register `other`.
fn data_processing(first: u32, second: u32, other: Option<u32>) -> Instruction {
    let (rn, rd) = (field(first, 0, 4), field(second, 8, 4));
    let flags_only = rd == PC;
    let shifted = field(second, 12, 3) << 2 | field(second, 6, 2) != 0 || field(second, 4, 2) != 0;
    let alone = rn == PC;
    let name = match field(first, 5, 4) {
        0 if flags_only => "tst",
        0 => "and",
        1 => "bic",
        2 if alone && other.is_some() && shifted => "shift",
        2 if alone => "mov",
        2 => "orr",
        3 if alone => "mvn",
        3 => "orn",
        4 if flags_only => "teq",
        4 => "eor",
        6 => "pkh",
        8 if flags_only => "cmn",
        8 => "add",
        10 => "adc",
        11 => "sbc",
        13 if flags_only => "cmp",
        13 => "sub",
        14 => "rsb",
        _ => return Instruction::undefined(),
    };
    let reads = operand(rn) | other.map_or(NONE, Registers::core);
    let instruction = Instruction::alu(name, reads, operand(rd));
    if other.is_none() && rn == SP && rd == SP {
        let bytes = expand(first, second);
        return match name {
            "add" => instruction.moving_stack(bytes as i32),
            "sub" => instruction.moving_stack(-(bytes as i32)),
            _ => instruction,
        };
    }
    instruction
}

/// The twelve bits of an immediate, spread over both halfwords.
fn immediate(first: u32, second: u32) -> u32 {
    field(first, 10, 1) << 11 | field(second, 12, 3) << 8 | field(second, 0, 8)
}

/// A modified immediate (DDI 0403E.e, A5.3.2).
fn expand(first: u32, second: u32) -> u32 {
    let twelve = immediate(first, second);
    let byte = twelve & 0xFF;
    match twelve >> 8 {
        0 => byte,
        1 => byte << 16 | byte,
        2 => byte << 24 | byte << 8,
        3 => byte << 24 | byte << 16 | byte << 8 | byte,
        _ => (0x80 | byte & 0x7F).rotate_right(twelve >> 7),
    }
}

fn plain_immediate(first: u32, second: u32) -> Instruction {
    let (rn, rd) = (field(first, 0, 4), field(second, 8, 4));
    let (source, target) = (operand(rn), Registers::core(rd));
    let bytes = immediate(first, second) as i32;
    let to_stack = rn == SP && rd == SP;
    match field(first, 4, 5) {
        0 if to_stack => Instruction::alu("add", source, target).moving_stack(bytes),
        10 if to_stack => Instruction::alu("sub", source, target).moving_stack(-bytes),
        0 | 10 if rn == PC => Instruction::alu("adr", Registers::core(PC), target),
        0 => Instruction::alu("add", source, target),
        10 => Instruction::alu("sub", source, target),
        4 => Instruction::alu("movw", NONE, target),
        12 => Instruction::alu("movt", target, target),
        16 | 18 => Instruction::alu("ssat", source, target),
        20 => Instruction::alu("sbfx", source, target),
        22 if rn == PC => Instruction::alu("bfc", target, target),
        22 => Instruction::alu("bfi", source | target, target),
        24 | 26 => Instruction::alu("usat", source, target),
        28 => Instruction::alu("ubfx", source, target),
        _ => Instruction::undefined(),
    }
}

fn branch(address: u32, first: u32, second: u32) -> Instruction {
    let sign = field(first, 10, 1);
    let (j1, j2) = (field(second, 13, 1), field(second, 11, 1));
    let low = field(second, 0, 11) << 1;
    if bit(second, 12) {
        let (i1, i2) = (1 ^ j1 ^ sign, 1 ^ j2 ^ sign);
        let offset = sign << 24 | i1 << 23 | i2 << 22 | field(first, 0, 10) << 12 | low;
        let target = relative(address, signed(offset, 25));
        return if bit(second, 14) {
            Instruction::flow("bl", NONE, Flow::Call(target))
        } else {
            Instruction::flow("b", NONE, Flow::Jump(target))
        };
    }
    if bit(second, 14) {
        return Instruction::undefined();
    }
    if field(first, 7, 3) != 7 {
        let offset = sign << 20 | j2 << 19 | j1 << 18 | field(first, 0, 6) << 12 | low;
        let target = relative(address, signed(offset, 21));
        return Instruction::flow("bcc", NONE, Flow::Branch(target));
    }
    let system = |name, reads, writes| Instruction::new(name, Class::System, reads, writes);
    match field(first, 4, 7) {
        0x38 | 0x39 => {
            // Writing a stack pointer's special register (MSP 8, PSP 9) moves the stack.
            let moves = matches!(field(second, 0, 8), 8 | 9);
            let writes = if moves { Registers::core(SP) } else { NONE };
            system("msr", Registers::core(field(first, 0, 4)), writes)
        }
        0x3A => Instruction::alu("nop", NONE, NONE),
        0x3B => system("barrier", NONE, NONE),
        0x3E | 0x3F if !bit(second, 13) => {
            system("mrs", NONE, Registers::core(field(second, 8, 4)))
        }
        _ => Instruction::undefined(),
    }
}

fn single(first: u32, second: u32) -> Instruction {
    let load = bit(first, 4);
    let (base, target) = (field(first, 0, 4), field(second, 12, 4));
    let name = match (load, bit(first, 8), field(first, 5, 2)) {
        (false, _, 0) => "strb",
        (false, _, 1) => "strh",
        (false, ..) => "str",
        (true, false, 0) => "ldrb",
        (true, true, 0) => "ldrsb",
        (true, false, 1) => "ldrh",
        (true, true, 1) => "ldrsh",
        (true, ..) => "ldr",
    };
    let place = |index, offset| Address {
        base,
        index,
        offset,
    };
    let twelve = field(second, 0, 12) as i32;
    if load && target == PC && field(first, 5, 2) != 2 {
        return Instruction::alu("pld", operand(base), NONE);
    }
    if base == PC {
        let offset = if bit(first, 7) { twelve } else { -twelve };
        return Instruction::single(name, load, target, place(None, offset), None);
    }
    if bit(first, 7) {
        return Instruction::single(name, load, target, place(None, twelve), None);
    }
    if !bit(second, 11) {
        let index = Some((field(second, 0, 4), field(second, 4, 2)));
        return Instruction::single(name, load, target, place(index, 0), None);
    }
    let eight = field(second, 0, 8) as i32;
    let offset = if bit(second, 9) { eight } else { -eight };
    let (before, back) = (bit(second, 10), bit(second, 8));
    let place = place(None, if before { offset } else { 0 });
    Instruction::single(name, load, target, place, back.then_some(offset))
}

fn registers_only(first: u32, second: u32) -> Instruction {
    let reads = operand(field(first, 0, 4)) | Registers::core(field(second, 0, 4));
    let rd = Registers::core(field(second, 8, 4));
    let shift = !bit(first, 7) && !bit(second, 7);
    let name = match (shift, bit(first, 7), bit(second, 7)) {
        (true, ..) => "shift",
        (false, false, _) => "extend",
        (false, true, true) => "bits",
        (false, true, false) => "parallel",
    };
    Instruction::alu(name, reads, rd)
}

fn multiply(first: u32, second: u32) -> Instruction {
    let (rn, rm) = (
        Registers::core(field(first, 0, 4)),
        Registers::core(field(second, 0, 4)),
    );
    let high = Registers::core(field(second, 8, 4));
    if !bit(first, 7) {
        let added = operand(field(second, 12, 4));
        let name = if added == NONE { "mul" } else { "mla" };
        return Instruction::alu(name, rn | rm | added, high);
    }
    let both = high | Registers::core(field(second, 12, 4));
    match field(first, 4, 3) {
        1 | 3 => Instruction::new("div", Class::Divide, rn | rm, high),
        0 | 2 => Instruction::alu("mull", rn | rm, both),
        _ => Instruction::alu("mlal", rn | rm | both, both),
    }
}
