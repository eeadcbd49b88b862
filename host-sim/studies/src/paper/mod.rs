//! The paper's experiment (Zhong, section 4.1) on the UR5, and the robustness it asserts, measured.
//!
//! `steps` (1) excitation and joint sequence through inverse kinematics, (2) torques of known parameters, (3) the BP network
//! on 80 % of them, (4) an arbitrary path. `cell` one draw of the robustness study: every method on the same rows.
//! `page` shows their sums, `findings` states them.

mod cell;
mod findings;
mod page;
mod steps;

use crate::{Outcome, Progress, Records, StudyError, unsupported};
use cell::{Bench, ROWS};
pub use cell::{Cell, CellRecord, FRICTIONS, FrictionKind, MethodDraw};
use foretorque::arm::ur5::JOINTS;
use foretorque_workbench::dynamics::{Joints, State};
use foretorque_workbench::excitation::Excitation;
use foretorque_workbench::files::write_whole;
use foretorque_workbench::metrics::root_mean;
use foretorque_workbench::parallel::cores;
use foretorque_workbench::report::write_json;
use foretorque_workbench::robot::Robot;
use foretorque_workbench::table::write_motion;
use serde::Serialize;
use std::collections::BTreeMap;
use std::io;
use std::path::Path;
use steps::Sample;
pub use steps::{JointTorque, ParameterRow, Steps, Trained};

/// Runs the study; its tables, pictures and times go to `out`. `None` if the records are only written.
///
/// Errors: an excitation for another robot, or one that shows too little; the records'; files that cannot be written.
pub fn run(
    config: PaperConfig,
    records: &Records,
    out: &Path,
    progress: Progress<'_>,
) -> Result<Option<Outcome<PaperReport>>, StudyError> {
    let robot = Robot::load("ur5")?;
    config.excitation.check(&robot)?;
    let bench = Bench::new(robot, &config.excitation, ROWS).ok_or_else(|| unsupported(JOINTS))?;
    let made_of = PaperConfig {
        seed: 0,
        seeds: 0,
        ..config.clone()
    };
    let records = records.of(
        &made_of,
        (&config.cells(), |record: &CellRecord| record.cell),
        cores(),
        |cell| bench.draw(cell),
        progress,
    )?;
    let Some(records) = records else {
        return Ok(None);
    };
    let (steps, curves) = steps::run(&bench.robot, &config.excitation, config.seed)?;
    let conditions = summarise(&records);
    let report = PaperReport {
        version: env!("CARGO_PKG_VERSION"),
        findings: findings::findings(&steps, &conditions),
        steps,
        conditions,
        config,
    };
    let times = times(&records);
    curves.write(out)?;
    for (name, picture) in page::pictures(&report, &curves)? {
        write_whole(&out.join(name), picture.as_bytes())?;
    }
    write_json(&out.join("timing.json"), &times)?;
    Ok(Some(Outcome {
        page: page::page(&report, &curves, &times),
        text: page::text(&report),
        report,
        broken: None,
    }))
}

/// An excitation of `host-sim excite --robot ur5`, kept so that the study repeats; the file names its settings.
const PRECOMPUTED: &str = include_str!("../../../paths/ur5-excitation.json");

/// Settings of the study.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PaperConfig {
    /// Seed of the steps; the study uses this and the following ones.
    pub seed: u64,
    /// Draws of each condition: arm, noise, outliers, split and unseen path.
    pub seeds: u64,
    /// Standard deviation of the torque noise, % of the torque limit.
    pub noise_percent: Vec<f64>,
    /// Share of the samples of each joint that are outliers, %.
    pub outlier_percent: Vec<f64>,
    /// Friction of the arm.
    pub friction: Vec<FrictionKind>,
    /// Numbers of training rows for the efficiency study (1 % noise, Coulomb and viscous friction, no outliers).
    pub rows: Vec<usize>,
    /// The excitation.
    pub excitation: Excitation,
}

