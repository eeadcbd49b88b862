//! One method after the other on the same material.

use super::columns::Layout;
use super::consistent::consistent;
use super::evidence::evidence;
use super::gathered::{Gathered, SampleRow};
use super::methods::{Fit, MethodName, huber, irls, ols, wls};
use super::normal::NormalEquations;
use super::record::{MethodRecord, ParameterRecord, SplitRecord};
use super::residual::residual;
use super::ripple::RippleSums;
use super::speed::SpeedSums;
use super::study::Progress;
use super::truth::base_error;
use super::validation::Candidate;
use crate::robot::Robot;
use crate::training::{BlackBox, Descent, LinearLayer, PhysicalConfig, Trained};
use nalgebra::DVector;
use std::collections::BTreeMap;
use std::error::Error;
use std::time::Instant;

/// What is to be solved, whatever the rows.
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

/// What a method is trained on.
pub(super) struct Material<'a, const N: usize> {
    /// Sums over all moving rows.
    pub(super) sums: NormalEquations<N>,
    /// The same over rows without spikes.
    pub(super) clean_sums: NormalEquations<N>,
    /// What borders them by the waves of cogging.
    pub(super) ripple: RippleSums<N>,
    /// Rows for methods that iterate over them.
    pub(super) sample: Vec<&'a SampleRow<N>>,
    /// What raw torques say at each speed.
    pub(super) speeds: SpeedSums<N>,
    /// Rows behind the sums.
    pub(super) rows: usize,
}

impl<'a, const N: usize> Material<'a, N> {
    /// Everything that was gathered.
    pub(super) fn all(gathered: &'a Gathered<N>) -> Self {
        Self {
            sums: gathered.sums.clone(),
            clean_sums: gathered.clean_sums.clone(),
            ripple: gathered.ripple.clone(),
            sample: gathered.sample.iter().collect(),
            speeds: gathered.speeds.clone(),
            rows: gathered.rows,
        }
    }

    /// Some rows of the sample only.
    pub(super) fn of(layout: &Layout<N>, sample: Vec<&'a SampleRow<N>>) -> Self {
        let sums = |pick: fn(&SampleRow<N>) -> &[f64; N]| {
            let mut sums = NormalEquations::new(layout);
            for joint in 0..N {
                let (mut x, mut tau) = (Vec::new(), Vec::new());
                for row in sample.iter().filter(|row| row.moving[joint]) {
                    x.extend_from_slice(row.columns(layout, joint));
                    tau.push(pick(row)[joint]);
                }
                sums.joints[joint].add(&x, &tau);
            }
            sums
        };
        let mut ripple = RippleSums::new(layout);
        for joint in 0..N {
            let (mut x, mut waves, mut tau) = (Vec::new(), Vec::new(), Vec::new());
            for row in sample.iter().filter(|row| row.moving[joint]) {
                x.extend_from_slice(row.columns(layout, joint));
                waves.extend(row.waves[joint]);
                tau.push(row.clean[joint]);
            }
            ripple.add(joint, &x, &waves, &tau);
        }
        let mut speeds = SpeedSums::new(layout);
        for (place, row) in sample.iter().enumerate() {
            for joint in (0..N).filter(|&joint| row.moving[joint]) {
                let half = 10 * place / sample.len() % 2;
                let (qd, tau) = (row.state.qd[joint], row.clean[joint]);
                speeds.add(layout, joint, half, qd, &row.panel, &row.waves[joint], tau);
            }
        }
        Self {
            sums: sums(|row| &row.tau),
            clean_sums: sums(|row| &row.clean),
            ripple,
            speeds,
            rows: sample.len(),
            sample,
        }
    }
}

impl<const N: usize> Material<'_, N> {
    /// Huber's weights for the residuals of `theta` on the sums without spikes.
    pub(super) fn weigh(&mut self, layout: &Layout<N>, theta: &DVector<f64>, sigma: &[f64; N]) {
        for (joint, (sums, &sigma)) in self.clean_sums.joints.iter_mut().zip(sigma).enumerate() {
            *sums = huber(joint, &self.sample, layout, theta, sigma);
        }
    }
}

