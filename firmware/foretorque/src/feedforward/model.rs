//! The models a tick evaluates: the loaded one, and what was learnt since, for the motion it was learnt on.

use super::config::FeedForwardConfig;
use super::shares::{JointShares, network_share};
use crate::dynamics::{
    BaseParameters, FRICTION_COLUMNS, FrictionParameters, FrictionPoint, SmoothedSign,
};
use crate::joint::JointMotion;
use crate::learning::{JointNetwork, MotionRange, NETWORK_INPUTS, ParameterSet, network_inputs_at};
use crate::limits::{Flags, cut};
use crate::math::SinCos;
use nalgebra::{ArrayStorage, SVector};

/// The linear parameters of the set that was last loaded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Loaded<const N: usize, const P: usize> {
    pub(super) rigid: BaseParameters<P>,
    pub(super) friction: [FrictionParameters; N],
}

impl<const N: usize, const P: usize> Loaded<N, P> {
    pub(super) fn new(set: &ParameterSet<N, P>) -> Self {
        Self {
            rigid: set.rigid,
            friction: set.friction,
        }
    }
}

/// Difference of the linear parameters of a learnt set from those of the loaded one, and its share in the torque.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Difference<const N: usize, const P: usize> {
    pub(super) rigid: BaseParameters<P>,
    /// Part of the difference of each joint that is in its torque.
    pub(super) share: [f32; N],
    /// Times the share.
    friction: [FrictionParameters; N],
    /// The network of the joint is not the one that was loaded.
    pub(super) network: [bool; N],
}

impl<const N: usize, const P: usize> Difference<N, P> {
    /// No difference.
    pub(super) fn none() -> Self {
        Self {
            rigid: BaseParameters::zeros(),
            share: [0.0; N],
            friction: [FrictionParameters::NONE; N],
            network: [false; N],
        }
    }

    /// Set to `set` less `loaded` with `share`; its networks are learnt if they were so, or are not those of `before`.
    pub(super) fn update(
        &mut self,
        set: &ParameterSet<N, P>,
        share: &[f32; N],
        before: &ParameterSet<N, P>,
        loaded: &Loaded<N, P>,
    ) {
        let both = set.rigid.iter().zip(loaded.rigid.iter());
        for (rigid, (set, loaded)) in self.rigid.iter_mut().zip(both) {
            *rigid = set - loaded;
        }
        self.share = *share;
        let drives = set.friction.iter().zip(&loaded.friction).zip(share);
        for (difference, ((set, loaded), share)) in self.friction.iter_mut().zip(drives) {
            let both = set.0.iter().zip(&loaded.0);
            for (difference, (set, loaded)) in difference.0.iter_mut().zip(both) {
                *difference = share * (set - loaded);
            }
        }
        let networks = set.network.iter().zip(&before.network);
        for (learnt, (set, before)) in self.network.iter_mut().zip(networks) {
            *learnt |= set != before;
        }
    }
}

/// The motion of a tick: as it is wanted, and cut to what has been learnt.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct TickMotion<const N: usize> {
    pub(super) desired: JointMotion<N>,
    pub(super) bounded: JointMotion<N>,
}

impl<const N: usize> TickMotion<N> {
    /// At rest.
    pub(super) const fn zero() -> Self {
        Self {
            desired: JointMotion::zero(),
            bounded: JointMotion::zero(),
        }
    }

    /// Takes `wanted`, cut to the limits, and its speeds and accelerations cut to `range` as well; `false` if a number
    /// in it is not finite.
    #[inline]
    pub(super) fn take(
        &mut self,
        config: &FeedForwardConfig<N>,
        range: &MotionRange<N>,
        wanted: &JointMotion<N>,
        flags: &mut Flags,
    ) -> bool {
        for joint in 0..N {
            let (q, qd, qdd) = (wanted.q[joint], wanted.qd[joint], wanted.qdd[joint]);
            if !(q.is_finite() && qd.is_finite() && qdd.is_finite()) {
                return false;
            }
            let limits = &config.limits[joint];
            let (lower, upper) = limits.position;
            let inside = if q > upper {
                upper
            } else if q < lower {
                lower
            } else {
                q
            };
            let (velocity, fast) = cut(qd, limits.velocity);
            let (acceleration, abrupt) = cut(qdd, config.acceleration_limit);
            *flags |= Flags::when(inside != q || fast || abrupt, Flags::DESIRED_CLAMPED);
            self.desired.q[joint] = inside;
            self.desired.qd[joint] = velocity;
            self.desired.qdd[joint] = acceleration;
            self.bounded.q[joint] = inside;
            self.bounded.qd[joint] = cut(velocity, range.velocity[joint]).0;
            self.bounded.qdd[joint] = cut(acceleration, range.acceleration[joint]).0;
        }
        true
    }
}

/// Friction basis and network output of one joint at one speed.
#[derive(Clone, Copy)]
pub(super) struct AtSpeed {
    columns: [f32; FRICTION_COLUMNS],
    inputs: SVector<f32, NETWORK_INPUTS>,
}

impl AtSpeed {
    /// Uninitialised memory of it.
    pub(super) const NONE: Self = Self {
        columns: [0.0; FRICTION_COLUMNS],
        inputs: SVector::from_array_storage(ArrayStorage([[0.0; NETWORK_INPUTS]])),
    };

    /// At the speed `qd`, rad/s, where cogging is `cogging` and the gear carries `load`, N·m.
    #[inline]
    pub(super) fn new(qd: f32, cogging: SinCos, load: f32) -> Self {
        let sign = SmoothedSign::of(qd);
        Self {
            columns: FrictionPoint::new(qd, &sign, cogging, load).columns(),
            inputs: network_inputs_at(qd, &sign),
        }
    }

    /// Torque of `friction`, N·m.
    #[inline]
    pub(super) fn friction(&self, friction: &FrictionParameters) -> f32 {
        friction.torque(&self.columns)
    }
}

impl<const N: usize, const P: usize> Difference<N, P> {
    /// Shares of `joint` of a set that differs from the loaded one by `self`: the loaded set's `rigid` and `friction` for
    /// the desired motion, plus the learnt difference for the motion inside the learnt range.
    ///
    /// * `rigid` torque of the loaded rigid body and of what was learnt of it, N·m
    #[inline]
    pub(super) fn shares(
        &self,
        joint: usize,
        (rigid, friction): (f32, f32),
        network: &JointNetwork,
        [desired, bounded]: &[AtSpeed; 2],
        torque_limit: f32,
        flags: &mut Flags,
    ) -> JointShares {
        let speed = if self.network[joint] {
            bounded
        } else {
            desired
        };
        JointShares {
            rigid,
            friction: friction + bounded.friction(&self.friction[joint]),
            network: network_share(network, &speed.inputs, torque_limit, flags),
        }
    }
}
