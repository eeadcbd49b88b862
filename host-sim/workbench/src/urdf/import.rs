//! Request and result of an import.

use crate::robot::Robot;

/// Path of the tree that is the arm.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Selection<'a> {
    /// Link the arm stands on; the root of the tree when not given.
    pub base: Option<&'a str>,
    /// Link the arm ends at; needed where more than one moving joint leaves a link.
    pub tip: Option<&'a str>,
}

/// An arm, and what the file did not say about it.
#[derive(Clone, Debug, PartialEq)]
pub struct Import {
    /// The arm.
    pub robot: Robot,
    /// One sentence for each assumption made and each part left out.
    pub notes: Vec<String>,
}
