//! Forward kinematics, Jacobian and inverse kinematics of the tool.
//!
//! The tool flange is the tip of the description: the frame `flange` of a TOML file where it gives one, else the far end
//! of the last link (its DH frame); of a URDF the tip link. All poses are expressed in the base frame. Twists are six
//! numbers: velocity of the flange's origin, m/s, then angular velocity, rad/s, both along the axes of the base.
//!
//! [`Chain`] (any arm: forward, Jacobian) → `ur` (closed form) or damped least squares → [`Inverse`].

mod inverse;
mod ur;

use crate::dynamics::Joints;
use crate::robot::{Placement, Robot};
use nalgebra::{Matrix3, Rotation3, SMatrix, Vector3, Vector6};

pub use inverse::Inverse;

/// Velocity of the flange, m/s, then its angular velocity, rad/s; or the derivative of both.
pub type Twist = Vector6<f64>;

/// Below this smallest singular value of the Jacobian (m and rad mixed) a direction counts as lost.
const LOST: f64 = 1e-4;

/// A serial arm of revolute joints.
#[derive(Clone, Debug)]
pub struct Chain<const N: usize> {
    placements: [Placement; N],
    tip: Placement,
}

impl<const N: usize> Chain<N> {
    /// The arm with `tool` on its flange; `None` when the robot has not `N` joints.
    pub fn new(robot: &Robot, tool: &Placement) -> Option<Self> {
        Some(Self {
            placements: robot.each(|joint| joint.placement)?,
            tip: robot.flange.then(tool),
        })
    }

    /// Pose of the tip in the base frame: `P1 Rz(q1) … PN Rz(qN) · tip`.
    ///
    /// ```
    /// use foretorque_workbench::{dynamics::Joints, kinematics::Chain, robot::{Placement, Robot}};
    /// let ur5 = Robot::load("ur5").unwrap();
    /// let chain = Chain::<6>::new(&ur5, &Placement::identity()).unwrap();
    /// // Stretched out: x = a2 + a3 of the DH table.
    /// assert!((chain.forward(&Joints::zeros()).origin.x + 0.425 + 0.39225).abs() < 1e-12);
    /// ```
    pub fn forward(&self, q: &Joints<N>) -> Placement {
        self.frames(q).1
    }

    /// Geometric Jacobian, 6 × N: column j is the tip's twist when joint j turns at 1 rad/s.
    ///
    /// `J_j = (z_j × (p − o_j), z_j)`                                             [Siciliano et al. 2009, eq. 3.30]
    pub fn jacobian(&self, q: &Joints<N>) -> SMatrix<f64, 6, N> {
        let (frames, tip) = self.frames(q);
        SMatrix::<f64, 6, N>::from_columns(&frames.map(|frame| {
            let axis = axis(&frame);
            stacked(&axis.cross(&(tip.origin - frame.origin)), &axis)
        }))
    }

    /// Time derivative of the Jacobian while the joints turn at `qd`, rad/s.
    ///
    /// `ż_j = ω_j × z_j`, `d/dt (z_j × l) = ż_j × l + z_j × (ṗ − ȯ_j)`, ω_j of the link before joint j.
    pub fn jacobian_rate(&self, q: &Joints<N>, qd: &Joints<N>) -> SMatrix<f64, 6, N> {
        let (frames, tip) = self.frames(q);
        let (mut omega, mut velocity) = (Vector3::zeros(), Vector3::zeros());
        let moving: [_; N] = std::array::from_fn(|j| {
            if j > 0 {
                velocity += omega.cross(&(frames[j].origin - frames[j - 1].origin));
            }
            let before = (omega, velocity);
            omega += axis(&frames[j]) * qd[j];
            before
        });
        let last = frames.last().map_or(tip.origin, |last| last.origin);
        let tip_velocity = velocity + omega.cross(&(tip.origin - last));
        SMatrix::<f64, 6, N>::from_columns(&std::array::from_fn::<_, N, _>(|j| {
            let ((omega, velocity), axis) = (moving[j], axis(&frames[j]));
            let axis_rate = omega.cross(&axis);
            let turned = axis_rate.cross(&(tip.origin - frames[j].origin));
            stacked(
                &(turned + axis.cross(&(tip_velocity - velocity))),
                &axis_rate,
            )
        }))
    }

    /// Joint velocities and accelerations that give the tip the twist `v` and its derivative `a`; of all that do, the
    /// smallest velocities. `None` where the arm has lost a direction.
    ///
    /// With `J⁺ = Jᵀ (J Jᵀ)⁻¹`: `qd = J⁺ v`, and its derivative
    /// `qdd = J⁺ (a − J̇ qd) + (1 − J⁺ J) J̇ᵀ (J Jᵀ)⁻¹ v`            [Golub and Pereyra 1973, eq. 4.12 for full row rank]
    pub fn joint_motion(
        &self,
        q: &Joints<N>,
        v: &Twist,
        a: &Twist,
    ) -> Option<(Joints<N>, Joints<N>)> {
        let jacobian = self.jacobian(q);
        let square = jacobian * jacobian.transpose();
        if square.symmetric_eigenvalues().min() < LOST * LOST {
            return None;
        }
        let square = square.cholesky()?;
        let inverse = |twist: &Twist| -> Joints<N> { jacobian.tr_mul(&square.solve(twist)) };
        let qd = inverse(v);
        let rate = self.jacobian_rate(q, &qd);
        let drift: Joints<N> = rate.tr_mul(&square.solve(v));
        let qdd = inverse(&(a - rate * qd)) + drift - inverse(&(jacobian * drift));
        Some((qd, qdd))
    }

