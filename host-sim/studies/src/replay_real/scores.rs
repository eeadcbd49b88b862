//! Squared errors of the moving rows, joint by joint, and their quotients.

use super::logs::{Row, Stretch};
use super::record::{GATE_RAD_S, N, PathScores, Predictions};
use crate::real_ur5::geometric_mean;

/// Squared errors of one kind of prediction.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Squares {
    sum: [f64; N],
    count: [f64; N],
}

impl Squares {
    fn add(&mut self, joint: usize, error: f64) {
        self.sum[joint] += error * error;
        self.count[joint] += 1.0;
    }

    /// RMS error of every joint that has moved, N·m.
    fn rms(&self) -> Vec<Option<f64>> {
        let joints = self.sum.iter().zip(&self.count);
        joints
            .map(|(sum, &count)| (count > 0.0).then(|| (sum / count).sqrt()))
            .collect()
    }

    /// RMS error over another one's.
    pub(super) fn over(&self, other: &Self) -> Vec<Option<f64>> {
        let pairs = self.rms().into_iter().zip(other.rms());
        pairs.map(|(own, other)| Some(own? / other?)).collect()
    }
}

/// Errors on one path. Those called aged leave out the rows for which there are no old parameters yet.
#[derive(Clone, Debug, Default)]
pub(super) struct Scores {
    pub(super) newest: Squares,
    pub(super) aged: Squares,
    pub(super) frozen: Squares,
    pub(super) plain: Squares,
    pub(super) rich: Squares,
    pub(super) plain_aged: Squares,
    pub(super) rich_aged: Squares,
}

impl Scores {
    /// Adds a stretch; its first `skipped` rows have no old parameters.
    pub(super) fn add(&mut self, stretch: &Stretch, predicted: &Predictions, skipped: usize) {
        for (k, row) in stretch.rows.iter().enumerate() {
            for joint in moving(row) {
                let error = |torques: &[f64]| torques[k * N + joint] - row.tau[joint];
                let [plain, rich] = row.batch.map(|batch| batch[joint] - row.tau[joint]);
                self.newest.add(joint, error(&predicted.newest));
                self.frozen.add(joint, error(&predicted.frozen));
                self.plain.add(joint, plain);
                self.rich.add(joint, rich);
                if k >= skipped {
                    self.aged.add(joint, error(&predicted.aged));
                    self.plain_aged.add(joint, plain);
                    self.rich_aged.add(joint, rich);
                }
            }
        }
    }

    pub(super) fn record(&self, name: &str, within_1_1_after_s: Option<f64>) -> PathScores {
        PathScores {
            path: name.to_owned(),
            batch_rmse_moving_nm: self.rich.rms(),
            newest_ratio: self.newest.over(&self.rich),
            aged_ratio: self.aged.over(&self.rich_aged),
            frozen_ratio: self.frozen.over(&self.rich),
            within_1_1_after_s,
        }
    }
}

/// The joints that move in a row.
fn moving(row: &Row) -> impl Iterator<Item = usize> {
    (0..N).filter(|&joint| row.state.qd[joint].abs() > GATE_RAD_S)
}

/// Rows with motion until the error over the last `window` of them is within `close` times that of rich batch least
/// squares, geometric mean of the joints that move in it.
pub(super) fn motion_until_close(
    stretch: &Stretch,
    newest: &[f64],
    window: f64,
    close: f64,
) -> Option<usize> {
    let in_motion: Vec<usize> = (0..stretch.rows.len())
        .filter(|&k| moving(&stretch.rows[k]).next().is_some())
        .collect();
    let window = window as usize;
    // The window must end after the learner has had the time: what counts is motion before the window begins.
    (0..in_motion.len().saturating_sub(window)).find(|&begin| {
        let (mut own, mut rich) = (Squares::default(), Squares::default());
        for &k in &in_motion[begin..begin + window] {
            let row = &stretch.rows[k];
            for joint in moving(row) {
                own.add(joint, newest[k * N + joint] - row.tau[joint]);
                rich.add(joint, row.batch[1][joint] - row.tau[joint]);
            }
        }
        let ratios: Vec<f64> = own.over(&rich).into_iter().flatten().collect();
        !ratios.is_empty() && geometric_mean(&ratios) <= close
    })
}
