//! `report.html` and text of the replay.

use super::record::{PathScores, ReplayReport};
use crate::Outcome;
use crate::real_ur5::joint_rows;
use foretorque_workbench::report::page::{Page, Section, ratio};

pub(super) fn outcome(report: ReplayReport) -> Outcome<ReplayReport> {
    let cards = [
        (
            Some(report.aged_10_s_vs_rich_wls_ratio),
            "parameters 10 s old, geometric mean of joints and paths",
        ),
        (Some(report.newest_vs_rich_wls_ratio), "newest parameters"),
        (
            report.aged_10_s_after_other_paths_vs_rich_wls_ratio,
            "10 s old, all other paths learnt before",
        ),
        (Some(report.frozen_vs_rich_wls_ratio), "start, frozen"),
        (
            Some(report.plain_wls_vs_rich_wls_ratio),
            "batch least squares, Coulomb and viscous friction only",
        ),
    ];
    let lead = format!(
        "Error over that of batch least squares ({}), joints that move faster than 0.05 rad/s, filtered torque.",
        report.reference
    );
    let page = Page::new(
        format!("{}, learnt row by row from its logs", report.robot),
        lead,
    );
    let page = cards.iter().fold(page, |page, (value, label)| {
        page.card(ratio(*value), *label)
    });
    let joints = report
        .paths
        .first()
        .map_or(0, |path| path.newest_ratio.len());
    let header: String = (1..=joints).map(|joint| format!(" | J{joint}")).collect();
    let header = format!("path{header}");
    let of_joints = |heading: &str, pick: fn(&PathScores) -> &[Option<f64>]| {
        Section::new(heading, "Error over the reference's.").table(
            header.clone(),
            joint_rows(&report.paths, |path| &path.path, pick),
        )
    };
    let within = report.paths.iter();
    let within = within.map(|path| {
        let window = ratio(path.worst_window_over_start_ratio);
        [path.path.clone(), ratio(path.within_1_1_after_s), window]
    });
    let decisions = report.decisions_count.iter();
    let decisions = decisions.map(|(reason, count)| [reason.clone(), count.to_string()]);
    let page = page.sections([
        of_joints("Parameters 10 s old", |path| &path.aged_ratio),
        of_joints("Parameters before each row", |path| &path.newest_ratio),
        of_joints("Start, frozen", |path| &path.frozen_ratio),
        Section::new(
            "Motion until the error over 2 s is within 1.1 of the reference; worst 3 s against the start",
            "A board fresh from the start on every path, s.",
        )
        .table("path | s | worst 3 s over the start", within),
        Section::new(
            "Decisions of the supervisor",
            "Over all logs.",
        )
        .table("reason | count", decisions),
        Section::new("Treatment of the logs", format!("Rows {:.3} ms apart.", 1e3 * report.period_s))
            .table("note", report.notes.iter().map(|note| [note.clone()])),
    ]);
    let lines = cards
        .iter()
        .map(|(value, label)| format!("{label:<56} {} × {}\n", ratio(*value), report.reference));
    let worst = ratio(report.worst_window_over_start_ratio);
    let worst = format!(
        "{:<56} {worst} × {}\n",
        "worst 3 s of the newest parameters", report.start
    );
    let decisions = format!("decisions of the supervisor {:?}\n", report.decisions_count);
    Outcome {
        text: lines.chain([worst, decisions]).collect(),
        page,
        report,
    }
}
