//! Incremental learning in the slack of the tick.
//!
//! The tick hands over one [`Lesson`] a tick; the [`Learner`] works through them at its own pace and lays a finished
//! [`ParameterSet`] on the [`Exchange`] desk after every round of `N` ticks, in which each joint had one row. The tick
//! takes the set at a fixed tick of the next round, never earlier, so the torque does not depend on how fast the
//! learner was.

mod conditioning;
mod config;
mod estimator;
mod learner;
mod parameters;
mod stacked;
mod ud;

pub use conditioning::{Conditioned, DELAY, MeasurementWindow, TAPS};
pub use config::{ConfigError, LearnerConfig};
pub use estimator::{Estimator, torque_row};
pub use learner::{Learner, LearnerState, LearnerStatistics};
pub use parameters::{JointNetwork, NETWORK_HIDDEN, NETWORK_INPUTS, ParameterSet, network_inputs};
pub use stacked::Stacked;
pub use ud::UdFilter;

use crate::joint::JointMeasurement;

/// What one tick hands to the learner.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lesson<const N: usize> {
    /// Counter of the tick.
    pub tick: u32,
    /// What the arm did, `None` when nothing fresh was measured.
    pub measured: Option<JointMeasurement<N>>,
    /// Learning is switched on.
    pub enabled: bool,
}

/// The desk between tick and learner: the only state both touch, each for the time of one copy.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exchange<const N: usize, const P: usize> {
    /// A finished set on its way to the tick, with the tick at whose end its round closed.
    pub published: Option<(u32, ParameterSet<N, P>)>,
    /// A set that replaces the learner's own (a bank was loaded, the state was reset), with the first tick it holds for.
    pub reload: Option<(u32, ParameterSet<N, P>)>,
}

impl<const N: usize, const P: usize> Exchange<N, P> {
    /// An empty desk.
    pub const fn new() -> Self {
        Self {
            published: None,
            reload: None,
        }
    }
}

impl<const N: usize, const P: usize> Default for Exchange<N, P> {
    fn default() -> Self {
        Self::new()
    }
}
