//! One method after the other on the same training data.

use super::IdentifyError;
use super::columns::Layout;
use super::consistent::consistent;
use super::methods::{Fit, MethodName, evidence, irls, ols, wls};
use super::normal::SampleRow;
use super::normal::{CoggingAmplitudes, NormalEquations};
use super::problem::{Candidate, MethodResult, Problem, Progress, TrainingData, thinned};
use crate::dynamics::PerJoint;
use crate::parallel::in_parallel;
use crate::robot::Robot;
use crate::training::{BlackBox, Descent, PhysicalConfig, train_residual};
use foretorque::feedforward::JointNetwork;
use foretorque::learning::network_inputs;
use nalgebra::{DMatrix, DVector};
use std::time::Instant;

/// Trains `methods` on `rows`, whose panels are those of `layout`: for studies over many small sets of rows.
///
/// * `board` the columns among them that the board has: the linear part of `bp_residual`
///
/// Errors: columns that the rows do not show; a method that cannot be solved.
pub fn fit_rows(
    robot: &Robot,
    (layout, board): (&Layout, &Layout),
    methods: &[MethodName],
    rows: &[&SampleRow],
    seed: u64,
) -> Result<Vec<MethodResult>, IdentifyError> {
    let data = TrainingData::of(layout, rows.to_vec());
    data.sums.all.check_rank(layout)?;
    let problem = Problem {
        robot,
        layout,
        board,
        methods,
        networks: true,
        seed,
    };
    solve_all(&problem, &data, &|_| ())
}

/// The results of all methods, in the order of the problem.
pub(super) fn solve_all(
    problem: &Problem<'_>,
    data: &TrainingData<'_>,
    progress: Progress<'_>,
) -> Result<Vec<MethodResult>, IdentifyError> {
    let methods = problem.methods.iter();
    // Three methods share the robust fit.
    let is_robust = |name: &MethodName| {
        matches!(
            name,
            MethodName::Irls | MethodName::Consistent | MethodName::Evidence
        )
    };
    let (start, sums) = (Instant::now(), &data.sums.clean);
    let robust = methods.clone().any(is_robust);
    let robust = robust.then(|| irls(sums, &data.sample, problem.layout));
    let robust = robust.transpose()?;
    let robust_s = start.elapsed().as_secs_f64();
    methods
        .map(|name| {
            progress(&name.to_string());
            let start = Instant::now();
            let mut result = solve_one(*name, problem, data, robust.as_ref(), progress)?;
            let shared_s = if is_robust(name) { robust_s } else { 0.0 };
            result.record.seconds = shared_s + start.elapsed().as_secs_f64();
            Ok(result)
        })
        .collect()
}

fn solve_one(
    name: MethodName,
    problem: &Problem<'_>,
    data: &TrainingData<'_>,
    robust: Option<&Fit>,
    progress: Progress<'_>,
) -> Result<MethodResult, IdentifyError> {
    let layout = problem.layout;
    let sampled = data.sample.len();
    let robust = || robust.ok_or(IdentifyError::Unsolvable);
    let linear = |fit: Result<Fit, IdentifyError>, rows| {
        let fit = fit?;
        let candidate = Candidate::Linear(fit.theta.clone());
        Ok(MethodResult {
            fit: Some(fit.clone()),
            ..MethodResult::plain(name, candidate, (rows, fit.iterations))
        })
    };
    match name {
        MethodName::Ols => linear(ols(&data.sums.all, layout), data.sums.rows),
        MethodName::Wls => linear(wls(&data.sums.all, layout), data.sums.rows),
        MethodName::Irls => linear(robust().cloned(), sampled),
        MethodName::Consistent => {
            let found = consistent(problem.robot, layout, robust()?);
            let (fit, robot, nats) = found.ok_or(IdentifyError::Unsolvable)?;
            let mut result = linear(Ok(fit), sampled)?;
            result.robot = Some(robot);
            result.record.distance_from_free_nats = Some(nats);
            Ok(result)
        }
        MethodName::Evidence => {
            let free = robust()?;
            let sums = data.robust_sums(layout, &free.theta, &free.sigma);
            linear(evidence(problem.robot, layout, &sums, &free.sigma), sampled)
        }
        MethodName::BpPhysical => physical(problem, data, progress),
        MethodName::BpBlackBox => Ok(black_box(problem, data, progress)),
        MethodName::BpResidual => residual(problem, data, progress),
    }
}

