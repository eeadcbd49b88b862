//! Incremental learning in the slack of the tick.
//!
//! The tick hands over one [`LearningSample`] a tick; the [`Learner`] works through them at its own pace and lays a finished
//! [`ParameterSet`] on the [`Exchange`] desk after every round of `N` ticks, in which each joint had one row. The tick
//! takes the set at a fixed tick of the next round, never earlier, so the torque does not depend on how fast the
//! learner was.

mod conditioning;
mod config;
mod decision;
mod detector;
mod doubt;
mod estimator;
mod evidence;
mod exchange;
mod guard;
mod guard_config;
mod learner;
mod monitor;
mod parameters;
mod payload;
mod quality;
mod request;
mod small_filter;
mod stacked;
mod trainer;
mod trial;
mod ud;

pub use conditioning::{
    ConditionedSample, DELAY, MAX_BRIDGED, MeasurementWindow, TAPS, cogging_attenuation,
};
pub use config::{ConfigError, LearnerConfig};
pub use decision::{DECISION_CAPACITY, Decision, DecisionLog, Reason};
pub use detector::DetectorConfig;
pub use doubt::{prior_factor, prior_factor_count, prior_floor};
pub use estimator::{Correction, Estimator, torque_row};
pub use exchange::{Exchange, LearnerReport, LearningSample, MotionRange, Publication};
pub use guard_config::{SupervisorConfig, payload_bound, rated_payload};
pub use learner::{Learner, LearnerState, LearnerStatistics};
pub(crate) use parameters::network_inputs_at;
pub use parameters::{
    JointNetwork, NETWORK_BOUND, NETWORK_HIDDEN, NETWORK_INPUTS, ParameterSet, network_inputs,
};
pub use quality::{ModelQuality, PayloadEstimate, Phase};
pub use request::{Request, RequestPending};
pub use stacked::LinearParameters;
pub use trainer::TrainerConfig;
pub use ud::UdFilter;
