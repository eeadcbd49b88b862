//! An arm as a URDF, MJCF or SDF file, with the links, names and axes of the file that it came from.

use crate::robot::{Joint, Link, Placement, Robot};
use nalgebra::{Rotation3, UnitQuaternion, Vector3};
use std::f64::consts::PI;

/// The link that MJCF and SDF have without saying so.
const WORLD: &str = "world";

/// A joint with the link that it moves, in the frames of the file.
struct Part<'a> {
    joint: &'a Joint,
    /// Name of the link, and of the link that carries it.
    names: [String; 2],
    /// Frame of the link in that of the link before, at q = 0.
    placement: Placement,
    /// Axis of the joint in the frame of the link.
    axis: Vector3<f64>,
    link: Link,
}

/// The parts of an arm, then name and placement of its tip in the last link, unless that is the last link itself.
fn parts(robot: &Robot) -> (String, Vec<Part<'_>>, Option<(String, Placement)>) {
    let ends = robot.link_names.as_ref();
    let base = ends.map_or("base", |ends| &ends.0);
    let mut parent = (escaped(base), Placement::identity());
    let mut parts = Vec::new();
    for (number, joint) in (1..).zip(&robot.joints) {
        let name = joint.link_name.as_deref();
        let name = name.map_or_else(|| format!("link{number}"), escaped);
        let inside = joint.link_frame.inverse();
        let in_parent = parent.1.inverse().then(&joint.placement);
        parts.push(Part {
            joint,
            names: [name.clone(), parent.0],
            placement: in_parent.then(&joint.link_frame).snapped(),
            axis: inside.snapped().rot_parent_child.column(2).into_owned(),
            link: joint.link.placed(&inside),
        });
        parent = (name, joint.link_frame);
    }
    let tip = escaped(ends.map_or("flange", |ends| &ends.1));
    let placed = parent.1.inverse().then(&robot.flange).snapped();
    let tip = (tip != parent.0).then_some((tip, placed));
    (escaped(base), parts, tip)
}

/// The URDF of an arm.
///
/// A URDF has no place for rotor inertias, drive gains, Stribeck friction, ripple and the size of gravity: the TOML description
/// ([`Robot::to_toml`]) keeps them. Gravity is along −z of the root, on which a base in another position stands tilted.
pub fn write(robot: &Robot) -> String {
    let (base, parts, tip) = parts(robot);
    let mut out = format!(
        "<?xml version=\"1.0\"?>\n<robot name=\"{}\">\n  <link name=\"{base}\"/>\n",
        escaped(&robot.name)
    );
    let origin = |frame: &Placement| {
        let (xyz, rpy) = (list(&frame.origin), list(&frame.rpy()));
        format!("<origin xyz=\"{xyz}\" rpy=\"{rpy}\"/>")
    };
    if let Some(tilted) = tilt(&robot.gravity) {
        out += &format!(
            "  <joint name=\"{base}_tilt\" type=\"fixed\">\n    <parent link=\"{base}_ground\"/> <child link=\"{base}\"/>\n    {}\n  \
             </joint>\n  <link name=\"{base}_ground\"/>\n",
            origin(&tilted)
        );
    }
    for part in &parts {
        let (limits, friction) = (&part.joint.limits, &part.joint.friction);
        let [name, parent] = &part.names;
        let [xx, yy, zz, xy, xz, yz] = tensor(&part.link);
        let (lower, upper) = limits.position;
        out += &format!(
            r#"  <joint name="{joint}" type="revolute">
    <parent link="{parent}"/> <child link="{name}"/> <axis xyz="{axis}"/>
    {origin}
    <limit lower="{lower}" upper="{upper}" velocity="{velocity}" effort="{torque}" acceleration="{acceleration}"/>
    <dynamics damping="{viscous}" friction="{coulomb}"/>
  </joint>
  <link name="{name}"><inertial>
    <origin xyz="{com}" rpy="0 0 0"/> <mass value="{mass}"/>
    <inertia ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="{xy}" ixz="{xz}" iyz="{yz}"/>
  </inertial></link>
"#,
            joint = escaped(&part.joint.name),
            axis = list(&part.axis),
            origin = origin(&part.placement),
            velocity = limits.velocity,
            torque = limits.torque,
            acceleration = limits.acceleration,
            viscous = friction.viscous,
            coulomb = friction.coulomb,
            com = list(&part.link.com),
            mass = part.link.mass,
        );
    }
    if let (Some((tip, placed)), Some(last)) = (tip, parts.last()) {
        out += &format!(
            "  <joint name=\"{tip}_fixed\" type=\"fixed\">\n    <parent link=\"{}\"/> <child link=\"{tip}\"/>\n    {}\n  \
             </joint>\n  <link name=\"{tip}\"/>\n",
            last.names[0],
            origin(&placed)
        );
    }
    out + "</robot>\n"
}

