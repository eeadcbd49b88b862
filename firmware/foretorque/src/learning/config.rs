use super::conditioning::{LEAST_DELAY, MOST_DELAY, TAPS, taps};
use super::parameters::LinearParameters;
use super::prior_covariance::rigid_sigma;
use super::supervisor::config::SupervisorConfig;
use super::trainer::TrainerConfig;
use super::{ConfigError, check_positive};
use crate::arm::{Arm, ArmModel, table};
use crate::dynamics::{FRICTION_COLUMNS, friction_prior};
use core::ops::RangeInclusive;

/// Time in motion in which friction as large as its prior standard deviation changes by that with temperature, grease and
/// wear, s: 17 hours.
const FRICTION_CHANGE_S: f32 = 6e4;

/// Accepted periods of the tick, s. Milliseconds in place of seconds are outside.
pub(super) const PERIODS_S: RangeInclusive<f32> = 1e-5..=0.1;
/// Length of a sample of the motion filter, s.
const SAMPLE_S: f32 = 2e-3;
/// Largest length of a sample of the motion filter, s, for coarse encoders and noisy positions: longer filters flatten the motion
/// of the arm.
pub const LONGEST_SAMPLE_S: f32 = 8e-3;
/// Time over which disturbances of rows are correlated: rows of 6 joints at 1 kHz have at least three times the noise of
/// independent ones on real arms.
const ROWS_CORRELATED_S: f32 = 6e-3;
/// Fastest change of the torque of any joint by newly published sets, torque limits a second: learnt torque, at most a fifth of
/// the limit, leaves within 0.24 s.
const TORQUE_RATE: f32 = 5.0 / 6.0;
/// Least speed of a joint whose rows are used, rad/s.
const VELOCITY_GATE: f32 = 0.05;
/// Least steps of an encoder within the motion filter at that speed. Rounding errs the fitted velocity by at most 1.5 steps
/// a filter length: 3/8 of that speed.
const GATE_STEPS: f32 = 4.0;

/// Assumed standard deviation of a torque measurement, in units of the torque limit.
pub const TORQUE_NOISE: f32 = 0.01;

/// Configuration of the learner.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LearnerConfig<const N: usize, const P: usize> {
    /// Ticks per second, 1/s: 10 to 1e5.
    pub inv_period: f32,
    /// Assumed standard deviation of a torque measurement, in units of the torque limit.
    pub noise: f32,
    /// Bound of an innovation, standard deviations; larger ones count as this many, and leave the covariance as it is.
    pub outlier_sigmas: f32,
    /// Factor on the noise of a row in the update of the estimate, because rows are correlated: the least of real arms with
    /// 6 joints, 3, and more for rows that follow one another sooner. The measured correlation is no measure of it: errors of
    /// the estimate are correlated, too. They would count as noise where the prior is too narrow, slow the estimate down, and
    /// so last.
    pub noise_inflation: f32,
    /// Ticks averaged to one sample of the motion filter: samples of 2 ms, so that the filter is 62 ms long; up to 8 ms, and
    /// so 248 ms, for an encoder with less than four steps in the filter at 0.05 rad/s.
    pub decimation: u32,
    /// Delay of the motion filter, samples: 15, and 2 at least; fewer where a tick is longer than a sample, for the filter to
    /// keep its length.
    pub delay: u32,
    /// Time over which residuals are correlated at most, s: tenths of a second on real arms. Length of a block of rows that
    /// counts as one observation.
    pub correlation_s: f32,
    /// Process noise of a friction parameter for each row of the joint, in units of the prior variance, if its mean square
    /// E\[p²\] is at least that variance; in proportion to E\[p²\] below. That of an offset is constant.
    pub process_noise: f32,
    /// Largest torque change of any joint by a newly published set, in units of the torque limit.
    pub torque_step: f32,
    /// Prior standard deviations, in the units of the parameters; 0 keeps a friction parameter at its prior.
    pub sigma: LinearParameters<N, P>,
    /// Least speed of a joint whose rows are used, rad/s: stiction is not a function of velocity. Faster where the motion filter
    /// has less than four steps of the encoder at this speed.
    pub velocity_gate: f32,
    /// Largest plausible acceleration, rad/s²; beyond it an encoder error is assumed and rows of all joints are rejected.
    pub acceleration_limit: f32,
    /// Training of the networks.
    pub network: TrainerConfig,
    /// Thresholds of the supervisor.
    pub supervisor: SupervisorConfig,
}

