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
        for (joint, network) in (0..).zip(&mut network) {
            *network = JointNetwork::silent(seed.wrapping_add(joint));
        }
        Self {
            rigid: *A::nominal(),
            friction: [FrictionParameters::NONE; N],
            network,
        }
    }

    /// True if every parameter is finite.
    pub fn is_finite(&self) -> bool {
        let friction = self.friction.iter().flat_map(|joint| &joint.0);
        let mut linear = self.rigid.as_slice().iter().chain(friction);
        linear.all(|p| p.is_finite()) && self.network.iter().all(JointNetwork::is_finite)
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

/// Output of a joint's network at the joint velocity `qd`, rad/s, in units of the joint's torque limit, without its bound.
///
/// Not inlined, for flash; the tick has the inputs at hand.
#[inline(never)]
pub(crate) fn network_output(network: &JointNetwork, qd: f32) -> f32 {
    let [[output]] = network.forward(&network_inputs(qd)).data.0;
    output
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

    /// Scalar product Σ a b.
    pub fn dot(&self, other: &Self) -> f32 {
        let [friction, rigid] = self.parts();
        let [other_friction, other_rigid] = other.parts();
        dot(friction, other_friction) + dot(rigid, other_rigid)
    }

    /// Entries of `joint`; `None` if there is no such joint.
    pub(super) fn of_joint(&self, joint: usize) -> Option<JointEntries<P>> {
        Some(JointEntries {
            own: *self.friction.get(joint)?,
            rigid: self.rigid,
        })
    }
}

/// Non-zero part of a torque row: friction of its joint and rigid body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct JointEntries<const P: usize> {
    pub(super) own: [f32; FRICTION_COLUMNS],
    pub(super) rigid: [f32; P],
}

impl<const P: usize> JointEntries<P> {
    pub(super) const ZERO: Self = Self {
        own: [0.0; FRICTION_COLUMNS],
        rigid: [0.0; P],
    };

    /// Torque of the friction of `joint` in `parameters`, N·m; 0 if there is no such joint.
    pub(super) fn friction_dot<const N: usize>(
        &self,
        joint: usize,
        parameters: &LinearParameters<N, P>,
    ) -> f32 {
        let own = parameters.friction.get(joint);
        own.map_or(0.0, |own| dot(&self.own, own))
    }

    /// Torque of the rigid body in `parameters`, N·m.
    #[inline(never)]
    pub(super) fn rigid_dot<const N: usize>(&self, parameters: &LinearParameters<N, P>) -> f32 {
        dot(&self.rigid, &parameters.rigid)
    }

    /// Torque of `joint` by the change from the parameters `from` to those of `to`, N·m.
    #[inline(never)]
    pub(super) fn change<const N: usize>(
        &self,
        joint: usize,
        from: &LinearParameters<N, P>,
        to: &LinearParameters<N, P>,
    ) -> f32 {
        self.friction_dot(joint, to) - self.friction_dot(joint, from) + self.rigid_dot(to)
            - self.rigid_dot(from)
    }

    /// Entries in units of the standard deviations `own` and `rigid` and of the noise.
    #[inline(never)]
    pub(super) fn scaled(
        &self,
        own: &[f32; FRICTION_COLUMNS],
        rigid: &[f32; P],
        inv_noise: f32,
    ) -> Self {
        let mut phi = *self;
        let own = phi.own.iter_mut().zip(own);
        for (phi, sigma) in own.chain(phi.rigid.iter_mut().zip(rigid)) {
            *phi *= sigma * inv_noise;
        }
        phi
    }

    /// Scale the cogging columns by the gain `attenuation` of the motion filter.
    ///
    /// * returns the torque of the removed part as commanded by the friction `active`, N·m: it is in the measured torque, but
    ///   not in the filtered motion
    pub(super) fn attenuate_cogging(
        &mut self,
        attenuation: f32,
        active: &FrictionParameters,
    ) -> f32 {
        let mut commanded = 0.0;
        for column in COGGING_COLUMNS {
            let entry = &mut self.own[column as usize];
            commanded += (1.0 - attenuation) * *entry * active[column];
            *entry *= attenuation;
        }
        commanded
    }
}

/// Least part of the prior deviation: drives change after identification.
const LEAST_PART: f32 = 0.05;
/// Parts are stored in bytes.
const PART_UNIT: f32 = 1.0 / u8::MAX as f32;

/// Standard deviations of a set from which learning starts, as parts of the prior deviations in 1/255.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StartDeviations<const N: usize, const P: usize> {
    /// Friction, joint by joint.
    pub friction: [[u8; FRICTION_COLUMNS]; N],
    /// Base parameters.
    pub rigid: [u8; P],
}

impl<const N: usize, const P: usize> StartDeviations<N, P> {
    /// Prior deviations, of a set without deviations of its own.
    pub const PRIOR: Self = Self {
        friction: [[u8::MAX; FRICTION_COLUMNS]; N],
        rigid: [u8::MAX; P],
    };

    /// Part for a parameter of a set: its `deviation`, within 5 % to 100 % of the `prior` one.
    ///
    /// A deviation that is not a positive number gives the prior one.
    pub fn part(deviation: f32, prior: f32) -> u8 {
        let part = deviation / prior;
        if deviation > 0.0 && part < 1.0 {
            let part = if part > LEAST_PART { part } else { LEAST_PART };
            (part / PART_UNIT + 0.5) as u8
        } else {
            u8::MAX
        }
    }

    /// Parts of the prior deviations.
    pub(super) fn parts(&self) -> LinearParameters<N, P> {
        let part = |byte: u8| f32::from(byte) * PART_UNIT;
        LinearParameters {
            friction: self.friction.map(|joint| joint.map(part)),
            rigid: self.rigid.map(part),
        }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_part_lies_within_its_range_whatever_the_deviation() {
        let part = |deviation| StartDeviations::<1, 1>::part(deviation, 2.0);
        for (deviation, expected) in [(0.6, 77), (2.0, 255), (1e-6, 13), (0.0, 255), (-1.0, 255)] {
            assert_eq!(part(deviation), expected, "{deviation}");
        }
        assert_eq!([part(f32::NAN), part(f32::INFINITY)], [255; 2]);
        assert_eq!(StartDeviations::<1, 1>::part(0.1, 0.0), 255);
    }
}
