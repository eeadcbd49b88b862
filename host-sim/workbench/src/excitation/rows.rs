//! Rows of the base regressor in the link frames of the description, with rotor and friction columns.

use crate::dynamics::{LinkMotion, Motion, PerJoint, RigidBodies, STATES, independent_columns};
use crate::robot::{Coupling, Joint, LINK_PARAMETERS, Placement, Robot};
use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use std::ops::Range;

/// Frames in which the inertial parameters of a link are expressed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Frames {
    /// Standard DH frames, at the far ends of the links; joint frames where the description gives none.
    Dh,
    /// The joint frames of the board (Craig).
    Board,
}

/// Motion of a link, and of the frame of its parameters: `a`, `w` and `al` in that frame, all else in the base frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct FrameMotion {
    pub(super) link: LinkMotion,
    /// Orientation of the parameters' frame.
    pub(super) rot_frame: Matrix3<f64>,
    /// From the origin of the joint frame to that of the parameters' frame.
    pub(super) lever: Vector3<f64>,
    /// Acceleration of the origin of the parameters' frame, less gravity.
    pub(super) a: Vector3<f64>,
    pub(super) w: Vector3<f64>,
    pub(super) al: Vector3<f64>,
}

/// Regressor of rigid body and friction over the independent columns.
///
/// Columns: base parameters of the links, base rotor inertias, then a viscous and a Coulomb column a joint.
#[derive(Clone, Debug)]
pub(super) struct Rows {
    bodies: RigidBodies,
    pub(super) placements: Vec<Placement>,
    /// Frame of the parameters in the joint frame.
    frames: Vec<Placement>,
    pub(super) coupling: Option<Coupling>,
    /// (link, parameter) of every base column of the links.
    pub(super) link_columns: Vec<(usize, usize)>,
    pub(super) rotor_columns: Vec<usize>,
}

impl Rows {
    pub(super) fn new(robot: &Robot, frames: Frames) -> Self {
        let joints = robot.joint_count();
        let parameters = |joint: &Joint| match frames {
            Frames::Dh => joint.dh_frame.unwrap_or_else(Placement::identity),
            Frames::Board => Placement::identity(),
        };
        let links = joints * LINK_PARAMETERS;
        let place = |column: usize| (column / LINK_PARAMETERS, column % LINK_PARAMETERS);
        let mut rows = Self {
            bodies: RigidBodies::new(robot),
            placements: robot.joints.iter().map(|joint| joint.placement).collect(),
            frames: robot.joints.iter().map(parameters).collect(),
            coupling: robot.coupling.clone(),
            link_columns: (0..links).map(place).collect(),
            rotor_columns: (0..joints).collect(),
        };
        let rigid = (LINK_PARAMETERS + 1) * joints;
        let full = rows.stacked(&rows.bodies.random_motions(STATES));
        let (columns, _) = independent_columns(&full.columns(0, rigid).into_owned());
        let (of_links, of_rotors) = columns.into_iter().partition::<Vec<_>, _>(|c| *c < links);
        rows.link_columns = of_links.into_iter().map(place).collect();
        rows.rotor_columns = of_rotors.into_iter().map(|c| c - links).collect();
        rows
    }

    pub(super) fn joints(&self) -> usize {
        self.placements.len()
    }

    pub(super) fn count(&self) -> usize {
        self.link_columns.len() + self.rotor_columns.len() + 2 * self.joints()
    }

    pub(super) fn columns_of(&self, link: usize) -> Range<usize> {
        let before = |link: usize| self.link_columns.partition_point(|column| column.0 < link);
        before(link)..before(link + 1)
    }

    /// Lets `work` change the entries of every link column of `block` in turn, one a joint; `block` has N rows of
    /// [`count`](Self::count) entries, one after the other.
    pub(super) fn for_each_link_column(
        &self,
        block: &mut [f64],
        work: impl Fn(&mut PerJoint<f64>),
    ) {
        let width = self.count();
        for column in 0..self.link_columns.len() {
            let mut entries = PerJoint::from_fn(self.joints(), |j| block[j * width + column]);
            work(&mut entries);
            let entries = entries.iter().enumerate();
            entries.for_each(|(j, entry)| block[j * width + column] = *entry);
        }
    }

