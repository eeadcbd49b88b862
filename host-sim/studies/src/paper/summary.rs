//! Sums over the draws of the robustness study.

use super::cell::{CellRecord, FrictionKind, MethodDraw};
use serde::Serialize;
use std::collections::BTreeMap;

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
    pub(super) fn is_plain(&self) -> bool {
        self.noise_percent == 1.0
            && self.outlier_percent == 0.0
            && self.friction == FrictionKind::CoulombViscous
    }
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

/// The conditions in the order of the jobs.
pub(super) fn summarise(records: &[CellRecord]) -> Vec<Condition> {
    let same = |a: &&CellRecord, b: &&CellRecord| {
        let key = |r: &CellRecord| {
            let cell = r.cell;
            (
                cell.noise_percent.to_bits(),
                cell.outlier_percent.to_bits(),
                cell.rows,
            )
        };
        key(a) == key(b) && a.cell.friction == b.cell.friction
    };
    let records: Vec<&CellRecord> = records.iter().collect();
    let groups = records.chunk_by(same);
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
        let rms = |pick: fn(&MethodDraw) -> f64| {
            (draws.iter().map(|d| pick(d).powi(2)).sum::<f64>() / count).sqrt()
        };
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
pub(super) fn times(records: &[CellRecord]) -> Times {
    let mut all: BTreeMap<String, BTreeMap<usize, Vec<f64>>> = BTreeMap::new();
    for record in records {
        for (name, draw) in &record.methods {
            let own = all.entry(name.clone()).or_default();
            own.entry(record.cell.rows).or_default().push(draw.seconds);
        }
    }
    let least = |seconds: Vec<f64>| seconds.into_iter().fold(f64::INFINITY, f64::min);
    let by_rows = |own: BTreeMap<usize, Vec<f64>>| {
        let times = own
            .into_iter()
            .map(|(rows, seconds)| (rows, least(seconds)));
        times.collect()
    };
    Times {
        note: "seconds of training, sums over the rows apart, least of all draws (other work only adds); rows, seconds",
        least_seconds: all
            .into_iter()
            .map(|(name, own)| (name, by_rows(own)))
            .collect(),
    }
}
