//! From logs of motion and torque to validated parameters.
//!
//! `problem` holds the nouns. `log` (rows, checked) → `filter` and `prepare` (motion, regressor and torque through the same
//! zero-phase filter) → `normal` (one pass over any number of rows, bounded memory) → `methods` → `validation` → `record`.

mod cogging;
mod columns;
mod consistent;
mod dataset;
mod evidence;
mod filter;
mod fourier;
mod gains;
mod identify;
mod judge;
mod log;
mod log_search;
#[cfg(test)]
mod log_tests;
mod methods;
mod normal;
mod page;
mod prepare;
mod problem;
mod record;
mod residual;
mod solve;
mod stream;
mod study;
mod uncertainty;
mod validation;
mod whole_log;

pub use cogging::CoggingAmplitudes;
pub use columns::{ColumnSet, FrictionTerm, Layout, Parameter};
pub use dataset::SampleRow;
pub use filter::{Butterworth, despiked};
pub use identify::{IdentifyConfig, Outcome, bank_of_fit, identify};
pub use judge::{Finding, JointCheck, Judgement, judge, unexplained};
pub use log::LogRow;
pub use methods::{Fit, METHODS, MethodName};
pub use page::page;
pub use prepare::{Preparation, PrepareConfig, Prepared, cut_offs, longest_period_s};
pub use problem::{Candidate, MethodResult, Progress};
pub use record::{
    GainRecord, LearningPoint, MethodRecord, ParameterRecord, Report, SplitRecord, ValidationRecord,
};
pub use solve::fit_rows;
pub use stream::for_each_prepared;
pub use whole_log::WholeLog;

use crate::table::TableError;
use std::path::PathBuf;

/// Failure of an identification.
#[derive(Debug, thiserror::Error)]
pub enum IdentifyError {
    /// A log is missing or damaged.
    #[error(transparent)]
    Table(#[from] TableError),
    /// No joint moves in these logs.
    #[error("{0}: no joint moves")]
    NoMotion(String),
    /// The rows of a log, so many a second, are too far apart for the cut-off of an option, Hz.
    #[error(
        "{0}: {1} is {2}, must be below {limit:.4}, {share} of its {3:.4} rows a second{hint}",
        limit = Butterworth::RATE_SHARE * .3, share = Butterworth::RATE_SHARE,
        hint = if *.3 < 5.0 { ": are its times in ms (--units t=ms)?" } else { "" }
    )]
    CutOff(PathBuf, &'static str, f64, f64),
    /// The motion has a rank below the number of parameters: it does not show these.
    #[error("the excitation is rank deficient ({0} of {1}): it does not show {names}", names = .2.join(", "))]
    RankDeficient(usize, usize, Vec<String>),
    /// A matrix that must be positive definite is not.
    #[error("the normal equations cannot be solved")]
    Unsolvable,
    /// The thread that trains a network ended early.
    #[error("a network could not be trained")]
    Untrained,
    /// A log has torques instead of motor currents.
    #[error("{0}: no motor currents to find drive gains from")]
    NoCurrents(PathBuf),
    /// The folding period, s, is no whole number of rows, s apart.
    #[error("{0}: a period of {1} s is no whole number of rows, which are {2:.6} s apart")]
    PeriodOfRows(PathBuf, f64, f64),
    /// A row (line, time in s) is off the even spacing, s.
    #[error("{0}:{1}: column t_s: {2} is off the even spacing of {3:.6} s that folding needs")]
    UnevenRow(PathBuf, u64, f64, f64),
    /// The log is shorter than the folding period, s.
    #[error("{0}: the log does not show a whole period of {1} s")]
    ShortLog(PathBuf, f64),
}

/// An unknown word in place of a method or a column set, with the known ones.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum UnknownName {
    /// No column set.
    #[error("unknown column set '{0}': join any of {1} by '+', or take full for all")]
    Columns(String, String),
    /// No method.
    #[error("unknown method '{0}': one of {1}")]
    Method(String, String),
}
