//! The nouns of an identification: problem, training data, candidate model, result of a method.

use super::cogging::{CoggingAmplitudes, CoggingSums};
use super::columns::Layout;
use super::dataset::{Dataset, SampleRow};
use super::methods::{Fit, MethodName, huber};
use super::normal::NormalEquations;
use super::speed::SpeedSums;
use crate::dynamics::{Joints, State};
use crate::robot::Robot;
use crate::training::{BlackBox, LinearLayer};
use foretorque::feedforward::{JointNetwork, NETWORK_BOUND};
use foretorque::learning::network_inputs;
use nalgebra::DVector;

/// Progress of an identification: stage, and the loss while a network trains.
pub type Progress<'a> = &'a dyn Fn(&str);

/// A problem to be solved on any rows.
#[derive(Clone, Copy)]
pub(super) struct Problem<'a, const N: usize> {
    /// The description.
    pub(super) robot: &'a Robot,
    /// All columns.
    pub(super) layout: &'a Layout<N>,
    /// The columns among them that the board has.
    pub(super) board: &'a Layout<N>,
    /// Methods.
    pub(super) methods: &'a [MethodName],
    /// Seed of random starts.
    pub(super) seed: u64,
}

/// The rows that a method is trained on, and sums over them.
pub(super) struct TrainingData<'a, const N: usize> {
    /// Sums over all moving rows.
    pub(super) sums: NormalEquations<N>,
    /// Sums over the same rows without spikes.
    pub(super) clean_sums: NormalEquations<N>,
    /// Their border by the sine and cosine of cogging.
    pub(super) cogging: CoggingSums<N>,
    /// Rows for methods that iterate over them.
    pub(super) sample: Vec<&'a SampleRow<N>>,
    /// Sums over raw torques by speed.
    pub(super) speeds: SpeedSums<N>,
    /// Rows behind the sums.
    pub(super) rows: usize,
}

impl<'a, const N: usize> TrainingData<'a, N> {
    /// Training data of a whole dataset.
    pub(super) fn all(dataset: &'a Dataset<N>) -> Self {
        Self {
            sums: dataset.sums.clone(),
            clean_sums: dataset.clean_sums.clone(),
            cogging: dataset.cogging.clone(),
            sample: dataset.sample.iter().collect(),
            speeds: dataset.speeds.clone(),
            rows: dataset.rows,
        }
    }

    /// Training data of some sampled rows only.
    pub(super) fn of(layout: &Layout<N>, sample: Vec<&'a SampleRow<N>>) -> Self {
        let mut data = Self {
            sums: NormalEquations::new(layout),
            clean_sums: NormalEquations::new(layout),
            cogging: CoggingSums::new(layout),
            speeds: SpeedSums::new(),
            rows: sample.len(),
            sample: Vec::new(),
        };
        for joint in 0..N {
            let (mut x, mut basis) = (Vec::new(), Vec::new());
            let (mut tau, mut clean) = (Vec::new(), Vec::new());
            for row in sample.iter().filter(|row| row.moving[joint]) {
                x.extend_from_slice(row.columns(layout, joint));
                basis.extend(row.cogging_basis[joint]);
                tau.push(row.tau[joint]);
                clean.push(row.clean[joint]);
            }
            data.sums.joints[joint].add(&x, &tau);
            data.clean_sums.joints[joint].add(&x, &clean);
            data.cogging.add(joint, &x, &basis, &clean);
        }
        for (place, row) in sample.iter().enumerate() {
            for joint in (0..N).filter(|&joint| row.moving[joint]) {
                let half = 10 * place / sample.len() % 2;
                let columns = row.columns(layout, joint);
                let (qd, tau) = (row.state.qd[joint], row.clean[joint]);
                let basis = &row.cogging_basis[joint];
                data.speeds.add((joint, half), qd, columns, basis, tau);
            }
        }
        Self { sample, ..data }
    }

    /// Applies Huber's weights for the residuals of `theta` to the sums without spikes.
    pub(super) fn weigh(&mut self, layout: &Layout<N>, theta: &DVector<f64>, sigma: &[f64; N]) {
        for (joint, (sums, &sigma)) in self.clean_sums.joints.iter_mut().zip(sigma).enumerate() {
            *sums = huber(joint, &self.sample, layout, theta, sigma);
        }
    }

