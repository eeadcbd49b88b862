//! Bounds of the rate of the drive torques, for the time between two points of a certificate.

use crate::dynamics::Joints;
use crate::robot::{Placement, Robot};
use nalgebra::Vector3;

/// Sizes of an arm that no pose exceeds.
#[derive(Clone, Debug)]
pub(super) struct TorqueRates<const N: usize> {
    mass: [f64; N],
    /// Largest moment of inertia of each link about its centre of mass, kg·m².
    inertia: [f64; N],
    rotor: [f64; N],
    /// Distance of each centre of mass from its joint frame, m.
    com: [f64; N],
    /// Length from each joint frame to the next, m; entry 0 is the base's.
    step: [f64; N],
    gravity: f64,
}

/// Bounds of the motion around an instant, all N × and not negative.
#[derive(Clone, Copy, Debug)]
pub(super) struct MotionBounds<const N: usize> {
    pub(super) qd: Joints<N>,
    pub(super) qdd: Joints<N>,
    pub(super) jerk: Joints<N>,
}

impl<const N: usize> TorqueRates<N> {
    /// `None` when the robot has not `N` joints.
    pub(super) fn new(robot: &Robot) -> Option<Self> {
        let length = |placement: &Placement| Vector3::norm(&placement.origin);
        Some(Self {
            mass: robot.each(|joint| joint.link.mass)?,
            inertia: robot.each(|joint| joint.link.inertia_com.symmetric_eigenvalues().max())?,
            rotor: robot.each(|joint| joint.drive.rotor_inertia)?,
            com: robot.each(|joint| joint.link.com.norm())?,
            step: robot.each(|joint| length(&joint.placement))?,
            gravity: robot.gravity.norm(),
        })
    }

    /// Bound of |d tau / dt| of the rigid body and the rotors, N·m/s.
    ///
    /// Kane: `tau_j = Σ_k m p·a + z_j·(I α + ω × I ω)` with p = z_j × (c_k − o_j). With Ω, A, B bounds of |ω|, |α|, |α̇|
    /// (ω = Σ z_i qd_i, ż = ω × z), a length ℓ that turns with link i adds at most
    /// ```text
    /// (A + Ω²) ℓ to |a|,    (B + 3 Ω A + Ω³) ℓ to |ȧ|,    ℓ to |p|,    (Ω_i + Ω_j) ℓ to |ṗ|,
    /// |d/dt (I α + ω × I ω)| ≤ I (B + 4 Ω A + 2 Ω³)
    /// ```
    pub(super) fn bound(&self, motion: &MotionBounds<N>) -> Joints<N> {
        let (mut omega, mut alpha, mut beta) = ([0.0; N], [0.0; N], [0.0; N]);
        let (mut w, mut a, mut b) = (0.0_f64, 0.0, 0.0);
        for k in 0..N {
            w += motion.qd[k];
            a += motion.qdd[k] + w * motion.qd[k];
            b += motion.jerk[k] + 2.0 * w * motion.qdd[k] + (a + w * w) * motion.qd[k];
            (omega[k], alpha[k], beta[k]) = (w, a, b);
        }
        let turning = |i: usize| alpha[i] + omega[i] * omega[i];
        let turning_rate = |i: usize| beta[i] + 3.0 * omega[i] * alpha[i] + omega[i].powi(3);
        let mut rates = Joints::zeros();
        // Acceleration of joint frame k and its rate: lengths up to there.
        let (mut acceleration, mut jolt) = (self.gravity, 0.0);
        for k in 0..N {
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
            rates[k] += self.rotor[k] * motion.jerk[k];
        }
        rates
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dynamics::{ReferenceModel, State};
    use rand::{Rng, SeedableRng};

    #[test]
    fn torque_never_changes_faster_than_its_bound() {
        let robot = Robot::load("ur5").expect("built in");
        let model = ReferenceModel::<6>::new(&robot).expect("six joints");
        let rates = TorqueRates::<6>::new(&robot).expect("six joints");
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(1);
        let h = 1e-6;
        for _ in 0..2000 {
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
                qd: qd.abs(),
                qdd: qdd.abs(),
                jerk: jerk.abs(),
            });
            for j in 0..6 {
                assert!(change[j].abs() <= bound[j] * (1.0 + 1e-6), "joint {j}");
            }
        }
    }
}
