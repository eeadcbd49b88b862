//! The reproducible studies of foretorque, and its fault campaign.
//!
//! A study takes a configuration and gives an [`Outcome`]: figures for `report.json`, a page for `report.html`, and the same
//! figures as text that a snapshot keeps.

pub mod demo;
pub mod efficiency;
mod error;
pub mod excitation;
pub mod faults;
pub mod learning;
pub mod paper;
pub mod prior;
pub mod real_ur5;
pub mod records;
pub mod replay;

pub use error::StudyError;

use foretorque_workbench::report::page::Page;

/// Progress: stage, steps done, steps in all.
pub type Progress<'p> = &'p (dyn Fn(&'static str, usize, usize) + Sync);

/// Result of a study.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome<R> {
    /// Figures, units in the keys.
    pub report: R,
    /// The page.
    pub page: Page,
    /// The main figures as lines of text; no line depends on the machine.
    pub text: String,
}
