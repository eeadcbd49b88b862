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
mod tests {
    use super::*;
    use crate::robot::{LINK_PARAMETERS, Robot};
    use nalgebra::{DMatrix, DVector};
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn ur5() -> Robot {
        Robot::load("ur5").unwrap()
    }

    fn model(robot: &Robot) -> ReferenceModel<6> {
        ReferenceModel::new(robot).unwrap()
    }

    /// A UR5 whose two last drives turn both wrist joints.
    fn coupled() -> Robot {
        coupled_by("[[1, 0.5], [-1, 1]]")
    }

    fn coupled_by(matrix: &str) -> Robot {
        let limits = "limits = { position_rad = [-2, 2], velocity_rad_s = 2, torque_nm = 20 }";
        let overlay = format!(
            "from = 'ur5'
            joints = [{{ name = 'wrist_2', {limits} }}, {{ name = 'wrist_3', {limits} }}]
            [coupling]
            joints = ['wrist_2', 'wrist_3']
            matrix = {matrix}"
        );
        Robot::parse("coupled", &overlay).unwrap()
    }

    fn random_state(random: &mut ChaCha8Rng) -> State<6> {
        let mut draw = |size: f64| Joints::<6>::from_fn(|_, _| random.random_range(-size..=size));
        State {
            q: draw(std::f64::consts::TAU),
            qd: draw(std::f64::consts::PI),
            qdd: draw(10.0),
        }
    }

    #[test]
    fn gear_ratios_in_a_coupling_lose_no_base_parameter() {
        let columns = |matrix| coupled_by(matrix).base_map().columns;
        let unit = columns("[[1, 1], [1, -1]]");
        assert_eq!(columns("[[100, 100], [100, -100]]"), unit);
    }

    #[test]
    fn inverse_dynamics_is_mass_matrix_times_acceleration_plus_bias() {
        for robot in [ur5(), coupled()] {
            let model = model(&robot.perturbed(5));
            let mut random = ChaCha8Rng::seed_from_u64(1);
            for _ in 0..500 {
                let state = random_state(&mut random);
                let (mass, bias) = model.mass_matrix_and_bias(&state.q, &state.qd);
                let error = model.inverse_dynamics(&state) - (mass * state.qdd + bias);
                assert!(error.amax() < 1e-12 * 150.0, "{error}");
                assert!(mass.symmetric_eigenvalues().min() > 0.0);
            }
        }
    }

    #[test]
    fn power_of_the_torques_is_the_change_of_energy() {
        for robot in [ur5(), coupled()] {
            let model = model(&robot.perturbed(6));
            let mut random = ChaCha8Rng::seed_from_u64(2);
            for _ in 0..200 {
                let state = random_state(&mut random);
                let h = 1e-5;
                let energy = |t: f64| {
                    let q = state.q + state.qd * t + state.qdd * (0.5 * t * t);
                    model.energy(&q, &(state.qd + state.qdd * t))
                };
                let rate = (energy(h) - energy(-h)) / (2.0 * h);
                let power = state.qd.dot(&model.inverse_dynamics(&state));
                let near = (rate - power).abs() < 1e-6 * (1.0 + power.abs());
                assert!(near, "{rate} {power}");
            }
        }
    }

    #[test]
    fn regressor_times_standard_parameters_is_the_torque() {
        let mut random = ChaCha8Rng::seed_from_u64(4);
        for robot in [ur5(), coupled()] {
            let robot = robot.perturbed(7);
            let model = model(&robot);
            let x = DVector::from_vec(robot.standard_parameters());
            // Rows of the motion before are written over.
            let mut rows = DMatrix::zeros(6, (LINK_PARAMETERS + 1) * 6);
            for _ in 0..200 {
                let state = random_state(&mut random);
                let tau = model.inverse_dynamics(&state);
                RigidBodies::new(&robot).regressor_into(&state.into(), &mut rows, 0);
                let error = &rows * &x - DVector::from_column_slice(tau.as_slice());
                assert!(error.amax() < 1e-11, "{error}");
            }
        }
    }

    /// θ = C q, and drive torques m with `τ = Cᵀ m`: by hand for the wrist, whose rotors do not turn.
    #[test]
    fn drives_of_coupled_joints_carry_their_torques() {
        let (alone, coupled) = (ur5(), coupled());
        let [alone, both] = [&alone, &coupled].map(model);
        let q = Joints::<6>::from_column_slice(&[0.3, -1.0, 0.8, -0.4, 0.6, 0.9]);
        let tau = alone.gravity_torques(&q);
        let mut theta = q;
        (theta[4], theta[5]) = (q[4] + 0.5 * q[5], q[5] - q[4]);
        let m = both.gravity_torques(&theta);
        assert!((tau.rows(0, 4) - m.rows(0, 4)).amax() < 1e-12);
        assert!((tau[4] - (m[4] - m[5])).abs() < 1e-12 && tau[4].abs() > 0.01);
        assert!((tau[5] - (0.5 * m[4] + m[5])).abs() < 1e-12);
        let again = Robot::parse("again", &coupled.to_toml().unwrap());
        assert_eq!(again.unwrap().coupling, coupled.coupling);
    }
}
