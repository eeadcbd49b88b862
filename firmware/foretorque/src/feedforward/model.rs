//! The models a tick evaluates: the loaded one, and what was learnt since, for the motion it was learnt on.

use super::FeedForwardConfig;
use super::shares::{JointShares, network_share};
use crate::dynamics::{
    BaseParameters, FRICTION_COLUMNS, FrictionBound, FrictionColumn, FrictionParameters,
    FrictionPoint, SmoothedSign,
};
use crate::joint::JointMotion;
use crate::learning::{JointNetwork, MotionRange, NETWORK_INPUTS, ParameterSet, network_inputs_at};
use crate::limits::{Flags, cut};
use crate::math::SinCos;

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
    pub(super) fn none() -> Self {
        Self {
            rigid: BaseParameters::zeros(),
            share: [0.0; N],
            friction: [FrictionParameters::NONE; N],
            network: [false; N],
        }
    }

    /// Set to `set` less `loaded` with `share`.
    pub(super) fn update(
        &mut self,
        set: &ParameterSet<N, P>,
        share: &[f32; N],
        loaded: &ParameterSet<N, P>,
    ) {
        // Slices: iterators of a matrix look for the end of a column at every entry.
        let both = set.rigid.as_slice().iter().zip(loaded.rigid.as_slice());
        for (rigid, (set, loaded)) in self.rigid.as_mut_slice().iter_mut().zip(both) {
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
        let networks = set.network.iter().zip(&loaded.network);
        for (learnt, (set, loaded)) in self.network.iter_mut().zip(networks) {
            *learnt = set.layers() != loaded.layers();
        }
    }
}

/// Range of motion for which the active set has been learnt, and the basis functions at its edges.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct LearntRange<const N: usize> {
    motion: MotionRange<N>,
    /// At the largest speed of each joint, for a load of 1 N·m, without cogging.
    edge: [AtSpeed; N],
}

impl<const N: usize> LearntRange<N> {
    pub(super) const fn none() -> Self {
        Self {
            motion: MotionRange::NONE,
            edge: [AtSpeed::REST; N],
        }
    }

    /// Takes the range `motion`.
    ///
    /// Cost: one [`AtSpeed::new`] for each joint whose largest speed is another one.
    pub(super) fn set(&mut self, motion: &MotionRange<N>) {
        let speeds = motion.velocity.iter().zip(&self.motion.velocity);
        for (edge, (&speed, &before)) in self.edge.iter_mut().zip(speeds) {
            if speed != before {
                *edge = AtSpeed::edge(speed);
            }
        }
        self.motion = *motion;
    }

    /// Basis functions of `joint` at its desired speed `qd`, rad/s, cut to the range: where it is beyond, those at the edge.
    ///
    /// * `desired` basis functions at the desired speed      * `load` of the gear, N·m
    #[inline(always)]
    pub(super) fn cut(&self, joint: usize, qd: f32, load: f32, desired: &AtSpeed) -> AtSpeed {
        if qd.abs() <= self.motion.velocity[joint] {
            return *desired;
        }
        // All that depends on the speed is odd in it.
        let sign = 1.0_f32.copysign(qd);
        let edge = &self.edge[joint];
        let mut cut = *desired;
        for (k, (column, edge)) in cut.columns.iter_mut().zip(&edge.columns).enumerate() {
            if ODD[k] {
                *column = sign * edge;
            }
        }
        cut.columns[FrictionColumn::Load as usize] *= load.abs();
        for (input, edge) in cut.inputs.iter_mut().zip(&edge.inputs) {
            *input = sign * edge;
        }
        cut
    }
}

/// Columns that are odd in the speed, as all that dissipate; the others do not depend on it.
const ODD: [bool; FRICTION_COLUMNS] = {
    let (mut odd, mut k) = ([false; FRICTION_COLUMNS], 0);
    while k < FRICTION_COLUMNS {
        let bound = FrictionColumn::ALL[k].properties().bound;
        odd[k] = !matches!(bound, FrictionBound::None);
        k += 1;
    }
    odd
};

