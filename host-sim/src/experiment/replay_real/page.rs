//! `report.html` of the replay.

use super::{PathScores, ReplayReport};
use crate::report::page::{Section, Tile, html, table};

pub(super) fn page(report: &ReplayReport) -> String {
    let figure =
        |value: &Option<f64>| value.map_or("–".to_owned(), |value| format!("{value:.3}"));
    let rows = |pick: &dyn Fn(&PathScores) -> &Vec<Option<f64>>| -> Vec<Vec<String>> {
        let paths = report.paths.iter();
        paths
            .map(|path| {
                let mut row = vec![path.path.clone()];
                row.extend(pick(path).iter().map(figure));
                row
            })
            .collect()
    };
    let section = |heading: &str, caption: &str, header: &[&str], rows: &[Vec<String>]| Section {
        heading: heading.to_owned(),
        caption: caption.to_owned(),
        legend: Vec::new(),
        body: table(header, rows),
    };
    let tile = |value: f64, label: &str| Tile {
        value: format!("{value:.3}"),
        label: label.to_owned(),
    };
    let joints = ["path", "J1", "J2", "J3", "J4", "J5", "J6"];
    let decisions: Vec<Vec<String>> = report
        .decisions_count
        .iter()
        .map(|(reason, count)| vec![reason.clone(), count.to_string()])
        .collect();
    let within: Vec<Vec<String>> = report
        .paths
        .iter()
        .map(|path| vec![path.path.clone(), figure(&path.within_1_1_after_s)])
        .collect();
    html(
        "A real UR5, learnt from its logs as if the board had been there",
        &format!(
            "Error over that of batch least squares ({}), joints that move faster than 0.05 rad/s, filtered torque.",
            report.reference
        ),
        &[
            tile(
                report.aged_10_s_vs_rich_wls_ratio,
                "parameters 10 s old, geometric mean of joints and paths",
            ),
            tile(report.newest_vs_rich_wls_ratio, "parameters as they are"),
            tile(
                report.aged_10_s_after_other_paths_vs_rich_wls_ratio,
                "10 s old, all other paths learnt before",
            ),
            tile(report.frozen_vs_rich_wls_ratio, "data sheet, frozen"),
            tile(
                report.plain_wls_vs_rich_wls_ratio,
                "batch least squares, Coulomb and viscous friction only",
            ),
        ],
        &[
            section(
                "Parameters 10 s old",
                "Error over the reference's.",
                &joints,
                &rows(&|path| &path.aged_ratio),
            ),
            section(
                "Parameters as they were before each row",
                "Error over the reference's.",
                &joints,
                &rows(&|path| &path.newest_ratio),
            ),
            section(
                "Data sheet, frozen",
                "Error over the reference's.",
                &joints,
                &rows(&|path| &path.frozen_ratio),
            ),
            section(
                "Motion until the error over 2 s is within 1.1 of the reference",
                "A board fresh from the data sheet on every path, s.",
                &["path", "s"],
                &within,
            ),
            section(
                "Decisions of the guard",
                "Over all logs, none of which has a disturbance.",
                &["reason", "count"],
                &decisions,
            ),
        ],
    )
}
