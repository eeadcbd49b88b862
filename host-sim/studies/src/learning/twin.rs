//! A twin of the firmware's estimator on the plain covariance and in f64: nearly exact arithmetic.

use super::PERIOD_S;
use foretorque::arm::Arm;
use foretorque::arm::ur5::Ur5;
pub(super) use foretorque::arm::ur5::{JOINTS as N, PARAMETERS as P};
use foretorque::dynamics::{
    DISSIPATION_BOUNDS, FRICTION_COLUMNS, FrictionColumn, RANDOM_WALK_COLUMNS,
};
use foretorque::feedforward::ParameterSet;
use foretorque::joint::JointSample;
use foretorque::learning::{
    Estimator, LearnerConfig, LinearParameters, MeasurementWindow, prior_factor, prior_floor,
    torque_row,
};
use foretorque_link::wire::SampleFrame;
use nalgebra::{DMatrix, DVector, SVector};

/// Parameters of the soaked arm.
pub(super) type Set = ParameterSet<N, P>;

/// Ticks between two evaluations at what is large.
pub(super) const CHUNK: usize = 1000;
/// Where half of the |z| of a normal z lie, growth of the variance beyond it, and its range.
const MEDIAN: f64 = 0.6745;
const VARIANCE_STEP: f64 = 1.005;
const VARIANCE_RANGE: (f64, f64) = (0.02, 400.0);
/// Step of the first rows times their number, rows that count as taken before the first, and rows until it lasts.
const VARIANCE_GAIN: f64 = 2.3;
const FIRST_ROWS: f64 = 4.0;
const NOTICED_ROWS: f64 = VARIANCE_GAIN / (VARIANCE_STEP - 1.0);

/// Distance from a limit within which rounding may decide, standard deviations.
const BORDER: f64 = 1e-3;
/// Sweeps of Hildreth's method.
const SWEEPS: usize = 200;

/// The twin. Parameters in prior standard deviations from the start.
pub(super) struct Twin {
    config: LearnerConfig<N, P>,
    start: DVector<f64>,
    sigma: DVector<f64>,
    theta: DVector<f64>,
    covariance: DMatrix<f64>,
    variance: [f64; N],
    noticed: [f64; N],
    direction: [usize; N],
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
    let numbers = numbers.iter().map(|&x| f64::from(x));
    DVector::from_vec(numbers.collect())
}

impl Twin {
    pub(super) fn new(config: LearnerConfig<N, P>, prior: &Set) -> Self {
        let start = wide(&LinearParameters::of(prior));
        let n = start.len();
        Self {
            sigma: wide(&config.sigma),
            config,
            start,
            theta: DVector::zeros(n),
            covariance: prior_covariance(),
            variance: Estimator::new::<Ur5>(prior).variance().map(f64::from),
            noticed: [FIRST_ROWS; N],
            direction: [0; N],
        }
    }

    /// Takes in the torque `tau` of `joint` with its row, as the estimator does:
    /// `P ← P − P φ φᵀ P / S` unless e is clipped, `θ ← θ + P φ clip(e) / S`, then the bounds by way of P.
    ///
    /// * `taken` the estimator has raised its variance, and has changed its P: it decides where rounding may put e on either side
    ///   of the median or of the clip
    pub(super) fn correct(
        &mut self,
        joint: usize,
        row: &LinearParameters<N, P>,
        tau: f32,
        taken: [bool; 2],
    ) {
        let limit = <Ur5 as Arm<N, P>>::LIMITS[joint].torque;
        let unit = f64::from(self.config.noise * limit);
        let raw = wide(row);
        let value = &self.start + self.sigma.component_mul(&self.theta);
        let innovation = (f64::from(tau) - raw.dot(&value)) / unit;
        let phi = raw.component_mul(&self.sigma) / unit;
        let turn = &mut self.direction[joint];
        let columns = RANDOM_WALK_COLUMNS.len();
        let column = RANDOM_WALK_COLUMNS[*turn];
        let k = joint * FRICTION_COLUMNS + column as usize;
        let held = self.covariance[(k, k)];
        if held < 1.0 {
            let share = match column {
                FrictionColumn::Offset => 1.0,
                _ => ((value[k] / self.sigma[k]).powi(2) + held).min(1.0),
            };
            let noise = columns as f64 * f64::from(self.config.process_noise);
            self.covariance[(k, k)] += noise * share;
        }
        *turn = (*turn + 1) % columns;
        let spread = &self.covariance * &phi;
        let s = phi.dot(&spread) + self.variance[joint];
        let total =
            phi.dot(&spread) + f64::from(self.config.noise_inflation) * self.variance[joint];
        let z = innovation / s.sqrt();
        let [risen, informed] = taken;
        let beyond = |limit: f64, decided: bool| match z.abs() - limit {
            distance if distance.abs() < BORDER => decided,
            distance => distance > 0.0,
        };
        if !beyond(self.config.outlier_sigmas.into(), !informed) {
            self.covariance.ger(-1.0 / total, &spread, &spread, 1.0);
        }
        let (variance, noticed) = (&mut self.variance[joint], &mut self.noticed[joint]);
        let mut step = VARIANCE_STEP;
        if *noticed < NOTICED_ROWS {
            *noticed += *variance / s;
            step = 1.0 + VARIANCE_GAIN * *variance / s / *noticed;
        }
        *variance *= if beyond(MEDIAN, risen) {
            step
        } else {
            1.0 / step
        };
        *variance = variance.clamp(VARIANCE_RANGE.0, VARIANCE_RANGE.1);
        let most = f64::from(self.config.outlier_sigmas) * s.sqrt();
        let step = innovation.clamp(-most, most) / total;
        self.theta.axpy(step, &spread, 1.0);
        self.bound(joint * FRICTION_COLUMNS);
    }

