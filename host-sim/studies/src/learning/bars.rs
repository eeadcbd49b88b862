//! What is to be reached, beside what was measured.

use super::figures::Figures;
use serde::Serialize;
use std::collections::BTreeMap;

/// On which side of the bar a figure must lie.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Side {
    AtMost,
    AtLeast,
}
use Side::{AtLeast, AtMost};

/// Scenarios whose names begin so, figure, side, bar.
const BARS: &[(&str, &str, Side, f64)] = &[
    ("convergence-", "stays_below_2_percent_s", AtMost, 4.5),
    ("convergence-", "stays_below_1_percent_s", AtMost, 27.0),
    ("payload-3kg-", "pick_to_10_percent_median_s", AtMost, 0.25),
    ("payload-3kg-", "pick_to_10_percent_worst_s", AtMost, 0.5),
    ("payload-1kg-", "pick_to_10_percent_worst_s", AtMost, 2.5),
    ("payload-2kg-", "pick_to_10_percent_worst_s", AtMost, 2.5),
    ("payload-5kg-", "pick_to_10_percent_worst_s", AtMost, 2.5),
    (
        "payload-",
        "mass_error_after_1_s_worst_percent",
        AtMost,
        2.0,
    ),
    ("payload-", "com_error_after_1_s_worst_mm", AtMost, 10.0),
    (
        "payload-",
        "torque_after_release_change_worst_percent",
        AtMost,
        1.0,
    ),
    ("standstill-", "parameter_drift_prior_sigmas", AtMost, 0.0),
    ("collisions-", "above_5_percent_during_count", AtMost, 1.0),
    (
        "collisions-",
        "above_5_percent_one_second_after_count",
        AtMost,
        0.0,
    ),
    ("", "worst_window_learned_over_frozen_ratio", AtMost, 1.05),
    (
        "tracking-identified-pd3",
        "pd_over_frozen_mean_ratio",
        AtLeast,
        50.0,
    ),
    (
        "tracking-identified-pd6",
        "pd_over_frozen_mean_ratio",
        AtLeast,
        30.0,
    ),
    (
        "tracking-identified-pd3",
        "pd_over_learned_mean_ratio",
        AtLeast,
        50.0,
    ),
    (
        "tracking-identified-pd6",
        "pd_over_learned_mean_ratio",
        AtLeast,
        30.0,
    ),
    (
        "tracking-wrong-prior-pd3",
        "pd_over_learned_mean_ratio",
        AtLeast,
        50.0,
    ),
    (
        "tracking-wrong-prior-pd6",
        "pd_over_learned_mean_ratio",
        AtLeast,
        30.0,
    ),
    (
        "tracking-warm-pd3",
        "pd_over_learned_mean_ratio",
        AtLeast,
        45.0,
    ),
    (
        "tracking-warm-pd6",
        "pd_over_learned_mean_ratio",
        AtLeast,
        27.0,
    ),
    (
        "tracking-",
        "pd_over_learned_worst_joint_ratio",
        AtLeast,
        20.0,
    ),
    (
        "network-",
        "unseen_with_over_without_network_ratio",
        AtMost,
        0.85,
    ),
    (
        "network-",
        "unseen_with_over_without_network_worst_ratio",
        AtMost,
        1.0,
    ),
];

/// One figure against its bar.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Outcome {
    /// Scenario.
    pub scenario: String,
    /// Figure, its unit at the end.
    pub figure: String,
    /// What was measured; `null` if it never happened.
    pub measured: f64,
    /// `at most` or `at least`.
    pub side: &'static str,
    /// The bar.
    pub bar: f64,
    /// It is reached.
    pub met: bool,
}

/// Every figure that has a bar, scenario by scenario.
pub(super) fn outcomes<'f>(
    scenarios: impl Iterator<Item = (&'f String, &'f Figures)>,
) -> Vec<Outcome> {
    let scenarios: BTreeMap<&String, &Figures> = scenarios.collect();
    let mut out = Vec::new();
    for (beginning, figure, side, bar) in BARS {
        for (name, figures) in &scenarios {
            let Some(&measured) = figures.get(*figure).filter(|_| name.starts_with(beginning))
            else {
                continue;
            };
            // A figure that is none (never below 2 %) is on neither side.
            let met = match side {
                AtMost => measured <= *bar,
                AtLeast => measured >= *bar,
            };
            out.push(Outcome {
                scenario: (*name).clone(),
                figure: (*figure).to_owned(),
                measured,
                side: match side {
                    AtMost => "at most",
                    AtLeast => "at least",
                },
                bar: *bar,
                met,
            });
        }
    }
    out
}
