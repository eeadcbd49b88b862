//! Batch identification on the rows of a run: weighted least squares with all columns of the board.

use super::PERIOD_S;
use foretorque::arm::Arm;
use foretorque::feedforward::ParameterSet;
use foretorque::joint::JointMeasurement;
use foretorque::learning::{
    ConditionedSample, LearnerConfig, LinearParameters, MeasurementWindow, torque_row,
};
use foretorque_link::bank::ParameterBank;
use nalgebra::{DMatrix, DVector};

/// Every how many-th tick gives rows.
const STRIDE: usize = 10;
/// Prior standard deviations of the batch, in those of the learner: hardly any prior.
const DOUBT: f64 = 10.0;
/// Rows of a block that is added at once, and rows of half a second.
const BLOCK: usize = 64;
const CORRELATED: usize = (0.5 / PERIOD_S) as usize / STRIDE;

/// Rows as the board filters them.
pub(super) struct Rows<const N: usize> {
    window: MeasurementWindow<N>,
    ticks: usize,
    rows: Vec<ConditionedSample<N>>,
}

/// Sums of one joint's equations, columns in prior standard deviations.
struct Sums {
    gram: DMatrix<f64>,
    moment: DVector<f64>,
    power: f64,
    count: f64,
}

impl<const N: usize> Rows<N> {
    pub(super) fn new() -> Self {
        Self {
            window: MeasurementWindow::new(),
            ticks: 0,
            rows: Vec::new(),
        }
    }

    /// Takes the measurement of one tick, if one came.
    pub(super) fn push(&mut self, measured: Option<&JointMeasurement<N>>) {
        self.window.push(measured);
        self.ticks += 1;
        if self.ticks.is_multiple_of(STRIDE) {
            self.rows
                .extend(self.window.conditioned(1.0 / PERIOD_S as f32));
        }
    }

    /// The bank that fits the rows best, beginning at `start`, with the standard deviations that correlated residuals leave.
    pub(super) fn fit<A: Arm<N, P>, const P: usize>(
        &self,
        start: &ParameterSet<N, P>,
    ) -> ParameterBank {
        let config = LearnerConfig::<N, P>::for_arm::<A>(PERIOD_S as f32);
        let (origin, sigma) = (LinearParameters::of(start), config.sigma);
        let scale: Vec<f64> = sigma.iter().map(|s| DOUBT * f64::from(*s)).collect();
        let scale = DVector::from_vec(scale);
        let rows = |joint: usize| {
            let moving = move |seen: &&ConditionedSample<N>| {
                seen.motion.qd[joint].abs() >= config.velocity_gate
            };
            self.rows.iter().filter(moving).map(move |seen| {
                let row = torque_row::<A, N, P>(joint, seen);
                (row, f64::from(seen.tau[joint] - row.dot(&origin)))
            })
        };
        let scaled = |row: &LinearParameters<N, P>| {
            DVector::from_iterator(scale.len(), row.iter().map(|x| f64::from(*x)))
                .component_mul(&scale)
        };
        let sums: Vec<Sums> = (0..N)
            .map(|joint| {
                let rows: Vec<_> = rows(joint).collect();
                let mut sums = Sums::new(scale.len());
                for block in rows.chunks(BLOCK) {
                    let columns: Vec<_> = block.iter().map(|(row, _)| scaled(row)).collect();
                    let tau = DVector::from_iterator(block.len(), block.iter().map(|(_, t)| *t));
                    sums.add(&DMatrix::from_columns(&columns), &tau);
                }
                sums
            })
            .collect();
        let (mut weights, mut found) = ([1.0; N], DVector::zeros(scale.len()));
        let solve = |weights: &[f64; N]| {
            let mut normal = DMatrix::<f64>::identity(scale.len(), scale.len());
            let mut right = DVector::zeros(scale.len());
            for (sums, weight) in sums.iter().zip(weights) {
                normal += &sums.gram * *weight;
                right.axpy(*weight, &sums.moment, 1.0);
            }
            normal
                .cholesky()
                .map(|normal| (normal.solve(&right), normal))
        };
        for _ in 0..3 {
            weights = std::array::from_fn(|joint| 1.0 / sums[joint].variance(&found));
            found = solve(&weights).map_or(found, |(found, _)| found);
        }
        // Half-second blocks of correlated residuals carry less information than as many independent ones.
        let inflated: [f64; N] = std::array::from_fn(|joint| {
            let residuals: Vec<f64> = rows(joint)
                .map(|(row, tau)| tau - scaled(&row).dot(&found))
                .collect();
            weights[joint] / correlation(&residuals)
        });
        let variances = solve(&inflated).map(|(_, normal)| normal.inverse().diagonal());
        let mut fitted = origin;
        for (fitted, moved) in fitted.iter_mut().zip(found.component_mul(&scale).iter()) {
            *fitted += *moved as f32;
        }
        let mut set = *start;
        fitted.write(&mut set);
        let mut bank = ParameterBank::from_set::<A, N, P>(&set);
        if let Some(variances) = variances {
            let mut deviations = LinearParameters::<N, P>::filled(0.0);
            for (k, deviation) in deviations.iter_mut().enumerate() {
                *deviation = (variances[k].sqrt() * scale[k]) as f32;
            }
            let friction = deviations.friction.as_flattened();
            let rigid = bank.columns.len() - friction.len();
            let all = deviations.rigid[..rigid].iter().chain(friction);
            for (column, deviation) in bank.columns.iter_mut().zip(all) {
                column.deviation = *deviation;
            }
        }
        bank
    }
}

/// Variance of the sum of a block over that of independent values, at least 1.
fn correlation(residuals: &[f64]) -> f64 {
    let blocks = residuals.chunks_exact(CORRELATED);
    let sums: f64 = blocks.map(|block| block.iter().sum::<f64>().powi(2)).sum();
    let squares: f64 = residuals.iter().map(|e| e * e).sum();
    let count = (residuals.len() / CORRELATED * CORRELATED) as f64;
    let plain = squares * count / residuals.len().max(1) as f64;
    if plain > 0.0 {
        (sums / plain).max(1.0)
    } else {
        1.0
    }
}

impl Sums {
    fn new(columns: usize) -> Self {
        Self {
            gram: DMatrix::zeros(columns, columns),
            moment: DVector::zeros(columns),
            power: 0.0,
            count: 0.0,
        }
    }

    /// Adds equations, one a column of `x`.
    fn add(&mut self, x: &DMatrix<f64>, tau: &DVector<f64>) {
        self.gram.gemm(1.0, x, &x.transpose(), 1.0);
        self.moment.gemv(1.0, x, tau, 1.0);
        self.power += tau.norm_squared();
        self.count += tau.len() as f64;
    }

    /// Mean square residual, (N·m)²; never 0.
    fn variance(&self, found: &DVector<f64>) -> f64 {
        let sum = self.power - 2.0 * self.moment.dot(found) + found.dot(&(&self.gram * found));
        (sum / self.count.max(1.0)).max(1e-9)
    }
}
