//! Kane's equations through centre-of-mass Jacobians, world frame, for a number of joints that is known at run time.

use crate::robot::{Coupling, LINK_PARAMETERS, Link, MAX_JOINTS, Placement, Robot};
use nalgebra::{DMatrix, DMatrixViewMut, Matrix3, Rotation3, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::ops::{Deref, DerefMut};

/// One link: where its joint sits and how its mass is distributed.
#[derive(Clone, Copy, Debug)]
struct Body {
    placement: Placement,
    link: Link,
    rotor_inertia: f64,
}

/// Rigid-body dynamics of an arm of revolute joints, as many as its description has.
///
/// Motions and torques are those of the drives, which turn otherwise than the joints where the arm has a coupling.
#[derive(Clone, Debug)]
pub struct RigidBodies {
    bodies: Vec<Body>,
    gravity: Vector3<f64>,
    coupling: Option<Coupling>,
}

/// Kinematics of one link in the base frame.
#[derive(Clone, Copy, Debug, Default)]
pub struct LinkMotion {
    /// Rotation that maps the coordinates of the link into the base frame.
    pub rot: Matrix3<f64>,
    /// Axis of the joint.
    pub axis: Vector3<f64>,
    /// Origin of the joint frame, on that axis, m.
    pub origin: Vector3<f64>,
    /// Angular velocity, rad/s.
    pub omega: Vector3<f64>,
    /// Angular acceleration, rad/s².
    pub alpha: Vector3<f64>,
    /// Acceleration of the origin less gravity, m/s².
    pub acceleration: Vector3<f64>,
}

impl RigidBodies {
    /// The bodies of a robot.
    pub fn new(robot: &Robot) -> Self {
        let bodies = robot.joints.iter().map(|joint| Body {
            placement: joint.placement,
            link: joint.link,
            rotor_inertia: joint.drive.rotor_inertia,
        });
        Self {
            bodies: bodies.collect(),
            gravity: robot.gravity,
            coupling: robot.coupling.clone(),
        }
    }

    /// Number of joints.
    pub fn joints(&self) -> usize {
        self.bodies.len()
    }

    /// This arm with `payload` fixed to its last link, given in that link's frame.
    pub fn with_payload(&self, payload: &Link) -> Self {
        let mut loaded = self.clone();
        if let Some(last) = loaded.bodies.last_mut() {
            last.link = Link::lumped(&[last.link, *payload]).unwrap_or(last.link);
        }
        loaded
    }

    /// Torques τ = M(q)·qdd + V(q, qd) + G(q) (eq. 12), N·m.
    pub fn inverse_dynamics(&self, motion: &Motion) -> PerJoint<f64> {
        let kinematics = self.kinematics(motion);
        let mut tau = self.project(&kinematics);
        for (j, body) in self.bodies.iter().enumerate() {
            tau[j] += body.rotor_inertia * motion.qdd[j];
        }
        tau
    }

    /// Gravity torques G(q), N·m.
    pub fn gravity_torques(&self, q: &[f64]) -> PerJoint<f64> {
        let mut motion = Motion::zeros(q.len());
        motion.q = q.into();
        self.project(&self.kinematics(&motion))
    }

    /// Largest gravity torque of each joint over 64 seeded poses, N·m.
    pub fn largest_gravity_torques(&self) -> PerJoint<f64> {
        self.largest(|motion| self.gravity_torques(&motion.q))
    }

    /// Largest torque of each joint over 64 seeded motions of up to 3 rad/s and 10 rad/s², N·m.
    pub fn largest_torques(&self) -> PerJoint<f64> {
        self.largest(|motion| self.inverse_dynamics(motion))
    }

    /// [`random_motions`] of the joints, as motions of the drives.
    pub fn random_motions(&self, count: usize) -> Vec<Motion> {
        let mut motions = random_motions(self.joints(), count);
        if let Some(coupling) = &self.coupling {
            for motion in &mut motions {
                coupling.to_drives(&mut motion.q);
                coupling.to_drives(&mut motion.qd);
                coupling.to_drives(&mut motion.qdd);
            }
        }
        motions
    }

    fn largest(&self, torques: impl Fn(&Motion) -> PerJoint<f64>) -> PerJoint<f64> {
        const MOTIONS: usize = 64;
        let mut largest = PerJoint::repeat(self.joints(), 0.0_f64);
        for motion in self.random_motions(MOTIONS) {
            for (largest, torque) in largest.iter_mut().zip(torques(&motion).iter()) {
                *largest = largest.max(torque.abs());
            }
        }
        largest
    }

    /// M(q), symmetric and row by row, and h(q, qd), without accelerations in `motion`.
    ///
    /// `M = Σ_k m_k J_ckᵀ J_ck + J_ωkᵀ I_k J_ωk + diag(rotor)`, the Jacobians of the centres of mass.
    pub(super) fn mass_matrix_and_bias(&self, motion: &Motion, mass: &mut [f64]) -> PerJoint<f64> {
        let (count, kinematics) = (self.joints(), self.kinematics(motion));
        mass.fill(0.0);
        for (k, body) in self.bodies.iter().enumerate() {
            let rot = &kinematics[k].rot;
            let com = kinematics[k].origin + rot * body.link.com;
            let inertia = rot * body.link.inertia_com * rot.transpose();
            let mut partial = [Vector3::zeros(); MAX_JOINTS];
            for j in 0..=k {
                let axis = &kinematics[j].axis;
                partial[j] = axis.cross(&(com - kinematics[j].origin));
                let momentum = body.link.mass * partial[j];
                let spin = inertia * axis;
                for i in 0..=j {
                    mass[i * count + j] +=
                        partial[i].dot(&momentum) + kinematics[i].axis.dot(&spin);
                }
            }
        }
        let mut matrix = DMatrixViewMut::from_slice(mass, count, count);
        matrix.fill_upper_triangle_with_lower_triangle();
        // C⁻ᵀ M C⁻¹: M is symmetric, so both products are those of its rows.
        if let Some(coupling) = &self.coupling {
            for _ in 0..2 {
                for row in mass.chunks_exact_mut(count) {
                    coupling.to_drive_torques(row);
                }
                DMatrixViewMut::from_slice(mass, count, count).transpose_mut();
            }
        }
        for j in 0..count {
            mass[j * count + j] += self.bodies[j].rotor_inertia;
        }
        self.project(&kinematics)
    }

    /// Kinetic plus potential energy, J; the potential is zero with all centres of mass at the base origin.
    pub(super) fn energy(&self, motion: &Motion) -> f64 {
        let kinematics = self.kinematics(motion);
        let mut energy = 0.0;
        let mut velocity = Vector3::zeros();
        for (k, body) in self.bodies.iter().enumerate() {
            if k > 0 {
                let lever = kinematics[k].origin - kinematics[k - 1].origin;
                velocity += kinematics[k - 1].omega.cross(&lever);
            }
            let (rot, omega) = (&kinematics[k].rot, &kinematics[k].omega);
            let lever = rot * body.link.com;
            let speed = velocity + omega.cross(&lever);
            let spin = rot.transpose() * omega;
            energy += 0.5 * body.link.mass * speed.norm_squared()
                + 0.5 * spin.dot(&(body.link.inertia_com * spin))
                + 0.5 * body.rotor_inertia * motion.qd[k] * motion.qd[k]
                - body.link.mass * self.gravity.dot(&(kinematics[k].origin + lever));
        }
        energy
    }

    /// Joint torque regressor, written into `target` from row `first_row` on, for stacking long logs; the rows must be zero, or
    /// those of another motion.
    /// N rows for N joints; ten columns a link in the order of eq. 14, then N rotor columns, so that
    /// `regressor · robot.standard_parameters() = inverse_dynamics`.
    ///
    /// Link wrench about its origin o, in the link frame, with `U = [α]× + [ω]×²`:
    /// `F = m a + U (m c)`, `n_o = (m c) × a + I α + ω × I ω`; the torque of joint j is `z_j · (n_o + (o − o_j) × F)`.
    ///
    /// Panics when `target` is smaller than N rows below `first_row` or than 11 N columns.
    pub fn regressor_into(&self, motion: &Motion, target: &mut DMatrix<f64>, first_row: usize) {
        let rotors = LINK_PARAMETERS * self.joints();
        let kinematics = self.kinematics(motion);
        for k in 0..self.joints() {
            let world_to_link = kinematics[k].rot.transpose();
            let a = world_to_link * kinematics[k].acceleration;
            let w = world_to_link * kinematics[k].omega;
            let alpha = world_to_link * kinematics[k].alpha;
            let (force, moment) = unit_wrenches(&a, &w, &alpha);
            for j in 0..=k {
                let axis = world_to_link * kinematics[j].axis;
                let lever = world_to_link * (kinematics[k].origin - kinematics[j].origin);
                let partial = axis.cross(&lever);
                for c in 0..LINK_PARAMETERS {
                    target[(first_row + j, LINK_PARAMETERS * k + c)] =
                        axis.dot(&moment[c]) + partial.dot(&force[c]);
                }
            }
            target[(first_row + k, rotors + k)] = motion.qdd[k];
        }
        if let Some(coupling) = &self.coupling {
            for column in 0..rotors {
                let unmoved = column / LINK_PARAMETERS + 1..self.joints();
                unmoved.for_each(|joint| target[(first_row + joint, column)] = 0.0);
                let mut column = target.column_mut(column);
                let torques = &mut column.as_mut_slice()[first_row..][..self.joints()];
                coupling.to_drive_torques(torques);
            }
        }
    }

    /// Kinematics of every link, from the base on, under a motion of the drives.
    pub fn kinematics(&self, motion: &Motion) -> [LinkMotion; MAX_JOINTS] {
        let mut motion = *motion;
        if let Some(coupling) = &self.coupling {
            coupling.to_joints(&mut motion.q);
            coupling.to_joints(&mut motion.qd);
            coupling.to_joints(&mut motion.qdd);
        }
        // An arm at rest on a base that accelerates with −g has the same forces as one in the field g.
        let mut now = LinkMotion {
            rot: Matrix3::identity(),
            acceleration: -self.gravity,
            ..LinkMotion::default()
        };
        let mut out = [now; MAX_JOINTS];
        for (k, body) in self.bodies.iter().enumerate() {
            let step = now.rot * body.placement.origin;
            now.origin += step;
            now.acceleration += now.alpha.cross(&step) + now.omega.cross(&now.omega.cross(&step));
            let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), motion.q[k]);
            now.rot = now.rot * body.placement.rot_parent_child * turn.matrix();
            now.axis = now.rot.column(2).into_owned();
            now.alpha += now.axis * motion.qdd[k] + now.omega.cross(&now.axis) * motion.qd[k];
            now.omega += now.axis * motion.qd[k];
            out[k] = now;
        }
        out
    }

    /// Generalised inertia forces: every link's `m a_c` and `I α + ω × I ω` on the partial velocities of each joint.
    fn project(&self, kinematics: &[LinkMotion]) -> PerJoint<f64> {
        let mut tau = PerJoint::repeat(self.joints(), 0.0);
        for (k, body) in self.bodies.iter().enumerate() {
            let rot = &kinematics[k].rot;
            let (omega, alpha) = (&kinematics[k].omega, &kinematics[k].alpha);
            let lever = rot * body.link.com;
            let acceleration = kinematics[k].acceleration
                + alpha.cross(&lever)
                + omega.cross(&omega.cross(&lever));
            let force = body.link.mass * acceleration;
            let spin = rot.transpose() * omega;
            let moment = rot
                * (body.link.inertia_com * (rot.transpose() * alpha)
                    + spin.cross(&(body.link.inertia_com * spin)));
            let com = kinematics[k].origin + lever;
            for j in 0..=k {
                let axis = &kinematics[j].axis;
                let partial = axis.cross(&(com - kinematics[j].origin));
                tau[j] += partial.dot(&force) + axis.dot(&moment);
            }
        }
        if let Some(coupling) = &self.coupling {
            coupling.to_drive_torques(&mut tau);
        }
        tau
    }
}

