//! The function a search makes small: the criterion, and a penalty for every limit that is not kept.

use super::clearance::Clearances;
use super::information::{Criterion, Experiment, Worth};
use super::rows::Rows;
use super::series::Extremes;
use super::variables::{Bases, VARIABLES};
use crate::dynamics::{Joints, State};
use nalgebra::{DMatrix, DVector};
use std::f64::consts::TAU;

/// Instants of a period on which a search looks at a path. The highest harmonic of the series has 50 a cycle.
pub(super) const INSTANTS: usize = 250;
/// A smoother sign than the certificate's, so that 250 instants resolve it, rad/s.
const SIGN_WIDTH_RAD_S: f64 = 0.05;
/// A clearance missed by this much weighs like a limit exceeded by its own size, m.
const CLEARANCE_SCALE_M: f64 = 0.1;
/// Value of a path on which parameters cannot be told apart.
const UNSEEN: f64 = 1e3;

/// Criterion and limits of one robot.
#[derive(Clone, Debug)]
pub(super) struct Objective<const N: usize> {
    pub(super) rows: Rows<N>,
    pub(super) experiment: Experiment<N>,
    pub(super) clearances: Clearances<N>,
    /// Limits of the joints, as the search keeps them.
    pub(super) limits: Vec<Extremes>,
    /// Torque limits less what friction beyond the columns may add, N·m.
    pub(super) torque: [f64; N],
    /// Nominal parameters of all columns.
    pub(super) parameters: DVector<f64>,
    pub(super) criterion: Criterion,
    pub(super) ln_condition_limit: f64,
    /// q, qd, qdd of each variable at each instant.
    basis: Vec<[[f64; 3]; VARIABLES]>,
}

/// Weights of the limits.
#[derive(Clone, Debug)]
pub(super) struct PenaltyWeights {
    /// Weight of the penalties.
    pub(super) weight: f64,
    /// Distance asked for in each clearance, m: more than the limit, for what lies between the instants.
    pub(super) clearance: Vec<f64>,
}

impl<const N: usize> Objective<N> {
    #[expect(clippy::too_many_arguments, reason = "one call, one constant model")]
    pub(super) fn new(
        rows: Rows<N>,
        experiment: Experiment<N>,
        clearances: Clearances<N>,
        limits: Vec<Extremes>,
        torque: [f64; N],
        parameters: DVector<f64>,
        criterion: Criterion,
        condition_limit: f64,
        period_s: f64,
    ) -> Self {
        let (bases, omega) = (Bases::new(), TAU / period_s);
        let basis = (0..INSTANTS)
            .map(|k| {
                std::array::from_fn(|variable| {
                    let mut one = [0.0; VARIABLES];
                    one[variable] = 1.0;
                    let t_s = period_s * k as f64 / INSTANTS as f64;
                    let (q, qd, qdd) = bases.series(&one).at(t_s, omega);
                    [q, qd, qdd]
                })
            })
            .collect();
        Self {
            rows,
            experiment,
            clearances,
            limits,
            torque,
            parameters,
            criterion,
            ln_condition_limit: condition_limit.ln(),
            basis,
        }
    }

    fn state(&self, instant: usize, variables: &[f64]) -> State<N> {
        let zero = Joints::zeros();
        let (mut q, mut qd, mut qdd) = (zero, zero, zero);
        for (j, own) in variables.chunks_exact(VARIABLES).enumerate() {
            for (x, [of_q, of_qd, of_qdd]) in own.iter().zip(&self.basis[instant]) {
                q[j] += x * of_q;
                qd[j] += x * of_qd;
                qdd[j] += x * of_qdd;
            }
        }
        State { q, qd, qdd }
    }

    /// Value at `variables` (9 a joint), and its gradient where `gradient` is given.
    pub(super) fn value(
        &self,
        variables: &[f64],
        penalties: &PenaltyWeights,
        gradient: Option<&mut [f64]>,
    ) -> f64 {
        let width = self.rows.count();
        let states: Vec<State<N>> = (0..INSTANTS).map(|k| self.state(k, variables)).collect();
        let mut transposed = DMatrix::zeros(width, INSTANTS * N);
        for (state, block) in states
            .iter()
            .zip(transposed.as_mut_slice().chunks_exact_mut(N * width))
        {
            self.rows.write(state, SIGN_WIDTH_RAD_S, block);
        }
        let wanted = gradient.is_some();
        let mut adjoint = DMatrix::zeros(width, if wanted { INSTANTS * N } else { 0 });
        let shares = |worth: &Worth| self.shares(worth, penalties.weight).1;
        let worth = self
            .experiment
            .worth(&transposed, shares, wanted.then_some(&mut adjoint));
        let Some(worth) = worth else {
            if let Some(gradient) = gradient {
                gradient.fill(0.0);
            }
            return UNSEEN;
        };
        let mut value = self.shares(&worth, penalties.weight).0;
        // Derivatives of the penalties with respect to q, qd, qdd at every instant.
        let mut slopes = vec![[[0.0; 3]; N]; INSTANTS];
        let each = penalties.weight / INSTANTS as f64;
        let mut distances = vec![0.0; self.clearances.count()];
        for (k, state) in states.iter().enumerate() {
            value += each * self.joint_penalty(state, each, &mut slopes[k]);
            value += each
                * self.clearance_penalty(state, penalties, &mut distances, |j, slope| {
                    slopes[k][j][0] += each * slope;
                });
            for j in 0..N {
                let row = transposed.column(k * N + j);
                let tau = row.dot(&self.parameters);
                let over = tau.abs() / self.torque[j] - 1.0;
                if over > 0.0 {
                    value += each * over * over;
                    if wanted {
                        let slope = 2.0 * each * over * tau.signum() / self.torque[j];
                        adjoint
                            .column_mut(k * N + j)
                            .axpy(slope, &self.parameters, 1.0);
                    }
                }
            }
        }
        if let Some(gradient) = gradient {
            self.add_row_slopes(&states, &transposed, &adjoint, &mut slopes);
            for (j, own) in gradient.chunks_exact_mut(VARIABLES).enumerate() {
                for (v, sum) in own.iter_mut().enumerate() {
                    *sum = (0..INSTANTS)
                        .map(|k| {
                            (0..3)
                                .map(|d| slopes[k][j][d] * self.basis[k][v][d])
                                .sum::<f64>()
                        })
                        .sum();
                }
            }
        }
        value
    }

