//! Reads an arm from a URDF or MJCF file.
//!
//! Both are a tree of links; the arm is one path in it, from a base link to a tip link. Joint frames of a URDF are
//! Craig link frames when the joint axis is z; other axes are turned onto z here, without moving the joint's zero.
//! Everything bolted to a moving link by fixed joints becomes part of that link, behind the tip too. What moves beside the
//! path or behind the tip is left out unless it is welded, and listed with its mass in [`Import::notes`].
//!
//! A URDF has no drives, and its friction model is viscous plus Coulomb: rotor inertia is 0, the gain is
//! not known. The base frame is that of the base link, gravity along −z of the root.

mod chain;
mod document;
mod mjcf;
mod tree;
mod write;

pub use write::{mjcf, sdf, write};

use crate::Refusal;
use crate::robot::Robot;
use std::collections::HashSet;
use std::path::Path;

/// Which path of the tree is the arm.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Selection<'a> {
    /// Link the arm stands on, or the joint that leaves it; the root of the tree when not given.
    pub base: Option<&'a str>,
    /// Link the arm ends at, or the joint that moves it. Without it the arm ends where only fixed, prismatic or mimic
    /// joints and fingers follow.
    pub tip: Option<&'a str>,
    /// Bodies beyond moving joints beside the path are part of the link that carries them, at their zero.
    pub weld: bool,
    /// Inertias that no body has are moved to the nearest one that a body has.
    pub repair: bool,
    /// Mass of a link without inertial data, kg; such links are refused without it.
    pub link_mass: Option<f64>,
}

/// An arm, and the assumptions made for missing properties.
#[derive(Clone, Debug, PartialEq)]
pub struct Import {
    /// The arm.
    pub robot: Robot,
    /// One sentence for each assumption made and each part left out.
    pub notes: Vec<String>,
}

/// Reads an arm from the text of a URDF; `file` is only used in messages.
///
/// Errors: a line that names the file and the element.
///
/// ```
/// use foretorque_description::urdf::{Selection, parse};
/// let pendulum = r#"<robot name="pendulum">
///   <link name="wall"/>
///   <joint name="hinge" type="revolute">
///     <parent link="wall"/> <child link="rod"/> <axis xyz="0 1 0"/>
///     <limit lower="-3" upper="3" velocity="5" effort="10"/>
///   </joint>
///   <link name="rod"><inertial>
///     <origin xyz="0 0 -0.5"/> <mass value="2"/>
///     <inertia ixx="0.1" iyy="0.1" izz="0.001" ixy="0" ixz="0" iyz="0"/>
///   </inertial></link>
/// </robot>"#;
/// let import = parse("pendulum.urdf", pendulum, &Selection::default()).unwrap();
/// assert_eq!(import.robot.joints[0].link.mass, 2.0);
/// ```
pub fn parse(file: &str, text: &str, selection: &Selection<'_>) -> Result<Import, Refusal> {
    let document = read(file, text).map(|mut document| {
        if selection.base.is_some() {
            // A part of a robot hangs on a link of another file.
            let links: HashSet<String> = document.links.iter().map(|l| l.name.clone()).collect();
            let joints = &mut document.joints;
            joints.retain(|joint| links.contains(&joint.parent));
        }
        document
    });
    document
        .and_then(|document| chain::arm(&document, selection))
        .map_err(|problem| Refusal::of(file, problem))
}

fn read(file: &str, text: &str) -> Result<document::Document, String> {
    // Common URDF parsers accept blank lines before the XML declaration.
    let text = document::with_prefixes(text.trim_start());
    let xml = document::parsed(&text)?;
    if xml.root_element().has_tag_name("mujoco") {
        return mjcf::read(Path::new(file), text);
    }
    document::read(&text)
}

#[cfg(test)]
mod tests;
