use crate::arm::Arm;
use crate::dynamics::{
    BaseParameters, COGGING_COLUMNS, FRICTION_COLUMNS, FrictionParameters, SmoothedSign,
};
use crate::joint::zero_vector;
use crate::network::BpNetwork;
use nalgebra::SVector;

/// Inputs of a joint's network: `qd/2`, `tanh(qd/0.03)`, `tanh(qd/0.15)` (qd in rad/s).
pub const NETWORK_INPUTS: usize = 3;
/// Hidden units of a joint's network.
pub const NETWORK_HIDDEN: usize = 6;
/// Bound of the network share, in units of the joint's torque limit. Always applied.
pub const NETWORK_BOUND: f32 = 0.10;
/// Network of one joint. All joints together are one block-masked network, 18-36-6 for six joints.
pub type JointNetwork = BpNetwork<NETWORK_INPUTS, NETWORK_HIDDEN, 1>;

/// All learnt parameters, read by the tick and written by the learner; swapped whole at a tick boundary.
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
    /// Zeros: no body, no friction, networks of zeros.
    pub const fn zero() -> Self {
        Self {
            rigid: zero_vector(),
            friction: [FrictionParameters::NONE; N],
            network: [JointNetwork::zeros(); N],
        }
    }

    /// Rigid body of the description, no friction, and silent networks: random hidden layers (joint `j` from `seed + j`)
    /// with output layers of zeros.
    pub fn nominal<A: Arm<N, P>>(seed: u32) -> Self {
        let mut network = [JointNetwork::zeros(); N];
        for (seed, network) in (0..)
            .map(|joint| seed.wrapping_add(joint))
            .zip(&mut network)
        {
            *network = JointNetwork::silent(seed);
        }
        Self {
            rigid: *A::nominal(),
            friction: [FrictionParameters::NONE; N],
            network,
        }
    }

    /// True if every parameter is finite.
    pub fn is_finite(&self) -> bool {
        let rigid = self.rigid.as_slice().iter().all(|p| p.is_finite());
        let friction = self
            .friction
            .iter()
            .all(|f| f.0.iter().all(|p| p.is_finite()));
        rigid && friction && self.network.iter().all(JointNetwork::is_finite)
    }
}

/// Inputs of a joint's network at the joint velocity `qd`, rad/s.
///
/// Physical inputs only: a network with positions as inputs memorises paths. The two widths of the smoothed sign span a
/// Stribeck curve; `qd/2` scales velocity to order one.
#[inline]
pub fn network_inputs(qd: f32) -> SVector<f32, NETWORK_INPUTS> {
    network_inputs_at(qd, &SmoothedSign::of(qd))
}

/// [`network_inputs`] with the smoothed signs of `qd` given.
#[inline]
pub(crate) fn network_inputs_at(qd: f32, sign: &SmoothedSign) -> SVector<f32, NETWORK_INPUTS> {
    SVector::from([0.5 * qd, sign.narrow, sign.wide])
}

/// Vector over the linear parameters θ of an arm, friction first; also a torque row, or their standard deviations.
///
/// Two fields instead of one array: `P + N · FRICTION_COLUMNS` is no array length in stable Rust.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinearParameters<const N: usize, const P: usize> {
    /// Friction, joint by joint, in the order of [`crate::dynamics::friction_row`].
    pub friction: [[f32; FRICTION_COLUMNS]; N],
    /// Base parameters of the rigid body.
    pub rigid: [f32; P],
}

impl<const N: usize, const P: usize> LinearParameters<N, P> {
    /// Constant vector of `value`.
    pub const fn filled(value: f32) -> Self {
        Self {
            friction: [[value; FRICTION_COLUMNS]; N],
            rigid: [value; P],
        }
    }

    /// Linear parameters of `set`.
    pub fn of(set: &ParameterSet<N, P>) -> Self {
        let [rigid] = set.rigid.data.0;
        Self {
            friction: set.friction.map(|joint| joint.0),
            rigid,
        }
    }

    /// Copy these parameters into `set`; its networks stay.
    pub fn write(&self, set: &mut ParameterSet<N, P>) {
        for (friction, &columns) in set.friction.iter_mut().zip(&self.friction) {
            *friction = FrictionParameters(columns);
        }
        set.rigid.data.0 = [self.rigid];
    }

    /// Friction and rigid body as slices; loops over them cost less than over [`iter`](Self::iter).
    pub(super) fn parts(&self) -> [&[f32]; 2] {
        [self.friction.as_flattened(), &self.rigid]
    }

    /// Mutable [`parts`](Self::parts).
    pub(super) fn parts_mut(&mut self) -> [&mut [f32]; 2] {
        [self.friction.as_flattened_mut(), &mut self.rigid]
    }

    /// Iterator over all entries, friction first.
    pub fn iter(&self) -> impl Iterator<Item = &f32> {
        self.friction.as_flattened().iter().chain(&self.rigid)
    }

    /// Mutable [`iter`](Self::iter).
    pub fn iter_mut(&mut self) -> impl Iterator<Item = &mut f32> {
        let friction = self.friction.as_flattened_mut();
        friction.iter_mut().chain(&mut self.rigid)
    }

    /// Scale the cogging columns of a torque row of `joint` by the gain `attenuation` of the motion filter.
    ///
    /// * returns the torque of the removed part as commanded by `active`, N·m: it is in the measured torque, but not in the
    ///   filtered motion
    pub fn attenuate_cogging(&mut self, joint: usize, attenuation: f32, active: &Self) -> f32 {
        let mut commanded = 0.0;
        if let (Some(row), Some(active)) =
            (self.friction.get_mut(joint), active.friction.get(joint))
        {
            for column in COGGING_COLUMNS.map(|column| column as usize) {
                commanded += (1.0 - attenuation) * row[column] * active[column];
                row[column] *= attenuation;
            }
        }
        commanded
    }

    /// Scalar product Σ a b.
    pub fn dot(&self, other: &Self) -> f32 {
        self.friction_dot(other) + self.rigid_dot(other)
    }

    /// Part of [`dot`](Self::dot) of the friction columns.
    pub(super) fn friction_dot(&self, other: &Self) -> f32 {
        dot(self.friction.as_flattened(), other.friction.as_flattened())
    }

    /// Part of [`dot`](Self::dot) of the rigid body.
    pub(super) fn rigid_dot(&self, other: &Self) -> f32 {
        dot(&self.rigid, &other.rigid)
    }
}

/// Partial sums of [`dot`]: their loads and additions do not wait for each other.
const LANES: usize = 4;

/// Scalar product Σ a b in four partial sums, added at the end.
#[inline(always)]
pub(super) fn dot(a: &[f32], b: &[f32]) -> f32 {
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
    let mut sums = [0.0; LANES];
    for ([a0, a1, a2, a3], [b0, b1, b2, b3]) in a.iter().zip(b) {
        sums[0] += a0 * b0;
        sums[1] += a1 * b1;
        sums[2] += a2 * b2;
        sums[3] += a3 * b3;
    }
    let mut rest = 0.0;
    for (a, b) in a_rest.iter().zip(b_rest) {
        rest += a * b;
    }
    (sums[0] + sums[1]) + (sums[2] + sums[3]) + rest
}
