//! An arm as a URDF file.

use crate::robot::{Placement, Robot};
use nalgebra::Rotation3;
use std::fmt::Write;

/// The URDF of an arm: joint frames are Craig's link frames, axes their z, link inertias about the centres of mass.
///
/// A URDF has no place for rotor inertias, drive gains, Stribeck friction and ripple: the TOML description
/// ([`Robot::to_toml`]) keeps them.
pub fn write(robot: &Robot) -> String {
    let mut out = String::new();
    let mut line = |text: std::fmt::Arguments<'_>| {
        // Writing to a string cannot fail.
        let _ = writeln!(out, "{text}");
    };
    line(format_args!("<?xml version=\"1.0\"?>"));
    line(format_args!("<robot name=\"{}\">", escaped(&robot.name)));
    line(format_args!("  <link name=\"base\"/>"));
    let mut parent = "base".to_owned();
    for (index, joint) in robot.joints.iter().enumerate() {
        let child = format!("link{}", index + 1);
        let limits = &joint.limits;
        line(format_args!(
            "  <joint name=\"{}\" type=\"revolute\">",
            escaped(&joint.name)
        ));
        line(format_args!(
            "    <parent link=\"{parent}\"/> <child link=\"{child}\"/> <axis xyz=\"0 0 1\"/>"
        ));
        line(format_args!("    {}", origin(&joint.placement)));
        line(format_args!(
            "    <limit lower=\"{}\" upper=\"{}\" velocity=\"{}\" effort=\"{}\" acceleration=\"{}\"/>",
            limits.position.0,
            limits.position.1,
            limits.velocity,
            limits.torque,
            limits.acceleration
        ));
        line(format_args!(
            "    <dynamics damping=\"{}\" friction=\"{}\"/>",
            joint.friction.viscous, joint.friction.coulomb
        ));
        line(format_args!("  </joint>"));
        let (com, i) = (&joint.link.com, &joint.link.inertia_com);
        line(format_args!("  <link name=\"{child}\"><inertial>"));
        line(format_args!(
            "    <origin xyz=\"{} {} {}\" rpy=\"0 0 0\"/> <mass value=\"{}\"/>",
            com.x, com.y, com.z, joint.link.mass
        ));
        line(format_args!(
            "    <inertia ixx=\"{}\" iyy=\"{}\" izz=\"{}\" ixy=\"{}\" ixz=\"{}\" iyz=\"{}\"/>",
            i.m11, i.m22, i.m33, i.m12, i.m13, i.m23
        ));
        line(format_args!("  </inertial></link>"));
        parent = child;
    }
    line(format_args!("  <joint name=\"flange\" type=\"fixed\">"));
    line(format_args!(
        "    <parent link=\"{parent}\"/> <child link=\"flange\"/>"
    ));
    line(format_args!("    {}", origin(&robot.flange)));
    line(format_args!("  </joint>"));
    line(format_args!("  <link name=\"flange\"/>"));
    line(format_args!("</robot>"));
    out
}

fn origin(frame: &Placement) -> String {
    let (roll, pitch, yaw) =
        Rotation3::from_matrix_unchecked(frame.rot_parent_child).euler_angles();
    let at = &frame.origin;
    format!(
        "<origin xyz=\"{} {} {}\" rpy=\"{roll} {pitch} {yaw}\"/>",
        at.x, at.y, at.z
    )
}

fn escaped(name: &str) -> String {
    name.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('"', "&quot;")
}