    /// Moves the friction whose columns begin at `first` within its bounds by way of the covariance: θ ← θ + P Aᵀ λ, with
    /// the multipliers of Hildreth's method.
    fn bound(&mut self, first: usize) {
        const BOUNDS: usize = DISSIPATION_BOUNDS.len();
        let mut rows = DMatrix::zeros(BOUNDS, self.theta.len());
        let mut values = [0.0; BOUNDS];
        for (i, bound) in DISSIPATION_BOUNDS.iter().enumerate() {
            for (k, &a) in (first..).zip(bound) {
                rows[(i, k)] = f64::from(a) * self.sigma[k];
                values[i] += f64::from(a) * (self.start[k] + self.sigma[k] * self.theta[k]);
            }
        }
        if values.iter().all(|&value| value >= 0.0) {
            return;
        }
        let spread = &self.covariance * rows.transpose();
        let gram = rows * &spread;
        let mut multipliers = DVector::zeros(BOUNDS);
        for _ in 0..SWEEPS {
            for i in 0..BOUNDS {
                let value = values[i] + gram.row(i).transpose().dot(&multipliers);
                multipliers[i] = f64::max(0.0, multipliers[i] - value / gram[(i, i)]);
            }
        }
        self.theta += spread * multipliers;
    }

    /// Largest distance of any parameter of `estimate`, prior standard deviations; infinite if one is not finite.
    pub(super) fn distance(&self, estimate: &LinearParameters<N, P>) -> f64 {
        let found = (wide(estimate) - &self.start).component_div(&self.sigma);
        let distances = (found - &self.theta).abs();
        match distances.iter().all(|distance| distance.is_finite()) {
            true => distances.max(),
            false => f64::INFINITY,
        }
    }
}

/// The firmware's estimator beside exact arithmetic, on the rows of the same samples. Returns the largest distance, prior
/// standard deviations, and the number of rows.
pub(super) fn twin(
    prior: &Set,
    samples: impl Iterator<Item = JointSample<N>>,
    advance: &dyn Fn(),
) -> (f64, usize) {
    let config = LearnerConfig::<N, P>::for_arm::<Ur5>(PERIOD_S as f32);
    let mut estimator = Box::new(Estimator::<N, P>::new::<Ur5>(prior));
    let mut twin = Twin::new(config, prior);
    let mut window = MeasurementWindow::<N>::new(config.decimation, config.delay);
    let (mut worst, mut rows) = (0.0_f64, 0);
    for (tick, sample) in samples.enumerate() {
        let sample = SampleFrame::new(&sample).sample(&[0.0; N]);
        window.push(sample.measured.as_ref());
        let joint = tick % N;
        let seen = window.conditioned(config.inv_period);
        if let Some(seen) = seen.filter(|seen| seen.motion.qd[joint].abs() >= config.velocity_gate)
        {
            let row = torque_row::<Ur5, N, P>(joint, &seen);
            let limit = <Ur5 as Arm<N, P>>::LIMITS[joint].torque;
            let variance = estimator.variance()[joint];
            let diagonal = estimator.filter().diagonal().rigid;
            let corrected = estimator.correct(&config, joint, limit, &row, seen.tau[joint]);
            let risen = estimator.variance()[joint] > variance;
            let informed = estimator.filter().diagonal().rigid != diagonal;
            if corrected.is_some() {
                twin.correct(joint, &row, seen.tau[joint], [risen, informed]);
                rows += 1;
            }
        }
        if tick % CHUNK == CHUNK - 1 {
            worst = worst.max(twin.distance(estimator.parameters()));
            advance();
        }
    }
    (worst.max(twin.distance(estimator.parameters())), rows)
}
