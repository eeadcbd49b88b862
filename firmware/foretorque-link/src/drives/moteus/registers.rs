//! Registers and subframes of a frame.

use super::super::frame::carried;
use super::super::{Frame, Resolution};

/// Padding of a frame to the next length of CAN-FD: a subframe that does nothing.
pub(super) const NOP: u8 = 0x50;
pub(super) const WRITE: u8 = 0x00;
pub(super) const READ: u8 = 0x10;
pub(super) const REPLY: u8 = 0x20;
pub(super) const MODE: u32 = 0x000;
pub(super) const TEMPERATURE: u32 = 0x00e;
pub(super) const FAULT: u32 = 0x00f;
pub(super) const COMMAND: u32 = 0x020;
pub(super) const TORQUE: u32 = 0x022;
pub(super) const WATCHDOG: u32 = 0x027;
/// Register that sets the output position; two bytes as a variable-length integer.
pub(super) const SET_OUTPUT: [u8; 2] = [0xb0, 0x02];
pub(super) const STOPPED: u8 = 0;
pub(super) const FAULTED: u8 = 1;
pub(super) const POSITION: u8 = 10;
pub(super) const TIMED_OUT: u8 = 11;

/// Bytes of a frame while it is put together.
pub(super) type Bytes = heapless::Vec<u8, { Frame::CAPACITY }>;

pub(super) fn put(bytes: &mut Bytes, more: &[u8]) {
    let fits = bytes.extend_from_slice(more);
    debug_assert!(fits.is_ok(), "longer than a frame");
}

/// Steps of position, velocity and torque in turns, turns/s and N·m; 0 for f32.
pub(super) const fn steps(resolution: Resolution) -> [f32; 3] {
    match resolution {
        Resolution::Int16 => [1e-4, 2.5e-4, 1e-2],
        Resolution::Int32 => [1e-5, 1e-5, 1e-3],
        Resolution::F32 => [0.0; 3],
    }
}

/// Bits 2 and 3 of a subframe's first byte, and bytes of a value.
pub(super) const fn form(resolution: Resolution) -> (u8, usize) {
    match resolution {
        Resolution::Int16 => (0x04, 2),
        Resolution::Int32 => (0x08, 4),
        Resolution::F32 => (0x0c, 4),
    }
}

/// Appends one value in units of `step`. The most negative integer means "not given", so it is never sent.
pub(super) fn write(
    bytes: &mut Bytes,
    resolution: Resolution,
    value: f32,
    step: f32,
    carry: &mut f32,
) -> bool {
    match resolution {
        Resolution::F32 => {
            put(bytes, &value.to_le_bytes());
            false
        }
        Resolution::Int16 => {
            let (value, most) = (value / step, i32::from(i16::MAX));
            let code = carried(value, carry, -most, most) as i16;
            put(bytes, &code.to_le_bytes());
            value > most as f32 || value < -most as f32
        }
        Resolution::Int32 => {
            let value = value / step;
            let code = carried(value, carry, -i32::MAX, i32::MAX);
            put(bytes, &code.to_le_bytes());
            value >= 2_147_483_600.0 || value <= -2_147_483_600.0
        }
    }
}

/// Value of one register in a subframe.
#[derive(Clone, Copy)]
pub(super) enum Value {
    Integer(i32, Resolution),
    Byte(i8),
    Float(f32),
}

impl Value {
    /// In the unit of a register with these steps for 8, 16 and 32 bits; `None` where it is not given.
    pub(super) fn scaled(self, byte: f32, short: f32, long: f32) -> Option<f32> {
        match self {
            Self::Byte(i8::MIN) | Self::Integer(i32::MIN, Resolution::Int32) => None,
            Self::Integer(value, Resolution::Int16) if value == i16::MIN.into() => None,
            Self::Byte(value) => Some(f32::from(value) * byte),
            Self::Integer(value, Resolution::Int16) => Some(value as f32 * short),
            Self::Integer(value, _) => Some(value as f32 * long),
            Self::Float(value) => value.is_finite().then_some(value),
        }
    }

    pub(super) fn count(self) -> u32 {
        match self {
            Self::Byte(value) => value.max(0) as u32,
            Self::Integer(value, _) => value.max(0) as u32,
            Self::Float(value) => value as u32,
        }
    }
}

pub(super) fn varuint<'a>(bytes: &mut &'a [u8]) -> Option<u32> {
    let mut value = 0_u32;
    for shift in [0, 7, 14, 21, 28] {
        let (&byte, rest): (&'a u8, _) = bytes.split_first()?;
        *bytes = rest;
        value |= u32::from(byte & 0x7f) << shift;
        if byte & 0x80 == 0 {
            return Some(value);
        }
    }
    None
}

pub(super) fn next(bytes: &mut &[u8], form: u8) -> Option<Value> {
    fn take<const N: usize>(bytes: &mut &[u8]) -> Option<[u8; N]> {
        let (&head, rest) = bytes.split_first_chunk()?;
        *bytes = rest;
        Some(head)
    }
    Some(match form {
        0 => Value::Byte(i8::from_le_bytes(take(bytes)?)),
        1 => Value::Integer(i16::from_le_bytes(take(bytes)?).into(), Resolution::Int16),
        2 => Value::Integer(i32::from_le_bytes(take(bytes)?), Resolution::Int32),
        _ => Value::Float(f32::from_le_bytes(take(bytes)?)),
    })
}

/// Calls `register` with every value of `kind` in a frame and the place behind it; `false` where the frame ends in the middle of a subframe or
/// has one of an unknown kind.
pub(super) fn each(all: &[u8], kind: u8, mut register: impl FnMut(u32, Value, usize)) -> bool {
    let mut bytes = all;
    let mut walk = || {
        while let Some((&first, rest)) = bytes.split_first() {
            bytes = rest;
            match first & 0xf0 {
                _ if first == NOP => {}
                family @ (WRITE | READ | REPLY) => {
                    let count = match first & 3 {
                        0 => varuint(&mut bytes)?,
                        count => count.into(),
                    };
                    let start = varuint(&mut bytes)?;
                    if family == READ {
                        continue;
                    }
                    // A frame of 64 bytes has no room for more.
                    for place in 0..count.min(64) {
                        let value = next(&mut bytes, first >> 2 & 3)?;
                        if family == kind {
                            register(start.wrapping_add(place), value, all.len() - bytes.len());
                        }
                    }
                }
                _ => return None,
            }
        }
        Some(())
    };
    walk().is_some()
}