    /// Motion of the joints under a motion of the drives.
    pub(super) fn of_joints(&self, drives: &Motion) -> Motion {
        let mut joints = *drives;
        if let Some(coupling) = &self.coupling {
            for motion in [&mut joints.q, &mut joints.qd, &mut joints.qdd] {
                coupling.to_joints(motion);
            }
        }
        joints
    }

    /// Motion of every link, from the base on, under a motion of the drives.
    pub(super) fn motion(&self, drives: &Motion) -> Vec<FrameMotion> {
        let links = self.bodies.kinematics(drives);
        let frames = self.frames.iter().zip(links).map(|(frame, link)| {
            let (omega, alpha) = (link.omega, link.alpha);
            let lever = link.rot * frame.origin;
            let rot_frame = link.rot * frame.rot_parent_child;
            let to_frame = rot_frame.transpose();
            let turned = alpha.cross(&lever);
            let moved = link.acceleration + turned + omega.cross(&omega.cross(&lever));
            FrameMotion {
                link,
                rot_frame,
                lever,
                a: to_frame * moved,
                w: to_frame * omega,
                al: to_frame * alpha,
            }
        });
        frames.collect()
    }

    /// Writes N rows of [`Self::count`] entries into `out`, one after the other. `sign_width`, rad/s, smooths the sign of
    /// the Coulomb columns.
    ///
    /// With U = [α]× + [ω]×², s = z × ω, z the axis and p = z × (o − o_j), all in the parameters' frame of link k:
    /// `m: p·a`, `m·c: Uᵀp + a × z`, `Iij: z_i α_j + s_i ω_j`, symmetrised.
    pub(super) fn write(&self, state: &Motion, sign_width: f64, out: &mut [f64]) {
        let width = self.count();
        out.fill(0.0);
        let links = self.motion(state);
        for (k, frame) in links.iter().enumerate() {
            let to_frame = frame.rot_frame.transpose();
            let FrameMotion { a, w, al, .. } = *frame;
            let cross = w.cross_matrix();
            let u = al.cross_matrix() + cross * cross;
            for j in 0..=k {
                let z = to_frame * links[j].link.axis;
                let arm = frame.link.origin + frame.lever - links[j].link.origin;
                let p = z.cross(&(to_frame * arm));
                let s = z.cross(&w);
                let moment = u.tr_mul(&p) + a.cross(&z);
                let pair = |i: usize, j: usize| z[i] * al[j] + s[i] * w[j];
                let entries = [
                    p.dot(&a),
                    moment.x,
                    moment.y,
                    moment.z,
                    pair(0, 0),
                    pair(1, 1),
                    pair(2, 2),
                    pair(0, 1) + pair(1, 0),
                    pair(0, 2) + pair(2, 0),
                    pair(1, 2) + pair(2, 1),
                ];
                for column in self.columns_of(k) {
                    out[j * width + column] = entries[self.link_columns[column].1];
                }
            }
        }
        let rotors = self.link_columns.len();
        if let Some(coupling) = &self.coupling {
            self.for_each_link_column(out, |torques| coupling.to_drive_torques(torques));
        }
        for (c, &joint) in self.rotor_columns.iter().enumerate() {
            out[joint * width + rotors + c] = state.qdd[joint];
        }
        let friction = rotors + self.rotor_columns.len();
        for j in 0..self.joints() {
            out[j * width + friction + 2 * j] = state.qd[j];
            out[j * width + friction + 2 * j + 1] = (state.qd[j] / sign_width).tanh();
        }
    }