/// Result of `bp_physical`: every joint's rows are divided by the noise of weighted least squares.
fn physical(
    problem: &Problem<'_>,
    data: &TrainingData<'_>,
    progress: Progress<'_>,
) -> Result<MethodResult, IdentifyError> {
    let layout = problem.layout;
    let reference = wls(&data.sums.all, layout)?;
    let layer = data.layer(layout, &reference);
    let goal = layer.loss_of(&reference.theta);
    let mut watch =
        |epoch: usize, loss: f64| progress(&format!("bp_physical  epoch {epoch}  loss {loss:.5}"));
    let config = PhysicalConfig::new(Descent::Accelerated, problem.seed);
    let trained = layer.train(&config, &mut watch);
    let candidate = Candidate::Linear(trained.theta.clone());
    let size = (data.sums.rows, trained.losses.len().saturating_sub(1));
    let mut result = MethodResult::plain(MethodName::BpPhysical, candidate, size);
    result.record.loss_ratio = thinned(&trained.losses);
    result.record.epochs_to_1_05_wls = Some([trained.epochs_to(1.05, goal), None]);
    // The minimum is that of weighted least squares, and so is the uncertainty.
    result.fit = Some(Fit {
        theta: trained.theta,
        ..reference
    });
    Ok(result)
}

fn black_box(
    problem: &Problem<'_>,
    data: &TrainingData<'_>,
    progress: Progress<'_>,
) -> MethodResult {
    let rows = data.sample.iter();
    let rows: Vec<_> = rows.map(|row| (row.state, row.tau, row.moving)).collect();
    let network = BlackBox::train(&rows, problem.seed, &mut |epoch, loss| {
        progress(&format!("bp_black_box  epoch {epoch}  loss {loss:.5}"));
    });
    let (size, losses) = ((rows.len(), network.losses.len()), thinned(&network.losses));
    let candidate = Candidate::BlackBox(Box::new(network));
    let mut result = MethodResult::plain(MethodName::BpBlackBox, candidate, size);
    result.record.loss_ratio = losses;
    result
}

/// Number of fits of the linear model, each to what the networks leave: a friction curve that the linear model cannot
/// follow would bias its other parameters.
const RESIDUAL_ROUNDS: usize = 3;

/// One network and the loss of each step, as a ratio of the torque limit.
type TrainedNetwork = (JointNetwork, Vec<f64>);

/// Linear model and cogging amplitudes.
type Linear = (Fit, CoggingAmplitudes);

/// Result of `bp_residual`: columns of the board fitted to rows without spikes and networks trained on what is left, in
/// turns.
fn residual(
    problem: &Problem<'_>,
    data: &TrainingData<'_>,
    progress: Progress<'_>,
) -> Result<MethodResult, IdentifyError> {
    let alone = data.sums.clean.subset(problem.layout, problem.board);
    let alone = widened(&wls(&alone, problem.board)?, problem.layout, problem.board);
    let plain = Candidate::Linear(alone.theta.clone());
    if !problem.networks {
        return Ok(MethodResult {
            fit: Some(alone),
            ..MethodResult::plain(MethodName::BpResidual, plain, (data.sample.len(), 0))
        });
    }
    let joints = problem.layout.joints();
    let limits = PerJoint::from_fn(joints, |joint| problem.robot.joints[joint].limits.torque);
    let mut linear = fit(
        problem,
        data,
        &data.sums.clean,
        PerJoint::repeat(joints, [0.0; 2]),
    )?;
    let mut trained = train(problem, data, &linear, &limits, progress);
    for _ in 1..RESIDUAL_ROUNDS {
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
    let (mut fit, cogging) = linear;
    let mut candidate = Candidate::Residual {
        theta: fit.theta.clone(),
        cogging,
        networks,
        limits: limits.to_vec(),
    };
    // Networks and cogging that do not even fit their own rows better are left out.
    let square =
        |candidate: &Candidate| weighted_square(problem.layout, data, candidate, &alone.sigma);
    let better = square(&candidate) <= square(&plain);
    if !better {
        (candidate, fit) = (plain, alone.clone());
    }
    let size = (data.sample.len(), mean.len());
    let mut result = MethodResult::plain(MethodName::BpResidual, candidate, size);
    result.record.loss_ratio = thinned(&mean);
    (result.fit, result.linear) = (Some(fit), Some(alone));
    Ok(result)
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
    for _ in 0..RESIDUAL_ROUNDS {
        let mut rest = sums.clone();
        for (joint, amplitude) in cogging.iter().enumerate() {
            let sums = &mut rest.joints[joint];
            data.sums.cogging.joints[joint].subtract_cogging(*amplitude, sums);
        }
        let found = widened(&wls(&rest.subset(layout, board), board)?, layout, board);
        for (joint, amplitude) in cogging.iter_mut().enumerate() {
            let own = found.theta.select_rows(&layout.active[joint]);
            *amplitude = data.sums.cogging.joints[joint].best_cogging(&own, found.sigma[joint]);
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
) -> Vec<TrainedNetwork> {
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
