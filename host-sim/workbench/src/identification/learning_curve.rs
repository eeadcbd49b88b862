//! Error of each method by number of rows.

use super::dataset::{Dataset, SampleRow};
use super::methods::MethodName;
use super::problem::{Problem, TrainingData};
use super::record::LearningPoint;
use super::solve::solve_all;
use super::split::errors;

/// Rows of the whole log that are shared out.
const ROWS: usize = 4000;
/// Shares from the start of the log.
const SHARES: [f64; 5] = [0.0625, 0.125, 0.25, 0.5, 1.0];

/// Trains every method on growing shares of the log and judges it on rows of an unseen one.
pub(super) fn learning_curves<const N: usize>(
    problem: &Problem<'_, N>,
    dataset: &Dataset<N>,
    unseen: &[SampleRow<N>],
) -> Vec<(MethodName, Vec<LearningPoint>)> {
    let stride = dataset.sample.len().div_ceil(ROWS).max(1);
    let rows: Vec<&SampleRow<N>> = dataset.sample.iter().step_by(stride).collect();
    let unseen: Vec<&SampleRow<N>> = unseen.iter().collect();
    problem
        .methods
        .iter()
        .map(|&name| {
            let one = Problem {
                methods: &[name],
                ..*problem
            };
            let points = SHARES.iter().filter_map(|&share| {
                let count = (share * rows.len() as f64) as usize;
                let data = TrainingData::of(problem.layout, rows[..count].to_vec());
                // Too short a share shows too little; that is no failure of the study.
                data.sums.check_rank(problem.layout).ok()?;
                let solved = solve_all(&one, &data, &|_| ()).ok()?;
                let solved = solved.first()?;
                let (_, ratios) = errors(problem.layout, &solved.candidate, &unseen);
                let known: Vec<f64> = ratios.into_iter().flatten().collect();
                let squares: f64 = known.iter().map(|ratio| ratio * ratio).sum();
                Some(LearningPoint {
                    share_ratio: share,
                    rows: count,
                    seconds: solved.seconds,
                    joints_nrmse_moving_ratio: (squares / known.len().max(1) as f64).sqrt(),
                })
            });
            (name, points.collect())
        })
        .collect()
}
