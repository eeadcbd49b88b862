//! The paper's split: 80 % of the rows to train on, 20 % to judge by. It flatters.

use super::columns::Layout;
use super::gathered::{Gathered, SampleRow};
use super::record::SplitRecord;
use super::solve::{Material, Problem, solve_all};
use super::validation::Candidate;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::error::Error;

/// Share of the rows the paper trains on.
const TRAINING_SHARE: f64 = 0.8;

/// Trains on 80 % of the rows, drawn at random, and scores on the rest.
pub(super) fn split<const N: usize>(
    problem: &Problem<'_, N>,
    gathered: &Gathered<N>,
) -> Result<Vec<SplitRecord>, Box<dyn Error>> {
    let layout = problem.layout;
    let mut random = ChaCha8Rng::seed_from_u64(problem.seed);
    let (training, held_out): (Vec<&SampleRow<N>>, Vec<&SampleRow<N>>) = gathered
        .sample
        .iter()
        .partition(|_| random.random_range(0.0..1.0) < TRAINING_SHARE);
    let material = Material::of(layout, training);
    let solved = solve_all(problem, &material, &|_| ())?;
    Ok(solved
        .iter()
        .map(|solved| {
            let (rmse_moving_nm, nrmse_moving_ratio) = errors(layout, &solved.candidate, &held_out);
            SplitRecord {
                rmse_moving_nm,
                nrmse_moving_ratio,
            }
        })
        .collect())
}

/// RMS error of every joint over its moving rows, N·m, and over the RMS torque.
pub(super) fn errors<const N: usize>(
    layout: &Layout<N>,
    candidate: &Candidate<N>,
    rows: &[&SampleRow<N>],
) -> (Vec<Option<f64>>, Vec<Option<f64>>) {
    let (mut rmse, mut ratio) = (Vec::new(), Vec::new());
    for joint in 0..N {
        let (mut error, mut power, mut count) = (0.0, 0.0, 0.0);
        for row in rows.iter().filter(|row| row.moving[joint]) {
            let theta = candidate.theta();
            let linear = theta.map_or(0.0, |theta| row.linear(layout, theta, joint));
            let network = candidate.network(&row.state).map_or(0.0, |tau| tau[joint]);
            let ripple = candidate.ripple(joint, &row.waves[joint]);
            error += (linear + ripple + network - row.tau[joint]).powi(2);
            power += row.tau[joint].powi(2);
            count += 1.0;
        }
        rmse.push((count > 0.0).then(|| f64::sqrt(error / count)));
        ratio.push((power > 0.0).then(|| f64::sqrt(error / power)));
    }
    (rmse, ratio)
}
