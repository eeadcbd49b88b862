//! Incremental learning in the slack of the tick.
//!
//! The tick passes one [`LearningSample`] to the [`Learner`], which processes it at its own pace: one torque row a tick, of
//! joint `tick % N`. After each round of `N` ticks the learner publishes a [`ParameterSet`] in the [`Exchange`]. The tick
//! adopts it at a fixed tick of the next round, so the torque does not depend on the learner's speed.
//!
//! The tables of the parameter sets, of the supervisor's transitions, thresholds and reason codes, and the equations of the
//! shares are in `docs/learning.md` of the repository. One pure function decides: state and evidence in, state and action
//! out.

mod change_detection;
mod conditioning;
mod config;
mod decision;
mod dense_ud;
mod estimator;
mod exchange;
mod learner;
mod parameters;
mod payload;
mod prior_covariance;
mod quality;
mod shares;
mod supervisor;
mod trainer;
mod ud;

pub use change_detection::DetectorConfig;
pub use conditioning::{
    ConditionedSample, DELAY, MAX_BRIDGED, MeasurementWindow, TAPS, cogging_attenuation,
};
pub use config::{LONGEST_SAMPLE_S, LearnerConfig, TORQUE_NOISE};
pub use decision::{DECISION_CAPACITY, Decision, DecisionLog, Reason};
pub use estimator::{Estimator, torque_row};
pub use exchange::{
    Exchange, LearnerReport, LearningSample, MotionRange, Publication, Request, RequestPending,
};
pub use learner::{Learner, LearnerState, LearnerStatistics};
pub use parameters::{
    JointNetwork, LinearParameters, NETWORK_BOUND, NETWORK_HIDDEN, NETWORK_INPUTS, ParameterSet,
    StartDeviations, network_inputs,
};
pub(crate) use parameters::{network_inputs_at, network_output};
pub use payload::{PAYLOAD_PART, RATED_COM_DISTANCE, payload_bound, rated_payload};
pub use prior_covariance::{prior_factor, prior_factor_count, prior_floor};
pub use quality::{ModelQuality, PayloadEstimate, Phase};
pub use shares::LearntShare;
pub use supervisor::config::SupervisorConfig;
pub use trainer::TrainerConfig;
pub use ud::UdFilter;

/// Invalid field of a configuration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ConfigError {
    /// The field is not a positive, finite number.
    NotPositive(&'static str),
    /// The field lies outside `0..1`.
    RateOutOfRange(&'static str),
    /// The field is beyond the bound in its documentation.
    TooLarge(&'static str),
}

impl core::fmt::Display for ConfigError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::NotPositive(field) => write!(f, "{field} must be positive and finite"),
            Self::RateOutOfRange(field) => write!(f, "{field} must lie between 0 and 1"),
            Self::TooLarge(field) => write!(f, "{field} is beyond the bound in its documentation"),
        }
    }
}

impl core::error::Error for ConfigError {}

/// Check of named fields; the first one that is not positive and finite is the error.
#[inline(never)]
pub(crate) fn check_positive(fields: &[(&'static str, f32)]) -> Result<(), ConfigError> {
    let is_bad = |value: f32| !(value > 0.0 && value <= f32::MAX);
    let bad = fields.iter().find(|(_, value)| is_bad(*value));
    bad.map_or(Ok(()), |(field, _)| Err(ConfigError::NotPositive(field)))
}
