use crate::arm::Arm;
use crate::learning::change_detection::DetectorConfig;
use crate::learning::payload::{Payload, max_com_distance, rated_payload};
use crate::learning::{ConfigError, check_positive};

/// Thresholds of the learning supervisor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SupervisorConfig {
    /// Length of a block, ticks: about 10 ms, and N + 1 at least.
    pub block_ticks: u32,
    /// Change detection.
    pub detector: DetectorConfig,
    /// Largest mass of a payload, kg.
    pub max_payload_mass: f32,
    /// Smallest mass of a payload, kg.
    pub min_payload_mass: f32,
    /// Largest distance of a payload's centre of mass from the origin of the last link, m.
    pub max_com_distance: f32,
    /// Largest standard deviation of the mass of a promoted payload, kg; a tenth of the mass is enough, too.
    pub max_mass_sigma: f32,
    /// Least evidence for a change of the payload, twice a log-likelihood ratio: χ² of seven degrees of freedom exceeds it
    /// with probability 1e-10.
    pub payload_evidence: f32,
    /// Blocks for which errors of the estimate count as constant: 1.5 s.
    pub lasting_blocks: u32,
    /// Mean square residual that counts as fully explained, in variances of a measurement.
    pub quiet_level: f32,
    /// Consecutive blocks for which a condition of the payload test has to hold.
    pub decision_blocks: u32,
    /// Blocks after an alarm until the hypothesis is refused; without one, a window ends that is not on the way to enough
    /// evidence in as many.
    pub timeout_blocks: u32,
    /// Longest window of the payload test, and blocks after promotion for which the payload filter runs on.
    pub payload_update_blocks: u32,
    /// Memory of the evidence for the learnt shares, s: longer than a path takes to show a joint its range.
    pub share_memory_s: f32,
    /// Length of relearning, ticks: 5 s, several times the memory of the measured variance.
    pub relearning_ticks: u32,
    /// Ticks between two commits while following: 8 s; a quarter of it before the first.
    pub commit_ticks: u32,
    /// Common share above which the active set counts as following the estimate, and below which it ceases to.
    pub following_share: (f32, f32),
    /// Ticks between two checkpoints: 0.128 s at 1 kHz, and four blocks at least. An alarm returns to one between one and two such
    /// times old, which is longer than the delay of change detection.
    pub checkpoint_ticks: u32,
    /// Variance added to each friction parameter in a turn of relearning, in units of the prior variance.
    pub raised_variance: f32,
    /// Blocks under a payload after which the estimate is updated again: 30 s, in which drives warm up.
    pub pause_blocks: u32,
    /// Rows of all joints that show the arm as it is: after them, torques that oppose the loaded set are reversed, and networks
    /// are trained on the residual of a joint whose learnt share stays small.
    pub training_rows: u32,
    /// Trust below which the flag is set.
    pub trust_floor: f32,
}

impl SupervisorConfig {
    /// Thresholds of a learner that has none yet; they do not validate.
    pub(in crate::learning) const ZERO: Self = Self {
        block_ticks: 0,
        detector: DetectorConfig {
            clip: 0.0,
            drift: 0.0,
            threshold: 0.0,
        },
        max_payload_mass: 0.0,
        min_payload_mass: 0.0,
        max_com_distance: 0.0,
        max_mass_sigma: 0.0,
        payload_evidence: 0.0,
        lasting_blocks: 0,
        quiet_level: 0.0,
        decision_blocks: 0,
        timeout_blocks: 0,
        payload_update_blocks: 0,
        share_memory_s: 0.0,
        relearning_ticks: 0,
        commit_ticks: 0,
        following_share: (0.0, 0.0),
        checkpoint_ticks: 0,
        raised_variance: 0.0,
        pause_blocks: 0,
        training_rows: 0,
        trust_floor: 0.0,
    };

    /// Defaults for an arm.
    ///
    /// * `inv_period` ticks per second, 1/s
    pub fn for_arm<A: Arm<N, P>, const N: usize, const P: usize>(inv_period: f32) -> Self {
        Self::for_sensor::<A, N, P>(inv_period, 1)
    }

