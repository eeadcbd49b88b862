//! The table of measured against reach, as it is kept in the documentation.

use super::LearningReport;
use super::page::number;

/// The table of `report`.
pub fn text(report: &LearningReport) -> String {
    let met = report.outcomes.iter().filter(|outcome| outcome.met).count();
    let mut out = format!(
        "Seed {}: {met} of {} reached.\n\n| scenario | figure | measured | reach | |\n|---|---|---|---|---|\n",
        report.seed,
        report.outcomes.len()
    );
    for outcome in &report.outcomes {
        out += &format!(
            "| {} | `{}` | {} | {} {} | {} |\n",
            outcome.scenario,
            outcome.figure,
            number(outcome.measured),
            outcome.side,
            outcome.bar,
            if outcome.met { "" } else { "missed" }
        );
    }
    if !report.comparison.is_empty() {
        out += "\n| estimator | multiply-adds a tick | below 2 % after / s | below 1 % after / s | after task / % | \
                after standstill / % | 3 kg to 10 % / s |\n|---|---|---|---|---|---|---|\n";
    }
    for (name, method) in &report.comparison {
        out += &format!(
            "| {name} | {} | {} | {} | {} | {} | {} |\n",
            method.multiply_adds_a_tick_count,
            number(method.stays_below_2_percent_s),
            number(method.stays_below_1_percent_s),
            number(method.after_task_nrmse_moving_percent),
            number(method.after_standstill_nrmse_moving_percent),
            number(method.payload_3kg_to_10_percent_s),
        );
    }
    out
}
