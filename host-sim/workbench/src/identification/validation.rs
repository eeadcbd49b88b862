//! How well a model says the torques of a log it has not seen.

use super::bootstrap::{middle, resample};
use super::columns::Layout;
use super::gathered::SampleRow;
use super::normal::NormalEquations;
use super::prepare::{Preparation, Prepared};
use super::record::ValidationRecord;
use super::ripple::Ripple;
use crate::dynamics::State;
use crate::training::BlackBox;
use foretorque::feedforward::{JointNetwork, NETWORK_BOUND};
use foretorque::learning::network_inputs;
use nalgebra::{DMatrix, DVector};

/// A model to be judged.
#[derive(Clone, Debug)]
pub enum Candidate<const N: usize> {
    /// The linear model.
    Linear(DVector<f64>),
    /// The black-box network.
    BlackBox(Box<BlackBox<N>>),
    /// The linear model and the board's networks, in f32 and with the board's bound.
    Residual {
        /// Parameters of the linear part, zero for columns the board does not have.
        theta: DVector<f64>,
        /// Direct connections of the networks from sine and cosine of the cogging phase, N·m.
        ripple: Ripple<N>,
        /// One network a joint.
        networks: Box<[JointNetwork; N]>,
        /// Torque limit of every joint, N·m.
        limits: [f64; N],
    },
}

impl<const N: usize> Candidate<N> {
    /// Parameters of its linear part.
    pub fn theta(&self) -> Option<&DVector<f64>> {
        match self {
            Self::Linear(theta) | Self::Residual { theta, .. } => Some(theta),
            Self::BlackBox(_) => None,
        }
    }

    /// Torque of its linear part at a joint with these columns, N·m.
    fn linear(&self, columns: &[f64], active: &[usize]) -> f64 {
        self.theta().map_or(0.0, |theta| {
            let pairs = columns.iter().zip(active);
            pairs.map(|(x, &place)| x * theta[place]).sum()
        })
    }

    /// Torque at a joint whose cogging phase has these sine and cosine, N·m.
    pub fn ripple(&self, joint: usize, waves: &[f64]) -> f64 {
        match self {
            Self::Residual { ripple, .. } => {
                let pairs = ripple[joint].iter().zip(waves);
                pairs.map(|(amplitude, wave)| amplitude * wave).sum()
            }
            Self::Linear(_) | Self::BlackBox(_) => 0.0,
        }
    }

    /// Torques its networks add at the speeds of `state`, N·m; `None` when it has none.
    pub fn network(&self, state: &State<N>) -> Option<[f64; N]> {
        match self {
            Self::Linear(_) => None,
            Self::BlackBox(network) => Some(network.torque(state)),
            Self::Residual {
                networks, limits, ..
            } => Some(std::array::from_fn(|joint| {
                let inputs = network_inputs(state.qd[joint] as f32);
                let [[output]] = networks[joint].forward(&inputs).data.0;
                f64::from(output.clamp(-NETWORK_BOUND, NETWORK_BOUND)) * limits[joint]
            })),
        }
    }
}

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

/// Squared errors of every candidate, squared torques and rows of one second, moving rows only.
#[derive(Clone, Debug)]
struct Block<const N: usize> {
    second: i64,
    errors: Vec<[f64; N]>,
    torque: [f64; N],
    count: [f64; N],
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