/// Force and moment about the link origin made by each standard parameter at value one, in the link frame.
fn unit_wrenches(
    a: &Vector3<f64>,
    w: &Vector3<f64>,
    alpha: &Vector3<f64>,
) -> (
    [Vector3<f64>; LINK_PARAMETERS],
    [Vector3<f64>; LINK_PARAMETERS],
) {
    let mut force = [Vector3::zeros(); LINK_PARAMETERS];
    let mut moment = [Vector3::zeros(); LINK_PARAMETERS];
    force[0] = *a;
    for axis in 0..3 {
        let first_moment = Vector3::ith(axis, 1.0);
        force[1 + axis] = alpha.cross(&first_moment) + w.cross(&w.cross(&first_moment));
        moment[1 + axis] = first_moment.cross(a);
    }
    // Ixx, Iyy, Izz, Ixy, Ixz, Iyz
    let entries = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)];
    for (c, (i, j)) in entries.into_iter().enumerate() {
        let mut inertia = Matrix3::zeros();
        inertia[(i, j)] = 1.0;
        inertia[(j, i)] = 1.0;
        moment[4 + c] = inertia * alpha + w.cross(&(inertia * w));
    }
    (force, moment)
}

/// One value for each joint, without the heap: a slice with room for the most joints an arm may have.
#[derive(Clone, Copy, Debug, Default)]
pub struct PerJoint<T> {
    values: [T; MAX_JOINTS],
    count: usize,
}

