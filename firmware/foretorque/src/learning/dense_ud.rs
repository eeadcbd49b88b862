/// Kalman filter of `K` constants with covariance factors `P = U D Uᵀ`; the prior is `P = I`. [Bierman 1977, ch. V.3]
///
/// For the payload and for the output layers of the networks. [`UdFilter`](super::ud::UdFilter) is the same update for the
/// block structure of an arm, ordered for speed and compensated for millions of rows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct DenseUdFilter<const K: usize> {
    pub(super) theta: [f32; K],
    /// U by columns; the unit diagonal is not stored.
    upper: [[f32; K]; K],
    diagonal: [f32; K],
}

impl<const K: usize> DenseUdFilter<K> {
    /// Estimate `theta` with the covariance of the prior.
    pub(super) const fn new(theta: [f32; K]) -> Self {
        Self {
            theta,
            upper: [[0.0; K]; K],
            diagonal: [1.0; K],
        }
    }

    /// Residual of the measurement `y` with row `phi`.
    pub(super) fn residual(&self, phi: &[f32; K], y: f32) -> f32 {
        y - dot(&self.theta, phi)
    }

    /// Update with `y = phi·theta + noise` of variance `variance`; a result that is not finite is discarded.
    ///
    /// * returns the variance of the innovation
    ///
    /// Cost: `3/2 K²` multiply-adds and K divisions.
    #[inline(never)]
    pub(super) fn update(&mut self, phi: &[f32; K], y: f32, variance: f32) -> f32 {
        let mut next = *self;
        let mut gain = [0.0; K];
        let mut alpha = variance;
        let columns = next.upper.iter_mut().zip(&mut next.diagonal).zip(phi);
        for (j, ((column, d), &phi_j)) in columns.enumerate() {
            let mut f = phi_j;
            for (u, phi) in column.iter().zip(phi).take(j) {
                f += u * phi;
            }
            let v = *d * f;
            let grown = alpha + v * f;
            let lambda = -f / alpha;
            *d *= alpha / grown;
            for (u, b) in column.iter_mut().zip(&mut gain).take(j) {
                let before = *u;
                *u = before + lambda * *b;
                *b += v * before;
            }
            if let Some(b) = gain.get_mut(j) {
                *b = v;
            }
            alpha = grown;
        }
        let step = self.residual(phi, y) / alpha;
        for (theta, gain) in next.theta.iter_mut().zip(&gain) {
            *theta += gain * step;
        }
        let mut numbers = next.theta.iter().chain(&next.diagonal);
        if numbers.all(|x| x.is_finite()) {
            *self = next;
        }
        alpha
    }

    /// Add `variance` to every entry of D: the constants drift between rows.
    pub(super) fn add_process_noise(&mut self, variance: f32) {
        for d in &mut self.diagonal {
            *d += variance;
        }
    }

    /// Variance of constant `index`; 0 if there is none.
    ///
    /// ```text
    /// P_ii = D_i + Σ U_ij² D_j (j > i)
    /// ```
    pub(super) fn variance(&self, index: usize) -> f32 {
        let mut variance = self.diagonal.get(index).copied().unwrap_or(0.0);
        let later = self.upper.iter().zip(&self.diagonal).skip(index + 1);
        for (column, d) in later {
            let u = column.get(index).copied().unwrap_or(0.0);
            variance += u * u * d;
        }
        variance
    }
}

fn dot<const K: usize>(a: &[f32; K], b: &[f32; K]) -> f32 {
    let mut sum = 0.0;
    for (a, b) in a.iter().zip(b) {
        sum += a * b;
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rows without a short period.
    fn row(k: u32) -> [f32; 3] {
        let t = 0.7 * k as f32;
        [t.sin(), (1.3 * t).cos(), 0.4]
    }

    #[test]
    fn estimate_and_variance_are_those_of_least_squares() {
        let truth = [1.5, -0.5, 0.25];
        let mut filter = DenseUdFilter::new([0.0; 3]);
        let mut covariance = nalgebra::Matrix3::<f64>::identity();
        for k in 0..400 {
            let phi = row(k);
            filter.update(&phi, dot(&truth, &phi), 0.04);
            let phi = nalgebra::Vector3::from(phi).cast::<f64>();
            let gain = covariance * phi;
            covariance -= gain * gain.transpose() / (phi.dot(&gain) + 0.04);
        }
        for k in 0..3 {
            let error = (filter.theta[k] - truth[k]).abs();
            assert!(error < 0.01, "{k}: {error}");
            let ratio = f64::from(filter.variance(k)) / covariance[(k, k)];
            assert!((ratio - 1.0).abs() < 1e-3, "{k}: {ratio}");
        }
    }

    #[test]
    fn a_row_that_is_not_finite_changes_nothing() {
        let mut filter = DenseUdFilter::new([0.0; 3]);
        filter.update(&row(1), 2.0, 0.1);
        let before = filter;
        for bad in [f32::NAN, f32::INFINITY] {
            filter.update(&row(2), bad, 0.1);
            filter.update(&[bad, 0.0, 0.0], 1.0, 0.1);
            filter.update(&row(2), 1.0, bad * 0.0);
            assert_eq!(filter, before);
        }
    }
}
