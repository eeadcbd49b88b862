//! Bounds of the rate of the drive torques, between two points of a certificate, from derivatives of the regressor's rows.

use super::rows::{FrameMotion, Rows};
use crate::dynamics::{Motion, PerJoint};
use crate::robot::{Coupling, Joint, LINK_PARAMETERS, Robot};
use nalgebra::{Matrix3, Vector3};

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

/// Derivatives by the motion of a link, in the base frame.
#[derive(Clone, Copy, Debug, Default)]
struct LinkSlopes {
    /// By a small turn of the link about the base's axes.
    turn: Vector3<f64>,
    origin: Vector3<f64>,
    acceleration: Vector3<f64>,
    axis: Vector3<f64>,
    omega: Vector3<f64>,
    alpha: Vector3<f64>,
}

impl LinkSlopes {
    /// Takes in the slope `by` of `α × r + ω × (ω × r)`, and returns that by r.
    fn take_lever(
        &mut self,
        by: &Vector3<f64>,
        lever: &Vector3<f64>,
        omega: &Vector3<f64>,
        alpha: &Vector3<f64>,
    ) -> Vector3<f64> {
        self.alpha += lever.cross(by);
        self.omega += omega.cross(lever).cross(by) + lever.cross(&by.cross(omega));
        by.cross(alpha) + by.cross(omega).cross(omega)
    }
}

impl Rows {
    /// Adds the derivatives of `Σ pull · rows` by q, qd, qdd of every joint to `slopes`.
    ///
    /// * `pull` N rows of [`Self::count`] weights, one after the other
    /// * `sign_width` as in [`write`](Self::write)
    ///
    /// The weighted columns of link k in row j are the torque `z · (r × h + n)` of a link with the weights m, c, I as
    /// parameters, `h = m a + α × c + ω × (ω × c)`, `n = c × a + I α + ω × I ω`, all in the parameters' frame of link k.
    /// A turn of everything changes nothing: the slope by a turn of the frame is less that of what is expressed in it.
    pub(super) fn add_slopes(
        &self,
        state: &Motion,
        sign_width: f64,
        pull: &[f64],
        slopes: &mut [[f64; 3]],
    ) {
        let (width, joints) = (self.count(), self.of_joints(state));
        let links = self.motion(state);
        // Weights of joint torques: `pullᵀ C⁻ᵀ`.
        let mut of_joints = pull.to_vec();
        if let Some(coupling) = &self.coupling {
            self.for_each_link_column(&mut of_joints, |weights| coupling.to_joints(weights));
        }
        let mut by = vec![LinkSlopes::default(); links.len()];
        for k in 0..links.len() {
            for j in 0..=k {
                let mut weights = [0.0; LINK_PARAMETERS];
                for column in self.columns_of(k) {
                    weights[self.link_columns[column].1] = of_joints[j * width + column];
                }
                add_torque(&links, [j, k], weights, &mut by);
            }
        }
        let mut by_joint = [PerJoint::repeat(links.len(), 0.0); 3];
        for k in (0..links.len()).rev() {
            let axis = links[k].link.axis;
            let before = k.checked_sub(1).map(|before| links[before].link);
            let before = before.unwrap_or_default();
            let (omega, alpha) = (before.omega, before.alpha);
            let step = before.rot * self.placements[k].origin;
            let (qd, qdd) = (joints.qd[k], joints.qdd[k]);
            let mut here = by[k];
            here.axis += here.omega * qd + here.alpha * qdd + here.alpha.cross(&omega) * qd;
            here.turn += axis.cross(&here.axis);
            by_joint[0][k] = axis.dot(&here.turn);
            by_joint[1][k] = axis.dot(&here.omega) + omega.cross(&axis).dot(&here.alpha);
            by_joint[2][k] = axis.dot(&here.alpha);
            let Some(inner) = k.checked_sub(1).map(|before| &mut by[before]) else {
                continue;
            };
            inner.omega += here.omega + axis.cross(&here.alpha) * qd;
            inner.alpha += here.alpha;
            inner.acceleration += here.acceleration;
            inner.origin += here.origin;
            let by_step = inner.take_lever(&here.acceleration, &step, &omega, &alpha) + here.origin;
            inner.turn += here.turn + step.cross(&by_step);
        }
        for (derivative, mut by_joint) in by_joint.into_iter().enumerate() {
            // The joints' derivatives by the drives are C⁻¹, as those of torques.
            if let Some(coupling) = &self.coupling {
                coupling.to_drive_torques(&mut by_joint);
            }
            let by_drive = slopes.iter_mut().zip(by_joint.iter());
            by_drive.for_each(|(slopes, by)| slopes[derivative] += by);
        }
        let rotors = self.link_columns.len();
        for (c, &joint) in self.rotor_columns.iter().enumerate() {
            slopes[joint][2] += pull[joint * width + rotors + c];
        }
        let friction = rotors + self.rotor_columns.len();
        for (j, slopes) in slopes.iter_mut().enumerate() {
            let own = &pull[j * width + friction + 2 * j..];
            let sign = (state.qd[j] / sign_width).tanh();
            slopes[1] += own[0] + own[1] * (1.0 - sign * sign) / sign_width;
        }
    }
}

