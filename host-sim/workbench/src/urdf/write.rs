//! An arm as a URDF file.

use crate::robot::{Placement, Robot};
use nalgebra::Rotation3;

/// The URDF of an arm: joint frames are Craig's link frames, axes their z, link inertias about the centres of mass.
///
/// A URDF has no place for rotor inertias, drive gains, Stribeck friction and ripple: the TOML description
/// ([`Robot::to_toml`]) keeps them.
pub fn write(robot: &Robot) -> String {
    let mut out = format!(
        "<?xml version=\"1.0\"?>\n<robot name=\"{}\">\n  <link name=\"base\"/>\n",
        escaped(&robot.name)
    );
    let mut parent = "base".to_owned();
    for (index, joint) in robot.joints.iter().enumerate() {
        let child = format!("link{}", index + 1);
        let (limits, friction, link) = (&joint.limits, &joint.friction, &joint.link);
        let (com, i) = (&link.com, &link.inertia_com);
        out += &format!(
            r#"  <joint name="{name}" type="revolute">
    <parent link="{parent}"/> <child link="{child}"/> <axis xyz="0 0 1"/>
    {origin}
    <limit lower="{lower}" upper="{upper}" velocity="{velocity}" effort="{torque}" acceleration="{acceleration}"/>
    <dynamics damping="{viscous}" friction="{coulomb}"/>
  </joint>
  <link name="{child}"><inertial>
    <origin xyz="{x} {y} {z}" rpy="0 0 0"/> <mass value="{mass}"/>
    <inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="{ixy}" ixz="{ixz}" iyz="{iyz}"/>
  </inertial></link>
"#,
            name = escaped(&joint.name),
            origin = origin(&joint.placement),
            lower = limits.position.0,
            upper = limits.position.1,
            velocity = limits.velocity,
            torque = limits.torque,
            acceleration = limits.acceleration,
            viscous = friction.viscous,
            coulomb = friction.coulomb,
            x = com.x,
            y = com.y,
            z = com.z,
            mass = link.mass,
            ixx = i.m11,
            iyy = i.m22,
            izz = i.m33,
            ixy = i.m12,
            ixz = i.m13,
            iyz = i.m23,
        );
        parent = child;
    }
    let flange = origin(&robot.flange);
    out + &format!(
        r#"  <joint name="flange" type="fixed">
    <parent link="{parent}"/> <child link="flange"/>
    {flange}
  </joint>
  <link name="flange"/>
</robot>
"#
    )
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
