//! Descriptions of arms: their files, their rigid-body model in f64, and their constants for the firmware.

pub mod described;
pub mod dynamics;
pub mod files;
pub mod generate;
pub mod robot;
pub mod urdf;

/// Reason for which an input is refused: one line that names the place of the defect.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct Refusal(pub String);

impl Refusal {
    /// A `problem` in a file, a field or an element.
    pub fn of(place: impl std::fmt::Display, problem: impl std::fmt::Display) -> Self {
        Self(format!("{place}: {problem}"))
    }
}
