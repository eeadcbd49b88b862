//! Errors of a URDF file.

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
