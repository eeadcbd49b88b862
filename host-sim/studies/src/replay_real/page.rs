//! `report.html` of the replay.

use super::{PathScores, ReplayReport};
use foretorque_workbench::report::page::{Section, Tile, html, ratio};

pub(super) fn page(report: &ReplayReport) -> String {
    let rows = |pick: &dyn Fn(&PathScores) -> &Vec<Option<f64>>| -> Vec<Vec<String>> {
        let paths = report.paths.iter();
        paths
            .map(|path| {
                let mut row = vec![path.path.clone()];
                row.extend(pick(path).iter().copied().map(ratio));
                row
            })
            .collect()
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
        .map(|path| vec![path.path.clone(), ratio(path.within_1_1_after_s)])
        .collect();
    html(
        "A real UR5, learnt from its logs as if the board had been there",
        &format!(
            "Error over that of batch least squares ({}), joints that move faster than 0.05 rad/s, filtered torque.",
            report.reference
        ),
        &[
            Tile::ratio(
                report.aged_10_s_vs_rich_wls_ratio,
                "parameters 10 s old, geometric mean of joints and paths",
            ),
            Tile::ratio(report.newest_vs_rich_wls_ratio, "parameters as they are"),
            Tile::ratio(
                report.aged_10_s_after_other_paths_vs_rich_wls_ratio,
                "10 s old, all other paths learnt before",
            ),
            Tile::ratio(report.frozen_vs_rich_wls_ratio, "data sheet, frozen"),
            Tile::ratio(
                report.plain_wls_vs_rich_wls_ratio,
                "batch least squares, Coulomb and viscous friction only",
            ),
        ],
        &[
            Section::of_table(
                "Parameters 10 s old",
                "Error over the reference's.",
                &joints,
                &rows(&|path| &path.aged_ratio),
            ),
            Section::of_table(
                "Parameters as they were before each row",
                "Error over the reference's.",
                &joints,
                &rows(&|path| &path.newest_ratio),
            ),
            Section::of_table(
                "Data sheet, frozen",
                "Error over the reference's.",
                &joints,
                &rows(&|path| &path.frozen_ratio),
            ),
            Section::of_table(
                "Motion until the error over 2 s is within 1.1 of the reference",
                "A board fresh from the data sheet on every path, s.",
                &["path", "s"],
                &within,
            ),
            Section::of_table(
                "Decisions of the guard",
                "Over all logs, none of which has a disturbance.",
                &["reason", "count"],
                &decisions,
            ),
        ],
    )
}
