//! `report.html` and text: figures against their bars, and the curves behind them.

use super::record::LearningReport;
use crate::Outcome;
use foretorque_workbench::report::page::{Page, Section};
use foretorque_workbench::report::plot::{Curve, Panel, PlotColor};
use foretorque_workbench::snapshot::{aligned, significant};

pub(super) fn outcome(report: LearningReport) -> Outcome<LearningReport> {
    Outcome {
        page: page(&report),
        text: text(&report),
        report,
    }
}

fn page(report: &LearningReport) -> Page {
    let met = report.outcomes.iter().filter(|outcome| outcome.met).count();
    let outcomes = report.outcomes.iter().map(|outcome| {
        [
            outcome.scenario.clone(),
            outcome.figure.clone(),
            number(outcome.measured),
            format!("{} {}", outcome.side, outcome.bar),
            if outcome.met { "met" } else { "missed" }.to_owned(),
        ]
    });
    let panels: Vec<Panel> = report
        .scenarios
        .iter()
        .map(|(name, scenario)| {
            let frozen = &scenario.frozen_nrmse_moving_percent;
            let curves = vec![
                Curve::new(PlotColor::Before, frozen, |point| *point),
                Curve::new(PlotColor::After, &scenario.nrmse_moving_percent, |point| {
                    *point
                }),
            ];
            Panel::new(name, "t / s", "NRMSE / %", curves).from_zero()
        })
        .collect();
    let scenarios = || report.scenarios.values();
    let mut names: Vec<&String> = scenarios().flat_map(|s| s.figures.keys()).collect();
    names.sort();
    names.dedup();
    let header: String = report
        .scenarios
        .keys()
        .map(|name| format!(" | {name}"))
        .collect();
    let figures = names.into_iter().map(|name| {
        let figure = scenarios().map(|s| s.figures.get(name).map_or(String::new(), |v| number(*v)));
        std::iter::once(name.clone()).chain(figure)
    });
    Page::new(
        "Learning on the board under disturbances",
        "A simulated UR5 under PD control; the firmware's own code learns in one configuration, everything switched on.",
    )
    .card(
        format!("{met} of {}", report.outcomes.len()),
        "figures reach their bar",
    )
    .card(report.seed, "seed")
    .sections([
        Section::new("Measured against the bars", "Every figure that has a bar.")
            .table("scenario | figure | measured | bar | ", outcomes),
        Section::new(
            "Torque error on a path that is never played",
            "NRMSE of the active parameters, moving rows; pd3 and pd6 are loops of 3 and 6 Hz.",
        )
        .legend([(PlotColor::Before, "frozen"), (PlotColor::After, "learning")])
        .plots(panels, 3),
        Section::new("All figures", "The unit is the end of the name.")
            .table(format!("figure{header}"), figures),
        Section::new("How this was made", "The same command gives the same digits.").command(
            format!(
                "cargo run --release -p host-sim -- experiment learning --seed {} --out DIR",
                report.seed
            ),
        ),
    ])
}

fn text(report: &LearningReport) -> String {
    let met = report.outcomes.iter().filter(|outcome| outcome.met).count();
    let outcomes = report.outcomes.iter().map(|outcome| {
        [
            outcome.scenario.clone(),
            outcome.figure.clone(),
            number(outcome.measured),
            format!("{} {}", outcome.side, outcome.bar),
            if outcome.met { "" } else { "missed" }.to_owned(),
        ]
    });
    let replayed = report.emulated.iter().map(|(name, replayed)| {
        [
            name.clone(),
            replayed.ticks_count.to_string(),
            replayed.ticks_with_other_bits_count.to_string(),
        ]
    });
    format!(
        "host-sim experiment learning, seed {}\n\n{met} of {} reached.\n\n{}\n{}",
        report.seed,
        report.outcomes.len(),
        aligned("scenario | figure | measured | reach | ", outcomes),
        aligned(
            "scenario | ticks on the board | ticks with other bits",
            replayed
        )
    )
}

/// Four significant digits.
fn number(value: f64) -> String {
    significant(value, 4)
}
