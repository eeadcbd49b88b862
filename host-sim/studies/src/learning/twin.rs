//! A twin of the firmware's estimator on the plain covariance and in f64: nearly exact arithmetic.

use super::setup::{N, P, Set};
use foretorque::arm::Arm;
use foretorque::arm::ur5::Ur5;
use foretorque::dynamics::{DISSIPATION_BOUNDS, FRICTION_COLUMNS, RANDOM_WALK_COLUMNS};
use foretorque::learning::{Estimator, LearnerConfig, LinearParameters, prior_factor, prior_floor};
use nalgebra::{DMatrix, DVector, SVector};

/// Where half of the |z| of a normal z lie, growth of the variance beyond it, and its range.
const MEDIAN: f64 = 0.6745;
const VARIANCE_STEP: f64 = 1.005;
const VARIANCE_RANGE: (f64, f64) = (0.02, 400.0);
/// Step of the first rows times their number, rows that count as taken before the first, and rows until it lasts.
const VARIANCE_GAIN: f64 = 2.3;
const FIRST_ROWS: f64 = 4.0;
const NOTICED_ROWS: f64 = VARIANCE_GAIN / (VARIANCE_STEP - 1.0);

/// The twin. Parameters in prior standard deviations from the start.
pub(super) struct Twin {
    config: LearnerConfig<N, P>,
    start: DVector<f64>,
    sigma: DVector<f64>,
    theta: DVector<f64>,
    covariance: DMatrix<f64>,
    variance: [f64; N],
    noticed: [f64; N],
    wandering: [usize; N],
}

/// Prior covariance of the parameters, in units of the prior standard deviations: friction uncorrelated, base parameters
/// correlated by the uncertainty of whole links.
fn prior_covariance() -> DMatrix<f64> {
    let friction = N * FRICTION_COLUMNS;
    let mut covariance = DMatrix::<f64>::identity(friction + P, friction + P);
    let mut rigid = covariance.view_mut((friction, friction), (P, P));
    let floor = SVector::<f64, P>::from(prior_floor::<Ur5, N, P>().map(f64::from));
    rigid.set_diagonal(&floor);
    for link in (0..).map_while(prior_factor::<Ur5, N, P>) {
        let link = SVector::<f64, P>::from(link.map(f64::from));
        rigid += link * link.transpose();
    }
    covariance
}

fn wide(numbers: &LinearParameters<N, P>) -> DVector<f64> {
    let numbers: Vec<f64> = numbers.iter().map(|&x| f64::from(x)).collect();
    DVector::from_vec(numbers)
}

impl Twin {
    pub(super) fn new(config: LearnerConfig<N, P>, prior: &Set) -> Self {
        let start = wide(&LinearParameters::of(prior));
        let n = start.len();
        Self {
            sigma: wide(&config.sigma()),
            config,
            start,
            theta: DVector::zeros(n),
            covariance: prior_covariance(),
            variance: Estimator::new::<Ur5>(prior).variance().map(f64::from),
            noticed: [FIRST_ROWS; N],
            wandering: [0; N],
        }
    }

    /// Takes in the torque `tau` of `joint` with its row, as the estimator does:
    /// `P ← P − P φ φᵀ P / S`, `θ ← θ + P φ clip(z, ±k) / √S`, then the bounds by way of P, three at most.
    pub(super) fn correct(&mut self, joint: usize, row: &LinearParameters<N, P>, tau: f32) {
        let limit = <Ur5 as Arm<N, P>>::LIMITS[joint].torque;
        let unit = f64::from(self.config.noise * limit);
        let raw = wide(row);
        let value = &self.start + self.sigma.component_mul(&self.theta);
        let innovation = (f64::from(tau) - raw.dot(&value)) / unit;
        let phi = raw.component_mul(&self.sigma) / unit;
        let turn = &mut self.wandering[joint];
        let columns = RANDOM_WALK_COLUMNS.len();
        let k = joint * FRICTION_COLUMNS + RANDOM_WALK_COLUMNS[*turn] as usize;
        if self.covariance[(k, k)] < 1.0 {
            self.covariance[(k, k)] += columns as f64 * f64::from(self.config.process_noise);
        }
        *turn = (*turn + 1) % columns;
        let spread = &self.covariance * &phi;
        let s = phi.dot(&spread) + self.variance[joint];
        self.covariance.ger(-1.0 / s, &spread, &spread, 1.0);
        let z = innovation / s.sqrt();
        let (variance, noticed) = (&mut self.variance[joint], &mut self.noticed[joint]);
        let mut step = VARIANCE_STEP;
        if *noticed < NOTICED_ROWS {
            *noticed += *variance / s;
            step = 1.0 + VARIANCE_GAIN * *variance / s / *noticed;
        }
        *variance *= if z.abs() > MEDIAN { step } else { 1.0 / step };
        *variance = variance.clamp(VARIANCE_RANGE.0, VARIANCE_RANGE.1);
        let most = f64::from(self.config.outlier_sigmas);
        self.theta
            .axpy(z.clamp(-most, most) / s.sqrt(), &spread, 1.0);
        for _ in 0..3 {
            self.project(joint * FRICTION_COLUMNS);
        }
    }

    /// Moves the worst violated bound of the friction whose columns begin at `first` by way of the covariance.
    fn project(&mut self, first: usize) {
        let mut worst = (1e-4, DVector::zeros(self.theta.len()));
        for bound in &DISSIPATION_BOUNDS {
            let mut direction = DVector::zeros(self.theta.len());
            let mut value = 0.0;
            for (k, &a) in (first..).zip(bound) {
                direction[k] = f64::from(a) * self.sigma[k];
                value += f64::from(a) * (self.start[k] + self.sigma[k] * self.theta[k]);
            }
            let deviation = direction.norm();
            if -value / deviation > worst.0 {
                worst = (-value / deviation, direction / deviation);
            }
        }
        let (violation, direction) = worst;
        let spread = &self.covariance * &direction;
        let variance = direction.dot(&spread);
        if variance > 0.0 {
            self.theta.axpy(violation / variance, &spread, 1.0);
        }
    }

    /// Largest distance of any parameter of `estimate`, prior standard deviations.
    pub(super) fn distance(&self, estimate: &LinearParameters<N, P>) -> f64 {
        let found = (wide(estimate) - &self.start).component_div(&self.sigma);
        (found - &self.theta).amax()
    }
}