    /// Judges a stretch: model and measurement through the same filter, network output included.
    pub fn add(
        &mut self,
        layout: &Layout<N>,
        preparation: &Preparation,
        prepared: &Prepared<N>,
        candidates: &[&Candidate<N>],
    ) {
        let networks: Vec<Option<Vec<f64>>> = candidates
            .iter()
            .map(|candidate| {
                let mut shares = Vec::with_capacity(prepared.tau.len());
                for state in &prepared.states {
                    shares.extend(candidate.network(state)?);
                }
                preparation.smooth_torque(&mut shares, N);
                Some(shares)
            })
            .collect();
        let stride = preparation.stride();
        let (first, seconds) = self.open_blocks(prepared, candidates.len());
        for (joint, active) in layout.active.iter().enumerate() {
            let (mut x, mut tau) = (Vec::new(), Vec::new());
            for row in prepared.core.clone() {
                let measured = prepared.tau[row * N + joint];
                let moving = prepared.states[row].qd[joint].abs() > preparation.still_rad_s;
                let start = row * layout.width + layout.offset[joint];
                let columns = &prepared.panel[start..start + active.len()];
                let place = first + seconds[row - prepared.core.start];
                let block = &mut self.blocks[place];
                let put = |sums: &mut Sums, value: f64| {
                    if moving {
                        sums.moving += value;
                    } else {
                        sums.still += value;
                    }
                };
                for (((candidate, shares), errors), in_block) in candidates
                    .iter()
                    .zip(&networks)
                    .zip(&mut self.errors)
                    .zip(&mut block.errors)
                {
                    let waves = &prepared.waves[2 * (row * N + joint)..][..2];
                    let linear = candidate.linear(columns, active) + candidate.ripple(joint, waves);
                    let share = shares
                        .as_ref()
                        .map_or(0.0, |shares| shares[row * N + joint]);
                    let square = (linear + share - measured).powi(2);
                    put(&mut errors[joint], square);
                    if moving {
                        in_block[joint] += square;
                    }
                }
                put(&mut self.torque[joint], measured * measured);
                put(&mut self.count[joint], 1.0);
                if moving {
                    block.torque[joint] += measured * measured;
                    block.count[joint] += 1.0;
                    let (low, high) = self.range[joint];
                    self.range[joint] = (low.min(measured), high.max(measured));
                    if row % stride == 0 {
                        x.extend_from_slice(columns);
                        tau.push(measured);
                    }
                }
            }
            self.sums.joints[joint].add(&x, &tau);
        }
        for row in prepared.core.clone().step_by(stride) {
            if self.sample.len() < SAMPLE {
                self.sample
                    .push(SampleRow::of(layout, preparation, prepared, row));
            }
        }
        for row in prepared.core.clone().step_by(stride) {
            if self.trace.len() >= TRACE {
                break;
            }
            let at = |table: &[f64]| std::array::from_fn(|joint| table[row * N + joint]);
            let predicted = candidates.iter().zip(&networks).map(|(candidate, shares)| {
                let shares: [f64; N] = shares.as_deref().map_or([0.0; N], at);
                std::array::from_fn(|joint| {
                    let start = row * layout.width + layout.offset[joint];
                    let columns = &prepared.panel[start..];
                    let waves = &prepared.waves[2 * (row * N + joint)..][..2];
                    candidate.linear(columns, &layout.active[joint])
                        + candidate.ripple(joint, waves)
                        + shares[joint]
                })
            });
            let predicted = predicted.collect();
            self.trace
                .push((prepared.t_s[row], at(&prepared.tau), predicted));
        }
    }

    /// Opens a block for every second of the stretch; returns the first of them and, row by row, which of them it is.
    fn open_blocks(&mut self, prepared: &Prepared<N>, candidates: usize) -> (usize, Vec<usize>) {
        let mut first = self.blocks.len();
        let second = |row: usize| prepared.t_s[row].floor() as i64;
        if let (Some(last), Some(row)) = (self.blocks.last(), prepared.core.clone().next())
            && last.second == second(row)
        {
            first -= 1;
        }
        let places = prepared
            .core
            .clone()
            .map(|row| {
                if self.blocks.len() == first
                    || self.blocks.last().map(|block| block.second) != Some(second(row))
                {
                    self.blocks.push(Block {
                        second: second(row),
                        errors: vec![[0.0; N]; candidates],
                        torque: [0.0; N],
                        count: [0.0; N],
                    });
                }
                self.blocks.len() - 1 - first
            })
            .collect();
        (first, places)
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

    /// The same for one known error of the parameters.
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
