//! Failures of the studies.

use foretorque::learning::ConfigError;
use foretorque_workbench::board::BoardError;
use foretorque_workbench::excitation::ExcitationError;
use foretorque_workbench::identification::IdentifyError;
use foretorque_workbench::report::ReportError;
use foretorque_workbench::report::plot::PlotError;
use foretorque_workbench::robot::RobotError;
use foretorque_workbench::table::TableError;
use std::io;

/// Failure of a study.
#[derive(Debug, thiserror::Error)]
pub enum StudyError {
    /// A request that the study cannot fulfil.
    #[error("{0}")]
    Unusable(String),
    /// A robot with another number of joints.
    #[error("robots of {0} joints are not supported")]
    Joints(usize),
    /// A board that broke off or refused.
    #[error(transparent)]
    Board(#[from] BoardError),
    /// A configuration that the firmware refuses.
    #[error("{0}")]
    Config(#[from] ConfigError),
    /// An excitation that cannot be found or played.
    #[error(transparent)]
    Excitation(#[from] ExcitationError),
    /// A file that cannot be read or written.
    #[error(transparent)]
    File(#[from] io::Error),
    /// An identification that fails.
    #[error(transparent)]
    Identify(#[from] IdentifyError),
    /// A file that is no JSON of this program.
    #[error(transparent)]
    Json(#[from] serde_json::Error),
    /// A report that cannot be written.
    #[error(transparent)]
    Report(#[from] ReportError),
    /// A robot that cannot be loaded.
    #[error(transparent)]
    Robot(#[from] RobotError),
    /// A log that cannot be read.
    #[error(transparent)]
    Table(#[from] TableError),
}

impl From<PlotError> for StudyError {
    fn from(error: PlotError) -> Self {
        Self::Report(error.into())
    }
}
