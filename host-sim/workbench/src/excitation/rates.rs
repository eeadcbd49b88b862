//! Bounds of the rate of the drive torques, for the time between two points of a certificate.

use crate::dynamics::PerJoint;
use crate::robot::{Coupling, Joint, Robot};

/// Sizes of an arm that no pose exceeds.
#[derive(Clone, Debug)]
pub(super) struct TorqueRates {
    mass: PerJoint<f64>,
    /// Largest moment of inertia of each link about its centre of mass, kg·m².
    inertia: PerJoint<f64>,
    rotor: PerJoint<f64>,
    /// Distance of each centre of mass from its joint frame, m.
    com: PerJoint<f64>,
    /// Length from each joint frame to the next, m; entry 0 is the base's.
    step: PerJoint<f64>,
    gravity: f64,
    coupling: Option<Coupling>,
}

/// Bounds of the motion around an instant, not negative.
#[derive(Clone, Copy, Debug)]
pub(super) struct MotionBounds {
    pub(super) qd: PerJoint<f64>,
    pub(super) qdd: PerJoint<f64>,
    pub(super) jerk: PerJoint<f64>,
}

impl TorqueRates {
    pub(super) fn new(robot: &Robot) -> Self {
        let each = |of: fn(&Joint) -> f64| {
            PerJoint::from_fn(robot.joint_count(), |joint| of(&robot.joints[joint]))
        };
        Self {
            mass: each(|joint| joint.link.mass),
            inertia: each(|joint| joint.link.inertia_com.symmetric_eigenvalues().max()),
            rotor: each(|joint| joint.drive.rotor_inertia),
            com: each(|joint| joint.link.com.norm()),
            step: each(|joint| joint.placement.origin.norm()),
            gravity: robot.gravity.norm(),
            coupling: robot.coupling.clone(),
        }
    }

    /// Bound of |d tau / dt| of the rigid body and the rotors, N·m/s.
    ///
    /// Kane: `tau_j = Σ_k m p·a + z_j·(I α + ω × I ω)` with p = z_j × (c_k − o_j). With Ω, A, B bounds of |ω|, |α|, |α̇|
    /// (ω = Σ z_i qd_i, ż = ω × z), a length ℓ that turns with link i adds at most
    /// ```text
    /// (A + Ω²) ℓ to |a|,    (B + 3 Ω A + Ω³) ℓ to |ȧ|,    ℓ to |p|,    (Ω_i + Ω_j) ℓ to |ṗ|,
    /// |d/dt (I α + ω × I ω)| ≤ I (B + 4 Ω A + 2 Ω³)
    /// ```
    pub(super) fn bound(&self, drives: &MotionBounds) -> PerJoint<f64> {
        let mut motion = *drives;
        if let Some(coupling) = &self.coupling {
            for bounds in [&mut motion.qd, &mut motion.qdd, &mut motion.jerk] {
                coupling.to_joint_bounds(bounds);
            }
        }
        let joints = self.mass.len();
        let zero = PerJoint::repeat(joints, 0.0);
        let (mut omega, mut alpha, mut beta) = (zero, zero, zero);
        let (mut w, mut a, mut b) = (0.0_f64, 0.0, 0.0);
        for k in 0..joints {
            w += motion.qd[k];
            a += motion.qdd[k] + w * motion.qd[k];
            b += motion.jerk[k] + 2.0 * w * motion.qdd[k] + (a + w * w) * motion.qd[k];
            (omega[k], alpha[k], beta[k]) = (w, a, b);
        }
        let turning = |i: usize| alpha[i] + omega[i] * omega[i];
        let turning_rate = |i: usize| beta[i] + 3.0 * omega[i] * alpha[i] + omega[i].powi(3);
        let mut rates = zero;
        // Acceleration of joint frame k and its rate: lengths up to there.
        let (mut acceleration, mut jolt) = (self.gravity, 0.0);
        for k in 0..joints {
            if k > 0 {
                acceleration += turning(k - 1) * self.step[k];
                jolt += turning_rate(k - 1) * self.step[k];
            }
            let at_com = acceleration + turning(k) * self.com[k];
            let jolt_com = jolt + turning_rate(k) * self.com[k];
            let spin = self.inertia[k] * turning(k);
            let spin_rate =
                self.inertia[k] * (beta[k] + 4.0 * omega[k] * alpha[k] + 2.0 * omega[k].powi(3));
            // p and ṗ grow from the centre of mass inwards.
            let mut lever = self.com[k];
            let mut sweep = omega[k] * self.com[k];
            for j in (0..=k).rev() {
                let swept = sweep + omega[j] * lever;
                rates[j] += self.mass[k] * (swept * at_com + lever * jolt_com)
                    + omega[j] * spin
                    + spin_rate;
                if j > 0 {
                    lever += self.step[j];
                    sweep += omega[j - 1] * self.step[j];
                }
            }
        }
        if let Some(coupling) = &self.coupling {
            coupling.to_drive_torque_bounds(&mut rates);
        }
        for (k, rate) in rates.iter_mut().enumerate() {
            *rate += self.rotor[k] * drives.jerk[k];
        }
        rates
    }
}

#[cfg(test)]
mod tests {
    use super::super::rows::coupled_ur5;
    use super::*;
    use crate::dynamics::{Joints, ReferenceModel, State};
    use rand::{Rng, SeedableRng};

    #[test]
    fn torque_never_changes_faster_than_its_bound() {
        let robots = [Robot::load("ur5").expect("built in"), coupled_ur5()];
        let models = robots.each_ref().map(|robot| {
            let model = ReferenceModel::<6>::new(robot).expect("six joints");
            (model, TorqueRates::new(robot))
        });
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(1);
        let h = 1e-6;
        for draw in 0..4000 {
            let (model, rates) = &models[draw % 2];
            let mut draw =
                |size: f64| Joints::<6>::from_fn(|_, _| random.random_range(-size..size));
            let (q, qd, qdd, jerk) = (draw(3.0), draw(3.0), draw(10.0), draw(30.0));
            let at = |t: f64| {
                model.inverse_dynamics(&State {
                    q: q + qd * t + qdd * (t * t / 2.0) + jerk * (t * t * t / 6.0),
                    qd: qd + qdd * t + jerk * (t * t / 2.0),
                    qdd: qdd + jerk * t,
                })
            };
            let change = (at(h) - at(-h)) / (2.0 * h);
            let bound = rates.bound(&MotionBounds {
                qd: qd.abs().into(),
                qdd: qdd.abs().into(),
                jerk: jerk.abs().into(),
            });
            for j in 0..6 {
                assert!(change[j].abs() <= bound[j] * (1.0 + 1e-6), "joint {j}");
            }
        }
    }
}
