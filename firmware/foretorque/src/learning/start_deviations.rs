use super::parameters::LinearParameters;
use crate::dynamics::FRICTION_COLUMNS;

/// Least part of the prior deviation: drives change after identification.
const LEAST: f32 = 0.05;
/// Parts are stored in bytes.
const UNIT: f32 = 1.0 / u8::MAX as f32;

/// Standard deviations of a set from which learning starts, as parts of the prior deviations in 1/255.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StartDeviations<const N: usize, const P: usize> {
    /// Friction, joint by joint.
    pub friction: [[u8; FRICTION_COLUMNS]; N],
    /// Base parameters.
    pub rigid: [u8; P],
}

impl<const N: usize, const P: usize> StartDeviations<N, P> {
    /// Prior deviations, of a set without deviations of its own.
    pub const PRIOR: Self = Self {
        friction: [[u8::MAX; FRICTION_COLUMNS]; N],
        rigid: [u8::MAX; P],
    };

    /// Part for a parameter of a set: its `deviation`, within 5 % to 100 % of the `prior` one.
    ///
    /// A deviation that is not a positive number gives the prior one.
    pub fn part(deviation: f32, prior: f32) -> u8 {
        let part = deviation / prior;
        if deviation > 0.0 && part < 1.0 {
            let part = if part > LEAST { part } else { LEAST };
            (part / UNIT + 0.5) as u8
        } else {
            u8::MAX
        }
    }

    /// Parts of the prior deviations.
    pub(super) fn parts(&self) -> LinearParameters<N, P> {
        let part = |byte: u8| f32::from(byte) * UNIT;
        LinearParameters {
            friction: self.friction.map(|joint| joint.map(part)),
            rigid: self.rigid.map(part),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_part_lies_within_its_range_whatever_the_deviation() {
        let part = |deviation| StartDeviations::<1, 1>::part(deviation, 2.0);
        for (deviation, expected) in [(0.6, 77), (2.0, 255), (1e-6, 13), (0.0, 255), (-1.0, 255)] {
            assert_eq!(part(deviation), expected, "{deviation}");
        }
        assert_eq!([part(f32::NAN), part(f32::INFINITY)], [255; 2]);
        assert_eq!(StartDeviations::<1, 1>::part(0.1, 0.0), 255);
    }
}
