use super::conditioning::{AVERAGED, Conditioned};
use super::config::LearnerConfig;
use super::doubt::{rigid_doubt, rigid_doubts, rigid_floor};
use super::parameters::ParameterSet;
use super::stacked::Stacked;
use super::ud::{UdFilter, dot};
use crate::arm::Arm;
use crate::dynamics::{FRICTION_COLUMNS, FrictionParameters, friction_row, regressor_row};
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

/// The first friction columns of a joint, those that change with temperature and wear, wander; offset and cogging do not.
const WANDERING: usize = 4;
/// The cogging columns come last.
const COGGING: usize = FRICTION_COLUMNS - 2;

/// The torque row of one joint: N·m for each unit of each linear parameter.
#[inline(never)]
pub fn torque_row<A: Arm<N, P>, const N: usize, const P: usize>(
    joint: usize,
    seen: &Conditioned<N>,
) -> Stacked<N, P> {
    let mut row = Stacked::filled(0.0);
    let (q, qd) = (seen.motion.q.get(joint), seen.motion.qd.get(joint));
    let cycles = A::COGGING_CYCLES.get(joint);
    if let (Some(slot), Some(&cycles), Some(&q), Some(&qd)) =
        (row.friction.get_mut(joint), cycles, q, qd)
    {
        *slot = friction_row(cycles, q, qd);
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
/// filter starts from the prior's correlations: friction from P = I, base parameters from what the doubts about single
/// links make of them. Nothing is forgotten; friction alone wanders (a random walk, up to the prior's doubt; one
/// column a row, in turn, with the noise of all). R is
/// the variance the joint is found to have: half of the |z| lie beyond 0.6745 when it is right. Innovations beyond k
/// standard deviations act as if they had k [Huber 1964].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimator<const N: usize, const P: usize> {
    parameters: Stacked<N, P>,
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
        estimator.parameters = Stacked::of(prior);
        while !estimator.prepare::<A>() {}
        estimator
    }

    /// Takes some of the doubts about links into the covariance; returns whether all are in it. Before that a row must not
    /// be taken. It is soon done: the window of measurements takes longer to fill.
    ///
    /// Cost: a row's, and nothing when all is done.
    pub(super) fn prepare<A: Arm<N, P>>(&mut self) -> bool {
        if self.doubted == 0 {
            self.filter.set_rigid(&rigid_floor::<A, N, P>());
        }
        for _ in 0..DOUBTS_A_TICK {
            let Some(mut doubt) = rigid_doubt::<A, N, P>(self.doubted) else {
                break;
            };
            self.filter.add_rigid(&mut doubt);
            self.doubted += 1;
        }
        self.doubted == rigid_doubts(N)
    }

    /// All parameters zero and as uncertain as a prior.
    pub(super) const fn idle() -> Self {
        Self {
            parameters: Stacked::filled(0.0),
            filter: UdFilter::new(),
            variance: [FIRST_VARIANCE; N],
            noticed: [FIRST_ROWS; N],
            wandering: [0; N],
            doubted: 0,
        }
    }

    /// Starts over from `prior`, in place.
    pub(super) fn reset(&mut self, prior: &ParameterSet<N, P>) {
        self.parameters = Stacked::of(prior);
        self.filter.reset();
        self.variance = [FIRST_VARIANCE; N];
        self.noticed = [FIRST_ROWS; N];
        self.wandering = [0; N];
        self.doubted = 0;
    }

    /// Takes `parameters` for the estimate; what is known of their covariance stays.
    pub(super) fn move_to(&mut self, parameters: &Stacked<N, P>) {
        self.parameters = *parameters;
    }

    /// Raises the doubt about one friction parameter by `variance`, in units of the prior's.
    pub(super) fn reopen(&mut self, joint: usize, column: usize, variance: f32) {
        self.filter.add_noise(joint, column, variance);
    }

    /// The estimate, in the units of the parameters.
    pub fn parameters(&self) -> &Stacked<N, P> {
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
        prior: &ParameterSet<N, P>,
        joint: usize,
        limit: f32,
        row: &Stacked<N, P>,
        tau: f32,
    ) -> Option<Correction> {
        let inv_noise = 1.0 / (config.noise * limit);
        let sigma = Stacked::sigma(config);
        let innovation = (tau - row.dot(&self.parameters)) * inv_noise;
        let measured = self.variance.get_mut(joint)?;
        let noticed = self.noticed.get_mut(joint)?;
        if !innovation.is_finite() {
            return None;
        }
        let column = self.wandering.get_mut(joint)?;
        if self.filter.friction_variance(joint, *column)? < 1.0 {
            let noise = WANDERING as f32 * config.process_noise;
            self.filter.add_noise(joint, *column, noise);
        }
        *column = (*column + 1) % WANDERING;
        let mut phi = *row;
        for (phi, sigma) in phi.parts_mut().into_iter().zip(sigma.parts()) {
            for (phi, sigma) in phi.iter_mut().zip(sigma) {
                *phi *= sigma * inv_noise;
            }
        }
        let mut gain = Stacked::filled(0.0);
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
        self.move_by(config, prior, &sigma, &gain, clipped / variance);
        Some(Correction {
            residual: innovation * config.noise,
            variance,
        })
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
        let parts = sigma.parts().into_iter().zip(gain.parts());
        let parts = parts.zip(prior.parts());
        for (theta, ((sigma, gain), prior)) in self.parameters.parts_mut().into_iter().zip(parts) {
            let columns = sigma.iter().zip(gain).zip(prior);
            for (theta, ((&sigma, &gain), &prior)) in theta.iter_mut().zip(columns) {
                let moved = *theta + sigma * gain * step;
                let (bounded, outside) = cut(moved - prior, config.box_sigmas * sigma);
                *theta = if outside { prior + bounded } else { moved };
            }
        }
        for friction in &mut self.parameters.friction {
            *friction = FrictionParameters::from_columns(*friction)
                .resisting()
                .columns();
        }
    }
}

