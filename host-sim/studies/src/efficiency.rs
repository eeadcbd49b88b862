//! Error of the robust fit over many noise draws, against the Cramér–Rao bound.

use crate::{Outcome, Progress, StudyError, unsupported};
use foretorque::arm::ur5::JOINTS;
use foretorque_workbench::dynamics::{Joints, ReferenceModel, State};
use foretorque_workbench::excitation::{SearchConfig, optimise};
use foretorque_workbench::identification::{
    ColumnSet, IdentifyConfig, MethodName, PrepareConfig, identify,
};
use foretorque_workbench::metrics::root_mean;
use foretorque_workbench::report::page::{Page, Section};
use foretorque_workbench::robot::Robot;
use foretorque_workbench::table::write_motion;
use foretorque_workbench::trajectory::Trajectory;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use serde::Serialize;
use std::path::Path;

const PERIOD_S: f64 = 1e-3;
/// White noise, share of the torque limit.
const NOISE: f64 = 0.01;
/// Share of the rows that are outliers, and their size in deviations of the noise.
const OUTLIERS: f64 = 0.05;
const OUTLIER_SIZE: f64 = 20.0;

/// One kind of noise.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CaseRecord {
    /// Name of the noise.
    pub noise: String,
    /// RMS over the draws of the error against the true torque of the unseen path, moving rows, joints as in
    /// `joints_nrmse_moving_ratio` of `identify`.
    pub irls_nrmse_moving_ratio: f64,
    /// NRMSE of weighted least squares over moving rows.
    pub wls_nrmse_moving_ratio: f64,
    /// RMS error of the robust fit over the bound.
    pub irls_over_cramer_rao_ratio: f64,
    /// RMS error of weighted least squares over the bound.
    pub wls_over_cramer_rao_ratio: f64,
    /// Robust fit, draw by draw.
    pub draws_nrmse_moving_ratio: Vec<f64>,
}

/// The study's figures.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct EfficiencyReport {
    /// Version of this program.
    pub version: String,
    /// Seed of arm, excitation and noise.
    pub seed: u64,
    /// Noise draws of each case.
    pub draws: usize,
    /// Cramér–Rao bound of the torque error on the unseen path, moving rows: what the noise of the raw rows must cause.
    pub cramer_rao_nrmse_moving_ratio: f64,
    /// Without and with outliers.
    pub cases: Vec<CaseRecord>,
}

/// Runs the study: the plant has exactly the model's columns, 10 s of the optimal excitation, 1 % noise. Logs are written
/// into `directory` and taken away again.
///
/// Errors: of the search, the files, the identification.
pub fn run(
    directory: &Path,
    seed: u64,
    draws: usize,
    progress: Progress<'_>,
) -> Result<Outcome<EfficiencyReport>, StudyError> {
    let robot = Robot::load("ur5")?;
    let mut truth = robot.perturbed(seed);
    for joint in &mut truth.joints {
        joint.friction.stribeck_ratio = 0.0;
        joint.friction.cogging = 0.0;
    }
    let search = SearchConfig {
        seed,
        ..SearchConfig::default()
    };
    let series = optimise(&robot, &search, None, |done, all| {
        progress("excitation", done, all);
    })?;
    let unseen = Trajectory::<JOINTS>::validation(&robot, seed);
    let [log, validate] = ["draw.csv.gz", "unseen.csv.gz"].map(|name| directory.join(name));
    let path = |t_s| unseen.at(t_s);
    write(&truth, &validate, unseen.duration_s(), &path, None)?;
    let excited = |t_s: f64| series.at::<JOINTS>(t_s);
    let figures = |prepare: PrepareConfig, methods: &[MethodName]| {
        let config = IdentifyConfig {
            truth: Some(truth.clone()),
            ..IdentifyConfig::new(methods.to_vec(), ColumnSet::plain(), prepare, seed)
        };
        let logs = (vec![log.clone()], vec![validate.clone()]);
        let outcome = identify(&robot, &logs.0, &logs.1, &config, &|_| ())?;
        let figures = methods.iter().map(|method| {
            let record = &outcome.report.methods[&method.to_string()].validation["unseen.csv.gz"];
            let error = record.truth_nrmse_moving_ratio;
            let bound = record.cramer_rao_nrmse_moving_ratio;
            (error.unwrap_or(f64::NAN), bound.unwrap_or(f64::NAN))
        });
        Ok::<Vec<(f64, f64)>, StudyError>(figures.collect())
    };
    let filtered = PrepareConfig {
        motion_hz: 40.0,
        torque_hz: Some(20.0),
        still_rad_s: 0.05,
    };
    let raw = PrepareConfig {
        torque_hz: None,
        ..filtered
    };
    let mut bound = 0.0;
    let mut cases = Vec::new();
    for (noise, outliers) in [
        ("white, 1 %", 0.0),
        ("and 5 % outliers of 20 deviations", OUTLIERS),
    ] {
        let (mut robust, mut plain) = (Vec::new(), Vec::new());
        for draw in 0..draws {
            progress(noise, draw, draws);
            let random = ChaCha8Rng::seed_from_u64(seed.wrapping_mul(1000) + draw as u64);
            let noise = Some((random, outliers));
            write(&truth, &log, series.period_s, &excited, noise)?;
            if bound == 0.0 {
                bound = figures(raw, &[MethodName::Wls])?[0].1;
            }
            let found = figures(filtered, &[MethodName::Irls, MethodName::Wls])?;
            robust.push(found[0].0);
            plain.push(found[1].0);
        }
        let rms = |values: &[f64]| root_mean(values.iter().map(|v| v * v));
        cases.push(CaseRecord {
            noise: noise.to_owned(),
            irls_nrmse_moving_ratio: rms(&robust),
            wls_nrmse_moving_ratio: rms(&plain),
            irls_over_cramer_rao_ratio: rms(&robust) / bound,
            wls_over_cramer_rao_ratio: rms(&plain) / bound,
            draws_nrmse_moving_ratio: robust,
        });
    }
    std::fs::remove_file(&log)?;
    std::fs::remove_file(&validate)?;
    let report = EfficiencyReport {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        seed,
        draws,
        cramer_rao_nrmse_moving_ratio: bound,
        cases,
    };
    Ok(outcome(report))
}

