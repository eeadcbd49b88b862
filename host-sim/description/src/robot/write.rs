//! A robot as a description file again.

use super::file::{CapsuleFile, DhFile, FrameFile, InertiaFile, JointFile, LinkFile, RobotFile};
use super::{Joint, Link, Placement, Robot};
use nalgebra::{Rotation3, Vector3};

impl Robot {
    /// The description file of this robot, which [`Robot::parse`] reads back to rounding. Joints that came with a
    /// Denavit–Hartenberg row keep it, and their links stand in its frame; all others are given by their joint frames.
    ///
    /// Errors: those of the serialiser.
    ///
    /// ```
    /// use foretorque_description::robot::Robot;
    /// let ur5 = Robot::load("ur5").unwrap();
    /// let again = Robot::parse("again", &ur5.to_toml().unwrap()).unwrap();
    /// assert!((again.joints[2].link.com - ur5.joints[2].link.com).amax() < 1e-15);
    /// ```
    pub fn to_toml(&self) -> Result<String, toml::ser::Error> {
        let mut joints = Vec::with_capacity(self.joints.len());
        let mut link_end = Placement::identity();
        for joint in &self.joints {
            let here = link_end.inverse().then(&joint.placement);
            joints.push(joint_file(joint, &here));
            link_end = joint.dh_frame.unwrap_or_else(Placement::identity);
        }
        let names: Vec<&str> = self
            .joints
            .iter()
            .map(|joint| joint.name.as_str())
            .collect();
        let flange = link_end.inverse().then(&self.flange).snapped();
        toml::to_string(&RobotFile {
            name: self.name.clone(),
            gravity_m_s2: self.gravity.into(),
            link_names: self.link_names.clone(),
            joints,
            // Part of the last link by now.
            tool: None,
            flange: (flange != Placement::identity()).then(|| frame_file(&flange)),
            coupling: self.coupling.as_ref().map(|coupling| coupling.file(&names)),
            log_columns: self.log_columns.clone(),
            workspace: self.workspace,
        })
    }
}

/// * `here` joint frame in the end frame of the link before
fn joint_file(joint: &Joint, here: &Placement) -> JointFile {
    let end = joint.dh_frame.unwrap_or_else(Placement::identity);
    let in_end = end.inverse();
    let link = joint.link.placed(&in_end);
    let capsule_end = |point: &Vector3<f64>| -> [f64; 3] { in_end.point(point).into() };
    JointFile {
        name: joint.name.clone(),
        link_name: joint.link_name.clone(),
        dh: joint.dh_frame.map(|end| DhFile {
            d_m: here.origin.z,
            a_m: end.origin.x,
            alpha_rad: end.rot_parent_child.m32.atan2(end.rot_parent_child.m22),
        }),
        frame: joint.dh_frame.is_none().then(|| frame_file(here)),
        link: link_file(&link),
        drive: joint.drive,
        friction: joint.friction,
        limits: joint.limits,
        capsules: joint
            .capsules
            .iter()
            .map(|capsule| CapsuleFile {
                from_m: capsule_end(&capsule.ends[0]),
                to_m: capsule_end(&capsule.ends[1]),
                radius_m: capsule.radius,
            })
            .collect(),
    }
}

fn frame_file(frame: &Placement) -> FrameFile {
    let (roll, pitch, yaw) =
        Rotation3::from_matrix_unchecked(frame.rot_parent_child).euler_angles();
    FrameFile {
        xyz_m: frame.origin.into(),
        rpy_rad: [roll, pitch, yaw],
    }
}

fn link_file(link: &Link) -> LinkFile {
    let i = &link.inertia_com;
    LinkFile {
        mass_kg: link.mass,
        com_m: link.com.into(),
        inertia_kg_m2: InertiaFile {
            xx: i.m11,
            yy: i.m22,
            zz: i.m33,
            xy: i.m12,
            xz: i.m13,
            yz: i.m23,
        },
    }
}

#[cfg(test)]
mod tests {
    use crate::robot::{Perturbation, Robot};

    #[test]
    fn a_description_is_read_back_as_the_robot_it_was_written_from() {
        for name in ["ur5", "panda"] {
            let robot = Robot::load(name)
                .expect("built in")
                .perturbed(3, &Perturbation::PLANT);
            let text = robot.to_toml().expect("serialises");
            let again = Robot::parse("again", &text).expect("reads its own writing");
            let pairs = robot.standard_parameters().into_iter();
            for (a, b) in pairs.zip(again.standard_parameters()) {
                assert!((a - b).abs() < 1e-12, "{name}: {a} {b}");
            }
            assert_eq!(robot.log_columns, again.log_columns);
            for (a, b) in robot.joints.iter().zip(&again.joints) {
                let apart = a.placement.rot_parent_child - b.placement.rot_parent_child;
                assert!(apart.amax() < 1e-12);
                assert!((a.placement.origin - b.placement.origin).amax() < 1e-12);
                assert_eq!((a.friction, a.limits), (b.friction, b.limits));
                assert_eq!(a.dh_frame.is_some(), b.dh_frame.is_some());
                for (a, b) in a.capsules.iter().zip(&b.capsules) {
                    assert!((a.ends[1] - b.ends[1]).amax() < 1e-12);
                }
            }
            assert!((robot.flange.origin - again.flange.origin).amax() < 1e-12);
        }
    }
}