/// The motion of a tick: as it is wanted, and cut to what has been learnt; the positions of both are those wanted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct TickMotion<const N: usize> {
    pub(super) desired: JointMotion<N>,
    pub(super) bounded: JointMotion<N>,
}

impl<const N: usize> TickMotion<N> {
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
        range: &LearntRange<N>,
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
            self.bounded.qd[joint] = cut(velocity, range.motion.velocity[joint]).0;
            self.bounded.qdd[joint] = cut(acceleration, range.motion.acceleration[joint]).0;
        }
        true
    }
}

/// Friction basis and network output of one joint at one speed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct AtSpeed {
    columns: [f32; FRICTION_COLUMNS],
    inputs: [f32; NETWORK_INPUTS],
}

impl AtSpeed {
    /// All that is odd in the speed, at rest.
    const REST: Self = Self {
        columns: [0.0; FRICTION_COLUMNS],
        inputs: [0.0; NETWORK_INPUTS],
    };

    /// At the largest speed of a range, rad/s. The tick has a code of its own.
    #[inline(never)]
    fn edge(speed: f32) -> Self {
        Self::new(speed, SinCos { sin: 0.0, cos: 0.0 }, 1.0)
    }

    /// At the speed `qd`, rad/s, where cogging is `cogging` and the gear carries `load`, N·m.
    #[inline(always)]
    pub(super) fn new(qd: f32, cogging: SinCos, load: f32) -> Self {
        let sign = SmoothedSign::of(qd);
        Self {
            columns: FrictionPoint::new(qd, &sign, cogging, load).columns(),
            inputs: network_inputs_at(qd, &sign).data.0[0],
        }
    }

    /// Torque of `friction`, N·m.
    #[inline(always)]
    pub(super) fn friction(&self, friction: &FrictionParameters) -> f32 {
        friction.torque(&self.columns)
    }
}

impl<const N: usize, const P: usize> Difference<N, P> {
    /// Friction in the torque, with `loaded` as the loaded one.
    pub(super) fn friction_over(
        &self,
        loaded: &[FrictionParameters; N],
    ) -> [FrictionParameters; N] {
        let mut friction = *loaded;
        for (friction, difference) in friction.iter_mut().zip(&self.friction) {
            for (value, difference) in friction.0.iter_mut().zip(&difference.0) {
                *value += difference;
            }
        }
        friction
    }

    /// Shares of `joint` of a set that differs from the loaded one by `self`: the loaded set's `rigid` and `friction` for
    /// the desired motion, plus the learnt difference for the motion inside the learnt range.
    ///
    /// * `learnt` torque of the difference of the rigid bodies, N·m
    #[inline(always)]
    pub(super) fn shares(
        &self,
        joint: usize,
        [rigid, friction, learnt]: [f32; 3],
        network: &JointNetwork,
        [desired, bounded]: [&AtSpeed; 2],
        torque_limit: f32,
        flags: &mut Flags,
    ) -> JointShares {
        let speed = if self.network[joint] {
            bounded
        } else {
            desired
        };
        JointShares {
            rigid: rigid + self.share[joint] * learnt,
            friction: friction + bounded.friction(&self.friction[joint]),
            network: network_share(network, &speed.inputs.into(), torque_limit, flags),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dynamics::cogging;

    #[test]
    fn beyond_the_learnt_range_everything_is_what_it_is_at_the_edge() {
        let (load, cogging) = (-7.3, cogging(202.0, 0.4));
        for edge in [0.0, 0.003, 0.2, 1.7] {
            let mut range = LearntRange::<1>::none();
            range.set(&MotionRange {
                velocity: [edge],
                acceleration: [0.0],
            });
            for qd in [-3.0, -0.2, -1e-3, 0.0, 1e-3, 0.2, 0.21, 3.0] {
                let desired = AtSpeed::new(qd, cogging, load);
                let direct = AtSpeed::new(cut(qd, edge).0, cogging, load);
                let cut = range.cut(0, qd, load, &desired);
                assert_eq!(cut, direct, "{qd} beyond {edge}");
            }
        }
    }
}
