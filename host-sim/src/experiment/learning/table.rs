//! The table of measured against reach, as it is kept in the documentation.

use super::LearningReport;
use super::page::number;

/// What stands before and after the table.
const BEGIN: &str = "<!-- learning table begins -->\n";
const END: &str = "<!-- learning table ends -->";

/// `text` has both marks.
pub fn has_marks(text: &str) -> bool {
    around(text).is_some()
}

/// What stands before and after the marks.
fn around(text: &str) -> Option<(&str, &str)> {
    let (before, rest) = text.split_once(BEGIN)?;
    let (_, after) = rest.split_once(END)?;
    Some((before, after))
}

/// `text` with the table of `report` between the marks; `None` if it has not both of them.
pub fn renewed(text: &str, report: &LearningReport) -> Option<String> {
    let (before, after) = around(text)?;
    Some(format!("{before}{BEGIN}{}{END}{after}", table(report)))
}

fn table(report: &LearningReport) -> String {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::learning::Outcome;

    #[test]
    fn a_table_is_put_between_its_marks_and_nowhere_else() {
        let report = LearningReport {
            version: String::new(),
            seed: 3,
            scenarios: Default::default(),
            comparison: Default::default(),
            emulated: Default::default(),
            outcomes: vec![Outcome {
                scenario: "task-pd6".to_owned(),
                figure: "error_percent".to_owned(),
                measured: f64::NAN,
                side: "at most",
                bar: 2.0,
                met: false,
            }],
        };
        let text = format!("before\n{BEGIN}old\n{END}\nafter\n");
        let new = renewed(&text, &report).expect("has marks");
        assert!(new.starts_with("before\n") && new.ends_with("\nafter\n"));
        assert!(!new.contains("old"));
        assert!(new.contains("| task-pd6 | `error_percent` | never | at most 2 | missed |"));
        assert_eq!(renewed(&new, &report).as_ref(), Some(&new));
        assert_eq!(renewed("no marks", &report), None);
    }
}
