//! `report.html` and text: figures against their bars by arm, and the curves behind them.

use super::arms::ARMS;
use super::{Comparison, LearningReport};
use crate::Outcome;
use foretorque_workbench::report::page::{Page, Section};
use foretorque_workbench::report::plot::{Curve, Panel, PlotColor};
use foretorque_workbench::snapshot::{aligned, significant};
use std::collections::BTreeSet;

pub(super) fn outcome(report: LearningReport) -> Outcome<LearningReport> {
    Outcome {
        page: page(&report),
        text: text(&report),
        report,
    }
}

/// Number of reached bars, in words.
fn reached(outcomes: &[&Comparison]) -> String {
    let met = outcomes.iter().filter(|outcome| outcome.met).count();
    format!("{met} of {}", outcomes.len())
}

/// Arms that ran, in the order of the table.
fn arms(report: &LearningReport) -> impl Iterator<Item = &'static str> {
    let ran: BTreeSet<&str> = report.scenarios.iter().map(|s| s.arm.as_str()).collect();
    let arms = ARMS.iter().map(|arm| arm.name);
    arms.filter(move |arm| ran.contains(arm))
}

/// Bars as rows, and one column for each arm: how many of its scenarios reach the bar, and the worst figure.
fn matrix(report: &LearningReport) -> (String, Vec<Vec<String>>) {
    let mut bars: Vec<(&str, &str, f64)> = Vec::new();
    for outcome in &report.outcomes {
        let bar = (outcome.figure.as_str(), outcome.side, outcome.bar);
        if !bars.contains(&bar) {
            bars.push(bar);
        }
    }
    let rows = bars.into_iter().map(|(figure, side, bar)| {
        let cells = arms(report).map(|arm| {
            let own = report.outcomes.iter().filter(|outcome| {
                let outcome = *outcome;
                outcome.arm == arm && (outcome.figure.as_str(), outcome.bar) == (figure, bar)
            });
            let own: Vec<&Comparison> = own.collect();
            let sign = if side == "at most" { 1.0 } else { -1.0 };
            let worst = own.iter().map(|outcome| sign * outcome.measured);
            let worst = sign * worst.fold(f64::NEG_INFINITY, f64::max);
            let missed = own.iter().any(|outcome| !outcome.met);
            match (own.is_empty(), missed) {
                (true, _) => String::new(),
                (_, false) => format!("{}, worst {}", reached(&own), number(worst)),
                (_, true) => format!("MISSED {}, worst {}", reached(&own), number(worst)),
            }
        });
        let first = [figure.to_owned(), format!("{side} {bar}")];
        first.into_iter().chain(cells).collect()
    });
    let header: Vec<&str> = arms(report).collect();
    (
        format!("figure | bar | {}", header.join(" | ")),
        rows.collect(),
    )
}

fn page(report: &LearningReport) -> Page {
    let all: Vec<&Comparison> = report.outcomes.iter().collect();
    let (header, rows) = matrix(report);
    let missed = report.outcomes.iter().filter(|outcome| !outcome.met);
    let panels = report
        .scenarios
        .iter()
        .filter(|s| s.scenario.starts_with("path-"));
    let panels: Vec<Panel> = panels
        .map(|scenario| {
            let title = format!("{} {}", scenario.arm, scenario.scenario);
            let curve = Curve::new(PlotColor::After, &scenario.curve, |point| *point);
            Panel::new(&title, "t / s", "error over start", vec![curve]).from_zero()
        })
        .collect();
    let figures = report.scenarios.iter().flat_map(|scenario| {
        scenario.figures.iter().map(|(figure, value)| {
            [
                scenario.arm.clone(),
                scenario.scenario.clone(),
                scenario.seed.to_string(),
                (*figure).to_owned(),
                number(*value),
            ]
        })
    });
    let kinds = ARMS
        .iter()
        .map(|arm| [arm.name.to_owned(), arm.kind.to_owned()]);
    Page::new(
        "Learning on the board of every arm",
        "Simulated arms with elastic gears, sticking friction, sensor errors and late reports under PD control. The \
         firmware's own session learns in one configuration.",
    )
    .card(reached(&all), "figures reach their bar")
    .sections([
        Section::new("Bars by arm", "Scenarios that reach the bar, and the worst figure.")
            .table(header, rows),
        Section::new("Missed", "Every figure that misses its bar.").table(
            "arm | scenario | seed | figure | measured | bar",
            missed.map(row),
        ),
        Section::new(
            "Torque error on a path that is never played",
            "Error of the set in force over that of the start; joints below 2 % of their limit count as 2 %.",
        )
        .plots(panels, 4),
        Section::new("Arms", "Descriptions in host-sim/robots.").table("arm | kind", kinds),
        Section::new("All figures", "The unit is the end of the name.")
            .table("arm | scenario | seed | figure | value", figures),
    ])
}

fn row(outcome: &Comparison) -> [String; 6] {
    [
        outcome.arm.clone(),
        outcome.scenario.clone(),
        outcome.seed.to_string(),
        outcome.figure.clone(),
        number(outcome.measured),
        format!("{} {}", outcome.side, outcome.bar),
    ]
}

fn text(report: &LearningReport) -> String {
    let all: Vec<&Comparison> = report.outcomes.iter().collect();
    let (header, rows) = matrix(report);
    let missed = report.outcomes.iter().filter(|outcome| !outcome.met);
    format!(
        "host-sim experiment learning: {} reached.\n\n{}\nMissed:\n\n{}",
        reached(&all),
        aligned(&header, rows),
        aligned(
            "arm | scenario | seed | figure | measured | reach",
            missed.map(row)
        ),
    )
}

/// Four significant digits.
fn number(value: f64) -> String {
    significant(value, 4)
}
