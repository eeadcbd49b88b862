//! Delay of the torques behind the positions.

use super::{ANALYTIC, DELAY_S, DEVIATIONS, FAST_RAD_S, Judgement};
use nalgebra::{DMatrix, DVector};

/// Delays that are tried on each side of none, and the largest of them, s.
const TRIED: usize = 20;
const LONGEST_S: f64 = 0.1;

/// Normal equations of one joint with its torque at several delays.
#[derive(Default)]
pub(super) struct Delay {
    gram: Option<DMatrix<f64>>,
    /// One column for each delay.
    moments: DMatrix<f64>,
    powers: DVector<f64>,
    count: f64,
}

/// Rows between two delays that are tried.
pub(super) fn step_rows(period_s: f64) -> usize {
    ((LONGEST_S / TRIED as f64 / period_s).round() as usize).max(1)
}

impl Delay {
    /// Adds row `row` with the torques `tau_nm` around it, if all are there; an offset and friction that falls with the speed
    /// stand beside the columns `x`.
    pub(super) fn add(
        &mut self,
        x: &[f64],
        qd: f64,
        (row, step): (usize, usize),
        tau_nm: &dyn Fn(usize) -> Option<f64>,
    ) {
        let reach = TRIED * step;
        let Some(first) = row.checked_sub(reach) else {
            return;
        };
        let torques: Option<Vec<f64>> = (0..=2 * TRIED).map(|k| tau_nm(first + k * step)).collect();
        let Some(torques) = torques.filter(|_| qd.abs() > FAST_RAD_S) else {
            return;
        };
        let torques = DVector::from_vec(torques);
        let falling = qd.signum() * (-qd.abs() / FAST_RAD_S).exp();
        let more = [1.0, falling, qd * qd.abs()];
        let columns = DVector::from_iterator(x.len() + more.len(), x.iter().copied().chain(more));
        let gram = self.gram.get_or_insert_with(|| {
            self.moments = DMatrix::zeros(columns.len(), torques.len());
            self.powers = DVector::zeros(torques.len());
            DMatrix::zeros(columns.len(), columns.len())
        });
        gram.ger(1.0, &columns, &columns, 1.0);
        self.moments.ger(1.0, &columns, &torques, 1.0);
        self.powers += torques.component_mul(&torques);
        self.count += 1.0;
    }

    /// Minus the logarithm of the likelihood of every delay, up to a constant.
    fn costs(&self) -> Option<DVector<f64>> {
        let gram = self.gram.as_ref()?;
        let size = gram
            .diagonal()
            .map(|square| 1.0 / f64::max(square, f64::MIN_POSITIVE).sqrt());
        let scaled = DMatrix::from_fn(gram.nrows(), gram.ncols(), |a, b| {
            gram[(a, b)] * size[a] * size[b]
        });
        let inverse = scaled.pseudo_inverse(1e-8).ok()?;
        let free = self.count - gram.nrows() as f64;
        let rests = DVector::from_fn(self.powers.len(), |delay, _| {
            let moment = self.moments.column(delay).component_mul(&size);
            self.powers[delay] - moment.dot(&(&inverse * &moment))
        });
        let sound = free > 2.0 * gram.nrows() as f64 && rests.min() > 0.0;
        sound.then(|| rests.map(|rest| 0.5 * free * rest.ln()))
    }
}

/// Most likely delay and its standard deviation in steps, by a parabola through the smallest cost and its neighbours.
fn vertex(costs: &DVector<f64>) -> (f64, f64) {
    let at = costs.imin().clamp(1, costs.len() - 2);
    let [before, here, after] = [costs[at - 1], costs[at], costs[at + 1]];
    let curvature = (before + after - 2.0 * here).max(f64::MIN_POSITIVE);
    let beside = (0.5 * (before - after) / curvature).clamp(-1.0, 1.0);
    (
        at as f64 + beside - TRIED as f64,
        ANALYTIC / curvature.sqrt(),
    )
}

/// Delay of the torques behind the positions, common to all joints, of rows `period_s` apart.
pub(super) fn delay(judgement: &mut Judgement, delays: &[Delay], period_s: f64) {
    let Some(costs) = delays.iter().filter_map(Delay::costs).reduce(|a, b| a + b) else {
        return;
    };
    let step_s = step_rows(period_s) as f64 * period_s;
    let (mean, deviation) = vertex(&costs);
    let (mean, deviation) = (mean * step_s, deviation * step_s);
    judgement.delay_s = Some((mean, deviation));
    let clear = mean.abs() > DEVIATIONS * deviation;
    if clear && mean.abs() > DELAY_S.1 {
        let refuses = mean.abs() > DELAY_S.0;
        let side = if mean > 0.0 { "behind" } else { "ahead of" };
        let text = format!(
            "torques are {:.1} ± {:.1} ms {side} the positions: shift them, a delay biases inertias and friction",
            1e3 * mean.abs(),
            1e3 * deviation
        );
        judgement.find(refuses, text);
    }
}