/// The MJCF of an arm: rotor inertias are armatures, Coulomb friction is frictionloss, viscous friction damping.
///
/// An MJCF has no place for velocity and acceleration limits, drive gains, Stribeck friction and ripple.
pub fn mjcf(robot: &Robot) -> String {
    let (base, parts, tip) = parts(robot);
    let place = |frame: &Placement| {
        let rot = Rotation3::from_matrix_unchecked(frame.rot_parent_child);
        let turn = UnitQuaternion::from_rotation_matrix(&rot);
        let [w, x, y, z] = [turn.w, turn.i, turn.j, turn.k].map(number);
        format!("pos=\"{}\" quat=\"{w} {x} {y} {z}\"", list(&frame.origin))
    };
    let mut out = format!(
        "<mujoco model=\"{}\">\n  <compiler angle=\"radian\" autolimits=\"true\"/>\n  <option gravity=\"{}\"/>\n  <worldbody>\n",
        escaped(&robot.name),
        list(&robot.gravity)
    );
    // The world is there already.
    let is_world = base == WORLD;
    if !is_world {
        out += &format!("  <body name=\"{base}\">\n");
    }
    let mut motors = String::new();
    for part in &parts {
        let (joint, torque) = (escaped(&part.joint.name), part.joint.limits.torque);
        let (lower, upper) = part.joint.limits.position;
        out += &format!(
            r#"  <body name="{name}" {place}>
    <inertial pos="{com}" mass="{mass}" fullinertia="{inertia}"/>
    <joint name="{joint}" type="hinge" axis="{axis}" range="{lower} {upper}" actuatorfrcrange="-{torque} {torque}"
      armature="{armature}" damping="{viscous}" frictionloss="{coulomb}"/>
"#,
            name = part.names[0],
            place = place(&part.placement),
            com = list(&part.link.com),
            mass = part.link.mass,
            inertia = tensor(&part.link).join(" "),
            axis = list(&part.axis),
            armature = part.joint.drive.rotor_inertia,
            viscous = part.joint.friction.viscous,
            coulomb = part.joint.friction.coulomb,
        );
        let range = format!("ctrlrange=\"-{torque} {torque}\"");
        motors += &format!("    <motor name=\"{joint}\" joint=\"{joint}\" {range}/>\n");
    }
    if let Some((tip, placed)) = tip {
        out += &format!("  <body name=\"{tip}\" {}/>\n", place(&placed));
    }
    out += &"  </body>\n".repeat(parts.len() + usize::from(!is_world));
    out + "  </worldbody>\n  <actuator>\n" + &motors + "  </actuator>\n</mujoco>\n"
}

