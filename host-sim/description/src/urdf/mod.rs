//! Reads an arm from a URDF or MJCF file.
//!
//! Both are a tree of links; the arm is one path in it, from a base link to a tip link. Joint frames of a URDF are
//! Craig link frames when the joint axis is z; other axes are turned onto z here, without moving the joint's zero.
//! Everything bolted to a moving link by fixed joints becomes part of that link. What hangs on the tip link, and what
//! moves beside the path, is left out unless it is welded, and listed in [`Import::notes`].
//!
//! A URDF has no drives, and its friction model is viscous plus Coulomb: rotor inertia is 0, the gain is
//! 1 N·m/A. The base frame is that of the base link, gravity along its −z.

mod chain;
mod document;
mod mjcf;
mod tree;
mod write;

pub use write::{mjcf, sdf, write};

use crate::robot::Robot;
use std::collections::HashSet;
use std::path::Path;

/// Which path of the tree is the arm.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Selection<'a> {
    /// Link the arm stands on, or the joint that leaves it; the root of the tree when not given.
    pub base: Option<&'a str>,
    /// Link the arm ends at, or the joint that moves it. Without it the arm ends where only fixed, prismatic or mimic
    /// joints and single fingers follow.
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

/// Reads an arm from a URDF file.
///
/// Errors: [`UrdfError`], one line that names the file and the element.
pub fn load(file: &Path, selection: &Selection<'_>) -> Result<Import, UrdfError> {
    let name = file.display().to_string();
    match std::fs::read_to_string(file) {
        Ok(text) => parse(&name, &text, selection),
        Err(error) => Err(UrdfError {
            file: name,
            problem: UrdfProblem::Unreadable(error.to_string()),
        }),
    }
}

/// Reads an arm from the text of a URDF; `file` is only used in messages.
///
/// Errors: [`UrdfError`], one line that names the file and the element.
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
pub fn parse(file: &str, text: &str, selection: &Selection<'_>) -> Result<Import, UrdfError> {
    let document = read(file, text).map(|mut document| {
        if selection.base.is_some() {
            // A part of a robot hangs on a link of another file.
            let links: HashSet<String> = document.links.iter().map(|l| l.name.clone()).collect();
            document
                .joints
                .retain(|joint| links.contains(&joint.parent));
        }
        document
    });
    document
        .and_then(|document| chain::arm(&document, selection))
        .map_err(|problem| UrdfError {
            file: file.to_owned(),
            problem,
        })
}

/// Links and joints of a URDF or MJCF.
fn read(file: &str, text: &str) -> Result<document::Document, UrdfProblem> {
    let text = document::with_prefixes(text);
    if document::parsed(&text)?
        .root_element()
        .has_tag_name("mujoco")
    {
        return mjcf::read(Path::new(file), text);
    }
    document::read(&text)
}

#[cfg(test)]
mod tests;

/// Refusal of a URDF.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{file}: {problem}")]
pub struct UrdfError {
    /// The file.
    pub file: String,
    /// Defect.
    pub problem: UrdfProblem,
}

/// Defect of a URDF.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum UrdfProblem {
    /// The file cannot be read.
    #[error("cannot be read: {0}")]
    Unreadable(String),
    /// Not XML, or not a robot.
    #[error("not a URDF or MJCF: {0}")]
    Syntax(String),
    /// Macros that have not been expanded.
    #[error("contains xacro macros: expand them first (xacro FILE)")]
    Xacro,
    /// An element lacks something or a number is none.
    #[error("line {line}: {problem}")]
    Element {
        /// Line of the element.
        line: u32,
        /// Reason, beginning with the name of the element.
        problem: String,
    },
    /// A link is named that does not exist.
    #[error("{named_by} names '{link}', which is neither a link nor a joint{mend}")]
    UnknownLink {
        /// The name.
        link: String,
        /// The joint or option that names it.
        named_by: String,
        /// Option that mends it, in brackets; empty where there is none.
        mend: String,
    },
    /// Two links or joints have the same name.
    #[error("the name '{0}' is used twice")]
    Duplicate(String),
    /// A link is the child of two joints, or of itself.
    #[error("link '{0}' closes a loop or has two parents, only a tree is an arm")]
    NotATree(String),
    /// More than one link could be the base.
    #[error("links '{}' have no parent: choose one with --base", .0.join("', '"))]
    Roots(Vec<String>),
    /// The tip cannot be reached from the base.
    #[error("link '{tip}' is not carried by link '{base}'")]
    NotBelow {
        /// Base link.
        base: String,
        /// Tip link.
        tip: String,
    },
    /// More than one moving joint leaves a link, and no tip is given.
    #[error("the tree branches at link '{link}': choose the arm's end with --tip '{}'", .tips.join("' or --tip '"))]
    Branch {
        /// The link.
        link: String,
        /// The last link of each branch, that of the longest first.
        tips: Vec<String>,
    },
    /// The arm has no joint, or more than the board supports.
    #[error("{}", joint_count(*.joints, .tip))]
    JointCount {
        /// Moving joints from base to tip.
        joints: usize,
        /// Link of the eighth.
        tip: String,
    },
    /// A joint of the arm cannot be used.
    #[error("joint '{joint}' {problem}{mend}")]
    Joint {
        /// The joint.
        joint: String,
        /// Why.
        problem: JointProblem,
        /// Option that leaves it out, in brackets; empty where none does.
        mend: String,
    },
    /// A moving link has neither mass nor anything with mass bolted to it.
    #[error(
        "link '{link}' is moved by joint '{joint}' but has no inertial data: give such links a mass with --link-mass"
    )]
    NoInertia {
        /// The link.
        link: String,
        /// The joint that moves it.
        joint: String,
    },
    /// No body has this mass distribution.
    #[error("link '{link}': {reason}{}", if .reason.starts_with("inertia") { " (--repair takes the nearest of a body)" } else { "" })]
    NotABody {
        /// The link.
        link: String,
        /// Why not.
        reason: String,
    },
}

/// Defect of a joint of the arm.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum JointProblem {
    /// It is not revolute; the type as written.
    #[error("is {0}: only revolute, continuous and fixed joints are supported")]
    Type(String),
    /// It follows another joint.
    #[error("mimics another joint: an arm's joints move on their own")]
    Mimic,
    /// A limit is missing or makes no sense.
    #[error("{0}")]
    Limit(String),
    /// Its axis has no direction.
    #[error("has an axis of length zero")]
    Axis,
}

fn joint_count(count: usize, tip: &str) -> String {
    match count {
        0 => "no moving joint between base and tip".to_owned(),
        _ => format!(
            "{count} moving joints, an arm has at most 8: choose its ends with --base and --tip, such as --tip '{tip}'"
        ),
    }
}
