//! `report.html` and text of the replay.

use super::record::{PathScores, ReplayReport};
use crate::Outcome;
use crate::real_ur5::joint_rows;
use foretorque_workbench::report::page::{Page, Section, ratio};

pub(super) fn outcome(report: ReplayReport) -> Outcome<ReplayReport> {
    let cards = [
        (
            report.aged_10_s_vs_rich_wls_ratio,
            "parameters 10 s old, geometric mean of joints and paths",
        ),
        (report.newest_vs_rich_wls_ratio, "newest parameters"),
        (
            report.aged_10_s_after_other_paths_vs_rich_wls_ratio,
            "10 s old, all other paths learnt before",
        ),
        (report.frozen_vs_rich_wls_ratio, "data sheet, frozen"),
        (
            report.plain_wls_vs_rich_wls_ratio,
            "batch least squares, Coulomb and viscous friction only",
        ),
    ];
    let lead = format!(
        "Error over that of batch least squares ({}), joints that move faster than 0.05 rad/s, filtered torque.",
        report.reference
    );
    let page = Page::new("A real UR5, learnt row by row from its logs", lead);
    let page = cards.iter().fold(page, |page, (value, label)| {
        page.card(ratio(Some(*value)), *label)
    });
    let of_joints = |heading: &str, pick: fn(&PathScores) -> &[Option<f64>]| {
        Section::new(heading, "Error over the reference's.").table(
            "path | J1 | J2 | J3 | J4 | J5 | J6",
            joint_rows(&report.paths, |path| &path.path, pick),
        )
    };
    let within = report.paths.iter();
    let within = within.map(|path| [path.path.clone(), ratio(path.within_1_1_after_s)]);
    let decisions = report.decisions_count.iter();
    let decisions = decisions.map(|(reason, count)| [reason.clone(), count.to_string()]);
    let page = page.sections([
        of_joints("Parameters 10 s old", |path| &path.aged_ratio),
        of_joints("Parameters before each row", |path| &path.newest_ratio),
        of_joints("Data sheet, frozen", |path| &path.frozen_ratio),
        Section::new(
            "Motion until the error over 2 s is within 1.1 of the reference",
            "A board fresh from the data sheet on every path, s.",
        )
        .table("path | s", within),
        Section::new(
            "Decisions of the supervisor",
            "Over all logs, none of which has a disturbance.",
        )
        .table("reason | count", decisions),
    ]);
    let lines = cards
        .iter()
        .map(|(value, label)| format!("{label:<56} {value:.3} × {}\n", report.reference));
    let decisions = format!("decisions of the supervisor {:?}\n", report.decisions_count);
    Outcome {
        text: lines.chain([decisions]).collect(),
        page,
        report,
    }
}
