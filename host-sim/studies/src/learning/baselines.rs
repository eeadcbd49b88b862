//! Estimators to compare the firmware's with, all on the same rows: what an engineer would try first.

use super::world::{N, P, Set};
use foretorque::arm::Arm;
use foretorque::arm::ur5::Ur5;
use foretorque::dynamics::FRICTION_COLUMNS;
use foretorque::learning::{Estimator, LearnerConfig, LinearParameters, prior_factor, prior_floor};
use nalgebra::{DMatrix, DVector, RealField, SVector};

/// Something that learns linear parameters row by row.
pub(super) trait RowEstimator {
    /// Takes in the torque `tau`, N·m, of `joint`.
    fn correct(&mut self, joint: usize, row: &LinearParameters<N, P>, tau: f32);
    /// The estimate.
    fn parameters(&self) -> LinearParameters<N, P>;
    /// Multiply-adds of one row, n parameters, to leading order.
    fn multiply_adds(&self, n: usize) -> usize;
}

/// Covariance of the parameters at first, in units of the prior standard deviations: friction uncorrelated, base parameters
/// as doubts about links make them.
pub(super) fn prior_covariance() -> DMatrix<f64> {
    let friction = N * FRICTION_COLUMNS;
    let mut covariance = DMatrix::<f64>::identity(friction + P, friction + P);
    let mut rigid = covariance.view_mut((friction, friction), (P, P));
    let floor = SVector::<f64, P>::from(prior_floor::<Ur5, N, P>().map(f64::from));
    rigid.set_diagonal(&floor);
    for doubt in (0..).map_while(prior_factor::<Ur5, N, P>) {
        let doubt = SVector::<f64, P>::from(doubt.map(f64::from));
        rigid += doubt * doubt.transpose();
    }
    covariance
}

/// Torque limit of a joint, N·m.
fn limit(joint: usize) -> f32 {
    <Ur5 as Arm<N, P>>::LIMITS[joint].torque
}

/// The firmware's filter.
pub(super) struct Firmware {
    config: LearnerConfig<N, P>,
    estimator: Box<Estimator<N, P>>,
}

impl Firmware {
    pub(super) fn new(config: LearnerConfig<N, P>, prior: &Set) -> Self {
        Self {
            config,
            estimator: Box::new(Estimator::new::<Ur5>(prior)),
        }
    }
}

impl RowEstimator for Firmware {
    fn correct(&mut self, joint: usize, row: &LinearParameters<N, P>, tau: f32) {
        let Self { config, estimator } = self;
        // A row with a number that is none changes nothing; there is none here.
        let _ = estimator.correct(config, joint, limit(joint), row, tau);
    }

    fn parameters(&self) -> LinearParameters<N, P> {
        *self.estimator.parameters()
    }

    fn multiply_adds(&self, n: usize) -> usize {
        let friction = n - P;
        (2 * friction + 3 * P / 2) * P
    }
}

/// Rows and parameters in units of noise and of the prior's standard deviations.
struct Scale {
    start: LinearParameters<N, P>,
    sigma: LinearParameters<N, P>,
    noise: f32,
}

impl Scale {
    fn new(config: &LearnerConfig<N, P>, prior: &Set) -> Self {
        Self {
            start: LinearParameters::of(prior),
            sigma: config.sigma(),
            noise: config.noise,
        }
    }

    /// The row, and what the start leaves unexplained.
    fn row<T: RealField>(
        &self,
        joint: usize,
        row: &LinearParameters<N, P>,
        tau: f32,
    ) -> (DVector<T>, T) {
        let inv_noise = 1.0 / (self.noise * limit(joint));
        let columns = row.iter().zip(self.sigma.iter());
        let phi: Vec<T> = columns
            .map(|(row, sigma)| nalgebra::convert(f64::from(row * sigma * inv_noise)))
            .collect();
        let left = f64::from((tau - row.dot(&self.start)) * inv_noise);
        (DVector::from_vec(phi), nalgebra::convert(left))
    }

    fn parameters(&self, theta: impl Iterator<Item = f64>) -> LinearParameters<N, P> {
        let mut found = self.start;
        let columns = found.iter_mut().zip(self.sigma.iter());
        for ((found, sigma), theta) in columns.zip(theta) {
            *found += sigma * theta as f32;
        }
        found
    }
}

/// Normalised least mean squares: `θ ← θ + μ φ e / (1 + φᵀφ)`.
pub(super) struct Nlms {
    scale: Scale,
    rate: f64,
    theta: DVector<f64>,
}

impl Nlms {
    pub(super) fn new(config: &LearnerConfig<N, P>, prior: &Set, rate: f64) -> Self {
        let scale = Scale::new(config, prior);
        let n = scale.start.iter().count();
        Self {
            scale,
            rate,
            theta: DVector::zeros(n),
        }
    }
}

impl RowEstimator for Nlms {
    fn correct(&mut self, joint: usize, row: &LinearParameters<N, P>, tau: f32) {
        let (phi, left) = self.scale.row::<f64>(joint, row, tau);
        let error = left - phi.dot(&self.theta);
        let step = self.rate * error / (1.0 + phi.norm_squared());
        self.theta.axpy(step, &phi, 1.0);
    }

    fn parameters(&self) -> LinearParameters<N, P> {
        self.scale.parameters(self.theta.iter().copied())
    }

    fn multiply_adds(&self, n: usize) -> usize {
        3 * n
    }
}

/// Recursive least squares with exponential forgetting, the covariance made symmetric after every row.
///
/// ```text
/// K = P φ / (λ + φᵀ P φ)      θ ← θ + K e      P ← (P − K φᵀ P) / λ,   P ← (P + Pᵀ) / 2
/// ```
pub(super) struct Rls<T: RealField> {
    scale: Scale,
    forgetting: T,
    theta: DVector<T>,
    covariance: DMatrix<T>,
}

impl<T: RealField + Copy> Rls<T> {
    pub(super) fn new(config: &LearnerConfig<N, P>, prior: &Set, forgetting: f64) -> Self {
        let scale = Scale::new(config, prior);
        let n = scale.start.iter().count();
        Self {
            scale,
            forgetting: nalgebra::convert(forgetting),
            theta: DVector::zeros(n),
            covariance: nalgebra::convert(prior_covariance()),
        }
    }
}

impl<T: RealField + Copy + Into<f64>> RowEstimator for Rls<T> {
    fn correct(&mut self, joint: usize, row: &LinearParameters<N, P>, tau: f32) {
        let (phi, left) = self.scale.row::<T>(joint, row, tau);
        let spread = &self.covariance * &phi;
        let inverse = T::one() / (self.forgetting + phi.dot(&spread));
        let error = left - phi.dot(&self.theta);
        self.theta.axpy(error * inverse, &spread, T::one());
        self.covariance.ger(-inverse, &spread, &spread, T::one());
        let half: T = nalgebra::convert(0.5);
        let transposed = self.covariance.transpose();
        self.covariance += transposed;
        self.covariance *= half / self.forgetting;
    }

    fn parameters(&self) -> LinearParameters<N, P> {
        self.scale
            .parameters(self.theta.iter().map(|&theta| theta.into()))
    }

    fn multiply_adds(&self, n: usize) -> usize {
        3 * n * n
    }
}
