mod bounds;
mod noise;

use super::conditioning::ConditionedSample;
use super::config::LearnerConfig;
use super::parameters::{JointEntries, LinearParameters, ParameterSet, StartDeviations};
use super::prior_covariance::{prior_factor, prior_factor_count, prior_floor};
use super::ud::UdFilter;
use crate::arm::Arm;
use crate::dynamics::{
    FRICTION_COLUMNS, FrictionBound, Pose, RANDOM_WALK_COLUMNS, friction_row, regressor_row_at,
};
use crate::joint::{JointMotion, JointVector};
use crate::limits::cut;
use crate::math::sqrt;
use bounds::{BOUNDED, Violation};
use noise::{FIRST_ROWS, FIRST_VARIANCE, MEDIAN_SQUARED, NoiseCorrelation, update_variance};

/// Prior factors added in one tick after a reset; all are added before the measurement window is full.
const FACTORS_PER_TICK: usize = 3;

/// Torque row of one joint: N·m for each unit of each linear parameter.
pub fn torque_row<A: Arm<N, P>, const N: usize, const P: usize>(
    joint: usize,
    sample: &ConditionedSample<N>,
) -> LinearParameters<N, P> {
    let Some(pose) = Pose::of::<A, P>(&sample.motion.q) else {
        return LinearParameters::filled(f32::NAN);
    };
    let entries = torque_row_at::<A, N, P>(joint, &pose, &sample.motion);
    let mut row = LinearParameters::filled(0.0);
    row.rigid = entries.rigid;
    if let Some(own) = row.friction.get_mut(joint) {
        *own = entries.own;
    }
    row
}

/// [`torque_row`] in the `pose` of `motion`.
#[inline(always)]
pub(super) fn torque_row_at<A: Arm<N, P>, const N: usize, const P: usize>(
    joint: usize,
    pose: &Pose<N>,
    motion: &JointMotion<N>,
) -> JointEntries<P> {
    let own = joint_friction_row::<A, N, P>(joint, &pose.load, motion);
    JointEntries {
        own: own.unwrap_or_default(),
        rigid: regressor_row_at::<A, N, P>(joint, &pose.angles, motion)
            .data
            .0[0],
    }
}

/// Friction columns of `joint` in `motion`, where the gears carry `load`, N × N·m; `None` if there is no such joint.
#[inline(never)]
pub(super) fn joint_friction_row<A: Arm<N, P>, const N: usize, const P: usize>(
    joint: usize,
    load: &JointVector<N>,
    motion: &JointMotion<N>,
) -> Option<[f32; FRICTION_COLUMNS]> {
    let (&cycles, &load) = (A::cogging_cycles().get(joint)?, load.get(joint)?);
    let (&q, &qd) = (motion.q.get(joint)?, motion.qd.get(joint)?);
    Some(friction_row(cycles, q, qd, load))
}

/// Recursive estimate of the linear parameters: a Kalman filter with factored covariance.
///
/// ```text
/// e = (tau − rowᵀθ) / σ    φ_i = row_i σ_i / σ    S = φᵀPφ + R    z = e/√S    θ ← θ + σ Pφ clip(z, ±k) √S / (S + (ρ − 1) R)
/// ```
/// * σ: configured noise of the joint's torque; σ_i: prior standard deviation of a parameter
/// * P starts as the [prior covariance](prior_factor) for base parameters and as I for friction, scaled by the
///   [`StartDeviations`] of the set
/// * process noise: a random walk of friction up to the prior variance; one column a row, in turn, with the noise of all.
///   Friction drifts in proportion to its size, so the noise is in proportion to E\[p²\]. Nothing is forgotten exponentially
/// * R: measured variance of the joint, at which half of the |z| exceed 0.6745
/// * ρ: [`noise_inflation`](LearnerConfig::noise_inflation); the update of P has ρ R in place of R
/// * k: innovations beyond it count as k [Huber 1964]
///
/// Each row ends at the most likely estimate within the sign bounds of the joint's friction. Nothing else bounds the estimate; the tick bounds the
/// torque.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimator<const N: usize, const P: usize> {
    parameters: LinearParameters<N, P>,
    /// Rounding error of the parameters: after many rows a step is only a few of their last bits.
    compensation: LinearParameters<N, P>,
    filter: UdFilter<N, P>,
    variance: [f32; N],
    /// Rows behind each variance; a row counts by the part of its innovation variance that is noise.
    effective_rows: [f32; N],
    correlation: [NoiseCorrelation; N],
    /// Place in [`RANDOM_WALK_COLUMNS`] of the process noise with the next row of each joint.
    random_walk_turn: [usize; N],
    start: StartDeviations<N, P>,
    /// Prior factors already in the covariance, and rows since it was that of the start.
    factors_added: usize,
    rows: u32,
}

