//! Errors on rows held out: the 80/20 split of the paper, and growing shares of the log against an unseen one.

use super::columns::Layout;
use super::dataset::SampleRow;
use super::error::IdentifyError;
use super::methods::MethodName;
use super::problem::{Candidate, Problem, TrainingData};
use super::record::{LearningPoint, SplitRecord};
use super::solve::solve_all;
use crate::dynamics::PerJoint;
use crate::metrics::root_mean_square;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Share of the rows the paper trains on.
const TRAINING_SHARE: f64 = 0.8;
/// Rows of the whole log that are shared out for the learning curves.
const ROWS: usize = 4000;
/// Shares from the start of the log.
const SHARES: [f64; 5] = [0.0625, 0.125, 0.25, 0.5, 1.0];

/// Errors on 20 % of the rows, drawn at random, of every method trained on the rest.
pub(super) fn split(
    problem: &Problem<'_>,
    sample: &[SampleRow],
) -> Result<Vec<SplitRecord>, IdentifyError> {
    let mut random = ChaCha8Rng::seed_from_u64(problem.seed);
    let (training, held_out): (Vec<&SampleRow>, Vec<&SampleRow>) = sample
        .iter()
        .partition(|_| random.random_range(0.0..1.0) < TRAINING_SHARE);
    let data = TrainingData::of(problem.layout, training);
    let results = solve_all(problem, &data, &|_| ())?;
    let records = results.iter();
    Ok(records
        .map(|result| errors(problem.layout, &result.candidate, &held_out))
        .collect())
}

/// Errors on rows of an unseen log of every method trained on growing shares of the log.
pub(super) fn learning_curves(
    problem: &Problem<'_>,
    sample: &[SampleRow],
    unseen: &[SampleRow],
) -> Vec<(MethodName, Vec<LearningPoint>)> {
    let stride = sample.len().div_ceil(ROWS).max(1);
    let rows: Vec<&SampleRow> = sample.iter().step_by(stride).collect();
    let unseen: Vec<&SampleRow> = unseen.iter().collect();
    let methods = problem.methods.iter();
    methods
        .map(|&name| {
            let one = Problem {
                methods: &[name],
                ..*problem
            };
            let points = SHARES.iter().filter_map(|&share_ratio| {
                let count = (share_ratio * rows.len() as f64) as usize;
                let data = TrainingData::of(problem.layout, rows[..count].to_vec());
                // A share that does not show every parameter has no point.
                data.sums.all.check_rank(problem.layout).ok()?;
                let result = solve_all(&one, &data, &|_| ()).ok()?.pop()?;
                let errors = errors(problem.layout, &result.candidate, &unseen);
                Some(LearningPoint {
                    share_ratio,
                    rows: count,
                    seconds: result.seconds,
                    joints_nrmse_moving_ratio: root_mean_square(&errors.nrmse_moving_ratio),
                })
            });
            (name, points.collect())
        })
        .collect()
}

/// RMS error of every joint over its moving rows.
pub(super) fn errors(layout: &Layout, candidate: &Candidate, rows: &[&SampleRow]) -> SplitRecord {
    let zero = PerJoint::repeat(layout.joints(), 0.0);
    let (mut error, mut power, mut count) = (zero, zero, zero);
    for row in rows {
        let predicted = candidate.torque(layout, row);
        for joint in (0..layout.joints()).filter(|&joint| row.moving[joint]) {
            error[joint] += (predicted[joint] - row.tau[joint]).powi(2);
            power[joint] += row.tau[joint].powi(2);
            count[joint] += 1.0;
        }
    }
    let root = |over: PerJoint<f64>| {
        let joints = error.iter().zip(over.iter());
        let roots = joints.map(|(error, over)| (*over > 0.0).then(|| f64::sqrt(error / over)));
        roots.collect()
    };
    SplitRecord {
        rmse_moving_nm: root(count),
        nrmse_moving_ratio: root(power),
    }
}
