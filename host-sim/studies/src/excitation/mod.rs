//! The excitation campaign: one search for every seed, every limit recounted on many points by code of its own.

mod page;
mod recount;

pub use recount::{Recount, recount};

use super::campaign::{Campaign, JobError};
use foretorque_workbench::excitation::{Excitation, SearchConfig, optimise};
use foretorque_workbench::files::write_whole;
use foretorque_workbench::robot::Robot;
use serde::{Deserialize, Serialize};
use std::error::Error;
use std::path::Path;

/// What the records depend on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExcitationConfig {
    /// Robot: a built-in name or a description file.
    pub robot: String,
    /// Seeds 1 to this.
    pub seeds: u64,
    /// Points of a period on which limits are recounted.
    pub points: u32,
    /// Starts of each search.
    pub starts: usize,
    /// Most iterations of a round for the best quarter of the starts.
    pub iterations: usize,
    /// Limit of the condition number.
    pub condition_limit: f64,
}

impl ExcitationConfig {
    /// The full campaign for a robot.
    pub fn full(robot: &str, seeds: u64) -> Self {
        let search = SearchConfig::default();
        Self {
            robot: robot.to_owned(),
            seeds,
            points: 100_000,
            starts: search.starts,
            iterations: search.iterations,
            condition_limit: search.condition_limit,
        }
    }

    /// Short searches on few points, for tests: they do not reach the lowest condition numbers.
    pub fn quick(robot: &str, seeds: u64) -> Self {
        Self {
            points: 2000,
            starts: 4,
            iterations: 40,
            condition_limit: 200.0,
            ..Self::full(robot, seeds)
        }
    }
}

/// What the search of one seed found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SeedRecord {
    /// Seed.
    pub seed: u64,
    /// Predicted torque error on task motion, %.
    pub predicted_nrmse_percent: f64,
    /// Condition number of the links' base regressor, standard DH frames, raw SI.
    pub condition_number_dh: f64,
    /// The same in the board's frames.
    pub condition_number_board: f64,
    /// What was recounted.
    pub recount: Recount,
    /// The coefficients.
    pub excitation: Excitation,
}

/// The whole report.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ExcitationReport<'a> {
    /// Version of this program.
    pub version: &'static str,
    /// What it was made from.
    pub config: &'a ExcitationConfig,
    /// Largest predicted torque error of all seeds, %.
    pub worst_predicted_nrmse_percent: f64,
    /// Largest condition number, standard DH frames.
    pub worst_condition_number_dh: f64,
    /// Limits missed, over all seeds and points.
    pub violations: u64,
    /// Values beyond what the certificates say is the worst.
    pub beyond_certificate: u64,
    /// Seed by seed.
    pub seeds: &'a [SeedRecord],
}

/// The campaign.
#[derive(Clone, Debug)]
pub struct ExcitationCampaign {
    config: ExcitationConfig,
    robot: Robot,
}

impl ExcitationCampaign {
    /// The campaign of a configuration.
    ///
    /// Errors: a robot that is none, or has neither six nor seven joints.
    pub fn new(config: ExcitationConfig) -> Result<Self, Box<dyn Error>> {
        let robot = Robot::load(&config.robot)?;
        match robot.joint_count() {
            6 | 7 => Ok(Self { config, robot }),
            joints => Err(format!("robots of {joints} joints are not supported").into()),
        }
    }

    fn searched<const N: usize>(&self, seed: u64) -> Result<SeedRecord, JobError> {
        let search = SearchConfig {
            seed,
            starts: self.config.starts,
            iterations: self.config.iterations,
            condition_limit: self.config.condition_limit,
            ..SearchConfig::default()
        };
        let excitation = optimise::<N>(&self.robot, &search, None, |_, _| ())?;
        let recount = recount::<N>(
            &self.robot,
            &excitation,
            search.range_rad,
            self.config.points,
        )
        .ok_or("the excitation has no certificate")?;
        let certificate = excitation
            .certificate
            .as_deref()
            .ok_or("the excitation has no certificate")?;
        Ok(SeedRecord {
            seed,
            predicted_nrmse_percent: certificate.predicted_nrmse_percent,
            condition_number_dh: certificate.condition_number_dh,
            condition_number_board: certificate.condition_number_board,
            recount,
            excitation: Excitation {
                certificate: None,
                ..excitation
            },
        })
    }
}

impl Campaign for ExcitationCampaign {
    const NAME: &'static str = "excitation";
    type Config = ExcitationConfig;
    type Record = SeedRecord;

    fn config(&self) -> &ExcitationConfig {
        &self.config
    }

    fn jobs(&self) -> usize {
        self.config.seeds as usize
    }

    /// One search at a time: it takes all cores itself.
    fn threads(&self) -> usize {
        1
    }

    fn run(&self, job: usize) -> Result<SeedRecord, JobError> {
        let seed = 1 + job as u64;
        match self.robot.joint_count() {
            6 => self.searched::<6>(seed),
            _ => self.searched::<7>(seed),
        }
    }

    fn finish(&self, records: &[SeedRecord], out: &Path) -> Result<Vec<String>, Box<dyn Error>> {
        let worst = |pick: fn(&SeedRecord) -> f64| records.iter().map(pick).fold(0.0, f64::max);
        let report = ExcitationReport {
            version: env!("CARGO_PKG_VERSION"),
            config: &self.config,
            worst_predicted_nrmse_percent: worst(|r| r.predicted_nrmse_percent),
            worst_condition_number_dh: worst(|r| r.condition_number_dh),
            violations: records.iter().map(|r| r.recount.violations).sum(),
            beyond_certificate: records.iter().map(|r| r.recount.beyond_certificate).sum(),
            seeds: records,
        };
        write_whole(&out.join("report.html"), page::page(&report).as_bytes())?;
        let json = serde_json::to_string_pretty(&report)? + "\n";
        write_whole(&out.join("report.json"), json.as_bytes())?;
        let mut lines: Vec<String> = records
            .iter()
            .map(|r| {
                format!(
                    "seed {:<3} {:.4} %  condition number {:.2}  {} violations",
                    r.seed, r.predicted_nrmse_percent, r.condition_number_dh, r.recount.violations
                )
            })
            .collect();
        lines.push(format!(
            "worst    {:.4} %  condition number {:.2}  {} violations on {} points each",
            report.worst_predicted_nrmse_percent,
            report.worst_condition_number_dh,
            report.violations,
            self.config.points
        ));
        lines.push(out.join("report.html").display().to_string());
        Ok(lines)
    }
}