impl<const N: usize, const P: usize> Estimator<N, P> {
    /// Estimate `prior` with the prior covariance of the arm.
    pub fn new<A: Arm<N, P>>(prior: &ParameterSet<N, P>) -> Self {
        let mut estimator = Self::empty();
        estimator.parameters = LinearParameters::of(prior);
        while !estimator.add_prior_factors::<A>() {}
        estimator
    }

    /// Add the next prior factors to the covariance; returns true when all are added. No row may be used before that.
    ///
    /// Cost: as much as one row, and nothing when all are added.
    pub(super) fn add_prior_factors<A: Arm<N, P>>(&mut self) -> bool {
        if self.factors_added == prior_factor_count(N) {
            return true;
        }
        let parts = self.start.parts();
        if self.factors_added == 0 {
            let mut variances = LinearParameters::filled(1.0);
            variances.rigid = prior_floor::<A, N, P>();
            for (variance, part) in variances.iter_mut().zip(parts.iter()) {
                *variance *= part * part;
            }
            self.filter.set_variances(&variances);
        }
        for _ in 0..FACTORS_PER_TICK {
            let Some(mut factor) = prior_factor::<A, N, P>(self.factors_added) else {
                break;
            };
            for (d, part) in factor.iter_mut().zip(&parts.rigid) {
                *d *= part;
            }
            self.filter.add_rigid_factor(&mut factor);
            self.factors_added += 1;
        }
        self.factors_added == prior_factor_count(N)
    }

    /// Zero parameters, P = I.
    pub(super) const fn empty() -> Self {
        Self {
            parameters: LinearParameters::filled(0.0),
            compensation: LinearParameters::filled(0.0),
            filter: UdFilter::new(),
            variance: [FIRST_VARIANCE; N],
            effective_rows: [FIRST_ROWS; N],
            correlation: [NoiseCorrelation::new(); N],
            random_walk_turn: [0; N],
            start: StartDeviations::PRIOR,
            factors_added: 0,
            rows: 0,
        }
    }

    /// Restart from `prior` with its deviations, in place.
    pub(super) fn reset(&mut self, prior: &ParameterSet<N, P>, start: &StartDeviations<N, P>) {
        self.move_to(&LinearParameters::of(prior));
        self.variance = [FIRST_VARIANCE; N];
        self.effective_rows = [FIRST_ROWS; N];
        self.correlation = [NoiseCorrelation::new(); N];
        self.random_walk_turn = [0; N];
        self.start = *start;
        self.reset_covariance();
    }

    /// Return to the prior covariance; rows wait until its factors are added.
    #[inline(never)]
    pub(super) fn reset_covariance(&mut self) {
        self.filter.reset();
        self.factors_added = 0;
        self.rows = 0;
    }

    /// Rows in the covariance.
    pub(super) fn rows(&self) -> u32 {
        self.rows
    }

    /// Replace the estimate by `parameters`; the covariance stays.
    pub(super) fn move_to(&mut self, parameters: &LinearParameters<N, P>) {
        self.parameters = *parameters;
        self.compensation = LinearParameters::filled(0.0);
    }

    /// Add `variance` to one friction parameter, in units of the prior variance, up to that variance.
    pub(super) fn raise_variance(&mut self, joint: usize, column: usize, variance: f32) {
        let own = self.filter.friction_variance(joint, column);
        let lacking = 1.0 - own.unwrap_or(1.0);
        if lacking > 0.0 {
            let noise = if lacking < variance {
                lacking
            } else {
                variance
            };
            self.filter.add_process_noise(joint, column, noise);
        }
    }

