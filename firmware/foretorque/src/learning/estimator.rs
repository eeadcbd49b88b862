use super::conditioning::{AVERAGED, ConditionedSample};
use super::config::LearnerConfig;
use super::doubt::{prior_factor, prior_factor_count, prior_floor};
use super::parameters::ParameterSet;
use super::stacked::LinearParameters;
use super::ud::{UdFilter, dot};
use crate::arm::Arm;
use crate::dynamics::{
    COGGING_COLUMNS, DISSIPATION_BOUNDS, FRICTION_COLUMNS, RANDOM_WALK_COLUMNS, friction_load,
    friction_row, regressor_row,
};
use crate::limits::cut;
use crate::math::sqrt;

/// Square of the median of |z| for a normal z: where the measured variance settles.
const MEDIAN_SQUARED: f32 = 0.6745 * 0.6745;
/// Growth of a joint's variance for an innovation above the median; it shrinks by as much below. Forgets in 1.2 s at
/// 167 rows a second.
const VARIANCE_STEP: f32 = 1.005;
/// Range of the variance, in units of the configured one.
const VARIANCE_RANGE: (f32, f32) = (0.02, 400.0);
/// Variance at first, fifty times that of a mean of white noise, which is what a row is made from: real wrists scatter by
/// 4 to 12 % of their limits, and what the first rows are believed too much stays in the covariance.
const FIRST_VARIANCE: f32 = 50.0 / AVERAGED as f32;
/// The first rows move the variance by this over their number, the step with which the median of a normal z is found in
/// the fewest rows: `1 / (2 φ(m) m)` with m = 0.6745 [Robbins and Monro 1951].
const VARIANCE_GAIN: f32 = 2.3;
/// Rows after which that step is the lasting one.
const NOTICED_ROWS: f32 = VARIANCE_GAIN / (VARIANCE_STEP - 1.0);
/// Rows for which the first variance counts.
const FIRST_ROWS: f32 = 4.0;

/// Doubts about links that a tick takes into the covariance after a reset: all of them before the window is full.
const DOUBTS_A_TICK: usize = 3;

/// Violated bounds that one row mends: no joint has more that bind at once but in its first rows.
const MAX_PROJECTIONS: usize = 3;
/// Violation of a bound that is rounding, prior standard deviations: some last bits of a parameter.
const TOLERANCE: f32 = 1e-4;

/// The torque row of one joint: N·m for each unit of each linear parameter.
#[inline(never)]
pub fn torque_row<A: Arm<N, P>, const N: usize, const P: usize>(
    joint: usize,
    seen: &ConditionedSample<N>,
) -> LinearParameters<N, P> {
    let mut row = LinearParameters::filled(0.0);
    row.rigid = regressor_row::<A, N, P>(joint, &seen.motion).data.0[0];
    let (q, qd) = (seen.motion.q.get(joint), seen.motion.qd.get(joint));
    let loads = friction_load::<A, N, P>(&seen.motion.q);
    let (cycles, load) = (A::COGGING_CYCLES.get(joint), loads.get(joint));
    if let (Some(slot), Some(&cycles), Some(&q), Some(&qd), Some(&load)) =
        (row.friction.get_mut(joint), cycles, q, qd, load)
    {
        *slot = friction_row(cycles, q, qd, load);
    }
    row
}

/// Recursive estimate of the linear parameters: a Kalman filter whose covariance is kept in factors.
///
/// ```text
/// e = (tau − rowᵀθ) / σ    φ_i = row_i σ_i / σ    S = φᵀPφ + R    z = e/√S    θ_i ← θ_i + σ_i (Pφ)_i clip(z, ±k) / √S
/// ```
/// with σ the configured noise of the joint's torque and σ_i the prior standard deviation of a parameter, so that the
/// filter starts from the prior's correlations: friction from P = I, base parameters from what the doubts about single
/// links make of them. Nothing is forgotten; friction alone wanders (a random walk, up to the prior's doubt; one
/// column a row, in turn, with the noise of all). R is
/// the variance the joint is found to have: half of the |z| lie beyond 0.6745 when it is right. Innovations beyond k
/// standard deviations act as if they had k [Huber 1964]. Friction that would push instead of resist is moved onto its
/// bound by way of P; nothing else bounds the estimate: what reaches the torque is bounded in the tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimator<const N: usize, const P: usize> {
    parameters: LinearParameters<N, P>,
    /// What rounding has kept from the parameters so far. After many rows a step is a few last bits of them, and no
    /// later row takes back what was rounded off.
    owed: LinearParameters<N, P>,
    filter: UdFilter<N, P>,
    variance: [f32; N],
    /// Rows that each is known from, as far as they were uncertain because of noise.
    noticed: [f32; N],
    /// The friction column of each joint that wanders with its next row.
    wandering: [usize; N],
    /// Doubts about links that are in the covariance already.
    doubted: usize,
}

/// What the estimate made of a row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Correction {
    /// What it left unexplained before, in units of the torque limit.
    pub residual: f32,
    /// The variance that was to be expected of it, in units of the configured one.
    pub variance: f32,
}

