//! Friction of the simulated drives.

use crate::dynamics::Joints;
use crate::robot::{Friction, Robot};

/// Speed at which the smoothed sign of the Coulomb torque has reached 76 %, rad/s. Ten times below the speed that counts
/// as moving, so that the truth is a true Coulomb torque there; the integrator takes its slope implicitly.
const SIGN_WIDTH_RAD_S: f64 = 0.005;

/// Friction of all joints: viscous with drift, Coulomb with a part under load, Stribeck peak, cogging.
///
/// ```text
/// tau = d(t) v qd + (c (1 + s exp(−(qd / v_s)²)) + l |load|) tanh(qd / 0.005) + g sin(z q)
/// ```
/// with d(t) the warm-up drift and load the torque against gravity and velocity products. At qd = 0 the speed-dependent
/// part is zero: a joint at rest has no friction and creeps under load instead of sticking.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct FrictionModel<const N: usize> {
    joints: [Friction; N],
    /// Relative growth of the viscous coefficient, 1/s.
    pub(super) viscous_drift: f64,
    /// Coulomb torque for each N·m of load.
    load: f64,
}

impl<const N: usize> FrictionModel<N> {
    pub(super) fn new(robot: &Robot, viscous_drift: f64, load: f64) -> Option<Self> {
        Some(Self {
            joints: robot.each(|joint| joint.friction)?,
            viscous_drift,
            load,
        })
    }

    /// Torque the drives must supply against friction, N·m, and its slope over the velocity, N·m·s/rad.
    pub(super) fn torque_and_slope(
        &self,
        q: &Joints<N>,
        qd: &Joints<N>,
        load: &Joints<N>,
        t_s: f64,
    ) -> (Joints<N>, Joints<N>) {
        let (mut torque, mut slope) = (Joints::zeros(), Joints::zeros());
        for (j, friction) in self.joints.iter().enumerate() {
            let viscous = friction.viscous * (1.0 + self.viscous_drift * t_s);
            let sign = (qd[j] / SIGN_WIDTH_RAD_S).tanh();
            let ratio = qd[j] / friction.stribeck_velocity;
            let peak = friction.stribeck_ratio * (-ratio * ratio).exp();
            let cogging = friction.cogging * (friction.cogging_cycles_rev * q[j]).sin();
            let coulomb = friction.coulomb * (1.0 + peak) + self.load * load[j].abs();
            torque[j] = viscous * qd[j] + coulomb * sign + cogging;
            // The falling flank of the Stribeck peak is left out of the slope: only what damps is taken implicitly.
            slope[j] = viscous + coulomb * (1.0 - sign * sign) / SIGN_WIDTH_RAD_S;
        }
        (torque, slope)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn friction_has_its_described_values_far_from_standstill() {
        let robot = Robot::load("ur5").expect("built in");
        let model = FrictionModel::<6>::new(&robot, 0.0, 0.0).expect("six joints");
        let zero = Joints::zeros();
        let (still, _) = model.torque_and_slope(&zero, &zero, &Joints::zeros(), 0.0);
        assert_eq!(still, zero);
        let (fast, _) = model.torque_and_slope(&zero, &Joints::repeat(-2.0), &Joints::zeros(), 0.0);
        let (slow, _) = model.torque_and_slope(&zero, &Joints::repeat(0.05), &Joints::zeros(), 0.0);
        for (j, joint) in robot.joints.iter().enumerate() {
            let f = joint.friction;
            assert!((fast[j] + f.coulomb + 2.0 * f.viscous).abs() < 1e-9);
            // At half the Stribeck velocity the peak has fallen to exp(−1/4).
            let expected = f.viscous * 0.05 + f.coulomb * (1.0 + 0.25 * (-0.25_f64).exp());
            assert!((slow[j] - expected).abs() < 1e-6);
        }
    }

    #[test]
    fn cogging_is_periodic_drift_viscous_and_load_adds_coulomb() {
        let robot = Robot::load("ur5").expect("built in");
        let model = FrictionModel::<6>::new(&robot, 0.3 / 600.0, 0.0).expect("six joints");
        let q = Joints::<6>::repeat(0.3);
        let turn = Joints::repeat(std::f64::consts::TAU / 202.0);
        let qd = Joints::repeat(1.0);
        let (here, _) = model.torque_and_slope(&q, &qd, &Joints::zeros(), 0.0);
        let (next, _) = model.torque_and_slope(&(q + turn), &qd, &Joints::zeros(), 0.0);
        let (half, _) = model.torque_and_slope(&(q + turn * 0.5), &qd, &Joints::zeros(), 0.0);
        let (late, _) = model.torque_and_slope(&q, &qd, &Joints::zeros(), 600.0);
        let loaded = FrictionModel::<6>::new(&robot, 0.0, 0.1).expect("six joints");
        let (heavy, _) = loaded.torque_and_slope(&q, &qd, &Joints::repeat(-20.0), 0.0);
        assert!((heavy - here - Joints::repeat(2.0)).amax() < 1e-9);
        assert!((here - next).amax() < 1e-9);
        assert!((here - half).amax() > 0.1);
        for (j, joint) in robot.joints.iter().enumerate() {
            assert!((late[j] - here[j] - 0.3 * joint.friction.viscous).abs() < 1e-9);
        }
    }
}
