use super::conditioning::Conditioned;
use super::config::LearnerConfig;
use super::parameters::ParameterSet;
use super::stacked::Stacked;
use super::ud::{UdFilter, dot};
use crate::arm::Arm;
use crate::dynamics::{FrictionParameters, friction_row, regressor_row};
use crate::limits::cut;
use crate::math::sqrt;

/// Square of the median of |z| for a normal z: where the measured variance settles.
const MEDIAN_SQUARED: f32 = 0.6745 * 0.6745;
/// Growth of a joint's variance for an innovation above the median; it shrinks by as much below. Forgets in 1.2 s at
/// 167 rows a second.
const VARIANCE_STEP: f32 = 1.005;
/// Range of the variance, in units of the configured one.
const VARIANCE_RANGE: (f32, f32) = (0.1, 400.0);

/// The torque row of one joint: N·m for each unit of each linear parameter.
pub(super) fn torque_row<A: Arm<N, P>, const N: usize, const P: usize>(
    joint: usize,
    seen: &Conditioned<N>,
) -> Stacked<N, P> {
    let mut row = Stacked::filled(0.0);
    if let (Some(slot), Some(&qd)) = (row.friction.get_mut(joint), seen.motion.qd.get(joint)) {
        *slot = friction_row(qd);
    }
    row.rigid = regressor_row::<A, N, P>(joint, &seen.motion).data.0[0];
    row
}

/// Recursive estimate of the linear parameters: a Kalman filter whose covariance is kept in factors.
///
/// ```text
/// e = (tau − rowᵀθ) / σ    φ_i = row_i σ_i / σ    S = φᵀPφ + R    z = e/√S    θ_i ← θ_i + σ_i (Pφ)_i clip(z, ±k) / √S
/// ```
/// with σ the configured noise of the joint's torque and σ_i the prior standard deviation of a parameter, so that the
/// filter starts from P = I. Nothing is forgotten; friction alone wanders (a random walk, up to the prior's doubt). R is
/// the variance the joint is found to have: half of the |z| lie beyond 0.6745 when it is right. Innovations beyond k
/// standard deviations act as if they had k [Huber 1964].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimator<const N: usize, const P: usize> {
    parameters: Stacked<N, P>,
    filter: UdFilter<N, P>,
    variance: [f32; N],
}

impl<const N: usize, const P: usize> Estimator<N, P> {
    pub(super) fn new(prior: &ParameterSet<N, P>) -> Self {
        Self {
            parameters: Stacked::of(prior),
            filter: UdFilter::new(),
            variance: [1.0; N],
        }
    }

    /// Starts over from `prior`, in place.
    pub(super) fn reset(&mut self, prior: &ParameterSet<N, P>) {
        self.parameters = Stacked::of(prior);
        self.filter.reset();
        self.variance = [1.0; N];
    }

    /// The estimate, in the units of the parameters.
    pub fn parameters(&self) -> &Stacked<N, P> {
        &self.parameters
    }

    /// The covariance, in units of the prior standard deviations.
    pub fn filter(&self) -> &UdFilter<N, P> {
        &self.filter
    }

    /// Variance of the torque of each joint as found, in units of the configured one.
    pub fn variance(&self) -> &[f32; N] {
        &self.variance
    }

    /// Takes in the torque `tau` of `joint`, whose limit is `limit`, N·m, with its `row`.
    ///
    /// * returns what the estimate left unexplained before, in units of the torque limit; `None` if a number was not
    ///   finite: then the estimate has not changed
    ///
    /// Cost: [`UdFilter::update`], about `6 n` multiply-adds besides.
    pub(super) fn correct(
        &mut self,
        config: &LearnerConfig<N, P>,
        prior: &ParameterSet<N, P>,
        joint: usize,
        limit: f32,
        row: &Stacked<N, P>,
        tau: f32,
    ) -> Option<f32> {
        let inv_noise = 1.0 / (config.noise * limit);
        let sigma = Stacked::sigma(config);
        let innovation = (tau - row.dot(&self.parameters)) * inv_noise;
        let measured = self.variance.get_mut(joint)?;
        if !innovation.is_finite() {
            return None;
        }
        for column in 0..sigma.friction.first()?.len() {
            if self.filter.friction_variance(joint, column) < 1.0 {
                self.filter.add_noise(joint, column, config.process_noise);
            }
        }
        let mut phi = *row;
        for (phi, sigma) in phi.iter_mut().zip(sigma.iter()) {
            *phi *= sigma * inv_noise;
        }
        let mut gain = Stacked::filled(0.0);
        let variance = self.filter.update(&phi, *measured, &mut gain);
        if !(variance > 0.0 && variance.is_finite()) {
            // Nothing sound is left in the factors: as uncertain as at first, but nothing wrong either.
            self.filter.reset();
            return None;
        }

        let squared = innovation * innovation;
        let beyond = squared > MEDIAN_SQUARED * variance;
        let (lower, upper) = VARIANCE_RANGE;
        let grown = if beyond {
            *measured * VARIANCE_STEP
        } else {
            *measured * (1.0 / VARIANCE_STEP)
        };
        *measured = grown.clamp(lower, upper);
        let (clipped, _) = cut(innovation, config.outlier_sigmas * sqrt(variance));
        self.move_by(config, prior, &sigma, &gain, clipped / variance);
        Some(innovation * config.noise)
    }

    /// θ ← θ + σ gain step, each kept within ±box of the prior's, friction never pushing.
    fn move_by(
        &mut self,
        config: &LearnerConfig<N, P>,
        prior: &ParameterSet<N, P>,
        sigma: &Stacked<N, P>,
        gain: &Stacked<N, P>,
        step: f32,
    ) {
        let prior = Stacked::of(prior);
        let columns = sigma.iter().zip(gain.iter()).zip(prior.iter());
        for (theta, ((&sigma, &gain), &prior)) in self.parameters.iter_mut().zip(columns) {
            let moved = *theta + sigma * gain * step;
            let (bounded, outside) = cut(moved - prior, config.box_sigmas * sigma);
            *theta = if outside { prior + bounded } else { moved };
        }
        for friction in &mut self.parameters.friction {
            *friction = FrictionParameters::from_columns(*friction)
                .resisting()
                .columns();
        }
    }
}

impl<const N: usize, const P: usize> Stacked<N, P> {
    /// Σ a b.
    pub(super) fn dot(&self, other: &Self) -> f32 {
        dot(
            self.friction.as_flattened(),
            other.friction.as_flattened(),
        ) + dot(&self.rigid, &other.rigid)
    }
}
