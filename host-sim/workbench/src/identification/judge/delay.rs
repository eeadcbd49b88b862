//! Delay of the torques behind the positions.

use super::{ANALYTIC, DELAY_S, DEVIATIONS, FAST_RAD_S, Judgement};
use nalgebra::{DMatrix, DVector};

/// Rows of one joint with the rate of its torque as one more column.
#[derive(Default)]
pub(super) struct Delay {
    gram: Option<DMatrix<f64>>,
    moment: DVector<f64>,
    power: f64,
    count: f64,
}

impl Delay {
    /// Adds a row; an offset and friction that falls with the speed stand beside the columns `x`.
    pub(super) fn add(&mut self, x: &[f64], qd: f64, tau: f64, rate: f64) {
        let falling = qd.signum() * (-qd.abs() / FAST_RAD_S).exp();
        let more = [1.0, falling, qd * qd.abs(), rate];
        let row = DVector::from_iterator(x.len() + more.len(), x.iter().copied().chain(more));
        let gram = self
            .gram
            .get_or_insert_with(|| DMatrix::zeros(row.len(), row.len()));
        gram.ger(1.0, &row, &row, 1.0);
        if self.moment.len() != row.len() {
            self.moment = DVector::zeros(row.len());
        }
        self.moment.axpy(tau, &row, 1.0);
        self.power += tau * tau;
        self.count += 1.0;
    }

    /// Delay, s, and its variance: `tau(t) = f(t − D)` is `f(t) − D tau'(t)` to the first order.
    fn estimate(&self) -> Option<(f64, f64)> {
        let gram = self.gram.as_ref()?;
        let last = gram.nrows() - 1;
        let size = gram
            .diagonal()
            .map(|square| 1.0 / f64::max(square, f64::MIN_POSITIVE).sqrt());
        let scaled = DMatrix::from_fn(last + 1, last + 1, |a, b| gram[(a, b)] * size[a] * size[b]);
        let inverse = scaled.pseudo_inverse(1e-8).ok()?;
        let inverse = DMatrix::from_fn(last + 1, last + 1, |a, b| {
            inverse[(a, b)] * size[a] * size[b]
        });
        let theta = &inverse * &self.moment;
        let rest = (self.power - theta.dot(&self.moment)).max(0.0);
        let noise = rest / (self.count - last as f64).max(1.0);
        let variance = noise * inverse[(last, last)];
        (self.count > 3.0 * last as f64 && variance > 0.0).then(|| (-theta[last], variance))
    }
}

/// Delay of the torques behind the positions, common to all joints.
pub(super) fn delay(judgement: &mut Judgement, delays: &[Delay]) {
    let found: Vec<(f64, f64)> = delays.iter().filter_map(Delay::estimate).collect();
    let weight: f64 = found.iter().map(|(_, variance)| 1.0 / variance).sum();
    if weight == 0.0 {
        return;
    }
    let mean = found
        .iter()
        .map(|(delay, variance)| delay / variance)
        .sum::<f64>()
        / weight;
    let deviation = ANALYTIC / weight.sqrt();
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