impl<const N: usize, const P: usize> LearnerConfig<N, P> {
    /// Configuration of a learner that has none yet; it does not validate.
    pub(super) const ZERO: Self = Self {
        inv_period: 0.0,
        noise: 0.0,
        outlier_sigmas: 0.0,
        noise_inflation: 0.0,
        decimation: 0,
        delay: 0,
        correlation_s: 0.0,
        process_noise: 0.0,
        torque_step: 0.0,
        sigma: LinearParameters::filled(0.0),
        velocity_gate: 0.0,
        acceleration_limit: 0.0,
        network: TrainerConfig {
            output_sigma: 0.0,
            hidden_rate: 0.0,
            clip_sigmas: 0.0,
            memory_rows: 0.0,
        },
        supervisor: SupervisorConfig::ZERO,
    };

    /// Defaults for an arm; prior standard deviations follow from the description and the limits of the joints.
    ///
    /// Mass and inertia of a link: 20 % of the description; rotor: 20 %, and 5 % of the torque limit at 10 rad/s²; centre of
    /// mass: 5 % of its distance and 3 mm along each axis; friction: table of [`FrictionColumn`](crate::dynamics::FrictionColumn).
    ///
    /// * `period_s` period of the tick, s; it validates from 10 µs to 0.1 s
    ///
    /// ```
    /// use foretorque::arm::ur5::{LearnerConfig, Ur5};
    /// let config: LearnerConfig = LearnerConfig::for_arm::<Ur5>(1e-3);
    /// assert!(config.validate().is_ok());
    /// ```
    pub fn for_arm<A: Arm<N, P>>(period_s: f32) -> Self {
        let supervisor = SupervisorConfig::for_arm::<A, N, P>(1.0 / period_s);
        let (decimation, delay) = motion_filter(period_s, A::encoder_step());
        let filter_s = taps(delay).saturating_mul(decimation) as f32 * period_s;
        Self {
            inv_period: 1.0 / period_s,
            noise: TORQUE_NOISE,
            outlier_sigmas: 3.0,
            noise_inflation: noise_inflation::<N>(decimation, period_s),
            decimation,
            delay,
            correlation_s: 0.5,
            process_noise: N as f32 * period_s / FRICTION_CHANGE_S,
            torque_step: TORQUE_RATE * N as f32 * period_s,
            // Tables, so that a board does not compute them.
            sigma: LinearParameters {
                friction: table!(A, friction_sigma),
                rigid: table!(A, rigid_sigma),
            },
            velocity_gate: velocity_gate(A::encoder_step(), filter_s),
            acceleration_limit: 100.0,
            network: TrainerConfig {
                output_sigma: 0.02,
                hidden_rate: 1e-4,
                clip_sigmas: 3.0,
                memory_rows: supervisor.share_memory_s / (period_s * N as f32),
            },
            supervisor,
        }
    }

    /// Lengthen the samples of the motion filter to `decimation` ticks, with the noise of their rows.
    pub fn lengthen_samples(&mut self, decimation: u32) {
        self.decimation = decimation;
        self.noise_inflation = noise_inflation::<N>(decimation, 1.0 / self.inv_period);
    }

    /// Length of the motion filter, ticks.
    pub(super) fn filter_ticks(&self) -> u32 {
        taps(self.delay).saturating_mul(self.decimation)
    }

    /// Rows of a joint in the correlation time.
    pub(super) fn block_rows(&self) -> f32 {
        self.correlation_s * self.inv_period / N as f32
    }

    /// Part of the evidence for the shares that lasts over a change: as much as one block of correlated rows.
    pub(super) fn lasting_part(&self) -> f32 {
        self.correlation_s / self.supervisor.share_memory_s
    }

    /// Check of every field.
    ///
    /// Errors: the first invalid field.
    pub fn validate(&self) -> Result<(), ConfigError> {
        check_positive(&[
            ("inv_period", self.inv_period),
            ("noise", self.noise),
            ("velocity_gate", self.velocity_gate),
            ("acceleration_limit", self.acceleration_limit),
            ("outlier_sigmas", self.outlier_sigmas),
            ("noise_inflation", self.noise_inflation),
            ("decimation", self.decimation as f32),
            ("correlation_s", self.correlation_s),
            ("process_noise", self.process_noise),
            ("torque_step", self.torque_step),
            ("clip_sigmas", self.network.clip_sigmas),
            ("memory_rows", self.network.memory_rows),
        ])?;
        if !PERIODS_S.contains(&(1.0 / self.inv_period)) {
            return Err(ConfigError::TooLarge("inv_period"));
        }
        if !(LEAST_DELAY..=MOST_DELAY).contains(&self.delay) {
            return Err(ConfigError::TooLarge("delay"));
        }
        let [friction, rigid] = self.sigma.parts();
        for &sigma in rigid {
            check_positive(&[("sigma.rigid", sigma)])?;
        }
        if !friction.iter().all(|&s| s >= 0.0 && s.is_finite()) {
            return Err(ConfigError::NotPositive("sigma.friction"));
        }
        if !(0.0..1.0).contains(&self.network.output_sigma) {
            return Err(ConfigError::RateOutOfRange("output_sigma"));
        }
        if !(0.0..1.0).contains(&self.network.hidden_rate) {
            return Err(ConfigError::RateOutOfRange("hidden_rate"));
        }
        self.supervisor.validate()
    }
}

