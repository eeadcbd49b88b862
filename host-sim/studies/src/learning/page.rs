//! `report.html`: what was reached, and the curves behind it.

use super::LearningReport;
use foretorque_workbench::report::page::{Section, Tile, command, html, table};
use foretorque_workbench::report::plot::{Curve, Ink, Panel, grid};
use std::error::Error;

/// The page of a report.
pub(super) fn page(report: &LearningReport) -> Result<String, Box<dyn Error>> {
    let met = report.outcomes.iter().filter(|outcome| outcome.met).count();
    let rows: Vec<Vec<String>> = report
        .outcomes
        .iter()
        .map(|outcome| {
            vec![
                outcome.scenario.clone(),
                outcome.figure.clone(),
                number(outcome.measured),
                format!("{} {}", outcome.side, outcome.bar),
                if outcome.met { "met" } else { "missed" }.to_owned(),
            ]
        })
        .collect();
    let panels: Vec<Panel> = report
        .scenarios
        .iter()
        .map(|(name, scenario)| Panel {
            title: name.clone(),
            x_label: "t / s".to_owned(),
            y_label: "NRMSE / %".to_owned(),
            curves: vec![
                Curve {
                    ink: Ink::Before,
                    points: scenario.frozen_nrmse_moving_percent.clone(),
                },
                Curve {
                    ink: Ink::After,
                    points: scenario.nrmse_moving_percent.clone(),
                },
            ],
            from_zero: true,
        })
        .collect();
    let mut names: Vec<&String> = report
        .scenarios
        .values()
        .flat_map(|scenario| scenario.figures.keys())
        .collect();
    names.sort();
    names.dedup();
    let mut header = vec!["figure"];
    header.extend(report.scenarios.keys().map(String::as_str));
    let figures: Vec<Vec<String>> = names
        .iter()
        .map(|name| {
            let mut row = vec![(*name).clone()];
            let scenarios = report.scenarios.values();
            row.extend(
                scenarios.map(|s| s.figures.get(*name).map_or(String::new(), |v| number(*v))),
            );
            row
        })
        .collect();
    let section =
        |heading: &str, caption: &str, legend: Vec<(Ink, String)>, body: String| Section {
            heading: heading.to_owned(),
            caption: caption.to_owned(),
            legend,
            body,
        };
    Ok(html(
        "Learning on the board, over everything that may go wrong",
        "A simulated UR5 under PD control; the firmware's own code learns in one configuration, everything switched on.",
        &[
            Tile {
                value: format!("{met} of {}", report.outcomes.len()),
                label: "figures reach their bar".to_owned(),
            },
            Tile {
                value: report.seed.to_string(),
                label: "seed".to_owned(),
            },
        ],
        &[
            section(
                "Measured against the bars",
                "Every figure that has a bar.",
                Vec::new(),
                table(&["scenario", "figure", "measured", "bar", ""], &rows),
            ),
            section(
                "Torque error on a path that is never played",
                "NRMSE of the parameters in force, moving rows; pd3 and pd6 are loops of 3 and 6 Hz.",
                vec![
                    (Ink::Before, "frozen".to_owned()),
                    (Ink::After, "learning".to_owned()),
                ],
                grid(&panels, 3, 360, 240)?,
            ),
            section(
                "All figures",
                "The unit is the end of the name.",
                Vec::new(),
                table(&header, &figures),
            ),
            section(
                "How this was made",
                "The same command gives the same digits.",
                Vec::new(),
                command(&format!(
                    "cargo run --release -p host-sim -- experiment learning --seed {} --out DIR",
                    report.seed
                )),
            ),
        ],
    ))
}

/// Four significant digits.
pub(super) fn number(value: f64) -> String {
    if !value.is_finite() {
        return "never".to_owned();
    }
    if value == value.round() && value.abs() < 1e7 {
        return format!("{value:.0}");
    }
    let decimals = (3.0 - value.abs().log10().floor()).clamp(0.0, 6.0) as usize;
    format!("{value:.decimals$}")
}