    /// Frames of the joints, and the tip, in the base frame.
    fn frames(&self, q: &Joints<N>) -> ([Placement; N], Placement) {
        let mut frame = Placement::identity();
        let frames = std::array::from_fn(|k| {
            frame = frame.then(&self.placements[k]).turned(q[k]);
            frame
        });
        (frames, frame.then(&self.tip))
    }
}

/// Axis of a joint in the frame in which its own is placed.
fn axis(frame: &Placement) -> Vector3<f64> {
    frame.rot_parent_child.column(2).into_owned()
}

/// The twist of a linear and an angular part.
pub(crate) fn stacked(linear: &Vector3<f64>, angular: &Vector3<f64>) -> Twist {
    Twist::new(
        linear.x, linear.y, linear.z, angular.x, angular.y, angular.z,
    )
}

/// Axis times angle (rad, at most π) of a rotation matrix.
///
/// From the matrix's unit quaternion: the trace alone loses half the digits of small angles.
pub fn rotation_vector(rot: &Matrix3<f64>) -> Vector3<f64> {
    let rotation = Rotation3::from_matrix_unchecked(*rot);
    nalgebra::UnitQuaternion::from_rotation_matrix(&rotation).scaled_axis()
}

/// The twist, over unit time, that moves `from` onto `to`: difference of origins, m, and rotation between them, rad.
fn pose_error(from: &Placement, to: &Placement) -> Twist {
    stacked(
        &(to.origin - from.origin),
        &rotation_vector(&(to.rot_parent_child * from.rot_parent_child.transpose())),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn arm<const N: usize>(name: &str) -> Chain<N> {
        let (xyz, rpy) = (Vector3::new(0.1, -0.05, 0.2), Vector3::new(0.3, 0.2, -1.0));
        let robot = Robot::load(name).expect("built in");
        Chain::new(&robot, &Placement::from_xyz_rpy(xyz, rpy)).expect("its size")
    }

    fn derivatives_agree<const N: usize>(chain: &Chain<N>) {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let mut draw = |size: f64| Joints::<N>::from_fn(|_, _| random.random_range(-size..=size));
        for _ in 0..50 {
            let (q, qd, h) = (draw(3.0), draw(2.0), 1e-6);
            let twist = pose_error(&chain.forward(&(q - qd * h)), &chain.forward(&(q + qd * h)));
            assert!((chain.jacobian(&q) * qd - twist / (2.0 * h)).amax() < 1e-7);
            let rate = (chain.jacobian(&(q + qd * h)) - chain.jacobian(&(q - qd * h))) / (2.0 * h);
            assert!((chain.jacobian_rate(&q, &qd) - rate).amax() < 1e-7);
        }
    }

    #[test]
    fn the_jacobian_and_its_rate_are_derivatives_of_the_pose() {
        derivatives_agree::<6>(&arm("ur5"));
        derivatives_agree::<7>(&arm("panda"));
    }

    fn motion_is_given_back<const N: usize>(chain: &Chain<N>) {
        let mut random = ChaCha8Rng::seed_from_u64(2);
        for _ in 0..50 {
            let q = Joints::<N>::from_fn(|_, _| random.random_range(-1.5..=1.5));
            let mut twist = || Twist::from_fn(|_, _| random.random_range(-0.3..=0.3));
            let (v, a) = (twist(), twist());
            let Some((qd, qdd)) = chain.joint_motion(&q, &v, &a) else {
                continue;
            };
            assert!((chain.jacobian(&q) * qd - v).amax() < 1e-6);
            let given = chain.jacobian(&q) * qdd + chain.jacobian_rate(&q, &qd) * qd;
            assert!((given - a).amax() < 1e-5 * (1.0 + qd.norm_squared()));
            // The acceleration is the derivative of the velocity along the motion.
            let h = 1e-6;
            let at = |t: f64| {
                let moved = q + qd * t + qdd * (0.5 * t * t);
                let (qd, _) = chain.joint_motion(&moved, &(v + a * t), &a).expect("near");
                qd
            };
            let slope = (at(h) - at(-h)) / (2.0 * h);
            assert!(
                (slope - qdd).amax() < 1e-3 * (1.0 + qdd.amax()),
                "{slope} {qdd}"
            );
        }
    }

    #[test]
    fn joint_motion_moves_the_tip_as_asked() {
        motion_is_given_back::<6>(&arm("ur5"));
        motion_is_given_back::<7>(&arm("panda"));
    }

    #[test]
    fn a_stretched_arm_has_lost_a_direction() {
        let straight = Joints::<6>::from_row_slice(&[0.3, -1.0, 0.0, 0.4, 1.0, 0.2]);
        let still = Twist::zeros();
        assert!(arm("ur5").joint_motion(&straight, &still, &still).is_none());
    }
}
