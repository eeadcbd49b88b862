//! Why a URDF was refused.

use std::fmt::{Display, Formatter, Result};

/// A URDF was refused.
#[derive(Clone, Debug, PartialEq)]
pub struct UrdfError {
    /// The file.
    pub file: String,
    /// What is wrong with it.
    pub problem: UrdfProblem,
}

/// What is wrong with a URDF.
#[derive(Clone, Debug, PartialEq)]
pub enum UrdfProblem {
    /// The file cannot be read.
    Unreadable(String),
    /// Not XML, or not a robot.
    Syntax(String),
    /// Macros that have not been expanded.
    Xacro,
    /// An element lacks something or a number is none.
    Element {
        /// Line of the element.
        line: u32,
        /// What is wrong, beginning with the name of the element.
        problem: String,
    },
    /// A link is named that does not exist.
    UnknownLink {
        /// The name.
        link: String,
        /// Who names it: a joint or an option.
        named_by: String,
    },
    /// Two links or joints have the same name.
    Duplicate(String),
    /// A link is the child of two joints, or of itself.
    NotATree(String),
    /// More than one link could be the base.
    Roots(Vec<String>),
    /// The tip cannot be reached from the base.
    NotBelow {
        /// Base link.
        base: String,
        /// Tip link.
        tip: String,
    },
    /// More than one moving joint leaves a link, and no tip is given.
    Branch {
        /// The link.
        link: String,
        /// The joints.
        joints: Vec<String>,
    },
    /// The arm has no joint, or more than the board supports.
    JointCount(usize),
    /// A joint of the arm cannot be used.
    Joint {
        /// The joint.
        joint: String,
        /// Why.
        problem: JointProblem,
    },
    /// A moving link has neither mass nor anything with mass bolted to it.
    NoInertia {
        /// The link.
        link: String,
        /// The joint that moves it.
        joint: String,
    },
    /// No body has this mass distribution.
    NotABody {
        /// The link.
        link: String,
        /// Why not.
        reason: String,
    },
}

/// Why a joint cannot be part of an arm.
#[derive(Clone, Debug, PartialEq)]
pub enum JointProblem {
    /// It is not revolute; the type as written.
    Type(String),
    /// It follows another joint.
    Mimic,
    /// A limit is missing or makes no sense.
    Limit(String),
    /// Its axis has no direction.
    Axis,
}

impl Display for UrdfProblem {
    fn fmt(&self, f: &mut Formatter<'_>) -> Result {
        match self {
            Self::Unreadable(reason) => write!(f, "cannot be read: {reason}"),
            Self::Syntax(reason) => write!(f, "not a URDF: {reason}"),
            Self::Xacro => write!(f, "contains xacro macros: expand them first (xacro FILE)"),
            Self::Element { line, problem } => write!(f, "line {line}: {problem}"),
            Self::UnknownLink { link, named_by } => {
                write!(f, "{named_by} names link '{link}', which does not exist")
            }
            Self::Duplicate(name) => write!(f, "the name '{name}' is used twice"),
            Self::NotATree(link) => {
                write!(
                    f,
                    "link '{link}' closes a loop or has two parents, only a tree is an arm"
                )
            }
            Self::Roots(links) => write!(
                f,
                "links '{}' have no parent: choose one with --base",
                links.join("', '")
            ),
            Self::NotBelow { base, tip } => {
                write!(f, "link '{tip}' is not carried by link '{base}'")
            }
            Self::Branch { link, joints } => write!(
                f,
                "the tree branches at link '{link}' (joints '{}'): choose the arm's end with --tip",
                joints.join("', '")
            ),
            Self::JointCount(0) => write!(f, "no moving joint between base and tip"),
            Self::JointCount(count) => write!(f, "{count} moving joints, an arm has at most 8"),
            Self::Joint { joint, problem } => write!(f, "joint '{joint}' {problem}"),
            Self::NoInertia { link, joint } => write!(
                f,
                "link '{link}' is moved by joint '{joint}' but has no inertial data"
            ),
            Self::NotABody { link, reason } => write!(f, "link '{link}': {reason}"),
        }
    }
}

impl Display for JointProblem {
    fn fmt(&self, f: &mut Formatter<'_>) -> Result {
        match self {
            Self::Type(kind) => write!(
                f,
                "is {kind}: only revolute, continuous and fixed joints are supported"
            ),
            Self::Mimic => write!(f, "mimics another joint: an arm's joints move on their own"),
            Self::Limit(problem) => write!(f, "{problem}"),
            Self::Axis => write!(f, "has an axis of length zero"),
        }
    }
}

impl Display for UrdfError {
    fn fmt(&self, f: &mut Formatter<'_>) -> Result {
        write!(f, "{}: {}", self.file, self.problem)
    }
}

impl std::error::Error for UrdfError {}