impl<const N: usize, const P: usize> Estimator<N, P> {
    /// Starts from `prior`, as uncertain as the description of the arm.
    pub fn new<A: Arm<N, P>>(prior: &ParameterSet<N, P>) -> Self {
        let mut estimator = Self::idle();
        estimator.parameters = LinearParameters::of(prior);
        while !estimator.prepare::<A>() {}
        estimator
    }

    /// Takes some of the doubts about links into the covariance; returns whether all are in it. Before that a row must not
    /// be taken. It is soon done: the window of measurements takes longer to fill.
    ///
    /// Cost: a row's, and nothing when all is done.
    pub(super) fn prepare<A: Arm<N, P>>(&mut self) -> bool {
        if self.doubted == 0 {
            self.filter.set_rigid(&prior_floor::<A, N, P>());
        }
        for _ in 0..DOUBTS_A_TICK {
            let Some(mut doubt) = prior_factor::<A, N, P>(self.doubted) else {
                break;
            };
            self.filter.add_rigid(&mut doubt);
            self.doubted += 1;
        }
        self.doubted == prior_factor_count(N)
    }

    /// All parameters zero and as uncertain as a prior.
    pub(super) const fn idle() -> Self {
        Self {
            parameters: LinearParameters::filled(0.0),
            owed: LinearParameters::filled(0.0),
            filter: UdFilter::new(),
            variance: [FIRST_VARIANCE; N],
            noticed: [FIRST_ROWS; N],
            wandering: [0; N],
            doubted: 0,
        }
    }

    /// Starts over from `prior`, in place.
    pub(super) fn reset(&mut self, prior: &ParameterSet<N, P>) {
        self.move_to(&LinearParameters::of(prior));
        self.filter.reset();
        self.variance = [FIRST_VARIANCE; N];
        self.noticed = [FIRST_ROWS; N];
        self.wandering = [0; N];
        self.doubted = 0;
    }

    /// Takes `parameters` for the estimate; what is known of their covariance stays.
    pub(super) fn move_to(&mut self, parameters: &LinearParameters<N, P>) {
        self.parameters = *parameters;
        self.owed = LinearParameters::filled(0.0);
    }

    /// Raises the doubt about one friction parameter by `variance`, in units of the prior's.
    pub(super) fn reopen(&mut self, joint: usize, column: usize, variance: f32) {
        self.filter.add_process_noise(joint, column, variance);
    }

    /// The estimate, in the units of the parameters.
    pub fn parameters(&self) -> &LinearParameters<N, P> {
        &self.parameters
    }

    /// The covariance, in units of the prior standard deviations.
    pub fn filter(&self) -> &UdFilter<N, P> {
        &self.filter
    }

    /// Variance of the averaged torque of each joint as found, in units of the configured one of a single measurement.
    pub fn variance(&self) -> &[f32; N] {
        &self.variance
    }

    /// Takes in the torque `tau` of `joint`, whose limit is `limit`, N·m, with its `row`.
    ///
    /// * returns what the estimate left unexplained before; `None` if a number was not finite: then the estimate has not
    ///   changed
    ///
    /// Cost: [`UdFilter::update`], about `6 n` multiply-adds besides.
    #[inline(never)]
    pub fn correct(
        &mut self,
        config: &LearnerConfig<N, P>,
        joint: usize,
        limit: f32,
        row: &LinearParameters<N, P>,
        tau: f32,
    ) -> Option<Correction> {
        let inv_noise = 1.0 / (config.noise * limit);
        let sigma = LinearParameters::sigma(config);
        let innovation = (tau - row.dot(&self.parameters)) * inv_noise;
        let measured = self.variance.get_mut(joint)?;
        let noticed = self.noticed.get_mut(joint)?;
        if !innovation.is_finite() {
            return None;
        }
        let turn = self.wandering.get_mut(joint)?;
        let column = *RANDOM_WALK_COLUMNS.get(*turn)? as usize;
        if self.filter.friction_variance(joint, column)? < 1.0 {
            let noise = RANDOM_WALK_COLUMNS.len() as f32 * config.process_noise;
            self.filter.add_process_noise(joint, column, noise);
        }
        *turn = (*turn + 1) % RANDOM_WALK_COLUMNS.len();
        let mut phi = *row;
        let scale = |phi: &mut [f32], sigma: &[f32]| {
            for (phi, sigma) in phi.iter_mut().zip(sigma) {
                *phi *= sigma * inv_noise;
            }
        };
        // A row has no friction but its joint's.
        scale(phi.friction.get_mut(joint)?, sigma.friction.get(joint)?);
        scale(&mut phi.rigid, &sigma.rigid);
        let mut gain = LinearParameters::filled(0.0);
        let variance = self.filter.update(joint, &phi, *measured, &mut gain);
        if !(variance > 0.0 && variance.is_finite()) {
            // Nothing sound is left in the factors: as uncertain as at first, but nothing wrong either.
            self.filter.reset();
            self.doubted = 0;
            return None;
        }

        let squared = innovation * innovation;
        let beyond = squared > MEDIAN_SQUARED * variance;
        let (lower, upper) = VARIANCE_RANGE;
        let step = if *noticed < NOTICED_ROWS {
            // An innovation that comes from doubt about the parameters says nothing of the noise.
            let share = *measured / variance;
            *noticed += share;
            1.0 + VARIANCE_GAIN * share / *noticed
        } else {
            VARIANCE_STEP
        };
        let grown = if beyond {
            *measured * step
        } else {
            *measured / step
        };
        *measured = grown.clamp(lower, upper);
        let (clipped, _) = cut(innovation, config.outlier_sigmas * sqrt(variance));
        self.move_by(&sigma, &gain, clipped / variance);
        self.project(&sigma, joint, &mut gain);
        Some(Correction {
            residual: innovation * config.noise,
            variance,
        })
    }

