//! Figures of the study.

use super::bars::Comparison;
use super::emulated::EmulatedReport;
use super::figures::Figures;
use serde::Serialize;
use std::collections::BTreeMap;

/// One scenario at one bandwidth.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ScenarioReport {
    /// Seed.
    pub seed: u64,
    /// Ticks of the learning run.
    pub ticks: usize,
    /// Time, s, and error of the active set on the unseen path, moving rows, %.
    pub nrmse_moving_percent: Vec<(f64, f64)>,
    /// NRMSE over moving rows of the board that never learns.
    pub frozen_nrmse_moving_percent: Vec<(f64, f64)>,
    /// Figures, units in the keys; `null` where there is none.
    pub figures: Figures,
    /// Checksum of all torques of the learning run, bit for bit.
    pub torque_checksum: String,
}

/// `report.json`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LearningReport {
    /// Version of this program.
    pub version: String,
    /// Seed.
    pub seed: u64,
    /// Scenarios by name.
    pub scenarios: BTreeMap<String, ScenarioReport>,
    /// Scenarios replayed on the board, by name; empty without a board.
    pub emulated: BTreeMap<String, EmulatedReport>,
    /// Figures against their bars.
    pub outcomes: Vec<Comparison>,
}
