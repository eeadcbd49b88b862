use super::Torque;
use crate::arm::Arm;
use crate::dynamics::{BaseParameters, Pose, friction_under, gravity_torque, rnea_of};
use crate::joint::{JointMotion, JointVector};
use crate::learning::{JointNetwork, NETWORK_BOUND, NETWORK_INPUTS, ParameterSet, network_output};
use crate::limits::{Flags, cut};
use nalgebra::SVector;

/// Bound of all that was learnt since the committed set, in units of the joint's torque limit in force. Never optional.
pub const LEARNED_BOUND: f32 = 0.20;
/// A rigid-body share beyond this many torque limits of the arm is a fault of the parameters, not a demanding motion.
const RIGID_PLAUSIBLE: f32 = 10.0;
/// A friction share beyond this many torque limits of the arm is a fault of the parameters.
const FRICTION_PLAUSIBLE: f32 = 2.0;

/// The shares whose sum is the feed-forward torque, before limits. N × N·m each.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shares<const N: usize> {
    /// Rigid-body torque.
    pub rigid: JointVector<N>,
    /// Friction torque.
    pub friction: JointVector<N>,
    /// Share of the network, clipped.
    pub network: JointVector<N>,
}

impl<const N: usize> Shares<N> {
    /// No torque.
    pub fn zero() -> Self {
        Self {
            rigid: JointVector::zeros(),
            friction: JointVector::zeros(),
            network: JointVector::zeros(),
        }
    }

    /// Sum of the shares, N × N·m.
    pub fn total(&self) -> JointVector<N> {
        self.rigid + self.friction + self.network
    }
}

/// Shares and total of `set` for `motion`, without limits other than the network's bound, without state.
#[inline(never)]
pub fn evaluate<A: Arm<N, P>, const N: usize, const P: usize>(
    set: &ParameterSet<N, P>,
    motion: &JointMotion<N>,
) -> Torque<N> {
    let mut flags = Flags::NONE;
    let [rigid, friction] = match Pose::of::<A, P>(&motion.q) {
        Some(pose) => {
            let mut rigid = [JointVector::zeros()];
            rnea_of::<A, N, P, 1>([&set.rigid], &pose.angles, motion, &mut rigid);
            let [rigid] = rigid;
            let (friction, JointMotion { q, qd, .. }) = (&set.friction, motion);
            [
                rigid,
                friction_under::<A, N, P>(friction, q, qd, &pose.load),
            ]
        }
        None => [JointVector::repeat(f32::NAN); 2],
    };
    let shares = Shares {
        rigid,
        friction,
        network: shares_of_networks::<A, N, P>(&set.network, &motion.qd, &mut flags),
    };
    let total = shares.total();
    flags |= Flags::when(!total.iter().all(|tau| tau.is_finite()), Flags::NOT_FINITE);
    Torque {
        total,
        shares,
        flags,
        tick: 0,
    }
}

/// Torque of gravity at the position `q`, N × rad, by the base parameters `rigid`, N × N·m; 0 where it is not plausible.
#[inline(never)]
pub(super) fn gravity<A: Arm<N, P>, const N: usize, const P: usize>(
    rigid: &BaseParameters<P>,
    q: &JointVector<N>,
) -> JointVector<N> {
    let mut gravity = gravity_torque::<A, N, P>(rigid, q);
    for (torque, limits) in gravity.as_mut_slice().iter_mut().zip(A::limits()) {
        let plausible = torque.abs() <= RIGID_PLAUSIBLE * limits.torque;
        *torque = if plausible { *torque } else { 0.0 };
    }
    gravity
}

/// Network shares at joint speeds `qd`, cut to their bound, N × N·m.
#[inline(never)]
fn shares_of_networks<A: Arm<N, P>, const N: usize, const P: usize>(
    networks: &[JointNetwork; N],
    qd: &JointVector<N>,
    flags: &mut Flags,
) -> JointVector<N> {
    let mut shares = JointVector::<N>::zeros();
    let joints = networks.iter().zip(A::limits()).zip(qd.as_slice());
    for (share, ((network, limits), &qd)) in shares.as_mut_slice().iter_mut().zip(joints) {
        *share = bounded_share(network_output(network, qd), limits.torque, flags);
    }
    shares
}

