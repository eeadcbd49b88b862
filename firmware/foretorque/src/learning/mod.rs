//! Incremental learning in the slack of the tick.
//!
//! The tick passes one [`LearningSample`] to the [`Learner`], which processes it at its own pace: one torque row a tick, of
//! joint `tick % N`. After each round of `N` ticks the learner publishes a [`ParameterSet`] in the [`Exchange`]. The tick
//! adopts it at a fixed tick of the next round, so the torque does not depend on the learner's speed.
//!
//! # Parameter sets
//!
//! | set | content | written by | read by | changes |
//! |---|---|---|---|---|
//! | nominal | rigid body of the description | `host-sim generate`, as constants of the [arm](crate::arm) | first prior, load friction | with a new build |
//! | prior | start of learning | learner, on load | estimate and networks at their start | at every load |
//! | loaded | set of the last load | tick, on load | tick: origin of the learnt change | at every load |
//! | active | parameters of the torque | supervisor; adopted by the tick | tick | at most once a round |
//! | committed | last set accepted as a whole | supervisor, on commit; tick, on load | tick: fallback, centre of the bound on learnt change; paired test: reference | on commit, at every load |
//! | estimate | linear parameters of the [`Estimator`] | estimator; supervisor, on rollback | supervisor, change detection | with every accepted row |
//! | checkpoint | estimate, active, committed and payload of one instant | supervisor, while healthy | supervisor: alarm, emergency stop, release of a payload | every 128 ticks; two are kept, and one from before a payload |
//! | snapshot | copy of the active set | [`Request::Snapshot`] | [`Request::Rollback`] | on request |
//! | network candidate | network of a joint in training | trainer | trainer: comparison with the active network | with every accepted row of the joint |
//! | payload hypothesis | seven parameters of a body at the last link | payload test | supervisor; after promotion the tick, as an addition to the rigid body | every block of a test, and for 10 s after promotion |
//!
//! # Supervisor
//!
//! States are those of [`Phase`], arrows carry the code of their [`Reason`], thresholds are the defaults of
//! [`SupervisorConfig`] at 1 kHz.
//!
//! ```text
//!          ┌────────────────────── 0 Healthy ──────────────────────┐
//!          │                                                       │   CUSUM > 25 (1)   ┌────────────────┐
//! start ───┼──► holding ─── t > 3, joints pass (25) ──► following  ├───────────────────►│ 1 PayloadTest  │
//!          │       ▲                                     │   │  ▲  │◄──── 2, 6, 8 ──────│   at most 3 s  │
//!          │       └──────────── t < −3 (7) ─────────────┘   └──┘  │                    └───────┬────────┘
//!          │                                          commit (9)   │                            │ refused (3, 4, 5)
//!          │                                                       │   5000 ticks (19)  ┌───────▼────────┐
//!          │                                                       │◄───────────────────│ 2 Relearning   │
//!          └───────────────────────────────────────────────────────┘                    └────────────────┘
//! every state ── emergency stop (16) ──► 3 Stopped ── learning off (17) ──► 0 Healthy
//! ```
//!
//! * following: the active set moves to the estimate, by at most 0.5 % of the torque limit a round. Holding: it stays.
//! * t: paired test of the estimate against the committed set on at least 200 rows (3000 while relearning). A joint passes
//!   if it has 200 rows of its own and is not worse, or if its torque at standstill hardly changes.
//! * commit: after 8 s of following, or 2 s with less than 0.36 of the squares. Following continues only if t > 3.
//! * alarm: estimate and active set return to the checkpoint of 128 to 256 ticks ago; both are frozen during the test.
//! * payload test: five blocks of 10 ms in a row decide for a payload (2), its release (8), or a transient (6).
//! * relearning: the variance of friction is raised; following begins as from holding.
//!
//! A saturated torque, an unbridged gap or a number that is not finite freezes learning in every state (13 to 15); it
//! resumes 31 ticks after the last cause (17).

mod change_detection;
mod conditioning;
mod config;
mod consts;
mod decision;
mod dense_ud;
mod error;
mod estimator;
mod exchange;
mod learner;
mod parameters;
mod payload;
mod prior_covariance;
mod quality;
mod start_deviations;
mod supervisor;
mod trainer;
mod ud;

pub use change_detection::DetectorConfig;
pub use conditioning::{
    ConditionedSample, DELAY, MAX_BRIDGED, MeasurementWindow, TAPS, cogging_attenuation,
};
pub use config::LearnerConfig;
pub use decision::{DECISION_CAPACITY, Decision, DecisionLog, Reason};
pub use error::ConfigError;
pub use estimator::{Correction, Estimator, torque_row};
pub use exchange::{
    Exchange, LearnerReport, LearningSample, MotionRange, Publication, Request, RequestPending,
};
pub use learner::{Learner, LearnerState, LearnerStatistics};
pub(crate) use parameters::network_inputs_at;
pub use parameters::{
    JointNetwork, LinearParameters, NETWORK_BOUND, NETWORK_HIDDEN, NETWORK_INPUTS, ParameterSet,
    network_inputs,
};
pub use payload::{payload_bound, rated_payload};
pub use prior_covariance::{prior_factor, prior_factor_count, prior_floor};
pub use quality::{ModelQuality, PayloadEstimate, Phase};
pub use start_deviations::StartDeviations;
pub use supervisor::config::SupervisorConfig;
pub use trainer::TrainerConfig;
pub use ud::UdFilter;
