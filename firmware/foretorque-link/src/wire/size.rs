//! Sizes of the cyclic frames and the share of a link that they take.

use crate::division::div_u64_by_u32;

/// Version, sequence number and message tag.
pub const HEADER: usize = 4;
/// CRC-32, COBS byte and delimiter.
pub const TRAILER: usize = 6;

/// Wire size of a frame whose message has `content` bytes behind the tag.
pub const fn frame(content: usize) -> usize {
    HEADER + content + TRAILER
}

/// Wire size of a sample of `joints` joints: flags, temperature, and 3 + 3 + 2 + 3 + 3 bytes a joint.
pub const fn sample(joints: usize) -> usize {
    frame(2 + 14 * joints)
}

/// Wire size of a torque with the shares of one joint: tick, flags, safety, total, three shares.
pub const fn torque(joints: usize) -> usize {
    frame(4 + 2 + 2 + 4 * joints + 3 * 4)
}

/// Wire size of a torque with all shares.
pub const fn full_torque(joints: usize) -> usize {
    frame(4 + 2 + 2 + 16 * joints)
}

/// Wire size of telemetry with `content` bytes of fields: tick, fields, length of the bytes as a varint of one or two.
pub const fn telemetry(content: usize) -> usize {
    frame(4 + 2 + 1 + (content > 127) as usize + content)
}

/// Wire size of a torque with the shares of one joint and the desired motion of an excitation, its stage at its longest.
pub const fn excited(joints: usize) -> usize {
    torque(joints) + 3 + 8 * joints
}

/// Sample of six joints: the cyclic request of the link, B.
pub const SAMPLE_6: usize = sample(6);
/// Torque of six joints: the cyclic reply of the link, B.
pub const TORQUE_6: usize = torque(6);

/// Part of one direction of a line that frames of `bytes` at `rate_hz` leave free, in per mille.
///
/// * `bytes_s` capacity of the direction, bytes a second
pub const fn headroom_permille(bytes: usize, rate_hz: u64, bytes_s: u32) -> i64 {
    1000 - (1000 * bytes as u64 * rate_hz / bytes_s as u64) as i64
}

/// Part of a line that is never planned for, in per cent: repeats, commands, what nobody thought of.
pub const RESERVE_PERCENT: u64 = 30;

/// Bytes that a direction of a line has left in one period besides a frame of `reply` bytes and the reserve.
///
/// * `bytes_s` capacity of the direction, bytes a second
pub const fn left(bytes_s: u32, period_us: u32, reply: usize) -> usize {
    let bytes = div_u64_by_u32(bytes_s as u64 * period_us as u64, 1_000_000);
    let planned = div_u64_by_u32(bytes as u64 * (100 - RESERVE_PERCENT), 100);
    (planned as usize).saturating_sub(reply)
}

const _: () = assert!(SAMPLE_6 <= 96 && TORQUE_6 <= 64);
const _: () = assert!(excited(7) <= full_torque(7));
