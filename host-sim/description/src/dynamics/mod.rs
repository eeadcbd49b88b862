//! The reference dynamics: f64, in a formulation of its own, as a reference for the firmware's recursion.
//!
//! The firmware runs Newton–Euler in link frames with moments about link origins. Here nothing is passed from link to
//! link but world-frame kinematics: the Newton–Euler equations of every link, about its centre of mass, are projected on
//! the partial velocities of the joints (Kane and Levinson 1985, chapter 6).

mod base_parameters;
mod kane;

pub use base_parameters::{BaseMap, BaseMapTerm, STATES, independent_columns};
pub use kane::{LinkMotion, Motion, PerJoint, RigidBodies, random_motions};

use crate::robot::{LINK_PARAMETERS, Link, Robot};
use nalgebra::{DMatrix, SMatrix, SVector};

/// One value for each joint, f64.
pub type Joints<const N: usize> = SVector<f64, N>;

/// Position, velocity and acceleration of all joints: rad, rad/s, rad/s².
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct State<const N: usize> {
    /// Joint positions, rad.
    pub q: Joints<N>,
    /// Joint velocities, rad/s.
    pub qd: Joints<N>,
    /// Joint accelerations, rad/s².
    pub qdd: Joints<N>,
}

impl<const N: usize> State<N> {
    /// Rest at `q`, rad.
    pub fn rest(q: Joints<N>) -> Self {
        let (qd, qdd) = (Joints::zeros(), Joints::zeros());
        Self { q, qd, qdd }
    }
}

impl<const N: usize> From<Joints<N>> for PerJoint<f64> {
    fn from(joints: Joints<N>) -> Self {
        joints.as_slice().into()
    }
}

impl<const N: usize> From<PerJoint<f64>> for Joints<N> {
    /// Panics for another number of joints.
    fn from(values: PerJoint<f64>) -> Self {
        Self::from_column_slice(&values)
    }
}

impl<const N: usize> From<State<N>> for Motion {
    fn from(state: State<N>) -> Self {
        let [q, qd, qdd] = [state.q, state.qd, state.qdd].map(PerJoint::from);
        Self { q, qd, qdd }
    }
}

impl<const N: usize> From<Motion> for State<N> {
    fn from(motion: Motion) -> Self {
        let [q, qd, qdd] = [motion.q, motion.qd, motion.qdd].map(Joints::from);
        Self { q, qd, qdd }
    }
}

/// [`RigidBodies`] with `N` joints.
#[derive(Clone, Debug)]
pub struct ReferenceModel<const N: usize>(RigidBodies);

impl<const N: usize> ReferenceModel<N> {
    /// The model of a robot; `None` when it has not `N` joints.
    pub fn new(robot: &Robot) -> Option<Self> {
        (robot.joint_count() == N).then(|| Self(RigidBodies::new(robot)))
    }

    /// This arm with `payload` fixed to its last link, given in that link's frame.
    pub fn with_payload(&self, payload: &Link) -> Self {
        Self(self.0.with_payload(payload))
    }

    /// Torques τ = M(q)·qdd + V(q, qd) + G(q) (eq. 12), N·m.
    pub fn inverse_dynamics(&self, state: &State<N>) -> Joints<N> {
        self.0.inverse_dynamics(&(*state).into()).into()
    }

    /// Gravity torques G(q), N·m.
    pub fn gravity_torques(&self, q: &Joints<N>) -> Joints<N> {
        self.0.gravity_torques(q.as_slice()).into()
    }

    /// Mass matrix M(q) with the rotor inertias on its diagonal, kg·m².
    pub fn mass_matrix(&self, q: &Joints<N>) -> SMatrix<f64, N, N> {
        self.mass_matrix_and_bias(q, &Joints::zeros()).0
    }

    /// M(q) and h(q, qd) from one pass over the kinematics: what a forward simulation needs at each step.
    pub fn mass_matrix_and_bias(
        &self,
        q: &Joints<N>,
        qd: &Joints<N>,
    ) -> (SMatrix<f64, N, N>, Joints<N>) {
        let mut mass = SMatrix::<f64, N, N>::zeros();
        let motion = coasting(q, qd);
        let bias = self.0.mass_matrix_and_bias(&motion, mass.as_mut_slice());
        (mass, bias.into())
    }

    /// Kinetic plus potential energy, J; the potential is zero with all centres of mass at the base origin.
    pub fn energy(&self, q: &Joints<N>, qd: &Joints<N>) -> f64 {
        self.0.energy(&coasting(q, qd))
    }

    /// Joint torque regressor, see [`RigidBodies::regressor_into`].
    pub fn regressor(&self, state: &State<N>) -> DMatrix<f64> {
        let mut rows = DMatrix::zeros(N, (LINK_PARAMETERS + 1) * N);
        self.0.regressor_into(&(*state).into(), &mut rows, 0);
        rows
    }
}

/// A motion without accelerations.
fn coasting<const N: usize>(q: &Joints<N>, qd: &Joints<N>) -> Motion {
    let state = State {
        qd: *qd,
        ..State::rest(*q)
    };
    state.into()
}

#[cfg(test)]
mod tests;