/// Ticks of a sample of the motion filter for an encoder of the step `encoder_step`, rad, and the delay of the filter,
/// samples.
fn motion_filter(period_s: f32, encoder_step: f32) -> (u32, u32) {
    let resolved_s = GATE_STEPS / (VELOCITY_GATE * TAPS as f32) * encoder_step;
    let ticks = resolved_s.clamp(SAMPLE_S, LONGEST_SAMPLE_S) / period_s;
    let whole = (ticks + 0.5) as u32;
    // The delay of a filter as long as 31 samples of `ticks`, to the nearest whole number.
    let delay = (0.5 * TAPS as f32 * ticks) as u32;
    match whole {
        0 | 1 => (1, delay.clamp(LEAST_DELAY, MOST_DELAY)),
        _ => (whole, MOST_DELAY),
    }
}

/// Factor on the noise of rows of samples of `decimation` ticks: a joint has a row in N ticks, and not sooner than its samples.
fn noise_inflation<const N: usize>(decimation: u32, period_s: f32) -> f32 {
    let row_s = (N as u32).max(decimation) as f32 * period_s;
    (1.0 + 2.0 * ROWS_CORRELATED_S / row_s).max(3.0)
}

/// Least speed, rad/s, for an encoder of the step `encoder_step`, rad, and a motion filter of `filter_s`.
fn velocity_gate(encoder_step: f32, filter_s: f32) -> f32 {
    VELOCITY_GATE.max(GATE_STEPS * encoder_step / filter_s)
}

const fn friction_sigma<const N: usize, const P: usize>(
    arm: &ArmModel<N, P>,
) -> [[f32; FRICTION_COLUMNS]; N] {
    let mut sigma = [[0.0; FRICTION_COLUMNS]; N];
    let mut joint = 0;
    while joint < N {
        sigma[joint] = friction_prior(&arm.limits[joint], arm.cogging_cycles[joint]).0;
        joint += 1;
    }
    sigma
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_and_checkpoints_follow_the_period() {
        use crate::arm::ur5::Ur5;
        for period_s in [2.5e-4, 1e-3, 1e-2] {
            let config = LearnerConfig::for_arm::<Ur5>(period_s);
            let rate = config.torque_step / (6.0 * period_s);
            assert!((rate - TORQUE_RATE).abs() < 1e-6, "{period_s}");
            let supervisor = config.supervisor;
            let checkpoint = supervisor.checkpoint_ticks as f32 / supervisor.block_ticks as f32;
            assert!((12.0..13.0).contains(&checkpoint), "{checkpoint}");
        }
    }

    #[test]
    fn a_short_filter_of_a_coarse_encoder_has_a_faster_gate() {
        let gate = |bits| velocity_gate(core::f32::consts::TAU / 2_f32.powi(bits), 31e-3);
        assert_eq!(gate(17), VELOCITY_GATE);
        assert!((gate(12) - 0.198).abs() < 1e-3, "{}", gate(12));
    }

    #[test]
    fn the_motion_filter_is_a_time_and_longer_for_a_coarse_encoder() {
        let step = |bits| core::f32::consts::TAU / 2_f32.powi(bits);
        let samples = |period_s, bits| motion_filter(period_s, step(bits));
        let ticks = |period_s, bits| samples(period_s, bits).0;
        assert_eq!(
            [17, 13, 12, 11, 8].map(|bits| ticks(1e-3, bits)),
            [2, 2, 4, 8, 8]
        );
        assert_eq!([17, 12].map(|bits| ticks(1.25e-4, bits)), [16, 32]);
        assert_eq!(motion_filter(1e-3, 0.0), (2, 15));
        for (period_s, filter) in [
            (2e-3, (1, 15)),
            (4e-3, (1, 7)),
            (10e-3, (1, 3)),
            (20e-3, (1, 2)),
        ] {
            assert_eq!(samples(period_s, 17), filter, "{period_s} s");
        }
        assert_eq!(samples(4e-3, 12), (1, 15));
    }
}
