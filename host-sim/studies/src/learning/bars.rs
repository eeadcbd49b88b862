//! Required values, beside the measured ones.

use super::figures::Figures;
use serde::Serialize;
use std::collections::BTreeMap;

/// Scenarios whose names begin so (`-` for all), figure, side, bar.
const BARS: &str = "\
convergence-              stays_below_2_percent_s                       at most   4.5
convergence-              stays_below_1_percent_s                       at most   27
payload-3kg-              pick_to_10_percent_median_s                   at most   0.25
payload-3kg-              pick_to_10_percent_worst_s                    at most   0.5
payload-1kg-              pick_to_10_percent_worst_s                    at most   2.5
payload-2kg-              pick_to_10_percent_worst_s                    at most   2.5
payload-5kg-              pick_to_10_percent_worst_s                    at most   2.5
payload-                  mass_error_after_1_s_worst_percent            at most   2
payload-                  com_error_after_1_s_worst_mm                  at most   10
payload-                  torque_after_release_change_worst_percent     at most   1
standstill-               parameter_drift_prior_sigmas                  at most   0
collisions-               above_5_percent_during_count                  at most   1
collisions-               above_5_percent_one_second_after_count        at most   0
-                         worst_window_learned_over_frozen_ratio        at most   1.05
tracking-identified-pd3   pd_over_frozen_mean_ratio                     at least  50
tracking-identified-pd6   pd_over_frozen_mean_ratio                     at least  30
tracking-identified-pd3   pd_over_learned_mean_ratio                    at least  50
tracking-identified-pd6   pd_over_learned_mean_ratio                    at least  30
tracking-wrong-prior-pd3  pd_over_learned_mean_ratio                    at least  50
tracking-wrong-prior-pd6  pd_over_learned_mean_ratio                    at least  30
tracking-warm-pd3         pd_over_learned_mean_ratio                    at least  45
tracking-warm-pd6         pd_over_learned_mean_ratio                    at least  27
tracking-                 pd_over_learned_worst_joint_ratio             at least  20
network-                  unseen_with_over_without_network_ratio        at most   0.85
network-                  unseen_with_over_without_network_worst_ratio  at most   1
";

/// One figure against its bar.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// Scenario.
    pub scenario: String,
    /// Figure, its unit at the end.
    pub figure: String,
    /// Measured value; `null` if it never happened.
    pub measured: f64,
    /// `at most` or `at least`.
    pub side: &'static str,
    /// The bar.
    pub bar: f64,
    /// It is reached.
    pub met: bool,
}

/// Beginning of the scenario's name, figure, whether the figure is to be at most the bar, bar.
fn bars() -> impl Iterator<Item = Option<(&'static str, &'static str, bool, f64)>> {
    BARS.lines().map(|line| {
        let mut words = line.split_whitespace();
        let scenario = words.next()?;
        let (figure, _, side, bar) = (words.next()?, words.next()?, words.next()?, words.next()?);
        let beginning = if scenario == "-" { "" } else { scenario };
        Some((beginning, figure, side == "most", bar.parse().ok()?))
    })
}

/// Every figure that has a bar, bar by bar.
pub(super) fn comparisons<'f>(
    scenarios: impl Iterator<Item = (&'f String, &'f Figures)>,
) -> Vec<Comparison> {
    let scenarios: BTreeMap<&String, &Figures> = scenarios.collect();
    let mut out = Vec::new();
    for (beginning, figure, at_most, bar) in bars().flatten() {
        for (name, figures) in scenarios
            .iter()
            .filter(|(name, _)| name.starts_with(beginning))
        {
            let Some(&measured) = figures.get(figure) else {
                continue;
            };
            out.push(Comparison {
                scenario: (*name).clone(),
                figure: figure.to_owned(),
                measured,
                side: if at_most { "at most" } else { "at least" },
                bar,
                // A figure that is not a number (never below 2 %) is on neither side.
                met: if at_most {
                    measured <= bar
                } else {
                    measured >= bar
                },
            });
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_line_of_the_table_is_a_bar() {
        assert_eq!(bars().flatten().count(), BARS.lines().count());
    }
}
