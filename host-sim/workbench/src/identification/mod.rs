//! From logs of motion and torque to validated parameters.
//!
//! `log` (rows, checked) → `filter` and `prepare` (motion, regressor and torque through the same zero-phase filter) →
//! `normal` (one pass over any number of rows, memory that does not grow) → `methods` → `validation` → `record`.

mod bank;
mod bootstrap;
mod columns;
mod consistent;
mod evidence;
mod filter;
mod fourier;
mod gains;
mod gathered;
mod learning_curve;
mod log;
mod methods;
mod normal;
mod page;
mod prepare;
mod record;
mod residual;
mod ripple;
mod solve;
mod sources;
mod speed;
mod split;
mod stream;
mod study;
mod trial;
mod truth;
mod validation;
mod whole_log;

pub use bank::bank_of_fit;
pub use columns::{ColumnSet, FrictionColumn, Layout, Parameter};
pub use filter::{Butterworth, despiked};
pub use gathered::{Gathered, SampleRow};
pub use log::{LogReader, LogRow};
pub use methods::{Fit, METHODS, MethodName};
pub use normal::{IdentificationError, NormalEquations};
pub use page::page;
pub use prepare::{MotionSource, Preparation, PrepareConfig, Prepared};
pub use record::{
    GainRecord, LearningPoint, MethodRecord, ParameterRecord, Report, SplitRecord, ValidationRecord,
};
pub use ripple::Ripple;
pub use stream::for_each_prepared;
pub use study::{IdentifyConfig, Outcome, Progress, identify};
pub use trial::{Trial, fit_rows};
pub use validation::{Candidate, FileScores};
pub use whole_log::WholeLog;
