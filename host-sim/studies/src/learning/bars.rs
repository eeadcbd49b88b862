//! Required values, beside the measured ones.

use super::ScenarioReport;
use serde::Serialize;

/// Arm (`-` for all), scenarios whose names begin so (`-` for all), figure, side, bar.
const BARS: &str = "\
-    path-description          unseen_over_start_ratio           at most  0.35
-    path-                     unseen_over_batch_ratio           at most  1.3
-    path-description-link     unseen_over_batch_ratio           at most  1.1
-    slow-                     unseen_over_batch_ratio           at most  1.5
-    -                         windows_above_1.05_percent        at most  1
-    -                         worst_window_ratio                at most  1.1
-    path-                     tracking_over_pd_ratio            at most  0.2
-    rigid-                    tracking_over_pd_ratio            at most  0.2
ur5  rigid-                    tracking_over_pd_ratio            at most  0.05
-    drift-                    mean_over_start_ratio             at most  0.8
-    calm-                     alarms_count                      at most  0
-    payload-                  payload_mass_error_worst_percent  at most  10
-    -                         armed_at_the_end_count            at least 1
";

/// One figure against its bar.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// Arm.
    pub arm: String,
    /// Scenario.
    pub scenario: String,
    /// Seed.
    pub seed: u64,
    /// Figure, its unit at the end.
    pub figure: String,
    /// Measured value.
    pub measured: f64,
    /// `at most` or `at least`.
    pub side: &'static str,
    /// The bar.
    pub bar: f64,
    /// It is reached.
    pub met: bool,
}

/// Arm, beginning of the scenario's name, figure, whether the figure is to be at most the bar, bar.
fn bars() -> impl Iterator<Item = Option<(&'static str, &'static str, &'static str, bool, f64)>> {
    BARS.lines().map(|line| {
        let mut words = line.split_whitespace();
        let mut beginning = || Some(words.next()?.trim_start_matches('-'));
        let (arm, scenario) = (beginning()?, beginning()?);
        let (figure, _, side, bar) = (words.next()?, words.next()?, words.next()?, words.next()?);
        Some((arm, scenario, figure, side == "most", bar.parse().ok()?))
    })
}

/// Every figure that has a bar, bar by bar.
pub(super) fn comparisons(reports: &[ScenarioReport]) -> Vec<Comparison> {
    let mut out = Vec::new();
    for (arm, scenario, figure, at_most, bar) in bars().flatten() {
        let of_bar = reports
            .iter()
            .filter(|report| report.arm.starts_with(arm) && report.scenario.starts_with(scenario));
        for report in of_bar {
            let Some(&measured) = report.figures.get(figure) else {
                continue;
            };
            out.push(Comparison {
                arm: report.arm.clone(),
                scenario: report.scenario.clone(),
                seed: report.seed,
                figure: figure.to_owned(),
                measured,
                side: if at_most { "at most" } else { "at least" },
                bar,
                // A figure that is not a number is on neither side.
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
