//! Saturation, slew and flags of the torque that leaves the tick.

use core::ops::{BitOr, BitOrAssign};

/// Flags of one tick, as a set of bits. The bit positions are part of the wire format.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Flags(pub u16);

impl Flags {
    /// Nothing to report.
    pub const NONE: Self = Self(0);
    /// A joint's torque was cut to its torque limit.
    pub const SATURATED: Self = Self(1 << 0);
    /// A joint's torque moved by its slew limit.
    pub const SLEWED: Self = Self(1 << 1);
    /// A network share was cut to its bound.
    pub const NETWORK_CLIPPED: Self = Self(1 << 2);
    /// The learnt part since the last committed set was cut to its bound.
    pub const LEARNED_CLIPPED: Self = Self(1 << 3);
    /// No usable sample came in this tick: the last torque is held, or is on its way to zero.
    pub const STALE_SAMPLE: Self = Self(1 << 4);
    /// A share was not finite or not plausible; the committed set's share stands in for it.
    pub const SHARE_FALLBACK: Self = Self(1 << 5);
    /// A number of the desired motion or of a share was not finite.
    pub const NOT_FINITE: Self = Self(1 << 6);
    /// Learning is switched on. When clear, learning is frozen.
    pub const LEARNING_ON: Self = Self(1 << 7);
    /// This tick is the first one with a newly learnt set.
    pub const SET_ADOPTED: Self = Self(1 << 8);
    /// The learner's set was not there when this tick was to adopt it, or came from an earlier round.
    pub const SET_LATE: Self = Self(1 << 9);
    /// The desired motion was outside the limits and was cut to them.
    pub const DESIRED_CLAMPED: Self = Self(1 << 10);
    /// The sample carried no measurement.
    pub const NO_MEASUREMENT: Self = Self(1 << 11);
    /// A share, or the whole torque, is being slewed to zero because nothing sound is left to put in its place.
    pub const WITHDRAWN: Self = Self(1 << 12);
    /// The torque of the payload was cut to its bound, or was no number and left out.
    pub const PAYLOAD_CLIPPED: Self = Self(1 << 13);
    /// A joint has no sound rigid-body share, so nothing carries it.
    pub const GRAVITY_LOST: Self = Self(1 << 14);

    /// Every flag with its name, from the lowest bit on.
    pub const NAMED: [(Self, &'static str); 15] = [
        (Self::SATURATED, "saturated"),
        (Self::SLEWED, "slewed"),
        (Self::NETWORK_CLIPPED, "network_clipped"),
        (Self::LEARNED_CLIPPED, "learned_clipped"),
        (Self::STALE_SAMPLE, "stale_sample"),
        (Self::SHARE_FALLBACK, "share_fallback"),
        (Self::NOT_FINITE, "not_finite"),
        (Self::LEARNING_ON, "learning_on"),
        (Self::SET_ADOPTED, "set_adopted"),
        (Self::SET_LATE, "set_late"),
        (Self::DESIRED_CLAMPED, "desired_clamped"),
        (Self::NO_MEASUREMENT, "no_measurement"),
        (Self::WITHDRAWN, "withdrawn"),
        (Self::PAYLOAD_CLIPPED, "payload_clipped"),
        (Self::GRAVITY_LOST, "gravity_lost"),
    ];

    /// Its name in reports; empty for several flags, or none.
    pub fn name(self) -> &'static str {
        let named = Self::NAMED.iter().find(|(flag, _)| *flag == self);
        named.map_or("", |(_, name)| name)
    }

    /// Every bit of `other` is set.
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// `flag` if `condition`, else nothing.
    pub const fn when(condition: bool, flag: Self) -> Self {
        if condition { flag } else { Self::NONE }
    }
}

impl BitOr for Flags {
    type Output = Self;
    fn bitor(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

impl BitOrAssign for Flags {
    fn bitor_assign(&mut self, other: Self) {
        self.0 |= other.0;
    }
}

/// `value` cut to ±`bound`, and whether it was cut. A not-a-number passes uncut.
#[inline(always)]
pub fn cut(value: f32, bound: f32) -> (f32, bool) {
    if value.abs() > bound {
        // Keeps the branch: computing both results for a selection takes twice the cycles.
        core::hint::black_box(());
        (bound.copysign(value), true)
    } else {
        (value, false)
    }
}

/// The torque that leaves the tick: `target` saturated, then slewed from the torque of the tick before.
///
/// * `target` wanted torque, N·m; finite      * `previous` torque of the tick before, N·m; finite
/// * `limit` torque limit, N·m      * `slew` largest change in one tick, N·m
/// * returns the torque, N·m, and `SATURATED`, `SLEWED`
#[inline]
pub fn limit(target: f32, previous: f32, limit: f32, slew: f32) -> (f32, Flags) {
    let (saturated, was_saturated) = cut(target, limit);
    let (change, was_slewed) = cut(saturated - previous, slew);
    // Unslewed, the target itself: previous + (target − previous) is another number in f32.
    let torque = if was_slewed {
        previous + change
    } else {
        saturated
    };
    let flags =
        Flags::when(was_saturated, Flags::SATURATED) | Flags::when(was_slewed, Flags::SLEWED);
    (torque, flags)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn torque_is_saturated_and_slewed_and_says_so() {
        let cases = [
            (10.0, 9.0, 10.0, Flags::NONE),
            (200.0, 149.0, 150.0, Flags::SATURATED),
            (-200.0, -149.0, -150.0, Flags::SATURATED),
            (10.0, 0.0, 5.0, Flags::SLEWED),
            (200.0, 0.0, 5.0, Flags::SATURATED | Flags::SLEWED),
            (0.0, 12.0, 7.0, Flags::SLEWED),
        ];
        for (target, previous, torque, flags) in cases {
            let limited = limit(target, previous, 150.0, 5.0);
            assert_eq!(limited, (torque, flags), "{target} after {previous}");
        }
    }
}