/// Position, velocity and acceleration of all joints: rad, rad/s, rad/s².
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Motion {
    /// Joint positions, rad.
    pub q: PerJoint<f64>,
    /// Joint velocities, rad/s.
    pub qd: PerJoint<f64>,
    /// Joint accelerations, rad/s².
    pub qdd: PerJoint<f64>,
}

impl Motion {
    /// So many joints at rest at zero.
    pub fn zeros(joints: usize) -> Self {
        let zero = PerJoint::repeat(joints, 0.0);
        let [q, qd, qdd] = [zero; 3];
        Self { q, qd, qdd }
    }
}

impl<T: Copy + Default> PerJoint<T> {
    /// The values that `of` gives for `count` joints.
    ///
    /// Panics beyond the most joints an arm may have; a description with more is refused.
    pub fn from_fn(count: usize, of: impl FnMut(usize) -> T) -> Self {
        let mut out = Self {
            values: [T::default(); MAX_JOINTS],
            count,
        };
        for (value, new) in out.values[..count].iter_mut().zip((0..count).map(of)) {
            *value = new;
        }
        out
    }

    /// `value` for each of `count` joints.
    pub fn repeat(count: usize, value: T) -> Self {
        Self::from_fn(count, |_| value)
    }

    /// Values of `of`, one for each value.
    pub fn map<U: Copy + Default>(&self, mut of: impl FnMut(T) -> U) -> PerJoint<U> {
        PerJoint::from_fn(self.count, |joint| of(self.values[joint]))
    }
}

impl<T: Copy + Default> From<&[T]> for PerJoint<T> {
    fn from(values: &[T]) -> Self {
        Self::from_fn(values.len(), |joint| values[joint])
    }
}

impl<T: Copy + Default, const N: usize> From<[T; N]> for PerJoint<T> {
    fn from(values: [T; N]) -> Self {
        values.as_slice().into()
    }
}

impl<T> Deref for PerJoint<T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        &self.values[..self.count]
    }
}

impl<T> DerefMut for PerJoint<T> {
    fn deref_mut(&mut self) -> &mut [T] {
        &mut self.values[..self.count]
    }
}

impl<T: PartialEq> PartialEq for PerJoint<T> {
    fn eq(&self, other: &Self) -> bool {
        **self == **other
    }
}

/// Seeded motions of so many joints at which inertia, velocity and gravity terms weigh alike.
pub fn random_motions(joints: usize, count: usize) -> Vec<Motion> {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let mut draw = |size: f64| PerJoint::from_fn(joints, |_| random.random_range(-size..=size));
    let motions = (0..count).map(|_| Motion {
        q: draw(std::f64::consts::PI),
        qd: draw(3.0),
        qdd: draw(10.0),
    });
    motions.collect()
}
