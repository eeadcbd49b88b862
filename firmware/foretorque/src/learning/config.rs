use super::doubt::rigid_sigma;
use super::guard_config::SupervisorConfig;
use super::trainer::TrainerConfig;
use crate::arm::Arm;
use crate::dynamics::{FrictionParameters, friction_prior};

/// A configuration that cannot work, with the field that is wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ConfigError {
    /// The field must be a positive, finite number.
    NotPositive(&'static str),
    /// The field is outside `0..1`.
    RateOutOfRange(&'static str),
}

impl core::fmt::Display for ConfigError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::NotPositive(field) => write!(f, "{field} must be positive and finite"),
            Self::RateOutOfRange(field) => write!(f, "{field} must lie between 0 and 1"),
        }
    }
}

impl core::error::Error for ConfigError {}

/// How the learner learns.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LearnerConfig<const N: usize, const P: usize> {
    /// Ticks per second, 1/s.
    pub inv_period: f32,
    /// Standard deviation of the torque measurement that is expected at first, in units of the torque limit.
    pub noise: f32,
    /// Innovations beyond this many standard deviations act as if they had this many.
    pub outlier_sigmas: f32,
    /// What a row of a joint adds to the variance of its friction, in units of the prior's.
    pub process_noise: f32,
    /// Largest change of any joint's torque that a newly published set may make, in units of the torque limit.
    pub torque_step: f32,
    /// Prior standard deviations of the base parameters, in their units.
    pub rigid_sigma: [f32; P],
    /// Prior standard deviations of the friction parameters; 0 where one is not to be learnt.
    pub friction_sigma: [FrictionParameters; N],
    /// Rows of a joint slower than this are skipped (stiction is not a function of velocity), rad/s.
    pub velocity_gate: f32,
    /// Rows in which any joint seems to accelerate faster are refused, rad/s²: the encoder is at fault, not the model.
    pub acceleration_limit: f32,
    /// How the networks are trained.
    pub network: TrainerConfig,
    /// When the guard believes what.
    pub supervisor: SupervisorConfig,
}

impl<const N: usize, const P: usize> LearnerConfig<N, P> {
    /// Defaults for an arm. Prior standard deviations follow from what a joint's drive can do, so that no arm needs
    /// numbers of its own: every link's mass, inertia and rotor are uncertain by 20 % of what the description says, its
    /// centre of mass by 5 % of its distance and 3 mm along each axis; friction as in the table of
    /// [`FrictionColumn`](crate::dynamics::FrictionColumn).
    ///
    /// * `period_s` period of the tick, s
    ///
    /// ```
    /// use foretorque::arm::ur5::{LearnerConfig, Ur5};
    /// const CONFIG: LearnerConfig = LearnerConfig::for_arm::<Ur5>(1e-3);
    /// assert!(CONFIG.validate().is_ok());
    /// ```
    pub const fn for_arm<A: Arm<N, P>>(period_s: f32) -> Self {
        Self {
            inv_period: 1.0 / period_s,
            noise: 0.01,
            outlier_sigmas: 3.0,
            process_noise: 1e-7,
            torque_step: 0.005,
            // Tables: a board need not work them out.
            rigid_sigma: const { rigid_sigma::<A, N, P>() },
            friction_sigma: const { friction_sigma::<A, N, P>() },
            velocity_gate: 0.05,
            acceleration_limit: 100.0,
            network: TrainerConfig {
                output_sigma: 0.02,
                hidden_rate: 1e-4,
                clip_sigmas: 3.0,
            },
            supervisor: SupervisorConfig::for_arm::<A, N, P>(1.0 / period_s),
        }
    }

    /// Every field is usable.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let positive = [
            ("inv_period", self.inv_period),
            ("noise", self.noise),
            ("velocity_gate", self.velocity_gate),
            ("acceleration_limit", self.acceleration_limit),
            ("outlier_sigmas", self.outlier_sigmas),
            ("process_noise", self.process_noise),
            ("torque_step", self.torque_step),
            ("network.clip_sigmas", self.network.clip_sigmas),
        ];
        let rigid = self.rigid_sigma.iter().map(|&s| ("rigid_sigma", s));
        for (field, value) in positive.into_iter().chain(rigid) {
            if !(value > 0.0 && value.is_finite()) {
                return Err(ConfigError::NotPositive(field));
            }
        }
        // A deviation of zero holds its parameter where it is.
        let mut friction = self.friction_sigma.iter().flat_map(|s| s.0);
        if !friction.all(|s| s >= 0.0 && s.is_finite()) {
            return Err(ConfigError::NotPositive("friction_sigma"));
        }
        if !(0.0..1.0).contains(&self.network.output_sigma) {
            return Err(ConfigError::RateOutOfRange("network.output_sigma"));
        }
        if !(0.0..1.0).contains(&self.network.hidden_rate) {
            return Err(ConfigError::RateOutOfRange("network.hidden_rate"));
        }
        self.supervisor.validate()
    }
}

const fn friction_sigma<A: Arm<N, P>, const N: usize, const P: usize>() -> [FrictionParameters; N] {
    let mut sigma = [FrictionParameters::NONE; N];
    let mut joint = 0;
    while joint < N {
        sigma[joint] = friction_prior(&A::LIMITS[joint], A::COGGING_CYCLES[joint]);
        joint += 1;
    }
    sigma
}
