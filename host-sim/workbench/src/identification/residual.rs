//! The linear model that the board has and one small BP network a joint for its residual.

use super::IdentifyError;
use super::cogging::CoggingAmplitudes;
use super::columns::Layout;
use super::methods::{Fit, MethodName, wls};
use super::normal::NormalEquations;
use super::problem::{Candidate, MethodResult, Problem, Progress, TrainingData, thinned};
use crate::dynamics::PerJoint;
use crate::parallel::in_parallel;
use crate::training::train_residual;
use foretorque::feedforward::JointNetwork;
use foretorque::learning::network_inputs;
use nalgebra::{DMatrix, DVector};

/// Number of fits of the linear model, each to what the networks leave: a friction curve that the linear model cannot
/// follow would bias its other parameters.
const ROUNDS: usize = 3;

/// One network and the loss of each step, as a ratio of the torque limit.
type Trained = (JointNetwork, Vec<f64>);

/// Linear model and cogging amplitudes.
type Linear = (Fit, CoggingAmplitudes);

/// Result of `bp_residual`: columns of the board fitted to rows without spikes and networks trained on what is left, in
/// turns.
pub(super) fn residual(
    problem: &Problem<'_>,
    data: &TrainingData<'_>,
    progress: Progress<'_>,
) -> Result<MethodResult, IdentifyError> {
    let joints = problem.layout.joints();
    let limits = PerJoint::from_fn(joints, |joint| problem.robot.joints[joint].limits.torque);
    let mut linear = fit(
        problem,
        data,
        &data.sums.clean,
        PerJoint::repeat(joints, [0.0; 2]),
    )?;
    let mut trained = train(problem, data, &linear, &limits, progress);
    for _ in 1..ROUNDS {
        let mut sums = data.sums.clean.clone();
        for (joint, (network, _)) in trained.iter().enumerate() {
            let torque = |qd: f64| {
                let output = network.forward(&network_inputs(qd as f32))[0];
                f64::from(output) * limits[joint]
            };
            data.speeds
                .subtract(joint, &mut sums.joints[joint], &torque);
        }
        linear = fit(problem, data, &sums, linear.1)?;
        trained = train(problem, data, &linear, &limits, progress);
    }
    let (networks, losses): (Vec<JointNetwork>, Vec<Vec<f64>>) = trained.into_iter().unzip();
    let epochs = losses.iter().map(Vec::len).max().unwrap_or(0);
    let at = |losses: &Vec<f64>, epoch| losses.get(epoch).or(losses.last()).copied().unwrap_or(0.0);
    let mean: Vec<f64> = (0..epochs)
        .map(|epoch| losses.iter().map(|own| at(own, epoch)).sum::<f64>() / joints as f64)
        .collect();
    let (fit, cogging) = linear;
    let alone = data.sums.clean.subset(problem.layout, problem.board);
    let alone = wls(&alone, problem.board).ok_or(IdentifyError::Unsolvable)?;
    let alone = widened(&alone, problem.layout, problem.board);
    let mut candidate = Candidate::Residual {
        theta: fit.theta.clone(),
        cogging,
        networks,
        limits: limits.to_vec(),
    };
    let plain = Candidate::Linear(alone.theta.clone());
    let mut fit = fit;
    // Networks and cogging that do not even fit their own rows better are left out.
    let square =
        |candidate: &Candidate| weighted_square(problem.layout, data, candidate, &alone.sigma);
    let better = square(&candidate) <= square(&plain);
    if !better {
        (candidate, fit) = (plain, alone.clone());
    }
    Ok(MethodResult {
        fit: Some(fit),
        linear: Some(alone),
        epochs: mean.len(),
        losses: thinned(&mean),
        ..MethodResult::plain(MethodName::BpResidual, candidate, data.sample.len())
    })
}

/// Mean square residual of the sampled rows, every joint in units of its `sigma`, N·m.
fn weighted_square(
    layout: &Layout,
    data: &TrainingData<'_>,
    candidate: &Candidate,
    sigma: &[f64],
) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for row in &data.sample {
        let torque = candidate.torque(layout, row);
        for joint in (0..layout.joints()).filter(|&joint| row.moving[joint]) {
            sum += ((row.clean[joint] - torque[joint]) / sigma[joint]).powi(2);
            count += 1.0;
        }
    }
    sum / f64::max(count, 1.0)
}

/// Columns of the board and cogging fitted in turns: cogging is fast against every other column, so few turns suffice.
fn fit(
    problem: &Problem<'_>,
    data: &TrainingData<'_>,
    sums: &NormalEquations,
    mut cogging: CoggingAmplitudes,
) -> Result<Linear, IdentifyError> {
    let Problem { layout, board, .. } = *problem;
    let mut fit = None;
    for _ in 0..ROUNDS {
        let mut rest = sums.clone();
        for (joint, amplitude) in cogging.iter().enumerate() {
            let sums = &mut rest.joints[joint];
            data.sums.cogging[joint].subtract(*amplitude, sums);
        }
        let found = wls(&rest.subset(layout, board), board).ok_or(IdentifyError::Unsolvable)?;
        let found = widened(&found, layout, board);
        for (joint, amplitude) in cogging.iter_mut().enumerate() {
            let own = found.theta.select_rows(&layout.active[joint]);
            *amplitude = data.sums.cogging[joint].best(&own, found.sigma[joint]);
        }
        fit = Some(found);
    }
    Ok((fit.ok_or(IdentifyError::Unsolvable)?, cogging))
}

/// Networks of all joints, trained on the residuals of the linear model and cogging.
fn train(
    problem: &Problem<'_>,
    data: &TrainingData<'_>,
    (fit, cogging): &Linear,
    limits: &[f64],
    progress: Progress<'_>,
) -> Vec<Trained> {
    let train = |&joint: &usize| {
        let halves = [0, 1].map(|half| {
            let (layout, place) = (problem.layout, (joint, half));
            data.speeds
                .residuals(layout, &fit.theta, cogging[joint], place, limits[joint])
        });
        let fastest = problem.robot.joints[joint].limits.velocity;
        train_residual(&halves, fastest, problem.seed, &mut |step, loss| {
            let (joint, percent) = (joint + 1, 100.0 * loss);
            progress(&format!(
                "bp_residual  joint {joint}  step {step}  loss {percent:.4} % of the torque limit"
            ));
        })
    };
    let joints: Vec<usize> = (0..limits.len()).collect();
    in_parallel(joints.len(), &joints, train, || ())
}

/// A fit over the columns of the board as one over all columns; the others are zero, with variance zero.
fn widened(fit: &Fit, layout: &Layout, board: &Layout) -> Fit {
    let places = layout.places_of(board);
    let size = layout.parameters.len();
    let (mut theta, mut covariance) = (DVector::zeros(size), DMatrix::zeros(size, size));
    for (own, &place) in places.iter().enumerate() {
        theta[place] = fit.theta[own];
        for (other, &column) in places.iter().enumerate() {
            covariance[(place, column)] = fit.covariance[(own, other)];
        }
    }
    Fit {
        theta,
        covariance,
        ..*fit
    }
}
