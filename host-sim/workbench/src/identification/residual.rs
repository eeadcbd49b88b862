//! The linear model that the board has and one small BP network a joint for what it leaves.

use super::cogging::CoggingAmplitudes;
use super::columns::Layout;
use super::error::IdentifyError;
use super::methods::{Fit, MethodName, wls};
use super::normal::NormalEquations;
use super::problem::{Candidate, MethodResult, Problem, Progress, TrainingData, thinned};
use crate::training::{ResidualConfig, train_residual};
use foretorque::feedforward::JointNetwork;
use foretorque::learning::network_inputs;
use nalgebra::{DMatrix, DVector};
use std::sync::mpsc::channel;

/// Times the linear model is fitted, each time to what the networks leave: a friction curve that the linear model cannot
/// follow would bend its other parameters.
const ROUNDS: usize = 3;

/// One network and the loss of each step, as a ratio of the torque limit.
type Trained = (JointNetwork, Vec<f64>);

/// Fits the columns of the board to rows without spikes and trains the networks on what is left, in turns.
pub(super) fn residual<const N: usize>(
    problem: &Problem<'_, N>,
    data: &TrainingData<'_, N>,
    progress: Progress<'_>,
) -> Result<MethodResult<N>, IdentifyError> {
    let Problem {
        robot,
        layout,
        board,
        ..
    } = *problem;
    let limits: [f64; N] = std::array::from_fn(|joint| robot.joints[joint].limits.torque);
    let mut cogging: CoggingAmplitudes<N> = [[0.0; 2]; N];
    // Cogging is fast against every other column: fitted in turns, both are there after a few.
    let solve = |sums: &NormalEquations<N>, cogging: &mut CoggingAmplitudes<N>| {
        let mut fit = None;
        for _ in 0..ROUNDS {
            let mut rest = sums.clone();
            for (joint, amplitude) in cogging.iter().enumerate() {
                data.cogging
                    .subtract(joint, *amplitude, &mut rest.joints[joint]);
            }
            let found = wls(&rest.subset(layout, board), board).ok_or(IdentifyError::Unsolvable)?;
            let found = widened(&found, layout, board);
            for (joint, amplitude) in cogging.iter_mut().enumerate() {
                let own = found.theta.select_rows(&layout.active[joint]);
                *amplitude = data.cogging.best(joint, &own, found.sigma[joint]);
            }
            fit = Some(found);
        }
        fit.ok_or(IdentifyError::Unsolvable)
    };
    let mut fit = solve(&data.clean_sums, &mut cogging)?;
    let mut trained = train(problem, data, (&fit.theta, &cogging), &limits, progress);
    for _ in 1..ROUNDS {
        let mut sums = data.clean_sums.clone();
        for (joint, (network, _)) in trained.iter().enumerate() {
            let torque = |qd: f64| {
                let output = network.forward(&network_inputs(qd as f32))[0];
                f64::from(output) * limits[joint]
            };
            data.speeds
                .subtract(joint, &mut sums.joints[joint], &torque);
        }
        fit = solve(&sums, &mut cogging)?;
        trained = train(problem, data, (&fit.theta, &cogging), &limits, progress);
    }
    let epochs = trained.iter().map(|(_, losses)| losses.len()).max();
    let mean: Vec<f64> = (0..epochs.unwrap_or(0))
        .map(|epoch| {
            let at = |losses: &[f64]| losses.get(epoch).or(losses.last()).copied().unwrap_or(0.0);
            trained.iter().map(|(_, losses)| at(losses)).sum::<f64>() / N as f64
        })
        .collect();
    let networks: Vec<JointNetwork> = trained.into_iter().map(|(network, _)| network).collect();
    let networks: [JointNetwork; N] = networks.try_into().map_err(|_| IdentifyError::Untrained)?;
    let candidate = Candidate::Residual {
        theta: fit.theta.clone(),
        cogging,
        networks: Box::new(networks),
        limits,
    };
    Ok(MethodResult {
        fit: Some(fit),
        epochs: mean.len(),
        losses: thinned(&mean),
        ..MethodResult::plain(MethodName::BpResidual, candidate, data.sample.len())
    })
}

/// Trains the networks of all joints on what parameters and cogging leave.
fn train<const N: usize>(
    problem: &Problem<'_, N>,
    data: &TrainingData<'_, N>,
    (theta, cogging): (&DVector<f64>, &CoggingAmplitudes<N>),
    limits: &[f64; N],
    progress: Progress<'_>,
) -> Vec<Trained> {
    let (reported, news) = channel();
    std::thread::scope(|scope| {
        let joints: Vec<_> = (0..N)
            .map(|joint| {
                let reported = reported.clone();
                scope.spawn(move || {
                    let of = |half| {
                        let speeds = &data.speeds;
                        let cogging = cogging[joint];
                        speeds.residuals(problem.layout, theta, cogging, joint, half, limits[joint])
                    };
                    let config = ResidualConfig {
                        seed: problem.seed,
                        ..ResidualConfig::default()
                    };
                    let fastest = problem.robot.joints[joint].limits.velocity;
                    train_residual(&[of(0), of(1)], fastest, &config, &mut |step, loss| {
                        // Nobody listens only when the command is already failing.
                        let _ = reported.send((joint, step, loss));
                    })
                })
            })
            .collect();
        drop(reported);
        for (joint, step, loss) in news {
            progress(&format!(
                "bp_residual  joint {}  step {step}  loss {:.4} % of the torque limit",
                joint + 1,
                100.0 * loss
            ));
        }
        // A joint that panicked has said so already.
        let joints = joints.into_iter();
        joints.filter_map(|joint| joint.join().ok()).collect()
    })
}

/// A fit over the columns of the board as one over all columns; the others are zero, and certain to be.
fn widened<const N: usize>(fit: &Fit<N>, layout: &Layout<N>, board: &Layout<N>) -> Fit<N> {
    let places = layout.places_of(board);
    let size = layout.parameters.len();
    let mut theta = DVector::zeros(size);
    let mut covariance = DMatrix::zeros(size, size);
    for (own, &place) in places.iter().enumerate() {
        theta[place] = fit.theta[own];
        for (other, &column) in places.iter().enumerate() {
            covariance[(place, column)] = fit.covariance[(own, other)];
        }
    }
    Fit {
        theta,
        covariance,
        ..fit.clone()
    }
}
