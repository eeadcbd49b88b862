//! Wire sizes of the cyclic frames, and the capacity of the link that carries them.

use crate::div_u64_by_u32;

/// Version, sequence number and message tag, bytes.
pub const HEADER: usize = 4;
/// CRC-32, COBS byte and delimiter, bytes.
const TRAILER: usize = 6;
/// Part of a link that is left free, in per cent: for repeats and commands.
const RESERVE_PERCENT: u64 = 30;

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

/// Largest wire size of a torque with the desired motion and state of an excitation.
pub const fn excited(joints: usize) -> usize {
    torque(joints) + 3 + 8 * joints
}

/// Capacity of one direction of a link, as its transport gives it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LinkCapacity {
    /// Bytes a second; 0 has no limit.
    pub bytes_s: u32,
}

impl LinkCapacity {
    /// No limit, as between two processes.
    pub const UNLIMITED: Self = Self::stream(0);
    /// Bytes of telemetry in one period where there is no limit: a record of all fields of eight joints.
    const UNLIMITED_LEFT: usize = 400;

    /// A stream of `bytes_s` bytes a second, which carries every frame of the protocol.
    pub const fn stream(bytes_s: u32) -> Self {
        Self { bytes_s }
    }

    /// Bytes that one period leaves besides a frame of `reply` bytes and the reserve.
    pub const fn left(&self, period_us: u32, reply: usize) -> usize {
        if self.bytes_s == 0 {
            return Self::UNLIMITED_LEFT;
        }
        let bytes = div_u64_by_u32(self.bytes_s as u64 * period_us as u64, 1_000_000);
        let planned = div_u64_by_u32(bytes as u64 * (100 - RESERVE_PERCENT), 100) as usize;
        planned.saturating_sub(reply)
    }
}

/// Part of one direction of a link that frames of `bytes` at `rate_hz` leave free, in per mille.
///
/// * `bytes_s` capacity of the direction, bytes a second
pub const fn headroom_permille(bytes: usize, rate_hz: u64, bytes_s: u32) -> i64 {
    1000 - (1000 * bytes as u64 * rate_hz / bytes_s as u64) as i64
}

const _: () = assert!(sample(6) <= 96 && torque(6) <= 64);
const _: () = assert!(excited(7) <= full_torque(7));
