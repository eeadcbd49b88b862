//! The campaign as a page.

use super::ExcitationReport;
use foretorque_workbench::report::page::{Section, Tile, html, table};

pub(super) fn page(report: &ExcitationReport<'_>) -> String {
    let tile = |value: String, label: &str| Tile {
        value,
        label: label.to_owned(),
    };
    let rows: Vec<Vec<String>> = report
        .seeds
        .iter()
        .map(|seed| {
            vec![
                seed.seed.to_string(),
                format!("{:.4}", seed.predicted_nrmse_percent),
                format!("{:.2}", seed.condition_number_dh),
                format!("{:.2}", seed.condition_number_board),
                seed.recount.violations.to_string(),
                seed.recount.beyond_certificate.to_string(),
            ]
        })
        .collect();
    let config = report.config;
    html(
        "Excitation campaign",
        &format!(
            "Robot {}, seeds 1 to {}: one search each ({} starts, {} iterations), condition number at most {}.",
            config.robot, config.seeds, config.starts, config.iterations, config.condition_limit
        ),
        &[
            tile(
                format!("{:.3} %", report.worst_predicted_nrmse_percent),
                "largest predicted torque error (10 s, 1 % noise)",
            ),
            tile(
                format!("{:.1}", report.worst_condition_number_dh),
                "largest condition number (links, standard DH frames, raw SI)",
            ),
            tile(
                report.violations.to_string(),
                &format!("limits missed on {} points of each seed", config.points),
            ),
        ],
        &[Section {
            heading: "Seed by seed".to_owned(),
            caption: format!(
                "Violations: position, velocity, acceleration, torque, table and distance of links, recounted at {} instants \
                 of the period by code of its own. Beyond certificate: values above what the certificate says is the worst.",
                config.points
            ),
            legend: Vec::new(),
            body: table(
                &[
                    "seed",
                    "predicted error / %",
                    "condition number, DH",
                    "condition number, board",
                    "violations",
                    "beyond certificate",
                ],
                &rows,
            ),
        }],
    )
}
