//! Incremental learning in the slack of the tick.

use crate::feedforward::ParameterSet;
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
    /// A set that replaces the learner's own (a bank was loaded, the state was reset).
    pub reload: Option<ParameterSet<N, P>>,
}
