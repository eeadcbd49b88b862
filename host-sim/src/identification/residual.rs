//! The plain linear model and one small BP network a joint for what it leaves.

use super::methods::{Fit, MethodName, wls};
use super::solve::{Material, Problem, Solved, thinned, unsolvable};
use super::study::Progress;
use super::validation::Candidate;
use crate::training::{ResidualConfig, train_residual};
use foretorque::feedforward::JointNetwork;
use nalgebra::DVector;
use std::error::Error;

/// Fits the plain columns to rows without spikes and trains the networks on what is left.
pub(super) fn residual<const N: usize>(
    problem: &Problem<'_, N>,
    material: &Material<'_, N>,
    progress: Progress<'_>,
) -> Result<Solved<N>, Box<dyn Error>> {
    let Problem {
        robot,
        layout,
        plain,
        ..
    } = *problem;
    let fit = wls(&material.clean_sums.subset(layout, plain), plain).ok_or_else(unsolvable)?;
    let places = layout.places_of(plain);
    let widened = |values: &DVector<f64>| {
        let mut out = DVector::zeros(layout.parameters.len());
        for (value, &place) in values.iter().zip(&places) {
            out[place] = *value;
        }
        out
    };
    let theta = widened(&fit.theta);
    let limits: [f64; N] = std::array::from_fn(|joint| robot.joints[joint].limits.torque);
    let (told, news) = std::sync::mpsc::channel();
    let trained: Vec<(JointNetwork, Vec<f64>)> = std::thread::scope(|scope| {
        let theta = &theta;
        let joints: Vec<_> = (0..N)
            .map(|joint| {
                let told = told.clone();
                scope.spawn(move || {
                    let of = |half| {
                        let speeds = &material.speeds;
                        speeds.residuals(layout, theta, joint, half, limits[joint])
                    };
                    let residual = ResidualConfig {
                        seed: problem.seed,
                        ..ResidualConfig::default()
                    };
                    let fastest = robot.joints[joint].limits.velocity;
                    train_residual(&[of(0), of(1)], fastest, &residual, &mut |step, loss| {
                        // Nobody listens only when the command is already failing.
                        let _ = told.send((joint, step, loss));
                    })
                })
            })
            .collect();
        drop(told);
        for (joint, step, loss) in news {
            progress(&format!(
                "bp_residual  joint {}  step {step}  loss {:.4} % of the torque limit",
                joint + 1,
                100.0 * loss
            ));
        }
        // A joint that panicked has said so already.
        joints
            .into_iter()
            .filter_map(|joint| joint.join().ok())
            .collect()
    });
    let epochs = trained
        .iter()
        .map(|(_, losses)| losses.len())
        .max()
        .unwrap_or(0);
    let mean: Vec<f64> = (0..epochs)
        .map(|epoch| {
            let at = |losses: &[f64]| losses.get(epoch).or(losses.last()).copied().unwrap_or(0.0);
            trained.iter().map(|(_, losses)| at(losses)).sum::<f64>() / N as f64
        })
        .collect();
    let networks: Vec<JointNetwork> = trained.into_iter().map(|(network, _)| network).collect();
    let networks: [JointNetwork; N] = networks
        .try_into()
        .map_err(|_| "a network could not be trained")?;
    let mut covariance = nalgebra::DMatrix::zeros(layout.parameters.len(), layout.parameters.len());
    for (row, &r) in places.iter().enumerate() {
        for (column, &c) in places.iter().enumerate() {
            covariance[(r, c)] = fit.covariance[(row, column)];
        }
    }
    let candidate = Candidate::Residual {
        theta: theta.clone(),
        networks: Box::new(networks),
        limits,
    };
    Ok(Solved {
        fit: Some(Fit {
            theta,
            covariance,
            sigma: fit.sigma,
            iterations: fit.iterations,
        }),
        epochs,
        losses: thinned(&mean),
        ..Solved::plain(MethodName::BpResidual, candidate, material.sample.len())
    })
}