    /// Estimate, in the units of the parameters.
    pub fn parameters(&self) -> &LinearParameters<N, P> {
        &self.parameters
    }

    /// Covariance, in units of the prior standard deviations.
    pub fn filter(&self) -> &UdFilter<N, P> {
        &self.filter
    }

    /// Measured variance of the averaged torque of each joint, in units of the configured one of a single measurement.
    pub fn variance(&self) -> &[f32; N] {
        &self.variance
    }

    /// Correlation factor ρ of `joint`: variance of a sum of its innovations over that of independent ones, at least 1.
    pub fn correlation(&self, joint: usize) -> f32 {
        let correlation = self.correlation.get(joint);
        correlation.map_or(1.0, NoiseCorrelation::factor)
    }

    /// Update with the torque `tau` of `joint`, N·m, and its `row`.
    ///
    /// * `limit` torque limit of the joint, N·m
    /// * returns the expected variance of the innovation, in units of the configured one; `None` if a number was not finite,
    ///   with the estimate unchanged
    ///
    /// Cost: [`UdFilter::update`], about `6 n` multiply-adds besides.
    pub fn correct(
        &mut self,
        config: &LearnerConfig<N, P>,
        joint: usize,
        limit: f32,
        row: &LinearParameters<N, P>,
        tau: f32,
    ) -> Option<f32> {
        self.correct_joint(config, joint, limit, &row.of_joint(joint)?, tau)
    }

    /// [`correct`](Self::correct) with the entries of `joint`.
    #[inline(never)]
    pub(super) fn correct_joint(
        &mut self,
        config: &LearnerConfig<N, P>,
        joint: usize,
        limit: f32,
        row: &JointEntries<P>,
        tau: f32,
    ) -> Option<f32> {
        let inv_noise = 1.0 / (config.noise * limit);
        let sigma = &config.sigma;
        let expected = row.friction_dot(joint, &self.parameters) + row.rigid_dot(&self.parameters);
        let innovation = (tau - expected) * inv_noise;
        let measured = self.variance.get_mut(joint)?;
        let effective_rows = self.effective_rows.get_mut(joint)?;
        if !innovation.is_finite() {
            return None;
        }
        let turn = self.random_walk_turn.get_mut(joint)?;
        let column = *RANDOM_WALK_COLUMNS.get(*turn)?;
        let (own, place) = (sigma.friction.get(joint)?, column as usize);
        let variance = self.filter.friction_variance(joint, place)?;
        if variance < 1.0 {
            let mean = self.parameters.friction.get(joint)?.get(place)? / own.get(place)?;
            // Friction drifts in proportion to its size; a column without bound, a sensor's zero, alike at any value.
            let square = match column.properties().bound {
                FrictionBound::None => 1.0,
                _ => (mean * mean + variance).min(1.0),
            };
            let noise = RANDOM_WALK_COLUMNS.len() as f32 * config.process_noise * square;
            self.filter.add_process_noise(joint, place, noise);
        }
        *turn = (*turn + 1) % RANDOM_WALK_COLUMNS.len();
        let phi = row.scaled(own, &sigma.rigid, inv_noise);
        let mut gain = LinearParameters::filled(0.0);
        let correlation = self.correlation.get_mut(joint)?;
        let inflated = config.noise_inflation * *measured;
        let f = self.filter.transposed_times(joint, &phi);
        let predicted = self.filter.variance_of(joint, &f);
        let noise = *measured;
        let variance = predicted + noise;
        let sigma_innovation = sqrt(variance);
        let (clipped, is_clipped) = cut(innovation, config.outlier_sigmas * sigma_innovation);
        // P loses information in proportion to the derivative of the step, which is zero where it is clipped [Masreliez 1975].
        // Otherwise the variance of friction far beyond its prior falls too fast, and the estimate stays wrong.
        let of_row = if is_clipped { f32::INFINITY } else { inflated };
        self.filter.update_joint(joint, &phi, f, of_row, &mut gain);
        if !(variance > 0.0 && variance <= f32::MAX) {
            // The factors are lost; the covariance returns to the prior, the estimate stays.
            self.reset_covariance();
            return None;
        }
        self.rows = self.rows.saturating_add(1);
        let beyond = innovation * innovation > MEDIAN_SQUARED * variance;
        update_variance(measured, effective_rows, variance, beyond);
        let z = innovation / sigma_innovation;
        correlation.add(z, noise / variance, config.block_rows());
        let mut step = clipped / (predicted + inflated);
        self.bound(sigma, joint, &mut gain, &mut step);
        self.move_by(sigma, &gain, step);
        Some(variance)
    }