/// Network share of one joint, cut to its bound, N·m.
#[inline(always)]
pub(super) fn network_share(
    network: &JointNetwork,
    inputs: &SVector<f32, NETWORK_INPUTS>,
    torque_limit: f32,
    flags: &mut Flags,
) -> f32 {
    let [[output]] = network.forward(inputs).data.0;
    bounded_share(output, torque_limit, flags)
}

/// Share for the `output` of a network, cut to its bound, N·m.
#[inline(always)]
fn bounded_share(output: f32, torque_limit: f32, flags: &mut Flags) -> f32 {
    let (bounded, was_cut) = cut(output, NETWORK_BOUND);
    *flags |= Flags::when(was_cut, Flags::NETWORK_CLIPPED);
    bounded * torque_limit
}

/// The shares of one joint, N·m each.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct JointShares {
    pub(super) rigid: f32,
    pub(super) friction: f32,
    pub(super) network: f32,
}

/// Shares of a joint after the checks, N·m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Selected {
    /// The active set's shares, each replaced by the committed set's where it was not sound.
    pub(super) shares: JointShares,
    /// Sum of the committed set's shares.
    pub(super) reference: f32,
    /// Learnt part, within its bound.
    pub(super) learned: f32,
}

/// Share of the active set, replaced by the committed one or by 0 where it is not sound, and the share to measure it from.
///
/// * `bound` largest plausible share, N·m      * `withdrawn` flags where both are not sound
#[inline(always)]
fn sound(
    [active, committed]: [f32; 2],
    bound: f32,
    withdrawn: Flags,
    flags: &mut Flags,
) -> [f32; 2] {
    // A comparison with a not-a-number is false: it counts as implausible.
    let (active_sound, committed_sound) = (active.abs() <= bound, committed.abs() <= bound);
    if active_sound && committed_sound {
        return [active, committed];
    }
    let mut share = active;
    if !active_sound {
        *flags |= Flags::when(!active.is_finite(), Flags::NOT_FINITE);
        *flags |= if committed_sound {
            Flags::SHARE_FALLBACK
        } else {
            withdrawn
        };
        share = if committed_sound { committed } else { 0.0 };
    }
    // Without a sound committed share there is nothing to measure the learnt change against.
    [share, if committed_sound { committed } else { share }]
}

/// Makes every share in `active` sound and bounds their sum around the committed set's.
///
/// * `arm_limit`, `limit` torque limits of the arm, of which networks are a part, and in force, N·m
#[inline(always)]
pub(super) fn select(
    active: &JointShares,
    committed: &JointShares,
    [arm_limit, limit]: [f32; 2],
    flags: &mut Flags,
) -> Selected {
    let [rigid, committed_rigid] = sound(
        [active.rigid, committed.rigid],
        RIGID_PLAUSIBLE * arm_limit,
        Flags::WITHDRAWN | Flags::GRAVITY_LOST,
        flags,
    );
    let [friction, committed_friction] = sound(
        [active.friction, committed.friction],
        FRICTION_PLAUSIBLE * arm_limit,
        Flags::WITHDRAWN,
        flags,
    );
    let [network, committed_network] = sound(
        [active.network, committed.network],
        NETWORK_BOUND * arm_limit,
        Flags::WITHDRAWN,
        flags,
    );
    let shares = JointShares {
        rigid,
        friction,
        network,
    };
    // The sums begin at 0: that of −0 and −0 is 0.
    let sum = 0.0 + rigid + friction + network;
    let reference = 0.0 + committed_rigid + committed_friction + committed_network;
    let (learned, was_cut) = cut(sum - reference, LEARNED_BOUND * limit);
    *flags |= Flags::when(was_cut, Flags::LEARNED_CLIPPED);
    Selected {
        shares,
        reference,
        learned,
    }
}