/// The SDF of an arm, fixed to the world. Rotor inertias stand in Drake's element for them, the only one there is.
pub fn sdf(robot: &Robot) -> String {
    let (base, parts, tip) = parts(robot);
    let pose = |frame: &Placement| format!("{} {}", list(&frame.origin), list(&frame.rpy()));
    let mut out = format!(
        r#"<?xml version="1.0"?>
<sdf version="1.9" xmlns:drake="http://drake.mit.edu"><model name="{}">
"#,
        escaped(&robot.name)
    );
    if base != WORLD {
        out += &format!(
            "  <link name=\"{base}\"/>\n  <joint name=\"{base}_fixed\" type=\"fixed\"><parent>{WORLD}</parent><child>{base}</child></joint>\n"
        );
    }
    for part in &parts {
        let (limits, friction) = (&part.joint.limits, &part.joint.friction);
        let [name, parent] = &part.names;
        let [xx, yy, zz, xy, xz, yz] = tensor(&part.link);
        let (lower, upper) = limits.position;
        out += &format!(
            r#"  <joint name="{joint}" type="revolute"><pose relative_to="{around}">{pose}</pose>
    <parent>{parent}</parent><child>{name}</child>
    <axis><xyz>{axis}</xyz>
      <limit><lower>{lower}</lower><upper>{upper}</upper><effort>{torque}</effort><velocity>{velocity}</velocity></limit>
      <dynamics><damping>{viscous}</damping><friction>{coulomb}</friction></dynamics></axis>
    <drake:rotor_inertia>{rotor}</drake:rotor_inertia></joint>
  <link name="{name}"><pose relative_to="{joint}">0 0 0 0 0 0</pose><inertial><pose>{com} 0 0 0</pose><mass>{mass}</mass>
    <inertia><ixx>{xx}</ixx><iyy>{yy}</iyy><izz>{zz}</izz><ixy>{xy}</ixy><ixz>{xz}</ixz><iyz>{yz}</iyz></inertia></inertial></link>
"#,
            joint = escaped(&part.joint.name),
            // A model may hang on the world, and not be placed in it.
            around = if parent == WORLD { "__model__" } else { parent },
            pose = pose(&part.placement),
            axis = list(&part.axis),
            torque = limits.torque,
            velocity = limits.velocity,
            viscous = friction.viscous,
            coulomb = friction.coulomb,
            rotor = part.joint.drive.rotor_inertia,
            com = list(&part.link.com),
            mass = part.link.mass,
        );
    }
    if let (Some((tip, placed)), Some(last)) = (tip, parts.last()) {
        out += &format!(
            "  <frame name=\"{tip}\" attached_to=\"{}\"><pose>{}</pose></frame>\n",
            last.names[0],
            pose(&placed)
        );
    }
    let gravity = list(&robot.gravity);
    out + &format!("  <!-- gravity of the world: {gravity} -->\n</model></sdf>\n")
}

/// Placement of a base on the ground, under gravity in the base's frame; `None` for an upright one.
fn tilt(gravity: &Vector3<f64>) -> Option<Placement> {
    let down = -Vector3::z();
    if gravity.xy().norm() == 0.0 && gravity.z <= 0.0 {
        return None;
    }
    // There are many rotations from up to down.
    let over = || Rotation3::from_axis_angle(&Vector3::x_axis(), PI);
    let rot = Rotation3::rotation_between(gravity, &down).unwrap_or_else(over);
    Some(Placement {
        rot_parent_child: rot.into_inner(),
        ..Placement::identity()
    })
}

/// Tensor entries about the centre of mass, kg·m²: xx, yy, zz, xy, xz, yz.
fn tensor(link: &Link) -> [String; 6] {
    let i = &link.inertia_com;
    // Entries that only rounding has made are none.
    let least = 1e-15 * i.amax();
    let entries = [i.m11, i.m22, i.m33, i.m12, i.m13, i.m23];
    entries.map(|x| number(if x.abs() < least { 0.0 } else { x }))
}

fn list(vector: &Vector3<f64>) -> String {
    let entries: Vec<String> = vector.iter().map(|x| number(*x)).collect();
    entries.join(" ")
}

/// All digits of a value, with an exponent where it is small; 0 for what rounding has left of it.
fn number(value: f64) -> String {
    match value.abs() {
        size if size < 1e-16 => "0".to_owned(),
        size if size < 1e-4 => format!("{value:e}"),
        _ => format!("{value}"),
    }
}

