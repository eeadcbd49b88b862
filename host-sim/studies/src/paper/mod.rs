//! The paper's experiment (Zhong, section 4.1) on the UR5, and the robustness it asserts, measured.
//!
//! `steps` (1) excitation and joint sequence through inverse kinematics, (2) torques of known parameters, (3) the BP network
//! on 80 % of them, (4) an arbitrary path. `cell` one draw of the robustness study: every method on the same rows.
//! `summary` adds the draws up; `page` shows them, `findings` states them.

mod cell;
mod curves;
mod findings;
mod page;
mod rigid;
mod steps;
mod summary;

pub use cell::{Cell, CellRecord, FRICTIONS, FrictionKind, MethodDraw};
pub use steps::{JointTorque, ParameterRow, Steps, Trained};
pub use summary::{Condition, MethodSummary, Times};

use crate::records::Records;
use crate::{Outcome, Progress, StudyError};
use cell::Bench;
use foretorque::arm::ur5::JOINTS;
use foretorque_workbench::excitation::Excitation;
use foretorque_workbench::files::write_whole;
use foretorque_workbench::parallel::cores;
use foretorque_workbench::robot::Robot;
use serde::Serialize;
use std::path::Path;

/// The excitation that `host-sim excite --robot ur5` finds.
const PRECOMPUTED: &str = include_str!("../../../paths/ur5-excitation.json");

/// Rows of one period of the excitation, of which 80 % are drawn for training.
const ROWS: usize = 2500;

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
    /// The whole study.
    ///
    /// Errors: none in an undamaged program.
    pub fn full(seed: u64, seeds: u64) -> Result<Self, StudyError> {
        Ok(Self {
            seed,
            seeds,
            noise_percent: vec![0.0, 0.5, 1.0, 2.0, 5.0],
            outlier_percent: vec![0.0, 1.0],
            friction: FRICTIONS.to_vec(),
            rows: vec![50, 100, 200, 500, 1000],
            excitation: serde_json::from_str(PRECOMPUTED)?,
        })
    }

    /// Few levels and draws, for tests.
    ///
    /// Errors: none in an undamaged program.
    pub fn quick(seed: u64, seeds: u64) -> Result<Self, StudyError> {
        Ok(Self {
            noise_percent: vec![1.0],
            outlier_percent: vec![0.0, 1.0],
            friction: vec![FrictionKind::CoulombViscous],
            rows: vec![100],
            ..Self::full(seed, seeds.min(2))?
        })
    }

    /// All cells in the order of the jobs: conditions, then numbers of rows, each with all seeds.
    fn cells(&self) -> Vec<Cell> {
        let mut kinds = Vec::new();
        for &outlier_percent in &self.outlier_percent {
            for &friction in &self.friction {
                for &noise_percent in &self.noise_percent {
                    kinds.push((noise_percent, friction, outlier_percent, ROWS * 4 / 5));
                }
            }
        }
        for &rows in &self.rows {
            kinds.push((1.0, FrictionKind::CoulombViscous, 0.0, rows));
        }
        let seeds = self.seed..self.seed + self.seeds;
        kinds
            .into_iter()
            .flat_map(|(noise_percent, friction, outlier_percent, rows)| {
                seeds.clone().map(move |seed| Cell {
                    noise_percent,
                    friction,
                    outlier_percent,
                    rows,
                    seed,
                })
            })
            .collect()
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
    let bench = Bench::new(robot, &config.excitation, ROWS).ok_or(StudyError::Joints(JOINTS))?;
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
    let conditions = summary::summarise(&records);
    let report = PaperReport {
        version: env!("CARGO_PKG_VERSION"),
        findings: findings::findings(&steps, &conditions),
        steps,
        conditions,
        config,
    };
    let times = summary::times(&records);
    curves.write(out)?;
    for (name, picture) in page::pictures(&report, &curves)? {
        write_whole(&out.join(name), picture.as_bytes())?;
    }
    let json = serde_json::to_string_pretty(&times)? + "\n";
    write_whole(&out.join("timing.json"), json.as_bytes())?;
    Ok(Some(Outcome {
        page: page::page(&report, &curves, &times),
        text: page::text(&report),
        report,
    }))
}