    /// Rows of all `states`, one a column, joints fastest; `sign_width` as in [`write`](Self::write).
    pub(super) fn transposed(&self, states: &[Motion], sign_width: f64) -> DMatrix<f64> {
        let (width, joints) = (self.count(), self.joints());
        let mut transposed = DMatrix::zeros(width, states.len() * joints);
        let blocks = transposed.as_mut_slice().chunks_exact_mut(joints * width);
        for (state, block) in states.iter().zip(blocks) {
            self.write(state, sign_width, block);
        }
        transposed
    }

    pub(super) fn stacked(&self, states: &[Motion]) -> DMatrix<f64> {
        self.transposed(states, 1.0).transpose()
    }

    /// Values of all columns' parameters for this robot: rigid ones by least squares from its exact torques,
    /// friction from the description.
    pub(super) fn parameters(&self, robot: &Robot) -> Option<DVector<f64>> {
        let rigid = self.link_columns.len() + self.rotor_columns.len();
        let states = self.bodies.random_motions(STATES);
        let rows = self.stacked(&states).columns(0, rigid).into_owned();
        let mut torques = DVector::zeros(self.joints() * STATES);
        for (k, state) in states.iter().enumerate() {
            let tau = self.bodies.inverse_dynamics(state);
            let mut target = torques.rows_mut(k * tau.len(), tau.len());
            target.copy_from_slice(&tau);
        }
        let solved = rows.svd(true, true).solve(&torques, 1e-12).ok()?;
        let mut all = DVector::zeros(self.count());
        all.rows_mut(0, rigid).copy_from(&solved);
        for (j, joint) in robot.joints.iter().enumerate() {
            all[rigid + 2 * j] = joint.friction.viscous;
            all[rigid + 2 * j + 1] = joint.friction.coulomb;
        }
        Some(all)
    }
}

/// A UR5 whose two last drives turn both wrist joints, with the limits of the joints.
#[cfg(test)]
pub(super) fn coupled_ur5() -> Robot {
    let text = Robot::load("ur5").expect("built in").to_toml();
    let coupling = "[coupling]\njoints = ['wrist_2', 'wrist_3']\nmatrix = [[1, 0.5], [-1, 1]]";
    let text = format!("{}\n{coupling}", text.expect("serialises"));
    Robot::parse("coupled", &text).expect("a description")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dynamics::random_motions;

    #[test]
    fn ur5_has_36_link_columns_in_both_frames() {
        let (ur5, coupled) = (Robot::load("ur5").expect("built in"), coupled_ur5());
        for (robot, frames) in [
            (&ur5, Frames::Dh),
            (&ur5, Frames::Board),
            (&coupled, Frames::Dh),
        ] {
            let model = RigidBodies::new(robot);
            let rows = Rows::new(robot, frames);
            assert_eq!((rows.link_columns.len(), rows.count()), (36, 36 + 4 + 12));
            let parameters = rows.parameters(robot).expect("solves");
            let mut block = vec![0.0; 6 * rows.count()];
            for state in random_motions(6, 60).into_iter().skip(STATES) {
                rows.write(&state, 1.0, &mut block);
                let tau = DMatrix::from_row_slice(6, rows.count(), &block) * &parameters;
                let expected = model.inverse_dynamics(&state);
                for j in 0..6 {
                    let (friction, qd) = (&robot.joints[j].friction, state.qd[j]);
                    let drag = friction.viscous * qd + friction.coulomb * qd.tanh();
                    let near = (tau[j] - drag - expected[j]).abs() < 1e-9;
                    assert!(near, "{frames:?} joint {j}");
                }
            }
        }
    }

    #[test]
    fn board_frames_choose_the_columns_of_the_board() {
        let robot = Robot::load("ur5").expect("built in");
        let rows = Rows::new(&robot, Frames::Board);
        let column = |(link, parameter): &(usize, usize)| link * LINK_PARAMETERS + parameter;
        let chosen: Vec<usize> = rows.link_columns.iter().map(column).collect();
        assert_eq!(chosen, robot.base_map().columns[..36]);
    }
}
