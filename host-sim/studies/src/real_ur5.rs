//! A real UR5: every path held out in turn, the recommended method against plain weighted least squares.

use crate::{Outcome, Progress, StudyError};
use foretorque_workbench::identification::{
    ColumnSet, IdentifyConfig, MethodName, PrepareConfig, identify,
};
use foretorque_workbench::report::page::{Page, Section, ratio};
use foretorque_workbench::robot::Robot;
use serde::Serialize;
use std::path::{Path, PathBuf};

const JOINTS: usize = 6;

/// Paths and the logs that show them: No6 and No7 are one path and are held out together.
pub(super) const PATHS: [(&str, &[&str]); 6] = [
    ("No1", &["Movement_No1.csv.gz"]),
    ("No2", &["Movement_No2.csv.gz"]),
    ("No3", &["Movement_No3_Acc.csv.gz"]),
    ("No5", &["Movement_No5_Acc_slow_no_disturbance.csv.gz"]),
    (
        "No6 and No7",
        &[
            "Movement_No6_Acc_slow_Verify_Model.csv.gz",
            "Movement_No7_Acc_slow_Verify_Model_short.csv.gz",
        ],
    ),
    ("TEST", &["TEST.csv.gz"]),
];

/// The columns of the recommended method beside Coulomb and viscous friction: the currents of this arm have offsets, and the
/// friction of harmonic drives grows with the torque they pass on.
const RECOMMENDED: &str = "coulomb-viscous+offset+load";

/// Filters: 0.16 of Nyquist on torque and regressor, as published for these logs; a joint moves above 0.02 rad/s.
const PREPARE: PrepareConfig = PrepareConfig {
    motion_hz: 20.0,
    torque_hz: Some(10.0),
    still_rad_s: 0.02,
};

/// One path.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PathRecord {
    /// Its name.
    pub path: String,
    /// Its logs.
    pub files: Vec<String>,
    /// RMS error of plain weighted least squares, moving rows, N·m; `null` where a joint never moves.
    pub wls_rmse_moving_nm: Vec<Option<f64>>,
    /// RMS error of the recommended method, moving rows, N·m.
    pub recommended_rmse_moving_nm: Vec<Option<f64>>,
    /// Their quotient.
    pub vs_wls_ratio: Vec<Option<f64>>,
    /// Geometric mean of the quotients over the joints that move.
    pub geometric_mean_vs_wls: f64,
}

/// The study's figures.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RealReport {
    /// Version of this program.
    pub version: String,
    /// The recommended method and its columns.
    pub recommended: String,
    /// Method and columns of the reference.
    pub reference: String,
    /// Cut-off on torque and regressor, Hz.
    pub torque_cutoff_hz: f64,
    /// Cut-off on the motion, Hz.
    pub motion_cutoff_hz: f64,
    /// A joint slower than this stands still, rad/s.
    pub still_rad_s: f64,
    /// Geometric mean over joints and paths of recommended over reference, moving rows, filtered torque.
    pub geometric_mean_vs_wls: f64,
    /// The largest of the paths' means.
    pub worst_path_vs_wls: f64,
    /// Path by path.
    pub paths: Vec<PathRecord>,
}