    /// Defaults for an arm that is measured every `ticks` ticks. A block has two measurements at least: of fewer, neighbouring blocks
    /// repeat the same disturbance, and change detection takes it for a change.
    ///
    /// * `inv_period` ticks per second, 1/s
    pub fn for_sensor<A: Arm<N, P>, const N: usize, const P: usize>(
        inv_period: f32,
        ticks: u32,
    ) -> Self {
        // Each joint of a block is processed in a tick of its own.
        let usual = ((0.01 * inv_period + 0.5) as u32).max(N as u32 + 1);
        let block_ticks = usual.max(ticks.saturating_mul(2));
        let blocks = |time_s: f32| (time_s * inv_period / block_ticks as f32 + 0.5).max(1.0) as u32;
        let rated = rated_payload::<A, N, P>();
        Self {
            block_ticks,
            detector: DetectorConfig {
                clip: 9.5,
                drift: 3.2,
                threshold: 25.0,
            },
            max_payload_mass: 1.2 * rated,
            min_payload_mass: 0.05 * rated,
            max_com_distance: max_com_distance::<A, N, P>(),
            max_mass_sigma: 0.03 * rated,
            payload_evidence: 60.0,
            lasting_blocks: blocks(1.5),
            quiet_level: 0.5,
            decision_blocks: 5,
            timeout_blocks: blocks(3.0),
            payload_update_blocks: blocks(10.0),
            share_memory_s: 20.0,
            relearning_ticks: (5.0 * inv_period) as u32,
            commit_ticks: (8.0 * inv_period) as u32,
            following_share: (0.5, 0.25),
            checkpoint_ticks: ((12.8 * usual as f32) as u32).max(block_ticks.saturating_mul(4)),
            raised_variance: 0.05,
            pause_blocks: blocks(30.0),
            training_rows: 4096,
            trust_floor: 0.7,
        }
    }

    /// True if `change` of the payload is a body within the limits of mass and distance, picked up or put down.
    pub(crate) fn is_body(&self, change: &Payload) -> bool {
        let [mass, x, y, z, ..] = *change;
        let first = self.max_com_distance * mass;
        let mass = mass.abs();
        mass >= self.min_payload_mass
            && mass <= self.max_payload_mass
            && x * x + y * y + z * z <= first * first
    }

    /// Check of every field.
    ///
    /// Errors: the first field that is not positive and finite.
    pub fn validate(&self) -> Result<(), ConfigError> {
        check_positive(&[
            ("detector.clip", self.detector.clip),
            ("detector.drift", self.detector.drift),
            ("detector.threshold", self.detector.threshold),
            ("max_payload_mass", self.max_payload_mass),
            ("min_payload_mass", self.min_payload_mass),
            ("max_com_distance", self.max_com_distance),
            ("max_mass_sigma", self.max_mass_sigma),
            ("payload_evidence", self.payload_evidence),
            ("lasting_blocks", self.lasting_blocks as f32),
            ("quiet_level", self.quiet_level),
            ("share_memory_s", self.share_memory_s),
            ("trust_floor", self.trust_floor),
            ("following_share", self.following_share.1),
            ("raised_variance", self.raised_variance),
            ("checkpoint_ticks", self.checkpoint_ticks as f32),
            ("block_ticks", self.block_ticks as f32),
            ("decision_blocks", self.decision_blocks as f32),
            ("timeout_blocks", self.timeout_blocks as f32),
            ("payload_update_blocks", self.payload_update_blocks as f32),
            ("pause_blocks", self.pause_blocks as f32),
            ("relearning_ticks", self.relearning_ticks as f32),
            ("commit_ticks", self.commit_ticks as f32),
            ("training_rows", self.training_rows as f32),
            ("following_share", self.following_share.0),
        ])
    }
}

#[cfg(test)]
mod tests {
    use crate::arm::ur5::{LearnerConfig, Ur5};

    #[test]
    fn a_block_is_ten_milliseconds_and_has_a_tick_for_every_joint() {
        for (period_s, ticks) in [(250e-6, 40), (1e-3, 10), (1.4e-3, 7), (4e-3, 7), (20e-3, 7)] {
            let config = LearnerConfig::for_arm::<Ur5>(period_s);
            assert_eq!(config.supervisor.block_ticks, ticks, "{period_s} s");
            let test_s = (config.supervisor.timeout_blocks * ticks) as f32 * period_s;
            assert!((test_s / 3.0 - 1.0).abs() < 0.05, "{test_s} s");
        }
    }
}
