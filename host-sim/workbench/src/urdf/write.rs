//! An arm as a URDF file.

use crate::robot::{Limits, Placement, Robot};
use nalgebra::Rotation3;

/// The URDF of an arm: joint frames are Craig's link frames, axes their z, link inertias about the centres of mass.
///
/// A URDF has no place for rotor inertias, drive gains, Stribeck friction and cogging: the TOML description
/// ([`Robot::to_toml`]) keeps them.
pub fn write(robot: &Robot) -> String {
    let name = escaped(&robot.name);
    let mut out =
        format!("<?xml version=\"1.0\"?>\n<robot name=\"{name}\">\n  <link name=\"base\"/>\n");
    let mut parent = "base".to_owned();
    for (number, joint) in (1..).zip(&robot.joints) {
        let (name, origin) = (escaped(&joint.name), origin(&joint.placement));
        let Limits {
            position: (lower, upper),
            velocity,
            acceleration,
            torque,
        } = joint.limits;
        let (damping, friction) = (joint.friction.viscous, joint.friction.coulomb);
        let (com, i, mass) = (&joint.link.com, &joint.link.inertia_com, joint.link.mass);
        out += &format!(
            r#"  <joint name="{name}" type="revolute">
    <parent link="{parent}"/> <child link="link{number}"/> <axis xyz="0 0 1"/>
    {origin}
    <limit lower="{lower}" upper="{upper}" velocity="{velocity}" effort="{torque}" acceleration="{acceleration}"/>
    <dynamics damping="{damping}" friction="{friction}"/>
  </joint>
  <link name="link{number}"><inertial>
    <origin xyz="{} {} {}" rpy="0 0 0"/> <mass value="{mass}"/>
    <inertia ixx="{}" iyy="{}" izz="{}" ixy="{}" ixz="{}" iyz="{}"/>
  </inertial></link>
"#,
            com.x, com.y, com.z, i.m11, i.m22, i.m33, i.m12, i.m13, i.m23
        );
        parent = format!("link{number}");
    }
    let origin = origin(&robot.flange);
    out + &format!(
        r#"  <joint name="flange" type="fixed">
    <parent link="{parent}"/> <child link="flange"/>
    {origin}
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
