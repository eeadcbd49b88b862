//! One method after the other on the same training data.

use super::IdentifyError;
use super::columns::Layout;
use super::consistent::consistent;
use super::dataset::SampleRow;
use super::evidence::evidence;
use super::methods::{Fit, MethodName, irls, ols, wls};
use super::problem::{Candidate, MethodResult, Problem, Progress, TrainingData, thinned};
use super::residual::residual;
use crate::robot::Robot;
use crate::training::{BlackBox, Descent, PhysicalConfig, Trained};
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
    methods
        .map(|&name| {
            progress(&name.to_string());
            let start = Instant::now();
            let result = solve_one(name, problem, data, progress)?;
            Ok(MethodResult {
                seconds: start.elapsed().as_secs_f64(),
                ..result
            })
        })
        .collect()
}

fn solve_one(
    name: MethodName,
    problem: &Problem<'_>,
    data: &TrainingData<'_>,
    progress: Progress<'_>,
) -> Result<MethodResult, IdentifyError> {
    let layout = problem.layout;
    let sampled = data.sample.len();
    let robust = || irls(&data.sums.clean, &data.sample, layout);
    let linear = |fit: Option<Fit>, rows| {
        let fit = fit.ok_or(IdentifyError::Unsolvable)?;
        Ok(MethodResult {
            epochs: fit.iterations,
            fit: Some(fit.clone()),
            ..MethodResult::plain(name, Candidate::Linear(fit.theta), rows)
        })
    };
    match name {
        MethodName::Ols => linear(ols(&data.sums.all, layout), data.sums.rows),
        MethodName::Wls => linear(wls(&data.sums.all, layout), data.sums.rows),
        MethodName::Irls => linear(robust(), sampled),
        MethodName::Consistent => {
            let free = robust().ok_or(IdentifyError::Unsolvable)?;
            let found =
                consistent(problem.robot, layout, &free).ok_or(IdentifyError::Unsolvable)?;
            Ok(MethodResult {
                robot: Some(found.robot),
                distance_nats: Some(found.distance_nats),
                ..linear(Some(found.fit), sampled)?
            })
        }
        MethodName::Evidence => {
            let free = robust().ok_or(IdentifyError::Unsolvable)?;
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
    let reference = wls(&data.sums.all, layout).ok_or(IdentifyError::Unsolvable)?;
    let layer = data.layer(layout, &reference);
    let goal = layer.loss_of(&reference.theta);
    let mut watch =
        |epoch: usize, loss: f64| progress(&format!("bp_physical  epoch {epoch}  loss {loss:.5}"));
    let mut train = |descent| -> Trained {
        layer.train(&PhysicalConfig::new(descent, problem.seed), &mut watch)
    };
    let fast = train(Descent::Accelerated);
    let slow = train(Descent::Plain);
    let candidate = Candidate::Linear(fast.theta.clone());
    Ok(MethodResult {
        epochs: fast.losses.len().saturating_sub(1),
        losses: thinned(&fast.losses),
        epochs_to_wls: Some([fast.epochs_to(1.05, goal), slow.epochs_to(1.05, goal)]),
        // The minimum is that of weighted least squares, and so is the uncertainty.
        fit: Some(Fit {
            theta: fast.theta,
            ..reference
        }),
        ..MethodResult::plain(MethodName::BpPhysical, candidate, data.sums.rows)
    })
}

/// Result of `bp_black_box`.
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
    let (epochs, losses) = (network.losses.len(), thinned(&network.losses));
    let candidate = Candidate::BlackBox(Box::new(network));
    MethodResult {
        epochs,
        losses,
        ..MethodResult::plain(MethodName::BpBlackBox, candidate, rows.len())
    }
}