    /// The linear layer whose loss is the weighted one: every joint's rows divided by the noise of `fit`.
    pub(super) fn layer(&self, layout: &Layout<N>, fit: &Fit<N>) -> LinearLayer {
        let (gram, moment) = self.sums.weighted(layout, &fit.sigma);
        let joints = self.sums.joints.iter().zip(&fit.sigma);
        let power = joints
            .map(|(joint, sigma)| joint.power / (sigma * sigma))
            .sum();
        LinearLayer::new(&gram, &moment, power, self.sums.count())
    }
}

/// A model to be validated.
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
        cogging: CoggingAmplitudes<N>,
        /// One network a joint.
        networks: Box<[JointNetwork; N]>,
        /// Torque limit of every joint, N·m.
        limits: [f64; N],
    },
}

impl<const N: usize> Candidate<N> {
    /// Torque of the linear part at a joint with these columns, N·m.
    pub(super) fn linear(&self, columns: &[f64], active: &[usize]) -> f64 {
        match self {
            Self::Linear(theta) | Self::Residual { theta, .. } => {
                let pairs = columns.iter().zip(active);
                pairs.map(|(x, &place)| x * theta[place]).sum()
            }
            Self::BlackBox(_) => 0.0,
        }
    }

    /// Cogging torque at a joint, N·m, from sine and cosine of its phase.
    pub(super) fn cogging(&self, joint: usize, basis: &[f64]) -> f64 {
        match self {
            Self::Residual { cogging, .. } => {
                let pairs = cogging[joint].iter().zip(basis);
                pairs.map(|(amplitude, basis)| amplitude * basis).sum()
            }
            Self::Linear(_) | Self::BlackBox(_) => 0.0,
        }
    }

    /// Torques of the networks at the speeds of `state`, N·m; `None` without networks.
    pub(super) fn network(&self, state: &State<N>) -> Option<[f64; N]> {
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

    /// Torque of the model at the state of `row`, N·m.
    pub fn torque(&self, layout: &Layout<N>, row: &SampleRow<N>) -> Joints<N> {
        let network = self.network(&row.state).unwrap_or([0.0; N]);
        Joints::from_fn(|joint, _| {
            self.linear(row.columns(layout, joint), &layout.active[joint])
                + self.cogging(joint, &row.cogging_basis[joint])
                + network[joint]
        })
    }
}

/// Result of one method.
#[derive(Clone, Debug)]
pub struct MethodResult<const N: usize> {
    /// The method.
    pub name: MethodName,
    /// The model.
    pub candidate: Candidate<N>,
    /// Its linear part with covariance, if it has one.
    pub fit: Option<Fit<N>>,
    /// The robot it describes, if it describes one.
    pub robot: Option<Robot>,
    /// Rows it was trained on.
    pub rows: usize,
    /// Epochs or iterations.
    pub epochs: usize,
    /// Time of the fit, the sums over the rows apart, s.
    pub seconds: f64,
    /// Epoch and loss, thinned.
    pub losses: Vec<(usize, f64)>,
    /// Epochs of `bp_physical` to 1.05 times the loss of weighted least squares, accelerated and plain.
    pub epochs_to_wls: Option<[Option<usize>; 2]>,
    /// Cost of physical consistency, nats.
    pub distance_nats: Option<f64>,
}

impl<const N: usize> MethodResult<N> {
    /// A result of nothing but a model and its rows.
    pub(super) fn plain(name: MethodName, candidate: Candidate<N>, rows: usize) -> Self {
        Self {
            name,
            candidate,
            fit: None,
            robot: None,
            rows,
            epochs: 0,
            seconds: 0.0,
            losses: Vec::new(),
            epochs_to_wls: None,
            distance_nats: None,
        }
    }
}

/// Epoch and loss, at most 200 points, first and last kept.
pub(super) fn thinned(losses: &[f64]) -> Vec<(usize, f64)> {
    const CURVE: usize = 200;
    let stride = losses.len().div_ceil(CURVE).max(1);
    let last = losses.len().saturating_sub(1);
    let points = losses.iter().copied().enumerate();
    points
        .filter(|(epoch, _)| epoch % stride == 0 || *epoch == last)
        .collect()
}