fn escaped(name: &str) -> String {
    name.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dynamics::{Joints, ReferenceModel, RigidBodies, State};
    use crate::urdf::tests::{ARM, to_hand, whole};

    #[test]
    fn a_written_arm_is_the_arm_again_with_the_names_of_its_links() {
        let arm = to_hand(ARM);
        let motions = crate::dynamics::random_motions(2, 20);
        let torques = |robot: &Robot| -> Vec<Joints<2>> {
            let model = RigidBodies::new(robot);
            let torque = |motion| model.inverse_dynamics(motion).into();
            motions.iter().map(torque).collect()
        };
        let mut bare = arm.clone();
        for text in [write(&arm), mjcf(&arm)] {
            let again = whole(&text);
            for (here, there) in torques(&arm).iter().zip(torques(&again)) {
                assert!((here - there).amax() < 1e-12, "{text}");
            }
            for link in ["upper", "fore", "hand"] {
                assert!(text.contains(&format!("name=\"{link}\"")), "{link}: {text}");
            }
            assert_eq!(again.joints[1].friction, arm.joints[1].friction);
            assert!(text.contains("\"0 1 0\""), "the axis of the file: {text}");
        }
        // The base of a URDF is tilted where gravity is.
        let size = arm.gravity.norm();
        for down in [Vector3::new(0.0, -0.3, -0.9), Vector3::x(), Vector3::z()] {
            let hung = Robot {
                gravity: down.normalize() * size,
                ..arm.clone()
            };
            let again = whole(&write(&hung));
            for (here, there) in torques(&hung).iter().zip(torques(&again)) {
                assert!((here - there).amax() < 1e-9, "{down}");
            }
        }
        // An armature is where a URDF has no place for it.
        bare.joints[0].drive.rotor_inertia = 0.5;
        assert_eq!(whole(&mjcf(&bare)).joints[0].drive.rotor_inertia, 0.5);
        assert!(sdf(&bare).contains("<drake:rotor_inertia>0.5</drake:rotor_inertia>"));
    }

    /// Torques of the written models by the tools that read them against ours; see `tests/data/written/README.md`.
    #[test]
    fn mujoco_and_pinocchio_compute_our_torques_from_the_written_models() {
        const TOLERANCE_NM: f64 = 1e-6;
        let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../..");
        for (name, description) in [
            ("ur5", "ur5".to_owned()),
            ("gen3", format!("{root}/host-sim/robots/gen3.toml")),
            (
                "oblique",
                format!("{root}/tests/data/pinocchio/arms/oblique.urdf"),
            ),
            ("eight", format!("{root}/host-sim/robots/eight.toml")),
        ] {
            let robot = Robot::load(&description).unwrap().with_assumed_rotors().0;
            for (ending, text) in [
                ("xml", mjcf(&robot)),
                ("urdf", write(&robot)),
                ("sdf", sdf(&robot)),
            ] {
                let file = format!("{root}/tests/data/written/{name}.{ending}");
                let written = std::fs::read_to_string(&file).unwrap();
                assert!(written == text, "{file} is stale: see the README beside it");
            }
            crate::joints!(robot.joint_count(), N => torques_agree::<N>(name, &robot, TOLERANCE_NM), else panic!("{name}"));
        }
    }

    fn torques_agree<const N: usize>(name: &str, robot: &Robot, tolerance_nm: f64) {
        let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/data/written");
        let file = std::fs::File::open(format!("{root}/{name}.csv.gz")).unwrap();
        let mut reader = csv::Reader::from_reader(flate2::read::GzDecoder::new(file));
        let model = ReferenceModel::<N>::new(robot).unwrap();
        let mut bare = robot.clone();
        for joint in &mut bare.joints {
            joint.drive.rotor_inertia = 0.0;
        }
        let bare = ReferenceModel::<N>::new(&bare).unwrap();
        let damping = Joints::<N>::from_fn(|j, _| robot.joints[j].friction.viscous);
        let (mut rows, mut worst) = (0, [0.0_f64; 4]);
        for row in reader.deserialize() {
            let row: Vec<f64> = row.unwrap();
            let [q, qd, qdd, by_mujoco, by_mjcf, by_urdf, by_sdf] =
                std::array::from_fn(|k| Joints::<N>::from_fn(|j, _| row[k * N + j]));
            let state = State { q, qd, qdd };
            let ours = model.inverse_dynamics(&state);
            let errors = [
                ours + damping.component_mul(&qd) - by_mujoco,
                ours - by_mjcf,
                bare.inverse_dynamics(&state) - by_urdf,
                ours - by_sdf,
            ];
            for (worst, error) in worst.iter_mut().zip(errors) {
                assert!(error.amax() <= tolerance_nm, "{name}: {error}");
                *worst = worst.max(error.amax());
            }
            rows += 1;
        }
        println!("{name}: off by {worst:?} N·m (MuJoCo, Pinocchio on MJCF and URDF, Drake on SDF)");
        assert_eq!(rows, 200);
    }
}
