//! Figures of the replay: `report.json`, `report.html` and text.

use crate::Outcome;
use crate::real_ur5::joint_rows;
use foretorque_workbench::report::page::{Page, Section, ratio};
use serde::Serialize;

/// A joint slower than this stands still, rad/s.
pub(super) const GATE_RAD_S: f64 = 0.05;

/// Error of one path over that of a reference.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PathScores {
    /// Its name.
    pub path: String,
    /// RMS error of every joint while it moves, N·m, of rich batch least squares on the other paths; `null` where it
    /// never moves.
    pub batch_rmse_moving_nm: Vec<Option<f64>>,
    /// Over it: the error of the parameters as they were before each row.
    pub newest_ratio: Vec<Option<f64>>,
    /// Over it: the error of parameters 10 s old.
    pub aged_ratio: Vec<Option<f64>>,
    /// Over it: the error of what the board started from, frozen.
    pub frozen_ratio: Vec<Option<f64>>,
    /// Motion until the newest parameters are within 1.1 of it over 2 s, from the start on this path, s;
    /// `null` if never.
    pub within_1_1_after_s: Option<f64>,
    /// Largest error of the newest parameters over that of the start in any 3 s, all joints as shares of their torque
    /// limits.
    pub worst_window_over_start_ratio: Option<f64>,
    /// Where that was.
    pub worst_window: Option<WorstWindow>,
}

/// Window in which the newest parameters are worst against the start.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct WorstWindow {
    /// Error of the newest parameters over that of the start, all joints as shares of their torque limits.
    pub ratio: f64,
    /// Begin of the window in the log's own time, s.
    pub from_s: f64,
    /// Joint with the largest excess of its square, from 1.
    pub joint: usize,
}

/// Decision of the supervisor.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ReplayDecision {
    /// Time from the first row of all logs, s.
    pub t_s: f64,
    /// Its reason.
    pub reason: String,
    /// Joint that caused it, from 1; none if it concerns the arm.
    pub joint: Option<u8>,
    /// Figure that the reason names; 0 if it names none.
    pub figure: f32,
}

/// `report.json`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ReplayReport {
    /// Version of this program.
    pub version: String,
    /// Robot.
    pub robot: String,
    /// Start of the board.
    pub start: String,
    /// Remarks on the logs.
    pub notes: Vec<String>,
    /// Period of the rows of every log, s.
    pub period_s: f64,
    /// The reference: batch least squares, or the description without friction where the logs show too little for it.
    pub reference: String,
    /// Error of the newest parameters over the reference's: geometric mean over joints and paths, moving rows; none if no
    /// joint moves.
    pub newest_vs_rich_wls_ratio: Option<f64>,
    /// Ratio of parameters 10 s old. The first 10 s of the first log have none and are left out; none if it is shorter.
    pub aged_10_s_vs_rich_wls_ratio: Option<f64>,
    /// Ratio of 10-s-old parameters for boards that have learnt all other paths before each path, as the reference has; none
    /// with a single path.
    pub aged_10_s_after_other_paths_vs_rich_wls_ratio: Option<f64>,
    /// Ratio of the start, frozen.
    pub frozen_vs_rich_wls_ratio: Option<f64>,
    /// Plain batch least squares over the reference; none if that is the description.
    pub plain_wls_vs_rich_wls_ratio: Option<f64>,
    /// The aged parameters over plain batch least squares; none likewise.
    pub aged_10_s_vs_plain_wls_ratio: Option<f64>,
    /// Largest error of the newest parameters over that of the start in any 3 s of any path.
    pub worst_window_over_start_ratio: Option<f64>,
    /// The longest of the paths' times to 1.1, s.
    pub within_1_1_worst_s: Option<f64>,
    /// Decisions of the supervisor, in order.
    pub decisions: Vec<ReplayDecision>,
    /// Ticks in which what was learnt was cut.
    pub learned_clipped_ticks_count: u32,
    /// Largest feed-forward torque asked with 30 rad/s² on one joint after another, over the torque limit.
    pub torque_at_30_rad_s2_over_limit_ratio: f64,
    /// Ticks.
    pub ticks_count: u32,
    /// Rows learnt from.
    pub rows_accepted_count: u32,
    /// Rows on which the estimate paused: under a payload, or while there was evidence for one.
    pub rows_paused_count: u32,
    /// Path by path.
    pub paths: Vec<PathScores>,
}

