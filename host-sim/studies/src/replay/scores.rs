//! Squared errors of the moving rows, joint by joint, and their quotients.

use super::logs::{Row, Stretch};
use super::record::{GATE_RAD_S, PathScores, Predictions};
use crate::real_ur5::geometric_mean;

/// Squared errors of one kind of prediction.
#[derive(Clone, Copy, Debug)]
pub(super) struct Squares<const N: usize> {
    sum: [f64; N],
    count: [f64; N],
}

impl<const N: usize> Default for Squares<N> {
    fn default() -> Self {
        Self {
            sum: [0.0; N],
            count: [0.0; N],
        }
    }
}

impl<const N: usize> Squares<N> {
    pub(super) fn add(&mut self, joint: usize, error: f64) {
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
pub(super) struct Scores<const N: usize> {
    pub(super) newest: Squares<N>,
    pub(super) aged: Squares<N>,
    pub(super) frozen: Squares<N>,
    pub(super) plain: Squares<N>,
    pub(super) rich: Squares<N>,
    pub(super) plain_aged: Squares<N>,
    pub(super) rich_aged: Squares<N>,
    /// Largest error of the newest parameters over that of the start in a window, all joints over their torque limits.
    pub(super) worst_window: Option<f64>,
}

impl<const N: usize> Scores<N> {
    /// Adds a stretch; its first `skipped` rows have no old parameters.
    pub(super) fn add(&mut self, stretch: &Stretch<N>, predicted: &Predictions, skipped: usize) {
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

    /// Compares the newest parameters with the start in every window of `rows` rows; errors are shares of `limits`, N·m, so
    /// that a joint without load does not decide.
    pub(super) fn watch(
        &mut self,
        stretch: &Stretch<N>,
        predicted: &Predictions,
        rows: usize,
        limits: &[f64; N],
    ) {
        let squares = |torques: &[f64], k: usize| -> f64 {
            let row = &stretch.rows[k];
            let joints =
                moving(row).map(|joint| (torques[k * N + joint] - row.tau[joint]) / limits[joint]);
            joints.map(|share| share * share).sum()
        };
        for begin in (0..stretch.rows.len().saturating_sub(rows)).step_by((rows / 4).max(1)) {
            let sum = |torques: &[f64]| {
                (begin..begin + rows)
                    .map(|k| squares(torques, k))
                    .sum::<f64>()
            };
            let (newest, start) = (sum(&predicted.newest), sum(&predicted.frozen));
            if start > 0.0 {
                let ratio = (newest / start).sqrt();
                self.worst_window = Some(self.worst_window.map_or(ratio, |worst| worst.max(ratio)));
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
            worst_window_over_start_ratio: self.worst_window,
        }
    }
}

/// The joints that move in a row.
pub(super) fn moving<const N: usize>(row: &Row<N>) -> impl Iterator<Item = usize> {
    (0..N).filter(|&joint| row.state.qd[joint].abs() > GATE_RAD_S)
}

/// Rows with motion until the error over the last `window` of them is within `close` times that of rich batch least
/// squares, geometric mean of the joints that move in it.
pub(super) fn motion_until_close<const N: usize>(
    stretch: &Stretch<N>,
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
        let (mut own, mut rich) = (Squares::<N>::default(), Squares::default());
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
