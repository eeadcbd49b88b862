//! The models a tick evaluates: the loaded one, and what was learnt since, for the motion it was learnt on.

use super::shares::{Shares, shares_of_networks};
use crate::arm::Arm;
use crate::dynamics::{BaseParameters, FRICTION_COLUMNS, FrictionParameters, friction_row, rnea};
use crate::joint::{JointMotion, JointVector};
use crate::learning::{MotionRange, ParameterSet};
use crate::limits::{Flags, cut};

/// The linear parameters of the set that was last loaded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Loaded<const N: usize, const P: usize> {
    rigid: BaseParameters<P>,
    friction: [FrictionParameters; N],
}

impl<const N: usize, const P: usize> Loaded<N, P> {
    pub(super) fn new(set: &ParameterSet<N, P>) -> Self {
        Self {
            rigid: set.rigid,
            friction: set.friction,
        }
    }
}

/// How the linear parameters of a set differ from those of the loaded one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Difference<const N: usize, const P: usize> {
    rigid: BaseParameters<P>,
    friction: [[f32; FRICTION_COLUMNS]; N],
    /// The network of the joint is not the one that was loaded.
    network: [bool; N],
}

impl<const N: usize, const P: usize> Difference<N, P> {
    /// No difference.
    pub(super) fn none() -> Self {
        Self {
            rigid: BaseParameters::zeros(),
            friction: [[0.0; FRICTION_COLUMNS]; N],
            network: [false; N],
        }
    }

    /// `set` less `loaded`; its networks are learnt if they were so in `self`, or are not those of `before`.
    pub(super) fn to(
        &self,
        set: &ParameterSet<N, P>,
        before: &ParameterSet<N, P>,
        loaded: &Loaded<N, P>,
    ) -> Self {
        let mut difference = Self::none();
        difference.rigid = set.rigid - loaded.rigid;
        let drives = set.friction.iter().zip(&loaded.friction);
        for (columns, (set, loaded)) in difference.friction.iter_mut().zip(drives) {
            let both = set.columns().into_iter().zip(loaded.columns());
            for (column, (set, loaded)) in columns.iter_mut().zip(both) {
                *column = set - loaded;
            }
        }
        difference.network = self.network;
        let networks = set.network.iter().zip(&before.network);
        for (learnt, (set, before)) in difference.network.iter_mut().zip(networks) {
            *learnt |= set != before;
        }
        difference
    }
}

/// The motion of a tick: as it is wanted, and cut to what has been learnt.
pub(super) struct TickMotion<const N: usize> {
    desired: JointMotion<N>,
    bounded: JointMotion<N>,
    rows: [[f32; FRICTION_COLUMNS]; N],
    bounded_rows: [[f32; FRICTION_COLUMNS]; N],
}

impl<const N: usize> TickMotion<N> {
    /// Cuts speeds and accelerations of `desired` to `range`; cogging at `place`, N × rad.
    ///
    /// Cost: two [`friction_row`]s a joint.
    #[inline(never)]
    pub(super) fn new<A: Arm<N, P>, const P: usize>(
        desired: &JointMotion<N>,
        range: &MotionRange<N>,
        place: &JointVector<N>,
    ) -> Self {
        let mut bounded = *desired;
        let speeds = bounded.qd.iter_mut().zip(&range.velocity);
        speeds.for_each(|(qd, &widest)| *qd = cut(*qd, widest).0);
        let accelerations = bounded.qdd.iter_mut().zip(&range.acceleration);
        accelerations.for_each(|(qdd, &widest)| *qdd = cut(*qdd, widest).0);
        Self {
            desired: *desired,
            bounded,
            rows: friction_rows::<A, N, P>(place, &desired.qd),
            bounded_rows: friction_rows::<A, N, P>(place, &bounded.qd),
        }
    }

    /// Rigid-body and friction torque of the loaded set, for the motion as it is wanted.
    #[inline]
    pub(super) fn loaded<A: Arm<N, P>, const P: usize>(
        &self,
        set: &Loaded<N, P>,
    ) -> (JointVector<N>, JointVector<N>) {
        let columns = set.friction.map(FrictionParameters::columns);
        (
            rigid_torque::<A, N, P>(&set.rigid, &self.desired),
            friction_torque(&columns, &self.rows),
        )
    }

    /// The shares of `set`: those of the loaded one for the motion as it is wanted, and what `difference` adds for the
    /// motion that was learnt.
    #[inline(never)]
    pub(super) fn shares<A: Arm<N, P>, const P: usize>(
        &self,
        loaded: &(JointVector<N>, JointVector<N>),
        set: &ParameterSet<N, P>,
        difference: &Difference<N, P>,
        flags: &mut Flags,
    ) -> Shares<N> {
        let mut speed = self.desired.qd;
        let speeds = speed.iter_mut().zip(self.bounded.qd.iter());
        for ((speed, &bounded), &learnt) in speeds.zip(&difference.network) {
            if learnt {
                *speed = bounded;
            }
        }
        Shares {
            rigid: loaded.0 + rigid_torque::<A, N, P>(&difference.rigid, &self.bounded),
            friction: loaded.1 + friction_torque(&difference.friction, &self.bounded_rows),
            network: shares_of_networks::<A, N, P>(&set.network, &speed, flags),
        }
    }

    /// Torque of a payload that adds `payload` to the base parameters, for the motion as it is wanted: its mass is
    /// known, not only what it did so far. N × N·m.
    #[inline]
    pub(super) fn payload<A: Arm<N, P>, const P: usize>(
        &self,
        payload: &BaseParameters<P>,
    ) -> JointVector<N> {
        rigid_torque::<A, N, P>(payload, &self.desired)
    }
}

/// [`rnea`], once in the binary for the four models of a tick.
#[inline(never)]
fn rigid_torque<A: Arm<N, P>, const N: usize, const P: usize>(
    rigid: &BaseParameters<P>,
    motion: &JointMotion<N>,
) -> JointVector<N> {
    rnea::<A, N, P>(rigid, motion)
}

#[inline]
fn friction_rows<A: Arm<N, P>, const N: usize, const P: usize>(
    place: &JointVector<N>,
    qd: &JointVector<N>,
) -> [[f32; FRICTION_COLUMNS]; N] {
    let mut rows = [[0.0; FRICTION_COLUMNS]; N];
    let joints = place.iter().zip(qd.iter()).zip(&A::COGGING_CYCLES);
    for (row, ((&place, &qd), &cycles)) in rows.iter_mut().zip(joints) {
        *row = friction_row(cycles, place, qd);
    }
    rows
}

#[inline]
fn friction_torque<const N: usize>(
    columns: &[[f32; FRICTION_COLUMNS]; N],
    rows: &[[f32; FRICTION_COLUMNS]; N],
) -> JointVector<N> {
    let mut tau = JointVector::<N>::zeros();
    for (tau, (columns, row)) in tau.iter_mut().zip(columns.iter().zip(rows)) {
        for (parameter, column) in columns.iter().zip(row) {
            *tau += parameter * column;
        }
    }
    tau
}
