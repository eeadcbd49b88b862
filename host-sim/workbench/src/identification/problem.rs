//! Nouns of an identification: problem, training data, candidate model, result of a method.

use super::columns::Layout;
use super::dataset::{Dataset, RowSums};
use super::methods::{Fit, MethodName, huber};
use super::normal::SampleRow;
use super::normal::{CoggingAmplitudes, NormalEquations, SpeedSums};
use super::record::MethodRecord;
use crate::dynamics::{Motion, PerJoint};
use crate::robot::Robot;
use crate::training::{BlackBox, LinearLayer};
use foretorque::feedforward::{JointNetwork, NETWORK_BOUND};
use foretorque::learning::network_inputs;
use nalgebra::DVector;

/// Progress of an identification: stage, and the loss while a network trains.
pub type Progress<'a> = &'a (dyn Fn(&str) + Sync);

/// A problem to be solved on any rows.
#[derive(Clone, Copy)]
pub(super) struct Problem<'a> {
    pub(super) robot: &'a Robot,
    /// All columns.
    pub(super) layout: &'a Layout,
    /// The columns among them that the board has.
    pub(super) board: &'a Layout,
    pub(super) methods: &'a [MethodName],
    /// `bp_residual` has networks, and is not the linear model that stands in for them.
    pub(super) networks: bool,
    pub(super) seed: u64,
}

/// Rows that a method is trained on, and sums over them.
pub(super) struct TrainingData<'a> {
    pub(super) sums: RowSums,
    /// Rows for methods that iterate over them.
    pub(super) sample: Vec<&'a SampleRow>,
    /// Sums over raw torques by speed.
    pub(super) speeds: SpeedSums,
}

impl<'a> TrainingData<'a> {
    pub(super) fn all(dataset: &'a Dataset) -> Self {
        Self {
            sums: dataset.sums.clone(),
            sample: dataset.sample.kept.iter().collect(),
            speeds: dataset.speeds.clone(),
        }
    }

    /// Training data of some sampled rows only.
    pub(super) fn of(layout: &Layout, sample: Vec<&'a SampleRow>) -> Self {
        let sums = RowSums::of(layout, &sample);
        let mut speeds = SpeedSums::new(layout.joints());
        for (place, row) in sample.iter().enumerate() {
            let half = 10 * place / sample.len() % 2;
            for joint in (0..layout.joints()).filter(|&joint| row.moving[joint]) {
                let columns = layout.columns_and_cogging(joint, &row.panel);
                speeds.add(
                    (joint, half),
                    row.state.qd[joint],
                    columns,
                    row.clean[joint],
                );
            }
        }
        Self {
            sums,
            sample,
            speeds,
        }
    }

    /// Sums over the sample with Huber's weights for the residuals of `theta`.
    pub(super) fn robust_sums(
        &self,
        layout: &Layout,
        theta: &DVector<f64>,
        sigma: &[f64],
    ) -> NormalEquations {
        let joints = sigma.iter().enumerate();
        let joints = joints.map(|(joint, &sigma)| huber(joint, &self.sample, layout, theta, sigma));
        NormalEquations {
            joints: joints.collect(),
        }
    }

    /// The linear layer whose loss is the weighted one: every joint's rows divided by the noise of `fit`.
    pub(super) fn layer(&self, layout: &Layout, fit: &Fit) -> LinearLayer {
        let sums = &self.sums.all;
        let (gram, moment) = sums.weighted(layout, &fit.sigma);
        let joints = sums.joints.iter().zip(fit.sigma.iter());
        let power = joints.map(|(joint, sigma)| joint.power / (sigma * sigma));
        LinearLayer::new(&gram, &moment, power.sum(), sums.count())
    }
}

/// A model to be validated.
#[derive(Clone, Debug)]
pub enum Candidate {
    /// The linear model.
    Linear(DVector<f64>),
    /// The black-box network.
    BlackBox(Box<BlackBox>),
    /// The linear model and the board's networks, in f32 and with the board's bound.
    Residual {
        /// Parameters of the linear part, zero for columns the board does not have.
        theta: DVector<f64>,
        /// Direct connections of the networks from sine and cosine of the cogging phase, N·m.
        cogging: CoggingAmplitudes,
        /// One network a joint.
        networks: Vec<JointNetwork>,
        /// Torque limit of every joint, N·m.
        limits: Vec<f64>,
    },
}

impl Candidate {
    /// Torque at a joint without networks, N·m, from a row of all joints.
    pub(super) fn linear(&self, layout: &Layout, joint: usize, row: &[f64]) -> f64 {
        let columns = layout.columns_and_cogging(joint, row);
        match self {
            Self::Linear(theta) => layout.torque(joint, columns, theta),
            Self::BlackBox(_) => 0.0,
            Self::Residual { theta, cogging, .. } => {
                layout.torque_with_cogging(joint, columns, theta, cogging[joint])
            }
        }
    }

    /// Torques of the networks at the speeds of `state`, N·m; `None` without networks.
    pub(super) fn network(&self, state: &Motion) -> Option<PerJoint<f64>> {
        match self {
            Self::Linear(_) => None,
            Self::BlackBox(network) => Some(network.torque(state)),
            Self::Residual {
                networks, limits, ..
            } => Some(PerJoint::from_fn(networks.len(), |joint| {
                let inputs = network_inputs(state.qd[joint] as f32);
                let [[output]] = networks[joint].forward(&inputs).data.0;
                f64::from(output.clamp(-NETWORK_BOUND, NETWORK_BOUND)) * limits[joint]
            })),
        }
    }

    /// Torque of the model at the state of `row`, N·m.
    pub fn torque(&self, layout: &Layout, row: &SampleRow) -> PerJoint<f64> {
        let joints = layout.joints();
        let network = self
            .network(&row.state)
            .unwrap_or(PerJoint::repeat(joints, 0.0));
        PerJoint::from_fn(joints, |joint| {
            self.linear(layout, joint, &row.panel) + network[joint]
        })
    }
}

/// Result of one method.
#[derive(Clone, Debug)]
pub struct MethodResult {
    /// The method.
    pub name: MethodName,
    /// The model.
    pub candidate: Candidate,
    /// Its linear part with covariance, if it has one.
    pub fit: Option<Fit>,
    /// The fit that takes the place of a model with networks where those are worse on unseen rows.
    pub linear: Option<Fit>,
    /// The robot it describes, if it describes one.
    pub robot: Option<Robot>,
    /// Figures of the training.
    pub record: MethodRecord,
}

impl MethodResult {
    /// A result of nothing but a model, and the rows and epochs of its training.
    pub(super) fn plain(
        name: MethodName,
        candidate: Candidate,
        (rows, epochs): (usize, usize),
    ) -> Self {
        Self {
            name,
            candidate,
            fit: None,
            linear: None,
            robot: None,
            record: MethodRecord {
                rows,
                epochs,
                ..MethodRecord::default()
            },
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