impl<const N: usize, const P: usize> Stacked<N, P> {
    /// Takes out of a torque row what the filter of the motion swallows of the cogging of `joint`, all but `share` of it.
    /// What `active` asks of the drive against that part is not in the motion, but in the torque: returned, N·m.
    pub fn swallow(&mut self, joint: usize, share: f32, active: &Self) -> f32 {
        let mut asked = 0.0;
        if let (Some(row), Some(active)) =
            (self.friction.get_mut(joint), active.friction.get(joint))
        {
            for (row, active) in row.iter_mut().zip(active).skip(COGGING) {
                asked += (1.0 - share) * *row * active;
                *row *= share;
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
mod tests {
    use super::*;
    use crate::arm::ur5::{JOINTS as N, PARAMETERS as P, Ur5};
    use crate::joint::{JointMotion, JointVector};
    use std::vec::Vec;

    const WIDTH: usize = FRICTION_COLUMNS;

    /// The same filter on the plain covariance, in f64.
    struct Twin {
        start: Vec<f64>,
        sigma: Vec<f64>,
        theta: Vec<f64>,
        p: Vec<Vec<f64>>,
        variance: [f64; N],
        noticed: [f64; N],
        visits: [usize; N],
    }

    impl Twin {
        fn correct(&mut self, joint: usize, phi: &[f64], innovation: f64, process_noise: f64) {
            let k = WIDTH * joint + self.visits[joint] % WANDERING;
            self.visits[joint] += 1;
            if self.p[k][k] < 1.0 {
                self.p[k][k] += WANDERING as f64 * process_noise;
            }
            let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
            let gain: Vec<f64> = self.p.iter().map(|row| dot(row, phi)).collect();
            let s = dot(&gain, phi) + self.variance[joint];
            for (row, a) in self.p.iter_mut().zip(&gain) {
                for (p, b) in row.iter_mut().zip(&gain) {
                    *p -= a * b / s;
                }
            }
            let z = innovation / s.sqrt();
            let up = z.abs() > 0.6745;
            let mut step = 1.005;
            if self.noticed[joint] < f64::from(NOTICED_ROWS) {
                self.noticed[joint] += self.variance[joint] / s;
                step = 1.0 + 2.3 * self.variance[joint] / s / self.noticed[joint];
            }
            self.variance[joint] *= if up { step } else { 1.0 / step };
            for (theta, gain) in self.theta.iter_mut().zip(&gain) {
                let moved = *theta + gain * z.clamp(-3.0, 3.0) / s.sqrt();
                *theta = moved.clamp(-4.0, 4.0);
            }
            let value = |k: usize, theta: &[f64]| self.start[k] + self.sigma[k] * theta[k];
            let floor = |k: usize, bound: f64, theta: &mut [f64]| {
                theta[k] = theta[k].max((bound - self.start[k]) / self.sigma[k]);
            };
            for viscous in (0..WIDTH * N).step_by(WIDTH) {
                let coulomb = viscous + 1;
                floor(viscous, 0.0, &mut self.theta);
                floor(coulomb, 0.0, &mut self.theta);
                let half = -0.5 * value(coulomb, &self.theta);
                floor(viscous + 2, half, &mut self.theta);
                floor(viscous + 3, half, &mut self.theta);
            }
        }
    }

    /// In units of the prior standard deviations: friction first, uncorrelated, then the doubts about links.
    fn prior_covariance(n: usize) -> Vec<Vec<f64>> {
        let floor = rigid_floor::<Ur5, N, P>();
        let mut p: Vec<Vec<f64>> = (0..n).map(|_| std::vec![0.0; n]).collect();
        for (k, row) in p.iter_mut().enumerate() {
            row[k] = k.checked_sub(n - P).map_or(1.0, |k| f64::from(floor[k]));
        }
        for doubt in (0..).map_while(rigid_doubt::<Ur5, N, P>) {
            for (row, a) in p[n - P..].iter_mut().zip(doubt) {
                for (p, b) in row[n - P..].iter_mut().zip(doubt) {
                    *p += f64::from(a) * f64::from(b);
                }
            }
        }
        p
    }

    #[test]
    fn it_starts_from_the_doubts_about_links_each_parameter_as_uncertain_as_its_deviation_says() {
        let prior = ParameterSet::nominal::<Ur5>(1);
        let estimator = Estimator::<N, P>::new::<Ur5>(&prior);
        let n = WIDTH * N + P;
        let twin = prior_covariance(n);
        for k in 0..P {
            let variance = f64::from(estimator.filter().rigid_variance(k).unwrap());
            assert!((variance - 1.0).abs() < 1e-4, "{k}: {variance}");
            assert!((variance - twin[n - P + k][n - P + k]).abs() < 1e-4, "{k}");
        }
        // The first moments of upper arm and forearm share the masses beyond the elbow.
        let (upper, forearm) = (n - P + 1, n - P + 8);
        assert!(twin[upper][forearm] > 0.5, "{}", twin[upper][forearm]);
    }

    /// Sines that never repeat, at most 2 rad/s, and the torque of an arm 10 % heavier than its description, with noise.
    fn seen(tick: u32, joint: usize, random: &mut u64) -> (Stacked<N, P>, f32) {
        let t = f64::from(tick) * 1e-3;
        let wave = |j: usize| {
            let w = 1.1 + 0.37 * j as f64;
            (w * t + j as f64, w)
        };
        let motion = JointMotion::<N> {
            q: JointVector::from_fn(|j, _| wave(j).0.sin() as f32),
            qd: JointVector::from_fn(|j, _| (wave(j).1 * wave(j).0.cos()) as f32),
            qdd: JointVector::from_fn(|j, _| (-wave(j).1.powi(2) * wave(j).0.sin()) as f32),
        };
        let mut tau = JointVector::<N>::zeros();
        let row = torque_row::<Ur5, N, P>(joint, &Conditioned { motion, tau });
        let mut truth = Stacked::of(&ParameterSet::nominal::<Ur5>(1));
        truth.rigid = truth.rigid.map(|theta| 1.1 * theta);
        truth.friction = [[2.0, 3.0, 0.5, 0.5, -0.3, 0.2, -0.1]; N];
        let noise: f64 = (0..12)
            .map(|_| {
                *random = random
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1);
                (*random >> 11) as f64 / (1u64 << 53) as f64 - 0.5
            })
            .sum();
        // A row is made from a mean of torques.
        let noise = 0.01 * noise / (AVERAGED as f64).sqrt();
        tau[joint] = row.dot(&truth) + noise as f32 * Ur5::LIMITS[joint].torque;
        (row, tau[joint])
    }

    #[test]
    fn after_a_million_rows_it_is_where_exact_arithmetic_is_and_its_factors_are_positive() {
        let config = LearnerConfig::<N, P>::for_arm::<Ur5>(1e-3);
        let prior = ParameterSet::nominal::<Ur5>(1);
        let (start, sigma) = (Stacked::of(&prior), Stacked::sigma(&config));
        let mut estimator = Estimator::<N, P>::new::<Ur5>(&prior);
        let n = start.iter().count();
        let wide = |numbers: &Stacked<N, P>| numbers.iter().copied().map(f64::from).collect();
        let mut twin = Twin {
            start: wide(&start),
            sigma: wide(&sigma),
            theta: std::vec![0.0; n],
            p: prior_covariance(n),
            variance: [f64::from(FIRST_VARIANCE); N],
            noticed: [f64::from(FIRST_ROWS); N],
            visits: [0; N],
        };
        let (mut worst, mut random) = (0.0f64, 7);
        for tick in 0..1_000_000 {
            let joint = tick as usize % N;
            let limit = Ur5::LIMITS[joint].torque;
            let (row, tau) = seen(tick, joint, &mut random);
            let before = estimator.correct(&config, &prior, joint, limit, &row, tau);
            assert!(before.is_some());
            let unit = f64::from(config.noise * limit);
            let mut innovation = f64::from(tau);
            let mut phi = Vec::with_capacity(n);
            let columns = row.iter().zip(start.iter()).zip(sigma.iter());
            for (((&row, &start), &sigma), theta) in columns.zip(&twin.theta) {
                let (row, sigma) = (f64::from(row), f64::from(sigma));
                innovation -= row * (f64::from(start) + sigma * theta);
                phi.push(row * sigma / unit);
            }
            twin.correct(
                joint,
                &phi,
                innovation / unit,
                f64::from(config.process_noise),
            );
            if tick % 1000 == 999 {
                let numbers = estimator.parameters().iter().zip(start.iter());
                for (((&theta, &start), &sigma), twin) in numbers.zip(sigma.iter()).zip(&twin.theta)
                {
                    let theta = (f64::from(theta) - f64::from(start)) / f64::from(sigma);
                    worst = worst.max((theta - twin).abs());
                }
                assert!(estimator.filter().diagonal().iter().all(|&d| d > 0.0));
            }
        }
        std::println!("f32 and f64 at most {worst:.1e} prior standard deviations apart");
        assert!(worst <= 1e-2, "{worst}");
    }
}
