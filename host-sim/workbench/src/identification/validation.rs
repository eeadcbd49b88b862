//! Torque errors of models on a log they were not trained on.

use super::bootstrap::{middle, resample};
use super::columns::Layout;
use super::dataset::SampleRow;
use super::normal::NormalEquations;
use super::prepare::{Preparation, Prepared};
use super::problem::Candidate;
use super::record::ValidationRecord;
use nalgebra::{DMatrix, DVector};

#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    moving: f64,
    still: f64,
}

/// Scores of several candidates on one log.
#[derive(Clone, Debug)]
pub struct FileScores<const N: usize> {
    errors: Vec<[Sums; N]>,
    torque: [Sums; N],
    count: [Sums; N],
    range: [(f64, f64); N],
    /// Sums over the moving rows, for bounds.
    pub sums: NormalEquations<N>,
    /// Sums over the moving rows of each second.
    blocks: Vec<Block<N>>,
    /// A thinned sample of its rows.
    pub sample: Vec<SampleRow<N>>,
    /// Time, measured torque, and the torque that every candidate predicts, thinned, for the plot.
    pub trace: Vec<(f64, [f64; N], Vec<[f64; N]>)>,
}

impl Sums {
    fn add(&mut self, moving: bool, value: f64) {
        if moving {
            self.moving += value;
        } else {
            self.still += value;
        }
    }
}

/// Squared errors of every candidate, squared torques and rows of one second, moving rows only.
#[derive(Clone, Debug)]
struct Block<const N: usize> {
    second: i64,
    errors: Vec<[f64; N]>,
    torque: [f64; N],
    count: [f64; N],
}

/// The block of the second at `t_s`.
fn open_block<const N: usize>(
    blocks: &mut Vec<Block<N>>,
    t_s: f64,
    candidates: usize,
) -> &mut Block<N> {
    let second = t_s.floor() as i64;
    if blocks.last().map(|block| block.second) != Some(second) {
        blocks.push(Block {
            second,
            errors: vec![[0.0; N]; candidates],
            torque: [0.0; N],
            count: [0.0; N],
        });
    }
    let last = blocks.len() - 1;
    &mut blocks[last]
}

/// Torques of a candidate in the rows that count, N a row, N·m, through the filter of the measurement.
fn predictions<const N: usize>(
    layout: &Layout<N>,
    preparation: &Preparation,
    prepared: &Prepared<N>,
    candidate: &Candidate<N>,
) -> Vec<f64> {
    let shares = prepared.states.iter().map(|state| candidate.network(state));
    let shares: Option<Vec<[f64; N]>> = shares.collect();
    let mut table = match shares {
        Some(shares) => {
            let mut table = shares.concat();
            preparation.smooth_torque(&mut table, N);
            table
        }
        None => vec![0.0; prepared.tau.len()],
    };
    for row in prepared.core.clone() {
        for (joint, active) in layout.active.iter().enumerate() {
            let basis = &prepared.cogging_basis[2 * (row * N + joint)..][..2];
            table[row * N + joint] += candidate
                .linear(prepared.columns(layout, row, joint), active)
                + candidate.cogging(joint, basis);
        }
    }
    table
}

/// Rows a sample keeps.
const SAMPLE: usize = 2000;
/// Points a trace keeps.
const TRACE: usize = 1500;

impl<const N: usize> FileScores<N> {
    /// No rows yet.
    pub fn new(layout: &Layout<N>, candidates: usize) -> Self {
        let zero = [Sums::default(); N];
        Self {
            errors: vec![zero; candidates],
            torque: zero,
            count: zero,
            range: [(f64::INFINITY, f64::NEG_INFINITY); N],
            sums: NormalEquations::new(layout),
            blocks: Vec::new(),
            sample: Vec::new(),
            trace: Vec::new(),
        }
    }

    /// Adds a stretch: model and measurement through the same filter, network output included.
    pub fn add(
        &mut self,
        layout: &Layout<N>,
        preparation: &Preparation,
        prepared: &Prepared<N>,
        candidates: &[&Candidate<N>],
    ) {
        let predicted: Vec<Vec<f64>> = candidates
            .iter()
            .map(|candidate| predictions(layout, preparation, prepared, candidate))
            .collect();
        let stride = preparation.stride();
        let mut equations: [(Vec<f64>, Vec<f64>); N] = std::array::from_fn(|_| Default::default());
        for row in prepared.core.clone() {
            let block = open_block(&mut self.blocks, prepared.t_s[row], candidates.len());
            for (joint, (x, tau)) in equations.iter_mut().enumerate() {
                let measured = prepared.tau[row * N + joint];
                let moving = prepared.states[row].qd[joint].abs() > preparation.still_rad_s;
                self.torque[joint].add(moving, measured * measured);
                self.count[joint].add(moving, 1.0);
                let errors = self.errors.iter_mut().zip(&mut block.errors);
                for (predicted, (errors, in_block)) in predicted.iter().zip(errors) {
                    let square = (predicted[row * N + joint] - measured).powi(2);
                    errors[joint].add(moving, square);
                    in_block[joint] += if moving { square } else { 0.0 };
                }
                if moving {
                    block.torque[joint] += measured * measured;
                    block.count[joint] += 1.0;
                    let (low, high) = self.range[joint];
                    self.range[joint] = (low.min(measured), high.max(measured));
                    if row % stride == 0 {
                        x.extend_from_slice(prepared.columns(layout, row, joint));
                        tau.push(measured);
                    }
                }
            }
        }
        for (sums, (x, tau)) in self.sums.joints.iter_mut().zip(&equations) {
            sums.add(x, tau);
        }
        let rows = || prepared.core.clone().step_by(stride);
        for row in rows().take(SAMPLE.saturating_sub(self.sample.len())) {
            let row = SampleRow::of(layout, preparation, prepared, row);
            self.sample.push(row);
        }
        for row in rows().take(TRACE.saturating_sub(self.trace.len())) {
            let at = |table: &[f64]| std::array::from_fn(|joint| table[row * N + joint]);
            let predicted = predicted.iter().map(|table| at(table)).collect();
            let measured = at(&prepared.tau);
            self.trace.push((prepared.t_s[row], measured, predicted));
        }
    }