    /// The criterion with the penalty on the condition number, and its derivatives.
    fn shares(&self, worth: &Worth, weight: f64) -> (f64, Worth) {
        let mut share = Worth::NONE;
        let value = match self.criterion {
            Criterion::Condition => {
                share.ln_condition = 1.0;
                worth.ln_condition
            }
            Criterion::DOptimal => {
                share.ln_spread = 1.0;
                worth.ln_spread
            }
            Criterion::VOptimal => {
                share.ln_error = 1.0;
                worth.ln_error
            }
            Criterion::Constrained => {
                share.ln_error = 1.0;
                let over = (worth.ln_condition - self.ln_condition_limit).max(0.0);
                share.ln_condition = 2.0 * weight * over;
                worth.ln_error + weight * over * over
            }
        };
        (value, share)
    }

    /// Squares of what exceeds the joints' limits, relative to them; `each` times the slopes is added to `slopes`.
    fn joint_penalty(&self, state: &State<N>, each: f64, slopes: &mut [[f64; 3]; N]) -> f64 {
        let mut penalty = 0.0;
        for (j, limit) in self.limits.iter().enumerate() {
            let half = 0.5 * (limit.q.1 - limit.q.0);
            let from_middle = state.q[j] - 0.5 * (limit.q.0 + limit.q.1);
            let limited = [
                (from_middle, half),
                (state.qd[j], limit.qd),
                (state.qdd[j], limit.qdd),
            ];
            for (d, (value, limit)) in limited.into_iter().enumerate() {
                let over = value.abs() / limit - 1.0;
                if over > 0.0 {
                    penalty += over * over;
                    slopes[j][d] += 2.0 * each * over * value.signum() / limit;
                }
            }
        }
        penalty
    }

    /// Squares of what is missing in the clearances; `slope(joint, derivative)` is called where something is.
    fn clearance_penalty(
        &self,
        state: &State<N>,
        penalties: &PenaltyWeights,
        distances: &mut [f64],
        mut slope: impl FnMut(usize, f64),
    ) -> f64 {
        const STEP_RAD: f64 = 1e-6;
        let mut penalty = |q: &Joints<N>| -> f64 {
            self.clearances.write(q, distances);
            let missing = distances.iter().zip(&penalties.clearance);
            missing
                .map(|(d, asked)| ((asked - d) / CLEARANCE_SCALE_M).max(0.0).powi(2))
                .sum()
        };
        let here = penalty(&state.q);
        if here > 0.0 {
            for j in 0..N {
                let mut q = state.q;
                q[j] += STEP_RAD;
                slope(j, (penalty(&q) - here) / STEP_RAD);
            }
        }
        here
    }

    /// Chain rule through the regressor rows: differences of `adjoint · rows` over q, qd, qdd at every instant.
    fn add_row_slopes(
        &self,
        states: &[State<N>],
        transposed: &DMatrix<f64>,
        adjoint: &DMatrix<f64>,
        slopes: &mut [[[f64; 3]; N]],
    ) {
        // The rows are quadratic in speed, linear in acceleration: only rounding limits those steps.
        const STEPS: [f64; 3] = [1e-6, 1e-6, 1e-4];
        let size = N * self.rows.count();
        let mut block = vec![0.0; size];
        let blocks = transposed.as_slice().chunks_exact(size);
        let pulls = adjoint.as_slice().chunks_exact(size);
        for (((state, rows), pull), slopes) in states.iter().zip(blocks).zip(pulls).zip(slopes) {
            for (j, slopes) in slopes.iter_mut().enumerate() {
                for d in 0..3 {
                    let mut moved = *state;
                    match d {
                        0 => moved.q[j] += STEPS[d],
                        1 => moved.qd[j] += STEPS[d],
                        _ => moved.qdd[j] += STEPS[d],
                    }
                    self.rows.write(&moved, SIGN_WIDTH_RAD_S, &mut block);
                    let change: f64 = block
                        .iter()
                        .zip(rows)
                        .zip(pull)
                        .map(|((moved, row), pull)| (moved - row) * pull)
                        .sum();
                    slopes[d] += change / STEPS[d];
                }
            }
        }
    }
}