    /// θ ← θ + σ gain step, in compensated sums [Kahan 1965].
    fn move_by(
        &mut self,
        sigma: &LinearParameters<N, P>,
        gain: &LinearParameters<N, P>,
        step: f32,
    ) {
        let parts = sigma.parts().into_iter().zip(gain.parts());
        let moving = self.parameters.parts_mut().into_iter();
        for ((theta, owed), (sigma, gain)) in moving.zip(self.owed.parts_mut()).zip(parts) {
            let columns = sigma.iter().zip(gain);
            for ((theta, owed), (&sigma, &gain)) in theta.iter_mut().zip(owed).zip(columns) {
                let step = sigma * gain * step + *owed;
                let moved = *theta + step;
                *owed = step - (moved - *theta);
                *theta = moved;
            }
        }
    }

    /// Moves the estimate onto the bounds of [`DISSIPATION_BOUNDS`] that the friction of `joint` violates, the worst first.
    ///
    /// ```text
    /// θ ← θ − P a (aᵀθ) / (aᵀPa)     P stays
    /// ```
    /// This is the most likely estimate on the bound [Simon and Chia 2002, eq. 20, W = P⁻¹]: columns that are correlated
    /// with the violated one move with it, so that rows which are explained stay explained. A column that is cut alone
    /// leaves torque unexplained, the next row pushes it again, and its neighbours run away.
    ///
    /// Cost: [`DISSIPATION_BOUNDS`] times the columns; [`UdFilter::friction_gain`] for each violated bound, `MAX_PROJECTIONS` at most.
    fn project(
        &mut self,
        sigma: &LinearParameters<N, P>,
        joint: usize,
        gain: &mut LinearParameters<N, P>,
    ) {
        let Some(sigma_own) = sigma.friction.get(joint) else {
            return;
        };
        for _ in 0..MAX_PROJECTIONS {
            let Some(own) = self.parameters.friction.get(joint) else {
                return;
            };
            let mut direction = [0.0; FRICTION_COLUMNS];
            let mut worst = TOLERANCE;
            for bound in &DISSIPATION_BOUNDS {
                let value = dot(bound, own);
                if value >= 0.0 {
                    continue;
                }
                let mut scaled = *bound;
                for (a, sigma) in scaled.iter_mut().zip(sigma_own) {
                    *a *= sigma;
                }
                let inv_deviation = 1.0 / sqrt(dot(&scaled, &scaled));
                let violation = -value * inv_deviation;
                // Infinite where none of the bound's columns is learnt: those stay as they are.
                if violation > worst && violation.is_finite() {
                    worst = violation;
                    direction = scaled.map(|a| a * inv_deviation);
                }
            }
            if worst <= TOLERANCE {
                return;
            }
            let variance = self.filter.friction_gain(joint, &direction, gain);
            let step = worst / variance;
            if !(variance > 0.0 && step.is_finite()) {
                return;
            }
            self.move_by(sigma, gain, step);
        }
    }
}

impl<const N: usize, const P: usize> LinearParameters<N, P> {
    /// Takes out of a torque row what the filter of the motion swallows of the cogging of `joint`, all but `share` of it.
    /// What `active` asks of the drive against that part is not in the motion, but in the torque: returned, N·m.
    pub fn attenuate_cogging(&mut self, joint: usize, share: f32, active: &Self) -> f32 {
        let mut asked = 0.0;
        if let (Some(row), Some(active)) =
            (self.friction.get_mut(joint), active.friction.get(joint))
        {
            for column in COGGING_COLUMNS.map(|column| column as usize) {
                asked += (1.0 - share) * row[column] * active[column];
                row[column] *= share;
            }
        }
        asked
    }

    /// Σ a b.
    pub fn dot(&self, other: &Self) -> f32 {
        self.friction_dot(other) + self.rigid_dot(other)
    }

    /// The part of [`dot`](Self::dot) that friction has.
    pub(super) fn friction_dot(&self, other: &Self) -> f32 {
        dot(self.friction.as_flattened(), other.friction.as_flattened())
    }

    /// The part of [`dot`](Self::dot) that the rigid body has.
    pub(super) fn rigid_dot(&self, other: &Self) -> f32 {
        dot(&self.rigid, &other.rigid)
    }
}

#[cfg(test)]
mod tests;
