use crate::joint::{JointMotion, JointVector, zero_vector};
use crate::limits::cut;

/// What a hundredth of a second leaves unexplained.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Slice<const N: usize> {
    /// Motion in the middle of the slice.
    pub motion: JointMotion<N>,
    /// Mean of what the estimate leaves of the torque of each joint, N·m.
    pub residual: JointVector<N>,
    /// The joint moved all the time.
    pub moving: [bool; N],
}

/// Gathers the residuals of `ticks` ticks into a [`Slice`].
///
/// Innovations of real arms are not white: what is left of friction stays for tenths of a second. Sums that count every
/// tick as news take that for a change; means of a hundredth of a second, each weighed like one sample, do not.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Decimator<const N: usize> {
    slice: Slice<N>,
    gathered: u32,
}

impl<const N: usize> Decimator<N> {
    /// Nothing gathered.
    pub(super) const fn new() -> Self {
        Self {
            slice: Slice {
                motion: JointMotion::zero(),
                residual: zero_vector(),
                moving: [true; N],
            },
            gathered: 0,
        }
    }

    /// Forgets what was gathered: what follows does not join on to it.
    pub(super) fn reset(&mut self) {
        *self = Self::new();
    }

    /// Takes the residuals of one tick, N·m, and returns the slice that they complete.
    ///
    /// * `gate` speed from which on a joint moves, rad/s      * `ticks` length of a slice
    pub(super) fn push(
        &mut self,
        motion: &JointMotion<N>,
        residual: &JointVector<N>,
        gate: f32,
        ticks: u32,
    ) -> Option<Slice<N>> {
        if self.gathered == ticks / 2 {
            self.slice.motion = *motion;
        }
        self.slice.residual += residual;
        for (moving, qd) in self.slice.moving.iter_mut().zip(motion.qd.iter()) {
            *moving &= qd.abs() >= gate;
        }
        self.gathered += 1;
        if self.gathered < ticks {
            return None;
        }
        let mut whole = self.slice;
        whole.residual *= 1.0 / ticks as f32;
        self.reset();
        Some(whole)
    }
}

impl<const N: usize> Default for Decimator<N> {
    fn default() -> Self {
        Self::new()
    }
}

/// When the detector speaks up. In units of a joint's standard deviation and of slices.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DetectorConfig {
    /// Innovations count up to this many standard deviations.
    pub clip: f32,
    /// An innovation below this many standard deviations lowers the sum.
    pub drift: f32,
    /// The sum that is an alarm.
    pub threshold: f32,
}

/// Two-sided cumulative sum of each joint's innovations: notices a change of the mean. [Page 1954]
///
/// ```text
/// up ← max(0, up + clip(z) − k)    down ← max(0, down − clip(z) − k)    alarm when either exceeds h
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ChangeDetector<const N: usize> {
    up: [f32; N],
    down: [f32; N],
}

impl<const N: usize> ChangeDetector<N> {
    /// Sums of zero.
    pub(super) const fn new() -> Self {
        Self {
            up: [0.0; N],
            down: [0.0; N],
        }
    }

    /// Takes the innovation `z` of `joint`, in standard deviations. Returns the sum when it is an alarm.
    pub(super) fn push(&mut self, config: &DetectorConfig, joint: usize, z: f32) -> Option<f32> {
        let (up, down) = (self.up.get_mut(joint)?, self.down.get_mut(joint)?);
        if !z.is_finite() {
            return None;
        }
        let (clipped, _) = cut(z, config.clip);
        *up = above_zero(*up + clipped - config.drift);
        *down = above_zero(*down - clipped - config.drift);
        let sum = if *up > *down { *up } else { *down };
        (sum > config.threshold).then_some(sum)
    }
}

impl<const N: usize> Default for ChangeDetector<N> {
    fn default() -> Self {
        Self::new()
    }
}

fn above_zero(value: f32) -> f32 {
    if value > 0.0 { value } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CONFIG: DetectorConfig = DetectorConfig {
        clip: 3.0,
        drift: 1.0,
        threshold: 8.0,
    };

    #[test]
    fn a_step_of_the_mean_is_noticed_as_fast_as_the_sum_can_grow_and_in_either_direction() {
        for sign in [1.0, -1.0] {
            let mut detector = ChangeDetector::<2>::new();
            let after = (1..100).find(|_| detector.push(&CONFIG, 1, sign * 20.0).is_some());
            assert_eq!(after, Some(5));
        }
    }

    #[test]
    fn a_mean_below_the_drift_and_single_outliers_are_no_alarm() {
        let mut detector = ChangeDetector::<1>::new();
        for slice in 0..100_000 {
            let z = if slice % 50 == 0 { 40.0 } else { 0.9 };
            assert_eq!(detector.push(&CONFIG, 0, z), None);
        }
        assert_eq!(detector.push(&CONFIG, 0, f32::NAN), None);
        assert_eq!(detector.push(&CONFIG, 7, 40.0), None);
    }

    #[test]
    fn a_slice_is_the_mean_of_its_ticks_and_moves_only_if_all_of_them_do() {
        let mut decimator = Decimator::<2>::new();
        for tick in 0..10u32 {
            let mut motion = JointMotion::zero();
            motion.q[0] = tick as f32;
            motion.qd[0] = 1.0;
            motion.qd[1] = if tick == 7 { 0.0 } else { -1.0 };
            let residual = JointVector::<2>::new(tick as f32, 2.0);
            let slice = decimator.push(&motion, &residual, 0.05, 10);
            assert_eq!(slice.is_some(), tick == 9);
            if let Some(slice) = slice {
                assert_eq!(slice.residual, JointVector::<2>::new(4.5, 2.0));
                assert_eq!(slice.motion.q[0], 5.0);
                assert_eq!(slice.moving, [true, false]);
            }
        }
    }
}
