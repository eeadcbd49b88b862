//! From logs of motion and torque to validated parameters.
//!
//! `problem` holds the nouns. `log` (rows, checked) → `filter` and `prepare` (motion, regressor and torque through the same
//! zero-phase filter) → `normal` (one pass over any number of rows, bounded memory) → `methods` → `validation` → `record`.

mod bank;
mod cogging;
mod columns;
mod consistent;
mod dataset;
mod error;
mod evidence;
mod filter;
mod fourier;
mod gains;
mod holdout;
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
mod speed;
mod stream;
mod study;
mod truth;
mod uncertainty;
mod validation;
mod whole_log;

pub use bank::bank_of_fit;
pub use cogging::CoggingAmplitudes;
pub use columns::{ColumnSet, FrictionTerm, Layout, Parameter};
pub use dataset::SampleRow;
pub use error::{IdentifyError, UnknownName};
pub use filter::{Butterworth, despiked};
pub use identify::{IdentifyConfig, Outcome, identify};
pub use judge::{Finding, JointCheck, Judgement, judge, unexplained};
pub use log::LogRow;
pub use methods::{Fit, METHODS, MethodName};
pub use page::page;
pub use prepare::{Preparation, PrepareConfig, Prepared};
pub use problem::{Candidate, MethodResult, Progress};
pub use record::{
    GainRecord, LearningPoint, MethodRecord, ParameterRecord, Report, SplitRecord, ValidationRecord,
};
pub use solve::fit_rows;
pub use stream::for_each_prepared;
pub use whole_log::WholeLog;