/// Writes a log of exact motion and true torque, with noise where a generator and a share of outliers are given.
fn write(
    truth: &Robot,
    path: &Path,
    duration_s: f64,
    motion: &dyn Fn(f64) -> State<JOINTS>,
    mut noise: Option<(ChaCha8Rng, f64)>,
) -> Result<(), StudyError> {
    let model = ReferenceModel::<JOINTS>::new(truth).ok_or_else(|| unsupported(JOINTS))?;
    let rows = (0..(duration_s / PERIOD_S).round() as usize).map(|row| {
        let t_s = row as f64 * PERIOD_S;
        let state = motion(t_s);
        let mut tau: Joints<JOINTS> = model.inverse_dynamics(&state);
        for ((joint, tau), qd) in truth.joints.iter().zip(&mut tau).zip(&state.qd) {
            *tau += joint.friction.sliding(*qd);
            if let Some((random, outliers)) = &mut noise {
                let sigma = NOISE * joint.limits.torque;
                *tau += sigma * random.sample::<f64, _>(StandardNormal);
                let strike: f64 = random.random_range(0.0..1.0);
                if strike < *outliers {
                    let way = if strike < 0.5 * *outliers { 1.0 } else { -1.0 };
                    *tau += way * OUTLIER_SIZE * sigma;
                }
            }
        }
        (t_s, state, [tau])
    });
    Ok(write_motion(path, ["tau"], rows)?)
}

fn outcome(report: EfficiencyReport) -> Outcome<EfficiencyReport> {
    let rows = report.cases.iter().map(|case| {
        [
            case.noise.clone(),
            format!("{:.3} %", 100.0 * case.irls_nrmse_moving_ratio),
            format!("{:.3}", case.irls_over_cramer_rao_ratio),
            format!("{:.3} %", 100.0 * case.wls_nrmse_moving_ratio),
            format!("{:.3}", case.wls_over_cramer_rao_ratio),
        ]
    });
    let lead = format!(
        "UR5, 10 s of optimal excitation, {} noise draws a case; torque error on an unseen path, moving rows.",
        report.draws
    );
    let section = Section::new(
        "Error over the bound",
        "RMS over the draws. A single draw may lie below the bound, their RMS does not.",
    );
    let page = Page::new("Identification against its Cramér–Rao bound", lead)
        .card(
            format!("{:.3} %", 100.0 * report.cramer_rao_nrmse_moving_ratio),
            "Cramér–Rao bound of the torque error",
        )
        .sections([section.table("noise | irls | over bound | wls | over bound", rows)]);
    let lines = report.cases.iter().map(|case| {
        format!(
            "{:<36} irls {:.3} x Cramér–Rao, wls {:.3} x\n",
            case.noise, case.irls_over_cramer_rao_ratio, case.wls_over_cramer_rao_ratio
        )
    });
    Outcome {
        text: lines.collect(),
        page,
        report,
        broken: None,
    }
}
