//! Scaled integers of the cyclic frames: resolution 2^-BITS, saturating, with one code for "not a number".

use foretorque::math::nearest;
use serde::{Deserialize, Serialize};

/// Signed integer of `BYTES` bytes in units of 2^-BITS, little endian on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Scaled<const BYTES: usize, const BITS: u32>(#[serde(with = "super::array")] [u8; BYTES]);

/// Joint position, resolution 2^-20 rad (0.95 µrad, a fiftieth of a 17-bit encoder's count), range ±8 rad.
pub type Position = Scaled<3, 20>;

/// Joint velocity, resolution 2^-18 rad/s (3.8 µrad/s), range ±32 rad/s.
///
/// Sixteen bits over ±16 rad/s would step by 0.5 mrad/s. At standstill the smoothed Coulomb torque has the slope
/// F_c / 0.01 rad/s; with F_c = 8 N·m that step would be 0.4 N·m of torque noise. With 24 bits it is 3 mN·m.
pub type Velocity = Scaled<3, 18>;

/// Joint acceleration, resolution 2^-9 rad/s² (2 mrad/s²), range ±64 rad/s².
///
/// Half a step at the 3 kg·m² of a stretched UR5's first joint is 3 mN·m, 2e-5 of the torque limit of this joint.
pub type Acceleration = Scaled<2, 9>;

/// Joint torque in N·m or motor current in A, resolution 2^-14 (61 µN·m, 61 µA), range ±512.
pub type Effort = Scaled<3, 14>;

impl<const BYTES: usize, const BITS: u32> Scaled<BYTES, BITS> {
    /// Largest magnitude; the code below `-MAX_CODE` means "not a number".
    const MAX_CODE: i32 = i32::MAX >> Self::SHIFT;
    const NAN_CODE: i32 = i32::MIN >> Self::SHIFT;
    const SHIFT: usize = 32 - 8 * BYTES;
    const UNITS: f32 = (1u32 << BITS) as f32;

    /// Step between neighbouring values.
    pub const RESOLUTION: f32 = 1.0 / Self::UNITS;
    /// Largest value.
    pub const MAX: f32 = Self::MAX_CODE as f32 / Self::UNITS;

    /// The nearest code. Saturates at ±[`MAX`](Self::MAX); NaN stays NaN.
    // A board encodes only while it plays an excitation; inlined for each joint this takes 1 kB of flash.
    #[inline(never)]
    pub fn encode(x: f32) -> Self {
        let code = if x.is_nan() {
            Self::NAN_CODE
        } else {
            nearest(x * Self::UNITS).clamp(-Self::MAX_CODE, Self::MAX_CODE)
        };
        let mut bytes = [0; BYTES];
        for (byte, part) in bytes.iter_mut().zip(code.to_le_bytes()) {
            *byte = part;
        }
        Self(bytes)
    }

    /// The value, exactly: 24 bits fit the mantissa of f32.
    pub fn decode(self) -> f32 {
        // The code goes into the upper bytes, so that the shift back extends the sign.
        let mut upper = [0; 4];
        for (byte, part) in upper.iter_mut().rev().zip(self.0.into_iter().rev()) {
            *byte = part;
        }
        let code = i32::from_le_bytes(upper) >> Self::SHIFT;
        if code == Self::NAN_CODE {
            f32::NAN
        } else {
            code as f32 * Self::RESOLUTION
        }
    }
}

impl<const BYTES: usize, const BITS: u32> Default for Scaled<BYTES, BITS> {
    fn default() -> Self {
        Self([0; BYTES])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_code_comes_back() {
        for code in -8_388_607..=8_388_607 {
            let x = code as f32 / 1_048_576.0;
            assert_eq!(Position::encode(x).decode(), x);
        }
        for code in -32_767..=32_767 {
            let x = code as f32 / 512.0;
            assert_eq!(Acceleration::encode(x).decode(), x);
        }
    }

    #[test]
    fn values_out_of_range_saturate_and_nan_stays_nan() {
        for x in [8.0, 9.0, 1e30, f32::INFINITY] {
            assert_eq!(Position::encode(x).decode(), Position::MAX);
            assert_eq!(Position::encode(-x).decode(), -Position::MAX);
        }
        assert_eq!(Acceleration::encode(1e9).decode(), Acceleration::MAX);
        assert_eq!(Acceleration::encode(-1e9).decode(), -Acceleration::MAX);
        assert!(Position::encode(f32::NAN).decode().is_nan());
        assert!(Acceleration::encode(f32::NAN).decode().is_nan());
    }

    #[test]
    fn rounding_errs_by_half_a_step_at_most() {
        for k in -100_000..100_000 {
            let x = k as f32 * 3.1e-4;
            assert!((Velocity::encode(x).decode() - x).abs() <= 0.5 * Velocity::RESOLUTION);
            assert!((Acceleration::encode(x).decode() - x).abs() <= 0.5 * Acceleration::RESOLUTION);
        }
    }
}
