//! The paper's split: 80 % of the rows to train on, 20 % to judge by. It flatters.

use super::columns::Layout;
use super::dataset::{Dataset, SampleRow};
use super::error::IdentifyError;
use super::problem::{Candidate, Problem, TrainingData};
use super::record::SplitRecord;
use super::solve::solve_all;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Share of the rows the paper trains on.
const TRAINING_SHARE: f64 = 0.8;

/// Trains on 80 % of the rows, drawn at random, and scores on the rest.
pub(super) fn split<const N: usize>(
    problem: &Problem<'_, N>,
    dataset: &Dataset<N>,
) -> Result<Vec<SplitRecord>, IdentifyError> {
    let layout = problem.layout;
    let mut random = ChaCha8Rng::seed_from_u64(problem.seed);
    let (training, held_out): (Vec<&SampleRow<N>>, Vec<&SampleRow<N>>) = dataset
        .sample
        .iter()
        .partition(|_| random.random_range(0.0..1.0) < TRAINING_SHARE);
    let data = TrainingData::of(layout, training);
    let solved = solve_all(problem, &data, &|_| ())?;
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
    let (mut error, mut power, mut count) = ([0.0; N], [0.0; N], [0.0; N]);
    for row in rows {
        let predicted = candidate.torque(layout, row);
        for joint in (0..N).filter(|&joint| row.moving[joint]) {
            error[joint] += (predicted[joint] - row.tau[joint]).powi(2);
            power[joint] += row.tau[joint].powi(2);
            count[joint] += 1.0;
        }
    }
    let root = |over: [f64; N]| {
        let joints = error.iter().zip(over);
        joints.map(|(error, over)| (over > 0.0).then(|| f64::sqrt(error / over)))
    };
    (root(count).collect(), root(power).collect())
}
