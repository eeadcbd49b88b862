//! Settings and figures of the study.

use super::cell::{Cell, FRICTIONS, FrictionKind, ROWS};
use super::steps::Steps;
use super::summary::Condition;
use crate::StudyError;
use foretorque_workbench::excitation::Excitation;
use serde::Serialize;

/// The excitation that `host-sim excite --robot ur5` finds.
pub(super) const PRECOMPUTED: &str = include_str!("../../../paths/ur5-excitation.json");

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
    pub(super) fn cells(&self) -> Vec<Cell> {
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
