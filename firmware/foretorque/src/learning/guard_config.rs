use super::config::ConfigError;
use super::detector::DetectorConfig;
use crate::arm::Arm;

/// When the guard believes what.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SupervisorConfig {
    /// Ticks of a slice, about a hundredth of a second.
    pub block_ticks: u32,
    /// When innovations are an alarm.
    pub detector: DetectorConfig,
    /// Largest mass that is believed to be a payload, kg.
    pub max_payload_mass: f32,
    /// Smallest mass that is believed to be a payload, kg.
    pub min_payload_mass: f32,
    /// Largest distance of a payload's centre of mass from the origin of the last link, m.
    pub max_com_distance: f32,
    /// Standard deviation of the mass below which a payload is believed, kg.
    pub max_mass_sigma: f32,
    /// Factor on the mean square that slices usually have, while a payload is weighed: residuals of one hundredth of a
    /// second look like those of the next.
    pub block_inflation: f32,
    /// A candidate has to leave less than this part of the mean square residual of the active set.
    pub residual_ratio: f32,
    /// Mean square residual, in variances of a measurement, below which nothing is left to explain.
    pub quiet_level: f32,
    /// Slices in a row for which the evidence has to hold.
    pub decision_blocks: u32,
    /// Slices after which a candidate that has not been believed is refused.
    pub timeout_blocks: u32,
    /// Slices for which a payload is weighed on after it was believed.
    pub payload_update_blocks: u32,
    /// Rows after which an estimate may be followed, if it has proved itself on them: a fifth of a second.
    pub test_rows: u32,
    /// Significance of a proof, in standard deviations.
    pub test_sigmas: f32,
    /// Rows between two commits.
    pub commit_rows: u32,
    /// A joint torque that is off by a common factor on all joints by more than this speaks against the sensors.
    pub gain_error: f32,
    /// Trust figure below which the flag rises.
    pub trust_floor: f32,
}

/// Acceleration of gravity that payloads are scaled by, m/s².
pub(super) const GRAVITY: f32 = 9.81;
/// Share of the torque limit that the weight of the rated payload takes at full stretch. Descriptions do not know the
/// rated payload; a third gives 5.0 kg for the UR5 (data sheet: 5 kg) and 3.3 kg for the Panda (3 kg).
const RATED_SHARE: f32 = 1.0 / 3.0;
/// Time on which an estimate has to prove itself at least, s: what is left of a real torque stays for tenths of a second, so
/// that it is time that proves, not rows.
const PROOF_S: f32 = 0.2;
/// Rows on which it has to do so at least, on a slow board.
const LEAST_PROOF: u32 = 100;
/// Distance from the origin of the last link within which a payload's centre of mass lies, m.
const PAYLOAD_REACH: f32 = 0.25;

/// Distance from joint `joint` to the origin of the last link when all links between lie in one line, m.
const fn stretch<A: Arm<N, P>, const N: usize, const P: usize>(joint: usize) -> f32 {
    let mut length = 0.0;
    let mut later = joint + 1;
    while later < N {
        let [x, y, z] = A::PLACEMENTS[later].origin;
        length += root(x * x + y * y + z * z);
        later += 1;
    }
    length
}

/// Square root by Newton's method, where constants are made; from 0 to a few m².
pub(super) const fn root(square: f32) -> f32 {
    let mut guess = 1.0;
    let mut step = 0;
    while step < 30 {
        guess = 0.5 * (guess + square / guess);
        step += 1;
    }
    guess
}

/// The payload an arm is rated for, kg: the mass whose weight at full stretch takes a third of the torque limit of the
/// joint that gives in first.
pub const fn rated_payload<A: Arm<N, P>, const N: usize, const P: usize>() -> f32 {
    let mut least = 1000.0;
    let mut joint = 0;
    while joint + 1 < N {
        let lever = stretch::<A, N, P>(joint);
        let mass = RATED_SHARE * A::LIMITS[joint].torque / (GRAVITY * lever);
        if mass < least {
            least = mass;
        }
        joint += 1;
    }
    least
}