/// Adds the slopes of the torque at joint j that link k causes, with these weights of its columns in the row.
fn add_torque(
    links: &[FrameMotion],
    [j, k]: [usize; 2],
    [mass, x, y, z, xx, yy, zz, xy, xz, yz]: [f64; LINK_PARAMETERS],
    slopes: &mut [LinkSlopes],
) {
    let c = &Vector3::new(x, y, z);
    let inertia = &Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
    let frame = &links[k];
    let FrameMotion {
        a, w, al, lever, ..
    } = frame;
    let (link, rot) = (&frame.link, &frame.rot_frame);
    let to_frame = rot.transpose();
    let r_base = link.origin + lever - links[j].link.origin;
    let (z, r) = (to_frame * links[j].link.axis, to_frame * r_base);
    let h = a * mass + al.cross(c) + w.cross(&w.cross(c));
    let (p, iw) = (z.cross(&r), inertia * w);
    let n = c.cross(a) + inertia * al + w.cross(&iw);
    let by_z = r.cross(&h) + n;
    let by_r = h.cross(&z);
    let by_a = p * mass + z.cross(c);
    let by_al = c.cross(&p) + inertia * z;
    let by_w = w.cross(c).cross(&p) + c.cross(&p.cross(w)) + iw.cross(&z) + inertia * z.cross(w);
    // What is expressed in the frame, turned back into the base.
    let against =
        a.cross(&by_a) + w.cross(&by_w) + al.cross(&by_al) + z.cross(&by_z) + r.cross(&by_r);
    let (by_a, by_r) = (rot * by_a, rot * by_r);
    let here = &mut slopes[k];
    here.acceleration += by_a;
    here.omega += rot * by_w;
    here.alpha += rot * by_al;
    here.origin += by_r;
    let by_lever = here.take_lever(&by_a, lever, &link.omega, &link.alpha) + by_r;
    here.turn += lever.cross(&by_lever) - rot * against;
    slopes[j].axis += rot * by_z;
    slopes[j].origin -= by_r;
}

#[cfg(test)]
mod tests {
    use super::super::rows::{Frames, coupled_ur5};
    use super::*;
    use crate::dynamics::{Joints, ReferenceModel, State, random_motions};
    use crate::robot::Robot;
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

    #[test]
    fn slopes_agree_with_central_differences() {
        const WIDTH: f64 = 0.3;
        let (ur5, coupled) = (Robot::load("ur5").expect("built in"), coupled_ur5());
        for (robot, frames) in [
            (&ur5, Frames::Dh),
            (&ur5, Frames::Board),
            (&coupled, Frames::Dh),
        ] {
            let rows = Rows::new(robot, frames);
            let size = 6 * rows.count();
            let pull: Vec<f64> = (0..size).map(|i| (1.7 * i as f64).sin()).collect();
            let sum = |state: &Motion| {
                let mut block = vec![0.0; size];
                rows.write(state, WIDTH, &mut block);
                block.iter().zip(&pull).map(|(x, y)| x * y).sum::<f64>()
            };
            for state in random_motions(6, 10) {
                let mut slopes = [[0.0; 3]; 6];
                rows.add_slopes(&state, WIDTH, &pull, &mut slopes);
                for (j, slopes) in slopes.iter().enumerate() {
                    let moved = |d: usize, by: f64| {
                        let mut moved = state;
                        *[&mut moved.q[j], &mut moved.qd[j], &mut moved.qdd[j]][d] += by;
                        sum(&moved)
                    };
                    for (d, slope) in slopes.iter().enumerate() {
                        let expected = (moved(d, 1e-5) - moved(d, -1e-5)) / 2e-5;
                        let close = (slope - expected).abs() < 1e-6 * (1.0 + expected.abs());
                        assert!(close, "{frames:?} joint {j}, {d}: {slope} {expected}");
                    }
                }
            }
        }
    }
}