/// One method after its training.
pub(super) struct Solved<const N: usize> {
    pub(super) name: MethodName,
    pub(super) candidate: Candidate<N>,
    pub(super) fit: Option<Fit<N>>,
    /// The arm it describes, where it describes one.
    pub(super) robot: Option<Robot>,
    pub(super) rows: usize,
    pub(super) epochs: usize,
    pub(super) seconds: f64,
    pub(super) losses: Vec<(usize, f64)>,
    pub(super) epochs_to_wls: Option<[Option<usize>; 2]>,
    /// What consistency costs, nats.
    pub(super) distance_nats: Option<f64>,
}

impl<const N: usize> Solved<N> {
    /// A method that has nothing to tell but these.
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

/// Points of a loss curve in the report.
const CURVE: usize = 200;

pub(super) fn unsolvable() -> String {
    "the normal equations cannot be solved".to_owned()
}

/// All methods, in the order asked for.
pub(super) fn solve_all<const N: usize>(
    problem: &Problem<'_, N>,
    material: &Material<'_, N>,
    progress: Progress<'_>,
) -> Result<Vec<Solved<N>>, Box<dyn Error>> {
    let layout = problem.layout;
    let mut out = Vec::new();
    for &name in problem.methods {
        progress(&name.to_string());
        let start = Instant::now();
        let sampled = material.sample.len();
        let robust = || irls(&material.clean_sums, &material.sample, layout);
        let mut solved = match name {
            MethodName::Ols => linear(name, ols(&material.sums, layout), material.rows)?,
            MethodName::Wls => linear(name, wls(&material.sums, layout), material.rows)?,
            MethodName::Irls => linear(name, robust(), sampled)?,
            MethodName::Consistent => {
                let free = robust().ok_or_else(unsolvable)?;
                let found = consistent(problem.robot, layout, &free).ok_or_else(unsolvable)?;
                Solved {
                    robot: Some(found.robot),
                    distance_nats: Some(found.distance_nats),
                    ..linear(name, Some(found.fit), sampled)?
                }
            }
            MethodName::Evidence => {
                let free = robust().ok_or_else(unsolvable)?;
                let joints = (0..N).map(|joint| {
                    let sigma = free.sigma[joint];
                    huber(joint, &material.sample, layout, &free.theta, sigma)
                });
                let sums = NormalEquations::<N> {
                    joints: joints.collect(),
                };
                let fit = evidence(problem.robot, layout, &sums, &free.sigma);
                linear(name, fit, sampled)?
            }
            MethodName::BpPhysical => physical(problem, material, progress)?,
            MethodName::BpBlackBox => black_box(problem, material, progress),
            MethodName::BpResidual => residual(problem, material, progress)?,
        };
        solved.seconds = start.elapsed().as_secs_f64();
        out.push(solved);
    }
    Ok(out)
}

fn linear<const N: usize>(
    name: MethodName,
    fit: Option<Fit<N>>,
    rows: usize,
) -> Result<Solved<N>, Box<dyn Error>> {
    let fit = fit.ok_or_else(unsolvable)?;
    Ok(Solved {
        epochs: fit.iterations,
        fit: Some(fit.clone()),
        ..Solved::plain(name, Candidate::Linear(fit.theta), rows)
    })
}

/// The layer whose loss is the weighted one: every joint's rows divided by the noise of `fit`.
pub(super) fn layer_of<const N: usize>(
    material: &Material<'_, N>,
    layout: &Layout<N>,
    fit: &Fit<N>,
) -> LinearLayer {
    let (gram, moment) = material.sums.weighted(layout, &fit.sigma);
    let joints = material.sums.joints.iter().zip(&fit.sigma);
    let power = joints
        .map(|(joint, sigma)| joint.power / (sigma * sigma))
        .sum();
    LinearLayer::new(&gram, &moment, power, material.sums.count())
}

/// Every joint's rows are divided by the noise an ordinary fit leaves, so that the layer's loss is the weighted one.
fn physical<const N: usize>(
    problem: &Problem<'_, N>,
    material: &Material<'_, N>,
    progress: Progress<'_>,
) -> Result<Solved<N>, Box<dyn Error>> {
    let layout = problem.layout;
    let reference = wls(&material.sums, layout).ok_or_else(unsolvable)?;
    let layer = layer_of(material, layout, &reference);
    let goal = layer.loss_of(&reference.theta);
    let mut watch =
        |epoch: usize, loss: f64| progress(&format!("bp_physical  epoch {epoch}  loss {loss:.5}"));
    let train = |descent, watch: &mut dyn FnMut(usize, f64)| -> Trained {
        layer.train(&PhysicalConfig::new(descent, problem.seed), watch)
    };
    let fast = train(Descent::Accelerated, &mut watch);
    let slow = train(Descent::Plain, &mut watch);
    let candidate = Candidate::Linear(fast.theta.clone());
    Ok(Solved {
        epochs: fast.losses.len().saturating_sub(1),
        losses: thinned(&fast.losses),
        epochs_to_wls: Some([fast.epochs_to(1.05, goal), slow.epochs_to(1.05, goal)]),
        // The layer ends where weighted least squares does, so its uncertainty is the same.
        fit: Some(Fit {
            theta: fast.theta,
            ..reference
        }),
        ..Solved::plain(MethodName::BpPhysical, candidate, material.rows)
    })
}

fn black_box<const N: usize>(
    problem: &Problem<'_, N>,
    material: &Material<'_, N>,
    progress: Progress<'_>,
) -> Solved<N> {
    let rows: Vec<_> = material
        .sample
        .iter()
        .map(|row| (row.state, row.tau, row.moving))
        .collect();
    let network = BlackBox::train(&rows, problem.seed, &mut |epoch, loss| {
        progress(&format!("bp_black_box  epoch {epoch}  loss {loss:.5}"));
    });
    Solved {
        epochs: network.losses.len(),
        losses: thinned(&network.losses),
        ..Solved::plain(
            MethodName::BpBlackBox,
            Candidate::BlackBox(Box::new(network)),
            rows.len(),
        )
    }
}

impl<const N: usize> Solved<N> {
    /// What the report says about it, validation apart.
    pub(super) fn record(
        &self,
        layout: &Layout<N>,
        truth: Option<&[Option<f64>]>,
        split_80_20: SplitRecord,
    ) -> MethodRecord {
        let parameters = self.fit.as_ref().map_or_else(Vec::new, |fit| {
            let deviations = fit.deviations();
            let named = layout.parameters.iter().enumerate();
            // Columns the method does not have carry neither value nor deviation.
            let own = named.filter(|(place, _)| fit.covariance[(*place, *place)] > 0.0);
            own.map(|(place, parameter)| ParameterRecord {
                name: parameter.name.clone(),
                value: fit.theta[place],
                unit: parameter.unit.to_owned(),
                std: deviations[place],
                ci95: None,
                truth: truth.and_then(|truth| truth[place]),
            })
            .collect()
        });
        let base_parameter_error_ratio = match (&self.fit, truth) {
            (Some(fit), Some(truth)) => base_error(&fit.theta, truth, layout.base),
            _ => None,
        };
        MethodRecord {
            validation: BTreeMap::new(),
            split_80_20,
            parameters,
            base_parameter_error_ratio,
            noise_nm: self
                .fit
                .as_ref()
                .map_or_else(Vec::new, |fit| fit.sigma.to_vec()),
            rows: self.rows,
            epochs: self.epochs,
            seconds: self.seconds,
            learning_curve: Vec::new(),
            loss_ratio: self.losses.clone(),
            distance_from_free_nats: self.distance_nats,
            epochs_to_1_05_wls: self.epochs_to_wls,
            base_parameter_error_ratio_by_epoch: Vec::new(),
        }
    }
}

/// Epoch and loss, at most [`CURVE`] points, first and last kept.
pub(super) fn thinned(losses: &[f64]) -> Vec<(usize, f64)> {
    let stride = losses.len().div_ceil(CURVE).max(1);
    let last = losses.len().saturating_sub(1);
    let points = losses.iter().copied().enumerate();
    points
        .filter(|(epoch, _)| epoch % stride == 0 || *epoch == last)
        .collect()
}