impl PaperConfig {
    /// The whole study; if `quick`, few levels and draws.
    ///
    /// Errors: none in an undamaged program.
    pub fn new(quick: bool, seed: u64, seeds: u64) -> Result<Self, StudyError> {
        let whole = Self {
            seed,
            seeds,
            noise_percent: vec![0.0, 0.5, 1.0, 2.0, 5.0],
            outlier_percent: vec![0.0, 1.0],
            friction: FRICTIONS.to_vec(),
            rows: vec![50, 100, 200, 500, 1000],
            excitation: serde_json::from_str(PRECOMPUTED)?,
        };
        Ok(match quick {
            true => Self {
                seeds: seeds.min(2),
                noise_percent: vec![1.0],
                friction: vec![FrictionKind::CoulombViscous],
                rows: vec![100],
                ..whole
            },
            false => whole,
        })
    }

    /// All cells in the order of the jobs: conditions, then numbers of rows, each with all seeds.
    fn cells(&self) -> Vec<Cell> {
        let mut cells = Vec::new();
        let mut add = |noise_percent, friction, outlier_percent, rows| {
            let seeds = self.seed..self.seed + self.seeds;
            cells.extend(seeds.map(|seed| Cell {
                noise_percent,
                friction,
                outlier_percent,
                rows,
                seed,
            }));
        };
        for &outlier_percent in &self.outlier_percent {
            for &friction in &self.friction {
                for &noise_percent in &self.noise_percent {
                    add(noise_percent, friction, outlier_percent, ROWS * 4 / 5);
                }
            }
        }
        for &rows in &self.rows {
            add(1.0, FrictionKind::CoulombViscous, 0.0, rows);
        }
        cells
    }
}

/// `report.json`: all figures but the times, which no run repeats.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PaperReport {
    /// Version of this program.
    pub version: &'static str,
    /// Settings.
    pub config: PaperConfig,
    /// The figures as sentences.
    pub findings: Vec<String>,
    /// Steps (1) to (4) of the paper.
    pub steps: Steps,
    /// Conditions of the robustness study, then numbers of rows, each with all methods.
    pub conditions: Vec<Condition>,
}

/// One condition with all its draws.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Condition {
    /// Standard deviation of the torque noise, % of the torque limit.
    pub noise_percent: f64,
    /// Friction of the arm.
    pub friction: FrictionKind,
    /// Share of the samples of each joint that are outliers, %.
    pub outlier_percent: f64,
    /// Training rows.
    pub rows: usize,
    /// Draws.
    pub draws: usize,
    /// Methods by name, over the draws in which they found a model.
    pub methods: BTreeMap<String, MethodSummary>,
    /// Methods that found none, and in how many draws.
    pub failed: BTreeMap<String, usize>,
}

impl Condition {
    /// The condition of the efficiency study: 1 % noise, Coulomb and viscous friction, no outliers.
    fn is_plain(&self) -> bool {
        self.noise_percent == 1.0
            && self.outlier_percent == 0.0
            && self.friction == FrictionKind::CoulombViscous
    }
}

/// The conditions with the most rows: those of the robustness study.
fn on_all_rows(conditions: &[Condition]) -> Vec<&Condition> {
    let full = conditions.iter().map(|c| c.rows).max().unwrap_or(0);
    conditions.iter().filter(|c| c.rows == full).collect()
}

/// The conditions of the efficiency study by their number of rows.
fn by_rows(conditions: &[Condition]) -> Vec<&Condition> {
    let mut plain: Vec<&Condition> = conditions.iter().filter(|c| c.is_plain()).collect();
    plain.sort_by_key(|c| c.rows);
    plain
}

/// One method in one condition.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MethodSummary {
    /// Torque error on unseen paths, root mean square over the draws, a ratio.
    pub path_nrmse_ratio: f64,
    /// The smallest of the draws.
    pub path_nrmse_least_ratio: f64,
    /// The largest of the draws.
    pub path_nrmse_most_ratio: f64,
    /// Error on the held-out 20 % of the excitation, root mean square over the draws, a ratio.
    pub split_nrmse_ratio: f64,
    /// Mean number of epochs or iterations.
    pub epochs: f64,
}

