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
//! | loaded | set of the last load | tick, on load | tick: origin of the learnt change; estimate at its start; shares: rival | at every load |
//! | estimate | linear parameters of the [`Estimator`] | estimator; supervisor, on restoration | supervisor, change detection | with every accepted row |
//! | learnt | the estimate, in steps of bounded torque | supervisor | tick | at most once a round |
//! | active | single set for reports and storage: loaded and learnt by the [`LearntShare`] | tick | reports, `BankRead` (live) | at most once a round |
//! | committed | active set of the last commit | tick, on commit and load | tick: fallback, centre of the bound on learnt change; `Save` | on commit, at every load |
//! | checkpoint | estimate, learnt set, shares, evidence and payload of one instant | supervisor, while healthy | supervisor: alarm, emergency stop, release of a payload | every 12.8 blocks; two are kept, and one from before a payload |
//! | snapshot | copy of learnt set, shares and networks | [`Request::Snapshot`] | [`Request::Rollback`] | on request |
//! | network candidate | network of a joint in training | trainer | trainer: comparison with the active network | with every accepted row of the joint |
//! | payload hypothesis | seven parameters of a body at the last link | payload test | supervisor; after promotion the tick, as an addition to the rigid body | every block of 10 ms, from the payload in the torque in each window; after promotion for 10 s |
//!
//! # Shares
//!
//! ```text
//! torque_j = loaded_j + w_j (learnt_j − loaded_j)     w_j = clip(v (1 − 4 s²/v²), 0, 1)
//! v = Σ d r / Σ d²     s² = ρ_j σ_j² / Σ d²
//! ```
//! d is the torque of the estimate at the older checkpoint less that of the loaded set, r the measured torque less those of
//! loaded set and network. The sums fade over 20 s. ρ is the correlation factor of the joint's innovations.
//!
//! # Supervisor
//!
//! States are those of [`Phase`], arrows carry the code of their [`Reason`], thresholds are the defaults of
//! [`SupervisorConfig`] at 1 kHz. One pure function decides: state and evidence in, state and action out.
//!
//! ```text
//!          ┌───────────── 0 Healthy ─────────────┐
//!          │                                     │    alarm (1)     ┌────────────────┐
//! start ──►│ torque follows the shares (25, 26), ├─────────────────►│ 1 PayloadTest  │
//!          │ commit every 8 s                    │◄──── 2, 6, 8 ────│   at most 3 s  │
//!          │                                     │                  └───────┬────────┘
//!          │                                     │                          │ refused (3, 4, 5)
//!          │                                     │  5 s (19)        ┌───────▼────────┐
//!          │                                     │◄─────────────────│ 2 Relearning   │
//!          └─────────────────────────────────────┘                  └────────────────┘
//! every state ── emergency stop (16) ──► 3 Stopped ── learning off (17) ──► 0 Healthy
//! every state but Stopped ── rollback with a snapshot (7), zero payload (11) ──► 0 Healthy
//! ```
//!
//! * Healthy: the learnt set moves to the estimate and the shares to their evidence, by at most 0.83 of the torque limit a
//!   second. Following begins (25) at a common share of 1/2 and ends (26) at 1/4.
//! * alarm: the CUSUM of a joint exceeds 25. Estimate, learnt set and shares return to the checkpoint of 0.128 s to 0.256 s
//!   ago and are frozen.
//! * payload test: five blocks of 10 ms in a row decide for a payload (2), its release (8), or a transient (6). While healthy
//!   it runs in windows of at most 10 s and finds payloads (2, 8) that stay below the CUSUM of every joint. A payload that
//!   makes the torque worse for 1.5 s is released (8).
//! * relearning: the variance of friction is raised and the estimate learns on; the learnt set stays, the shares move on new
//!   evidence. Its time, as that of the payload test, counts while the arm moves.
//!
//! A saturated torque, an unbridged gap or a number that is not finite freezes learning in every state (13 to 15); it
//! resumes one length of the motion filter, 62 ms, after the last cause (17).

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
pub use config::LearnerConfig;
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
pub use payload::{
    MAX_COM_DISTANCE, PAYLOAD_PART, RATED_COM_DISTANCE, payload_bound, rated_payload,
};
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