    /// Puts the 95 % intervals of one candidate into its record.
    pub fn intervals(&self, candidate: usize, seed: u64, record: &mut ValidationRecord) {
        let draws = resample(self.blocks.len().max(1), seed, |draw| {
            let (mut errors, mut torque, mut count) = ([0.0; N], [0.0; N], [0.0; N]);
            for &place in draw {
                let block = self.blocks.get(place)?;
                for joint in 0..N {
                    errors[joint] += block.errors[candidate][joint];
                    torque[joint] += block.torque[joint];
                    count[joint] += block.count[joint];
                }
            }
            Some((errors, torque, count))
        });
        let mut ratios: Vec<f64> = draws
            .iter()
            .map(|(errors, torque, _)| {
                let ratios = errors
                    .iter()
                    .zip(torque)
                    .filter(|(_, torque)| **torque > 0.0);
                let ratios: Vec<f64> = ratios.map(|(error, torque)| error / torque).collect();
                (ratios.iter().sum::<f64>() / ratios.len().max(1) as f64).sqrt()
            })
            .collect();
        record.joints_nrmse_moving_ratio_ci95 = middle(&mut ratios);
        record.rmse_moving_nm_ci95 = (0..N)
            .map(|joint| {
                let moved = draws.iter().filter(|(_, _, count)| count[joint] > 0.0);
                let rmse = moved.map(|(errors, _, count)| (errors[joint] / count[joint]).sqrt());
                middle(&mut rmse.collect::<Vec<f64>>())
            })
            .collect();
    }

    /// The figures of one candidate.
    pub fn record(&self, candidate: usize) -> ValidationRecord {
        let errors = &self.errors[candidate];
        let root = |sum: f64, count: f64| (count > 0.0).then(|| (sum / count).sqrt());
        let joints = |value: &dyn Fn(usize) -> Option<f64>| (0..N).map(value).collect::<Vec<_>>();
        let moving = |j: usize| root(errors[j].moving, self.count[j].moving);
        let torque = |j: usize| root(self.torque[j].moving, self.count[j].moving);
        let ratio = |j: usize| Some(moving(j)? / torque(j)?);
        let ratios: Vec<f64> = (0..N).filter_map(ratio).collect();
        let squares: f64 = ratios.iter().map(|ratio| ratio * ratio).sum();
        ValidationRecord {
            rmse_moving_nm: joints(&moving),
            rmse_still_nm: joints(&|j| root(errors[j].still, self.count[j].still)),
            rmse_all_nm: joints(&|j| {
                root(
                    errors[j].moving + errors[j].still,
                    self.count[j].moving + self.count[j].still,
                )
            }),
            nrmse_moving_ratio: joints(&ratio),
            rmse_over_range_moving_ratio: joints(&|j| {
                let (low, high) = self.range[j];
                Some(moving(j)? / (high - low))
            }),
            torque_rms_moving_nm: joints(&torque),
            joints_nrmse_moving_ratio_ci95: None,
            rmse_moving_nm_ci95: Vec::new(),
            joints_nrmse_moving_ratio: (squares / ratios.len().max(1) as f64).sqrt(),
            rows_moving: (0..N).map(|j| self.count[j].moving as u64).collect(),
            cramer_rao_nrmse_moving_ratio: None,
            truth_nrmse_moving_ratio: None,
        }
    }

    /// RMS over the joints of (RMS torque of parameters that are `covariance` uncertain / RMS torque): the error that the
    /// noise of the training log alone makes on this log, a ratio.
    pub fn propagated(&self, layout: &Layout<N>, covariance: &DMatrix<f64>) -> f64 {
        self.over_joints(|joint| {
            let active = &layout.active[joint];
            let gram = &self.sums.joints[joint].gram;
            let mut trace = 0.0;
            for (a, &row) in active.iter().enumerate() {
                for (b, &column) in active.iter().enumerate() {
                    trace += gram[(a, b)] * covariance[(row, column)];
                }
            }
            trace
        })
    }

    /// RMS over the joints for one known error of the parameters.
    pub fn propagated_error(&self, layout: &Layout<N>, error: &DVector<f64>) -> f64 {
        self.propagated(layout, &(error * error.transpose()))
    }

    fn over_joints(&self, square: impl Fn(usize) -> f64) -> f64 {
        let ratios: Vec<f64> = (0..N)
            .filter(|&joint| self.sums.joints[joint].power > 0.0)
            .map(|joint| square(joint) / self.sums.joints[joint].power)
            .collect();
        (ratios.iter().sum::<f64>() / ratios.len().max(1) as f64).sqrt()
    }
}