/// Seconds of training of every method: least of the draws, by number of training rows. No run repeats them.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Times {
    /// Meaning of the rows.
    pub note: &'static str,
    /// Method, then rows and seconds.
    pub least_seconds: BTreeMap<String, Vec<(usize, f64)>>,
}

/// Curves that are drawn and written as tables.
#[derive(Clone, Debug)]
struct Curves {
    /// Epoch, loss on training and on held-out rows, for plain and accelerated descent.
    losses: [Vec<(usize, f64, f64)>; 2],
    /// Epoch and loss of the black box.
    black_box: Vec<(usize, f64)>,
    data: Vec<Sample>,
    /// Time, motion, true torque, that of the network with physical weights, that of the black box.
    path: Vec<(f64, State<JOINTS>, [Joints<JOINTS>; 3])>,
}

impl Curves {
    /// Writes the training data (steps 1 and 2) and the arbitrary path (step 4) as tables.
    fn write(&self, out: &Path) -> io::Result<()> {
        let data = self.data.iter();
        let data = data.map(|(t_s, state, tau)| (*t_s, *state, [*tau]));
        write_motion(&out.join("training.csv"), ["tau"], data)?;
        let torques = ["tau", "bp_physical", "bp_black_box"];
        let path = self.path.iter().copied();
        write_motion(&out.join("validation.csv"), torques, path)
    }
}

/// The conditions in the order of the jobs.
fn summarise(records: &[CellRecord]) -> Vec<Condition> {
    let kind = |record: &CellRecord| Cell {
        seed: 0,
        ..record.cell
    };
    let groups = records.chunk_by(|a, b| kind(a) == kind(b));
    groups
        .filter_map(|draws| {
            let first = draws.first()?;
            let mut methods: BTreeMap<&String, Vec<&MethodDraw>> = BTreeMap::new();
            let mut failed: BTreeMap<String, usize> = BTreeMap::new();
            for record in draws {
                for (name, draw) in &record.methods {
                    methods.entry(name).or_default().push(draw);
                }
                for name in record.failed.keys() {
                    *failed.entry(name.clone()).or_default() += 1;
                }
            }
            let methods = methods.into_iter();
            let methods = methods.map(|(name, own)| (name.clone(), MethodSummary::of(&own)));
            Some(Condition {
                noise_percent: first.cell.noise_percent,
                friction: first.cell.friction,
                outlier_percent: first.cell.outlier_percent,
                rows: first.cell.rows,
                draws: draws.len(),
                methods: methods.collect(),
                failed,
            })
        })
        .collect()
}

impl MethodSummary {
    fn of(draws: &[&MethodDraw]) -> Self {
        let count = draws.len().max(1) as f64;
        let rms = |pick: fn(&MethodDraw) -> f64| root_mean(draws.iter().map(|d| pick(d).powi(2)));
        let path = || draws.iter().map(|d| d.path_nrmse_ratio);
        Self {
            path_nrmse_ratio: rms(|d| d.path_nrmse_ratio),
            path_nrmse_least_ratio: path().fold(f64::INFINITY, f64::min),
            path_nrmse_most_ratio: path().fold(0.0, f64::max),
            split_nrmse_ratio: rms(|d| d.split_nrmse_ratio),
            epochs: draws.iter().map(|d| d.epochs as f64).sum::<f64>() / count,
        }
    }
}

/// Least times of training: what else the machine does only adds to them.
fn times(records: &[CellRecord]) -> Times {
    let mut all: BTreeMap<String, BTreeMap<usize, f64>> = BTreeMap::new();
    for record in records {
        for (name, draw) in &record.methods {
            let own = all.entry(name.clone()).or_default();
            let least = own.entry(record.cell.rows).or_insert(f64::INFINITY);
            *least = least.min(draw.seconds);
        }
    }
    let listed = all.into_iter();
    let listed = listed.map(|(name, by_rows)| (name, by_rows.into_iter().collect()));
    Times {
        note: "seconds of training, sums over the rows apart, least of all draws (other work only adds); rows, seconds",
        least_seconds: listed.collect(),
    }
}
