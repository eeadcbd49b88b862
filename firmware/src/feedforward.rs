//! The one room where dynamics, network and learning meet.

use crate::dynamics::{BaseParameters, FrictionParameters};
use crate::joint::JointVector;
use crate::network::BpNetwork;

/// Inputs of a joint's network: `qd/2`, `tanh(qd/0.03)`, `tanh(qd/0.15)` (qd in rad/s).
pub const NETWORK_INPUTS: usize = 3;
/// Hidden units of a joint's network.
pub const NETWORK_HIDDEN: usize = 6;
/// The network of one joint. All joints together are one block-diagonal network, 18-36-6 for six joints.
pub type JointNetwork = BpNetwork<NETWORK_INPUTS, NETWORK_HIDDEN, 1>;

/// Everything that is learnt: what the tick reads and the learner writes, swapped whole at a tick boundary.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ParameterSet<const N: usize, const P: usize> {
    /// Base parameters of the rigid body.
    pub rigid: BaseParameters<P>,
    /// Friction of every joint.
    pub friction: [FrictionParameters; N],
    /// Residual network of every joint; its output is in units of the joint's torque limit.
    pub network: [JointNetwork; N],
}

/// The shares whose sum is the feed-forward torque, before limits. N × N·m each.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shares<const N: usize> {
    /// Rigid-body torque.
    pub rigid: JointVector<N>,
    /// Friction torque.
    pub friction: JointVector<N>,
    /// What the network adds, clipped.
    pub network: JointVector<N>,
}