/// Largest torque of the rated payload on each joint, N·m: its weight and as much again for acceleration, at full
/// stretch, at most 85 % of the limit.
pub const fn payload_bound<A: Arm<N, P>, const N: usize, const P: usize>() -> [f32; N] {
    let mass = rated_payload::<A, N, P>();
    let mut bound = [0.0; N];
    let mut joint = 0;
    while joint < N {
        let lever = stretch::<A, N, P>(joint) + PAYLOAD_REACH;
        let torque = 2.0 * GRAVITY * mass * lever;
        let most = 0.85 * A::LIMITS[joint].torque;
        bound[joint] = if torque < most { torque } else { most };
        joint += 1;
    }
    bound
}

impl SupervisorConfig {
    /// Defaults for an arm.
    ///
    /// * `inv_period` ticks per second, 1/s
    pub const fn for_arm<A: Arm<N, P>, const N: usize, const P: usize>(inv_period: f32) -> Self {
        let block_ticks = (0.01 * inv_period + 0.5) as u32;
        // Each joint of a slice is worked on in a tick of its own.
        let shortest = N as u32 + 1;
        let proof = (PROOF_S * inv_period + 0.5) as u32;
        Self {
            block_ticks: if block_ticks > shortest {
                block_ticks
            } else {
                shortest
            },
            detector: DetectorConfig {
                clip: 9.5,
                drift: 3.2,
                threshold: 25.0,
            },
            max_payload_mass: const { 1.2 * rated_payload::<A, N, P>() },
            min_payload_mass: 0.25,
            max_com_distance: PAYLOAD_REACH,
            max_mass_sigma: 0.15,
            block_inflation: 5.0,
            residual_ratio: 0.6,
            quiet_level: 0.5,
            decision_blocks: 5,
            timeout_blocks: 300,
            payload_update_blocks: 1000,
            test_rows: if proof > LEAST_PROOF {
                proof
            } else {
                LEAST_PROOF
            },
            test_sigmas: 3.0,
            commit_rows: 8000,
            gain_error: 0.08,
            trust_floor: 0.7,
        }
    }

    /// Every field is usable.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let positive = [
            ("supervisor.detector.clip", self.detector.clip),
            ("supervisor.detector.drift", self.detector.drift),
            ("supervisor.detector.threshold", self.detector.threshold),
            ("supervisor.max_payload_mass", self.max_payload_mass),
            ("supervisor.min_payload_mass", self.min_payload_mass),
            ("supervisor.max_com_distance", self.max_com_distance),
            ("supervisor.max_mass_sigma", self.max_mass_sigma),
            ("supervisor.block_inflation", self.block_inflation),
            ("supervisor.residual_ratio", self.residual_ratio),
            ("supervisor.quiet_level", self.quiet_level),
            ("supervisor.test_sigmas", self.test_sigmas),
            ("supervisor.gain_error", self.gain_error),
            ("supervisor.trust_floor", self.trust_floor),
            ("supervisor.block_ticks", self.block_ticks as f32),
            ("supervisor.decision_blocks", self.decision_blocks as f32),
            ("supervisor.timeout_blocks", self.timeout_blocks as f32),
        ];
        for (field, value) in positive {
            if !(value > 0.0 && value.is_finite()) {
                return Err(ConfigError::NotPositive(field));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arm::panda::{self, Panda};
    use crate::arm::ur5::{self, Ur5};

    #[test]
    fn the_rated_payload_is_near_that_of_the_data_sheets() {
        let ur5 = rated_payload::<Ur5, { ur5::JOINTS }, { ur5::PARAMETERS }>();
        let panda = rated_payload::<Panda, { panda::JOINTS }, { panda::PARAMETERS }>();
        assert!((ur5 - 5.0).abs() < 0.3, "{ur5}");
        assert!((panda - 3.0).abs() < 0.5, "{panda}");
    }

    #[test]
    fn the_bound_of_the_payload_holds_its_weight_at_full_stretch_and_less_than_the_joint_can() {
        let bound = payload_bound::<Ur5, { ur5::JOINTS }, { ur5::PARAMETERS }>();
        let weight = 5.0 * 9.81 * (1.0 + 0.13);
        assert!(bound[1] > weight, "{bound:?}");
        for (bound, limits) in bound.iter().zip(&Ur5::LIMITS) {
            assert!(*bound <= 0.85 * limits.torque);
        }
    }
}
