//! Failures of an identification.

use super::filter::Butterworth;
use crate::table::TableError;
use std::path::PathBuf;

/// Failure of an identification.
#[derive(Debug, thiserror::Error)]
pub enum IdentifyError {
    /// A log is missing or damaged.
    #[error(transparent)]
    Table(#[from] TableError),
    /// The robot has another number of joints.
    #[error("robot '{robot}' has not {joints} joints")]
    Joints {
        /// The robot.
        robot: String,
        /// Joints expected.
        joints: usize,
    },
    /// No joint moves.
    #[error("{logs}: no joint moves")]
    NoMotion {
        /// The logs.
        logs: String,
    },
    /// The rows are too far apart for the cut-off of a filter.
    #[error(
        "{log}: {option} is {asked_hz}, must be below {:.4}, {} of its {rate_hz:.4} rows a second",
        Butterworth::RATE_SHARE * .rate_hz, Butterworth::RATE_SHARE
    )]
    CutOff {
        /// The log.
        log: String,
        /// The option that sets the cut-off.
        option: &'static str,
        /// The cut-off, Hz.
        asked_hz: f64,
        /// Rows of the log a second.
        rate_hz: f64,
    },
    /// The motion does not show these parameters.
    #[error(
        "the excitation is rank deficient ({rank} of {wanted}): it does not show {}",
        .unseen.join(", ")
    )]
    RankDeficient {
        /// Rank found.
        rank: usize,
        /// Parameters wanted.
        wanted: usize,
        /// The parameters that cannot be seen.
        unseen: Vec<String>,
    },
    /// A matrix that must be positive definite is not.
    #[error("the normal equations cannot be solved")]
    Unsolvable,
    /// The thread that trains a network ended early.
    #[error("a network could not be trained")]
    Untrained,
    /// A log has torques instead of motor currents.
    #[error("{path}: no motor currents to find drive gains from")]
    NoCurrents {
        /// The log.
        path: PathBuf,
    },
    /// The folding period is no whole number of rows.
    #[error(
        "{path}: a period of {period_s} s is no whole number of rows, which are {row_s:.6} s apart"
    )]
    PeriodOfRows {
        /// The log.
        path: PathBuf,
        /// The period, s.
        period_s: f64,
        /// Time between two rows, s.
        row_s: f64,
    },
    /// A row is off the even spacing.
    #[error(
        "{path}:{line}: column t_s: {t_s} is off the even spacing of {row_s:.6} s that folding needs"
    )]
    UnevenRow {
        /// The log.
        path: PathBuf,
        /// Line of the row, from 1.
        line: u64,
        /// Time of the row, s.
        t_s: f64,
        /// Time between two rows, s.
        row_s: f64,
    },
    /// The log is shorter than the folding period.
    #[error("{path}: the log does not show a whole period of {period_s} s")]
    ShortLog {
        /// The log.
        path: PathBuf,
        /// The period, s.
        period_s: f64,
    },
}
