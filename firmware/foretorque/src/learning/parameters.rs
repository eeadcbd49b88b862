use crate::arm::Arm;
use crate::dynamics::{BaseParameters, FrictionParameters, SmoothedSign};
use crate::joint::zero_vector;
use crate::network::BpNetwork;
use nalgebra::SVector;

/// Inputs of a joint's network: `qd/2`, `tanh(qd/0.03)`, `tanh(qd/0.15)` (qd in rad/s).
pub const NETWORK_INPUTS: usize = 3;
/// Hidden units of a joint's network.
pub const NETWORK_HIDDEN: usize = 6;
/// Bound of the network share, in units of the joint's torque limit. Never optional.
pub const NETWORK_BOUND: f32 = 0.10;
/// The network of one joint. All joints together are one block-masked network, 18-36-6 for six joints.
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

impl<const N: usize, const P: usize> ParameterSet<N, P> {
    /// Nothing at all: no body, no friction, silent networks without hidden layers.
    pub(super) const fn nothing() -> Self {
        Self {
            rigid: zero_vector(),
            friction: [FrictionParameters::NONE; N],
            network: [JointNetwork::zeros(); N],
        }
    }

    /// The description's rigid body, no friction, and networks that say nothing yet: random hidden layers (joint `j`
    /// from `seed + j`) under output layers of zeros.
    pub fn nominal<A: Arm<N, P>>(seed: u32) -> Self {
        let mut network = [JointNetwork::zeros(); N];
        for (seed, network) in (0..)
            .map(|joint| seed.wrapping_add(joint))
            .zip(&mut network)
        {
            *network = JointNetwork::silent(seed);
        }
        Self {
            rigid: A::NOMINAL.into(),
            friction: [FrictionParameters::NONE; N],
            network,
        }
    }

    /// Every number of the set is finite.
    pub fn is_finite(&self) -> bool {
        let rigid = self.rigid.iter().all(|p| p.is_finite());
        let friction = self
            .friction
            .iter()
            .all(|f| f.0.iter().all(|p| p.is_finite()));
        rigid && friction && self.network.iter().all(JointNetwork::is_finite)
    }
}

/// Inputs of a joint's network for the joint velocity `qd` (rad/s).
///
/// Physical inputs only: a network that also saw positions would memorise paths. The two widths of the smoothed sign
/// are what a Stribeck curve needs; `qd/2` scales velocity to order one.
#[inline]
pub fn network_inputs(qd: f32) -> SVector<f32, NETWORK_INPUTS> {
    network_inputs_at(qd, &SmoothedSign::of(qd))
}

/// [`network_inputs`] where the smoothed signs of the speed are known.
#[inline]
pub(crate) fn network_inputs_at(qd: f32, sign: &SmoothedSign) -> SVector<f32, NETWORK_INPUTS> {
    SVector::from([0.5 * qd, sign.narrow, sign.wide])
}
