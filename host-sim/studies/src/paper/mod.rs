//! The paper's experiment (Zhong, section 4.1) on the UR5, and the robustness it asserts, measured.
//!
//! `steps` (1) excitation and joint sequence through inverse kinematics, (2) torques of known parameters, (3) the BP network
//! on 80 % of them, (4) an arbitrary path. `cell` one draw of the robustness study: every method on the same rows.
//! `summary` what the draws add up to; `figures` and `page` show it, `findings` says it.

mod cell;
mod curves;
mod figures;
mod findings;
mod page;
mod rigid;
mod steps;
mod summary;

pub use cell::{Cell, CellRecord, FRICTIONS, FrictionKind, MethodDraw};
pub use steps::{JointTorque, ParameterRow, Steps, Trained};
pub use summary::{Condition, MethodSummary, Times};

use super::campaign::{Campaign, JobError};
use cell::Bench;
use foretorque::arm::ur5::JOINTS;
use foretorque_workbench::excitation::Excitation;
use foretorque_workbench::files::write_whole;
use foretorque_workbench::parallel::cores;
use foretorque_workbench::robot::Robot;
use serde::{Deserialize, Serialize};
use std::error::Error;
use std::path::Path;

/// The excitation that `host-sim excite --robot ur5` finds.
const PRECOMPUTED: &str = include_str!("../../../paths/ur5-excitation.json");

/// Rows of one period of the excitation, of which 80 % are drawn for training.
const ROWS: usize = 2500;

/// What the records depend on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
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
    /// Errors: none but a damaged program.
    pub fn full(seed: u64, seeds: u64) -> Result<Self, Box<dyn Error>> {
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
    /// Errors: none but a damaged program.
    pub fn quick(seed: u64, seeds: u64) -> Result<Self, Box<dyn Error>> {
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

/// All figures but the times, which no run repeats.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PaperReport<'a> {
    /// Version of this program.
    pub version: &'static str,
    /// What it was made from.
    pub config: &'a PaperConfig,
    /// What the figures say.
    pub findings: &'a [String],
    /// Steps (1) to (4) of the paper.
    pub steps: &'a Steps,
    /// Conditions of the robustness study, then numbers of rows, each with all methods.
    pub conditions: &'a [Condition],
}

/// The study.
#[derive(Clone, Debug)]
pub struct PaperCampaign {
    config: PaperConfig,
    cells: Vec<Cell>,
    bench: Bench,
}

impl PaperCampaign {
    /// The study of a configuration.
    ///
    /// Errors: an excitation for another robot.
    pub fn new(config: PaperConfig) -> Result<Self, Box<dyn Error>> {
        let robot = Robot::load("ur5")?;
        config.excitation.check(&robot)?;
        let bench = Bench::new(robot, &config.excitation, ROWS).ok_or("the UR5 has six joints")?;
        Ok(Self {
            cells: config.cells(),
            bench,
            config,
        })
    }
}

impl Campaign for PaperCampaign {
    const NAME: &'static str = "paper";
    type Config = PaperConfig;
    type Record = CellRecord;

    fn config(&self) -> &PaperConfig {
        &self.config
    }

    fn jobs(&self) -> usize {
        self.cells.len()
    }

    fn threads(&self) -> usize {
        cores()
    }

    fn run(&self, job: usize) -> Result<CellRecord, JobError> {
        self.bench.draw(&self.cells[job])
    }

    fn finish(&self, records: &[CellRecord], out: &Path) -> Result<Vec<String>, Box<dyn Error>> {
        let (robot, excitation) = (&self.bench.robot, &self.config.excitation);
        let (steps, curves) = steps::run(robot, excitation, self.config.seed)?;
        curves.write(out)?;
        let conditions = summary::summarise(records);
        let findings = findings::findings(&steps, &conditions);
        let report = PaperReport {
            version: env!("CARGO_PKG_VERSION"),
            config: &self.config,
            findings: &findings,
            steps: &steps,
            conditions: &conditions,
        };
        for (name, picture) in figures::pictures(excitation, &curves, &conditions)? {
            write_whole(&out.join(name), picture.as_bytes())?;
        }
        let times = summary::times(records);
        let page = page::page(&report, &curves, &times)?;
        write_whole(&out.join("report.html"), page.as_bytes())?;
        let json = serde_json::to_string_pretty(&times)? + "\n";
        write_whole(&out.join("timing.json"), json.as_bytes())?;
        let json = serde_json::to_string_pretty(&report)? + "\n";
        write_whole(&out.join("report.json"), json.as_bytes())?;
        let mut lines = findings.clone();
        lines.extend(findings::of_times(&times));
        lines.push(out.join("report.html").display().to_string());
        Ok(lines)
    }
}
