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