/// Runs the study on the logs in `directory`. Returns the figures and the page.
///
/// Errors: a log is missing or damaged; an identification fails.
pub fn run(
    directory: &Path,
    seed: u64,
    progress: Progress<'_>,
) -> Result<Outcome<RealReport>, StudyError> {
    let robot = Robot::load("ur5")?;
    let mut paths = Vec::new();
    check_directory(directory)?;
    for (number, (path, files)) in PATHS.iter().enumerate() {
        progress("path held out", number, PATHS.len());
        let place = |file: &&str| directory.join(file);
        let held_out: Vec<PathBuf> = files.iter().map(place).collect();
        let others = PATHS.iter().filter(|(other, _)| other != path);
        let training = others.flat_map(|(_, files)| files.iter().map(place));
        let training: Vec<PathBuf> = training.collect();
        let rmse = |method: MethodName, columns: ColumnSet| {
            let config = IdentifyConfig::new(vec![method], columns, PREPARE, seed);
            let outcome = identify(&robot, &training, &held_out, &config, &|_| ())?;
            let method = &outcome.report.methods[&method.to_string()];
            let (mut squares, mut counts) = ([0.0; JOINTS], [0.0; JOINTS]);
            for record in method.validation.values() {
                for joint in 0..JOINTS {
                    let count = record.rows_moving[joint] as f64;
                    squares[joint] += count * record.rmse_moving_nm[joint].unwrap_or(0.0).powi(2);
                    counts[joint] += count;
                }
            }
            let rmse = |(square, count): (f64, f64)| (count > 0.0).then(|| (square / count).sqrt());
            Ok::<Vec<Option<f64>>, StudyError>(squares.into_iter().zip(counts).map(rmse).collect())
        };
        let wls = rmse(MethodName::Wls, ColumnSet::plain())?;
        let recommended = rmse(MethodName::Consistent, RECOMMENDED.parse()?)?;
        let ratio = wls.iter().zip(&recommended);
        let ratio = ratio.map(|(wls, own)| Some((*own)? / (*wls)?));
        let ratio: Vec<Option<f64>> = ratio.collect();
        paths.push(PathRecord {
            path: (*path).to_owned(),
            files: files.iter().map(|file| (*file).to_owned()).collect(),
            wls_rmse_moving_nm: wls,
            recommended_rmse_moving_nm: recommended,
            geometric_mean_vs_wls: geometric_mean(ratio.iter().flatten()),
            vs_wls_ratio: ratio,
        });
    }
    let all = paths.iter().flat_map(|path| &path.vs_wls_ratio).flatten();
    let means = paths.iter().map(|path| path.geometric_mean_vs_wls);
    let report = RealReport {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        recommended: format!("consistent, {RECOMMENDED}"),
        reference: "wls, coulomb-viscous".to_owned(),
        torque_cutoff_hz: PREPARE.torque_hz.unwrap_or(0.0),
        motion_cutoff_hz: PREPARE.motion_hz,
        still_rad_s: PREPARE.still_rad_s,
        geometric_mean_vs_wls: geometric_mean(all),
        worst_path_vs_wls: means.fold(0.0, f64::max),
        paths,
    };
    Ok(outcome(report))
}

/// Check that the directory of the logs is there.
///
/// Errors: one line that names the option.
pub(super) fn check_directory(directory: &Path) -> Result<(), StudyError> {
    if directory.is_dir() {
        return Ok(());
    }
    let name = directory.display();
    let text = format!("no directory {name} here: name that of the logs by --logs DIR");
    Err(StudyError::from(text))
}

/// Geometric mean; 1 of no values.
pub(super) fn geometric_mean<'a>(values: impl IntoIterator<Item = &'a f64>) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for value in values {
        sum += value.ln();
        count += 1.0;
    }
    f64::exp(sum / f64::max(count, 1.0))
}

/// Rows of a table with one row a path and one column a joint.
pub(super) fn joint_rows<P>(
    paths: &[P],
    name: fn(&P) -> &str,
    pick: fn(&P) -> &[Option<f64>],
) -> Vec<Vec<String>> {
    let row = |path| {
        let cells = pick(path).iter().copied().map(ratio);
        let name = std::iter::once(name(path).to_owned());
        name.chain(cells).collect()
    };
    paths.iter().map(row).collect()
}

fn outcome(report: RealReport) -> Outcome<RealReport> {
    let rows = |pick| joint_rows(&report.paths, |path| &path.path, pick);
    let mut ratios = rows(|path: &PathRecord| &path.vs_wls_ratio);
    for (row, path) in ratios.iter_mut().zip(&report.paths) {
        row.push(ratio(Some(path.geometric_mean_vs_wls)));
    }
    let joints = "path held out | J1 | J2 | J3 | J4 | J5 | J6";
    let (recommended, reference) = (&report.recommended, &report.reference);
    let (mean, worst) = (report.geometric_mean_vs_wls, report.worst_path_vs_wls);
    let rmse = |method: &str, pick| {
        let heading = format!("RMS error of {method} / N·m");
        Section::new(heading, "On the path that was not trained on.").table(joints, rows(pick))
    };
    let against = format!("{recommended} against {reference}.");
    let page = Page::new(
        "A real UR5, every path held out in turn",
        "Torque is drive gain × motor current, filtered; rows in which the joint moves.",
    )
    .card(
        ratio(Some(mean)),
        "error over that of plain weighted least squares, geometric mean",
    )
    .card(ratio(Some(worst)), "worst path")
    .sections([
        Section::new("Error over that of plain weighted least squares", against)
            .table(format!("{joints} | all"), ratios),
        rmse(recommended, |path| &path.recommended_rmse_moving_nm),
        rmse(reference, |path| &path.wls_rmse_moving_nm),
    ]);
    let lines = report.paths.iter();
    let lines = lines.map(|own| format!("{:<12} {:.3}\n", own.path, own.geometric_mean_vs_wls));
    let text = lines.collect::<String>()
        + &format!("{recommended} over {reference}: {mean:.3}, worst path {worst:.3}\n");
    Outcome {
        report,
        page,
        text,
        broken: None,
    }
}
