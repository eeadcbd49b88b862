//! The record of one run.

use super::setup::N;
use foretorque::joint::JointSample;
use foretorque::learning::{Decision, LearnerStatistics, PayloadEstimate};
use foretorque_link::safety::SafetyStatus;
use foretorque_workbench::metrics::TrackingError;
use foretorque_workbench::plant::Payload;

/// Feed-forward error and tracking error of one second.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Second {
    /// Squared error of the moving rows of each joint, (N·m)².
    pub(super) error: [f64; N],
    /// Squared torque of these rows, (N·m)².
    pub(super) torque: [f64; N],
    pub(super) tracking: TrackingError<N>,
}

/// Error of the active set on the unseen path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Evaluation {
    pub(super) t_s: f64,
    /// NRMSE of moving rows, ratio.
    pub(super) nrmse: f64,
    /// The error, in torque limits, over the torque of the payload in the hand, or last in it.
    pub(super) of_step: Option<f64>,
}

/// The record of one run.
#[derive(Clone, Debug, Default)]
pub(super) struct Trace {
    pub(super) ticks: usize,
    pub(super) seconds: Vec<Second>,
    pub(super) evaluations: Vec<Evaluation>,
    /// Change of the torque on the unseen path from before each pick to after the release, RMS ratio.
    pub(super) restored: Vec<f64>,
    /// Largest change of any parameter from one second after the stop to the end, in prior standard deviations.
    pub(super) drift: f64,
    pub(super) statistics: LearnerStatistics,
    /// Decisions of the supervisor with their times, s.
    pub(super) decisions: Vec<(f64, Decision)>,
    /// The board's estimate of every payload one second after it was picked, and the payload.
    pub(super) weighed: Vec<(PayloadEstimate, Payload)>,
    /// Standard deviations of mass, kg, and centre of mass, m, that the torque noise alone leaves then, and the payload.
    pub(super) weighable: Vec<(f64, f64, Payload)>,
    /// Lowest trust figure.
    pub(super) least_trust: f32,
    /// Ticks with each of these flags.
    pub(super) flags: Vec<(&'static str, u32)>,
    pub(super) late_sets: u32,
    /// Checksum (FNV-1a) of all torques, bit for bit.
    pub(super) checksum: u64,
    /// Safety state at the end.
    pub(super) safety: SafetyStatus,
    /// The sample that the board was armed with.
    pub(super) arming: Option<JointSample<N>>,
    /// Samples and the bits of their torques, where they were recorded.
    pub(super) recording: Vec<(Option<JointSample<N>>, [u32; N])>,
}
