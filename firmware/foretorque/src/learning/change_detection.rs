use crate::joint::{JointMotion, JointVector, zero_vector};
use crate::limits::cut;

/// Mean residuals of a block, about 10 ms.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Block<const N: usize> {
    /// Motion in the middle of the block.
    pub motion: JointMotion<N>,
    /// Mean residual torque of the estimate, without payload, N × N·m.
    pub residual: JointVector<N>,
    /// True for a joint that moved in every tick.
    pub moving: [bool; N],
}

/// Average of residuals over a [`Block`].
///
/// Innovations of real arms are not white: friction errors last for tenths of a second. A sum over all ticks takes them for
/// a change. Means over 10 ms, each with the weight of one sample, do not.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct BlockAverage<const N: usize> {
    block: Block<N>,
    ticks: u32,
}

impl<const N: usize> BlockAverage<N> {
    pub(super) const fn new() -> Self {
        Self {
            block: Block {
                motion: JointMotion::zero(),
                residual: zero_vector(),
                moving: [true; N],
            },
            ticks: 0,
        }
    }

    pub(super) fn reset(&mut self) {
        *self = Self::new();
    }

    /// Add the residuals of one tick, N·m; returns the block that they complete.
    ///
    /// * `gate` least speed of a moving joint, rad/s      * `length` ticks of a block
    pub(super) fn push(
        &mut self,
        motion: &JointMotion<N>,
        residual: &JointVector<N>,
        gate: f32,
        length: u32,
    ) -> Option<Block<N>> {
        if self.ticks == length / 2 {
            self.block.motion = *motion;
        }
        self.block.residual += residual;
        for (moving, qd) in self.block.moving.iter_mut().zip(motion.qd.iter()) {
            *moving &= qd.abs() >= gate;
        }
        self.ticks += 1;
        if self.ticks < length {
            return None;
        }
        let mut whole = self.block;
        whole.residual *= 1.0 / length as f32;
        self.reset();
        Some(whole)
    }
}

/// Change detection; figures in standard deviations of a joint's block.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DetectorConfig {
    /// Bound of an innovation.
    pub clip: f32,
    /// Drift k: smaller innovations lower the sum.
    pub drift: f32,
    /// Alarm threshold h of the sum.
    pub threshold: f32,
}

/// Two-sided CUSUM of each joint's innovations, for a change of the mean. [Page 1954]
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
    pub(super) const fn new() -> Self {
        Self {
            up: [0.0; N],
            down: [0.0; N],
        }
    }

    /// Add the innovation `z` of `joint`, standard deviations; returns the sum if it is an alarm.
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
    fn a_step_of_the_mean_is_detected_in_both_directions() {
        for sign in [1.0, -1.0] {
            let mut detector = ChangeDetector::<2>::new();
            let after = (1..100).find(|_| detector.push(&CONFIG, 1, sign * 20.0).is_some());
            assert_eq!(after, Some(5));
        }
    }

    #[test]
    fn small_means_and_single_outliers_raise_no_alarm() {
        let mut detector = ChangeDetector::<1>::new();
        for block in 0..100_000 {
            let z = if block % 50 == 0 { 40.0 } else { 0.9 };
            assert_eq!(detector.push(&CONFIG, 0, z), None);
        }
        assert_eq!(detector.push(&CONFIG, 0, f32::NAN), None);
        assert_eq!(detector.push(&CONFIG, 7, 40.0), None);
    }

    #[test]
    fn a_block_is_a_mean_and_moves_if_all_its_ticks_do() {
        let mut average = BlockAverage::<2>::new();
        for tick in 0..10u32 {
            let mut motion = JointMotion::zero();
            motion.q[0] = tick as f32;
            motion.qd[0] = 1.0;
            motion.qd[1] = if tick == 7 { 0.0 } else { -1.0 };
            let residual = JointVector::<2>::new(tick as f32, 2.0);
            let block = average.push(&motion, &residual, 0.05, 10);
            assert_eq!(block.is_some(), tick == 9);
            if let Some(block) = block {
                assert_eq!(block.residual, JointVector::<2>::new(4.5, 2.0));
                assert_eq!(block.motion.q[0], 5.0);
                assert_eq!(block.moving, [true, false]);
            }
        }
    }
}
