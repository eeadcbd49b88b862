//! From logs of motion and torque to validated parameters.
//!
//! `problem` holds the nouns. `log` (rows, checked) → `filter` and `prepare` (motion, regressor and torque through the same
//! zero-phase filter) → `normal` (one pass over any number of rows, bounded memory) → `methods` → `validation` → `record`.

mod clock;
mod columns;
mod consistent;
mod dataset;
mod filter;
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
mod solve;
mod stream;
mod study;
mod uncertainty;
mod validation;
mod whole_log;

pub use columns::{ColumnSet, FrictionTerm, Layout, Parameter};
pub use dataset::SampleRow;
pub use filter::{Butterworth, despiked};
pub use gains::with_gains;
pub use identify::{IdentifyConfig, Outcome, bank_of_fit, identify};
pub use judge::{Finding, JointCheck, Judgement, judge, unexplained};
pub use log::LogRow;
pub use methods::{Fit, METHODS, MethodName};
pub use normal::{CoggingAmplitudes, JointSums};
pub use page::page;
pub use prepare::{Preparation, PrepareConfig, Prepared, cut_offs};
pub use problem::{Candidate, MethodResult, Progress};
pub use record::{
    GainRecord, LearningPoint, MethodRecord, ParameterRecord, Report, SplitRecord, ValidationRecord,
};
pub use solve::fit_rows;
pub use stream::for_each_prepared;
pub use whole_log::WholeLog;

use crate::Refusal;
use crate::table::TableError;
use std::path::Path;

/// Failure of an identification.
#[derive(Debug, thiserror::Error)]
pub enum IdentifyError {
    /// A log is missing or damaged.
    #[error(transparent)]
    Table(#[from] TableError),
    /// The motion has a rank below the number of parameters: it does not show these.
    #[error("the excitation is rank deficient ({0} of {1}): it does not show {names}", names = .2.join(", "))]
    RankDeficient(usize, usize, Vec<String>),
    /// A matrix that must be positive definite is not.
    #[error("the normal equations cannot be solved")]
    Unsolvable,
    /// A log or an option that cannot be used.
    #[error(transparent)]
    Refused(#[from] Refusal),
}

/// The refusal of a log.
fn refused(path: &Path, problem: impl std::fmt::Display) -> IdentifyError {
    Refusal::of(path.display(), problem).into()
}