/// Torques of the parameters as they were before each row, of older ones, and of the data sheet, through the filter of
/// the figures.
#[derive(Default)]
pub(super) struct Predictions {
    pub(super) newest: Vec<f64>,
    pub(super) aged: Vec<f64>,
    pub(super) frozen: Vec<f64>,
}

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
        (report.frozen_vs_rich_wls_ratio, "start, frozen"),
        (
            report.plain_wls_vs_rich_wls_ratio,
            "batch least squares, Coulomb and viscous friction only",
        ),
    ];
    let lead = format!(
        "Error over that of the reference ({}), joints that move faster than 0.05 rad/s, filtered torque.",
        report.reference
    );
    let title = format!("{}, learnt row by row from its logs", report.robot);
    let mut page = Page::new(title, lead);
    for (value, label) in cards {
        page = page.card(ratio(value), label);
    }
    let first = report.paths.first();
    let joints = first.map_or(0, |path| path.newest_ratio.len());
    let header: String = (1..=joints).map(|joint| format!(" | J{joint}")).collect();
    let header = format!("path{header}");
    let of_joints = |heading: &str, pick: fn(&PathScores) -> &[Option<f64>]| {
        let rows = joint_rows(&report.paths, |path| &path.path, pick);
        Section::new(heading, "Error over the reference's.").table(header.clone(), rows)
    };
    let within = report.paths.iter().map(|path| {
        let window = ratio(path.worst_window_over_start_ratio);
        let place = path
            .worst_window
            .map_or([String::new(), String::new()], |worst| {
                [format!("{:.2}", worst.from_s), format!("J{}", worst.joint)]
            });
        let [from, joint] = place;
        let after = ratio(path.within_1_1_after_s);
        [path.path.clone(), after, window, from, joint]
    });
    let decisions = report.decisions.iter().map(|own| {
        let joint = own.joint.map_or("–".to_owned(), |j| format!("J{j}"));
        let (t_s, figure) = (format!("{:.2}", own.t_s), format!("{:.3}", own.figure));
        [t_s, own.reason.clone(), joint, figure]
    });
    let page = page.sections([
        of_joints("Parameters 10 s old", |path| &path.aged_ratio),
        of_joints("Parameters before each row", |path| &path.newest_ratio),
        of_joints("Start, frozen", |path| &path.frozen_ratio),
        Section::new(
            "Motion until the error over 2 s is within 1.1 of the reference; worst 3 s against the start",
            "A board fresh from the start on every path, s.",
        )
        .table("path | s | worst 3 s over the start | from / s | most in", within),
        Section::new("Decisions of the supervisor", "Time over all logs.")
            .table("time / s | reason | joint | figure", decisions),
        Section::new("Treatment of the logs", format!("Rows {:.3} ms apart.", 1e3 * report.period_s))
            .table("note", report.notes.iter().map(|note| [note.clone()])),
    ]);
    // One path has no others.
    let lines = cards
        .iter()
        .filter(|(value, _)| value.is_some())
        .map(|(value, label)| format!("{label:<56} {} × {}\n", ratio(*value), report.reference));
    let worst = ratio(report.worst_window_over_start_ratio);
    let (label, start) = ("worst 3 s of the newest parameters", &report.start);
    let found = report
        .paths
        .iter()
        .filter_map(|path| Some((path, path.worst_window?)));
    let found = found.max_by(|a, b| a.1.ratio.total_cmp(&b.1.ratio));
    let place = found.map_or(String::new(), |(path, worst)| {
        let WorstWindow { from_s, joint, .. } = worst;
        format!(
            ", from {from_s:.1} s of {}, most in joint {joint}",
            path.path
        )
    });
    let worst = format!("{label:<56} {worst} × {start}{place}\n");
    let decisions = format!("decisions  {}\n", decision_line(&report.decisions));
    let few = too_few_rows(
        report.rows_accepted_count,
        report.rows_paused_count,
        report.ticks_count,
    );
    let lines = few.into_iter().chain(lines);
    Outcome {
        text: lines.chain([worst, decisions]).collect(),
        page,
        report,
        broken: None,
    }
}

/// First line where the board could learn fewer than one tick in twenty.
fn too_few_rows(accepted: u32, paused: u32, ticks: u32) -> Option<String> {
    ((u64::from(accepted) + u64::from(paused)) * 20 < u64::from(ticks)).then(|| {
        format!(
            "the board learnt {accepted} of {ticks} ticks: rows repeat values, or the joints stand still\n"
        )
    })
}

/// Every reason once, in the order of its first time.
fn decision_line(decisions: &[ReplayDecision]) -> String {
    let first = |k: usize| {
        let mut before = decisions[..k].iter();
        before.all(|earlier| earlier.reason != decisions[k].reason)
    };
    let entry = |k: usize| {
        let (t_s, reason) = (decisions[k].t_s, &decisions[k].reason);
        let times = decisions.iter().filter(|d| d.reason == *reason).count();
        let joint = decisions[k].joint;
        let joint = joint.map_or(String::new(), |j| format!(" J{j}"));
        match times {
            1 => format!("{reason}{joint} at {t_s:.1} s"),
            _ => format!("{times} x {reason}, first{joint} at {t_s:.1} s"),
        }
    };
    let entries = (0..decisions.len()).filter(|&k| first(k)).map(entry);
    match decisions {
        [] => "none".to_owned(),
        _ => entries.collect::<Vec<_>>().join("; "),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_log_that_teaches_nothing_is_named() {
        assert_eq!(too_few_rows(600, 0, 12_000), None);
        assert_eq!(too_few_rows(84, 516, 12_000), None);
        let line = too_few_rows(84, 2, 11_973).expect("too few");
        assert!(
            line.starts_with("the board learnt 84 of 11973 ticks"),
            "{line}"
        );
    }
}
