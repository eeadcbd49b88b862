//! Machine code that stands in for hardware the emulator lacks: an encoder on the bus, a drive on the fault line.

/// Transfer number that is never reached.
pub(crate) const NEVER: u16 = u16::MAX;
/// Bytes that a reading of the encoder moves.
const READING: u16 = 4;

/// `movw r, value` (ARM DDI 0403, A7.7.76, encoding T3), or with `top` `movt` (A7.7.79).
fn mov16(register: u16, value: u16, top: bool) -> [u16; 2] {
    let (i, imm4) = ((value >> 11) & 1, value >> 12);
    let first = if top { 0xF2C0 } else { 0xF240 } | i << 10 | imm4;
    let second = ((value >> 8) & 7) << 12 | register << 8 | (value & 0xFF);
    [first, second]
}

/// RAM that the chip has not, and the emulator has: zero at start. The bytes are counted there.
const COUNTER: [[u16; 2]; 2] = [[0xF248, 0x0100], [0xF2C2, 0x0102]];

/// An encoder at `angle` counts in the place of the bus: of four bytes two are the angle and two the diagnostics, as they
/// are asked for in turn. After `readings` the line is low.
pub(crate) fn encoder(angle: u16, readings: u16) -> Vec<u16> {
    let even = |value: u16| value | ((value.count_ones() as u16 & 1) << 15);
    // In the order in which they are sent: an angle that nobody has asked for, then diagnostics (ready), angle, …
    let [angle, diagnostics] = [even(angle), even(1 << 8)].map(u16::swap_bytes);
    let mut code = COUNTER.concat();
    code.extend([
        0x680A, // ldr r2, [r1]
        0x1C53, // adds r3, r2, #1
        0x600B, // str r3, [r1]
    ]);
    code.extend(mov16(0, angle, false));
    code.extend(mov16(0, diagnostics, true));
    code.extend([
        0x00D3, // lsls r3, r2, #3
        0x41D8, // rors r0, r3
        0xB2C0, // uxtb r0, r0
    ]);
    if readings != NEVER {
        let last = u8::try_from(readings * READING).expect("compared with a byte");
        code.extend([
            0x2A00 | u16::from(last), // cmp r2, #last
            0xBF28,                   // it hs
            0x2000,                   // movhs r0, #0
        ]);
    }
    code.push(0x4770); // bx lr
    code
}

/// A fault line that is high until the encoder has been read `readings` times.
pub(crate) fn drive(readings: u16) -> Vec<u16> {
    if readings == NEVER {
        return vec![0x2001, 0x4770]; // movs r0, #1; bx lr
    }
    let mut code = COUNTER.concat();
    code.push(0x680A); // ldr r2, [r1]
    code.extend(mov16(3, readings * READING, false));
    code.extend([
        0x1AD0, // subs r0, r2, r3
        0x0FC0, // lsrs r0, r0, #31
        0x4770, // bx lr
    ]);
    code
}
