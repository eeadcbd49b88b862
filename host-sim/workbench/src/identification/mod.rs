//! From logs of motion and torque to validated parameters.
//!
//! `problem` holds the nouns. `log` (rows, checked) → `filter` and `prepare` (motion, regressor and torque through the same
//! zero-phase filter) → `normal` (one pass over any number of rows, bounded memory) → `methods` → `validation` → `record`.

mod clock;
mod columns;
mod consistent;
mod dataset;
mod filter;
mod filter_length;
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
mod repeated_rows;
mod solve;
mod stream;
mod study;
mod uncertainty;
mod validation;
mod whole_log;

pub use columns::{ColumnSet, FrictionTerm, Layout, Parameter};
pub use filter::despiked;
pub use filter_length::motion_filter;
pub use gains::with_gains;
pub use identify::{IdentifyConfig, Outcome, bank_of_fit, identify, same_content};
pub use judge::{Finding, JointCheck, Judgement, judge, unexplained};
pub use log::LogRow;
pub use methods::{Fit, METHODS, MethodName};
pub use normal::{CoggingAmplitudes, JointSums, SampleRow};
pub use page::page;
pub use prepare::{Preparation, PrepareConfig, Prepared};
pub use problem::{Candidate, MethodResult, Progress};
pub use record::{
    GainRecord, LearningPoint, MethodRecord, ParameterRecord, Report, SplitRecord, ValidationRecord,
};
pub use solve::fit_rows;
pub use stream::for_each_prepared;
pub use whole_log::WholeLog;

use crate::Refusal;
use crate::table::TableError;
use std::path::{Path, PathBuf};

/// Failure of an identification.
#[derive(Debug, thiserror::Error)]
pub enum IdentifyError {
    /// A log is missing or damaged.
    #[error(transparent)]
    Table(#[from] TableError),
    /// The motion has a rank below the number of parameters: it does not show these.
    #[error("the excitation is rank deficient ({0} of {1}): {text}", text = unseen(.2))]
    RankDeficient(usize, usize, Vec<String>),
    /// A matrix that must be positive definite is not.
    #[error(
        "the normal equations cannot be solved: a joint hardly moves; add a log in which it does, or take fewer --columns"
    )]
    Unsolvable,
    /// A log or an option that cannot be used.
    #[error(transparent)]
    Refused(#[from] Refusal),
}

/// The parameters that a motion does not show, or the joints that rest, and the remedy.
fn unseen(names: &[String]) -> String {
    let is_unseen = |joint: &str| {
        let own = ["Fv", "Fc"].map(|symbol| format!("{symbol}{joint}"));
        own.iter().all(|own| names.contains(own))
    };
    let joints = names.iter().filter_map(|name| name.strip_prefix("Fv"));
    let rest: Vec<&str> = joints.filter(|joint| is_unseen(joint)).collect();
    if !rest.is_empty() {
        let joints = rest.join(", ");
        return format!(
            "joints at rest: {joints}: add a --log in which every joint moves, for seconds"
        );
    }
    // Friction beyond viscous and Coulomb: a letter more, or another one, before the joint.
    let extra = |name: &String| {
        let symbol = name.trim_end_matches(|c: char| c.is_ascii_digit());
        symbol.starts_with('F') && !["Fv", "Fc"].contains(&symbol)
    };
    let remedy = match names.iter().all(extra) {
        true => {
            "--columns coulomb-viscous leaves them out, a smaller --still-rad-s takes slower rows too, or add a faster motion"
        }
        false => "add a --log with a richer motion, such as that of `excite`",
    };
    format!("it does not show {}: {remedy}", listed(names))
}

/// The first names, and how many there are more.
fn listed(names: &[String]) -> String {
    const SHOWN: usize = 8;
    let more = match names.len().saturating_sub(SHOWN) {
        0 => String::new(),
        more => format!(" and {more} more"),
    };
    names[..names.len().min(SHOWN)].join(", ") + &more
}

/// Paths of logs, separated by commas.
pub fn joined(logs: &[PathBuf]) -> String {
    let names = logs.iter().map(|log| log.display().to_string());
    names.collect::<Vec<_>>().join(", ")
}

/// Numbers of joints from 1 on, in words.
fn numbers(joints: impl Iterator<Item = usize>) -> String {
    let numbers: Vec<String> = joints.map(|joint| (joint + 1).to_string()).collect();
    numbers.join(", ")
}

fn refused(path: &Path, problem: impl std::fmt::Display) -> IdentifyError {
    Refusal::of(path.display(), problem).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_motion_that_does_not_show_all_is_refused_with_a_remedy() {
        for (names, wanted) in [
            (
                "mx4 Ia4 Fv4 Fc4 Fo4 Fv10 Fc10",
                "joints at rest: 4, 10: add",
            ),
            (
                "Fo4 Fvt4",
                "does not show Fo4, Fvt4: --columns coulomb-viscous",
            ),
            ("Fc4", "does not show Fc4: add a --log with a richer"),
            (
                "a b c d e f g h i j",
                "show a, b, c, d, e, f, g, h and 2 more: add",
            ),
        ] {
            let names = names.split(' ').map(str::to_owned).collect();
            let text = IdentifyError::RankDeficient(1, 3, names).to_string();
            assert!(text.contains(wanted), "{text}");
        }
    }
}