    /// Expected variance of the innovation of a `row` of `joint` that is not used, in units of the configured one.
    #[inline(never)]
    pub(super) fn innovation_variance(
        &self,
        config: &LearnerConfig<N, P>,
        joint: usize,
        limit: f32,
        row: &JointEntries<P>,
    ) -> Option<f32> {
        let own = config.sigma.friction.get(joint)?;
        let phi = row.scaled(own, &config.sigma.rigid, 1.0 / (config.noise * limit));
        Some(self.filter.prediction_variance(joint, &phi) + self.variance.get(joint)?)
    }

    /// Step θ ← θ + σ gain step, in compensated sums [Kahan 1965].
    fn move_by(
        &mut self,
        sigma: &LinearParameters<N, P>,
        gain: &LinearParameters<N, P>,
        step: f32,
    ) {
        let [theta, lost] = [&mut self.parameters, &mut self.compensation].map(|it| it.parts_mut());
        let parts = theta.into_iter().zip(lost).zip(sigma.parts());
        for (((theta, compensation), sigma), gain) in parts.zip(gain.parts()) {
            let columns = theta.iter_mut().zip(compensation).zip(sigma).zip(gain);
            for (((theta, compensation), sigma), gain) in columns {
                let step = sigma * gain * step + *compensation;
                let moved = *theta + step;
                *compensation = step - (moved - *theta);
                *theta = moved;
            }
        }
    }

    /// Add to a step the way to the most likely estimate within the [`DISSIPATION_BOUNDS`] of `joint`.
    ///
    /// ```text
    /// θ ← θ + P Aᵀ λ     P stays     λ: Violation::multipliers
    /// ```
    /// [Simon and Chia 2002, eq. 20, W = P⁻¹]. Correlated columns move with the violated one, so explained rows stay
    /// explained. Clipping the column alone leaves a residual. The next row repeats the step, and the correlated columns
    /// drift away.
    ///
    /// * `gain`, `step` θ moves by `sigma gain step`
    ///
    /// Cost: a product for each bound; in rows that violate one also [`UdFilter::friction_covariance`] and
    /// [`UdFilter::add_friction_gain`].
    ///
    /// [`DISSIPATION_BOUNDS`]: crate::dynamics::DISSIPATION_BOUNDS
    fn bound(
        &self,
        sigma: &LinearParameters<N, P>,
        joint: usize,
        gain: &mut LinearParameters<N, P>,
        step: &mut f32,
    ) {
        let (Some(theta), Some(sigma), Some(own_gain)) = (
            self.parameters.friction.get(joint),
            sigma.friction.get(joint),
            gain.friction.get(joint),
        ) else {
            return;
        };
        let mut own = *theta;
        for ((own, sigma), gain) in own.iter_mut().zip(sigma).zip(own_gain) {
            *own += sigma * gain * *step;
        }
        let Some(violation) = Violation::of(&own, sigma) else {
            return;
        };
        let covariance = self.filter.friction_covariance(joint, &BOUNDED);
        let direction = violation.multipliers(&covariance);
        if direction.iter().all(|a| a.is_finite()) {
            for part in gain.parts_mut() {
                part.iter_mut().for_each(|gain| *gain *= *step);
            }
            *step = 1.0;
            self.filter.add_friction_gain(joint, &direction, gain);
        }
    }
}

#[cfg(test)]
mod tests;
