//! Objective of the search: the criterion plus a penalty for every violated limit; and its descent by L-BFGS.

use super::clearance::Clearances;
use super::information::{Criterion, Experiment, Worth};
use super::rows::Rows;
use super::series::{Bases, Extremes, VARIABLES};
use crate::dynamics::{Motion, PerJoint};
use argmin::core::{CostFunction, Error, Executor, Gradient};
use argmin::solver::linesearch::MoreThuenteLineSearch;
use argmin::solver::quasinewton::LBFGS;
use nalgebra::{DMatrix, DVector};
use std::cell::RefCell;
use std::f64::consts::{PI, TAU};
use std::num::NonZeroUsize;

/// Instants of a period at which a search evaluates a path. The highest harmonic of the series has 50 a cycle.
pub(super) const INSTANTS: usize = 250;
/// A smoother sign than the certificate's, so that 250 instants resolve it, rad/s.
const SIGN_WIDTH_RAD_S: f64 = 0.05;
/// A clearance missed by this much weighs like a limit exceeded by its own size, m.
const CLEARANCE_SCALE_M: f64 = 0.1;
/// Figure of a path on which parameters cannot be distinguished, above that of any other; finite, as the line search requires.
const UNSEEN: f64 = 1e30;

/// Configuration of a search.
#[derive(Clone, Debug, PartialEq)]
pub struct SearchConfig {
    /// Period of the fundamental, s.
    pub period_s: f64,
    /// Objective.
    pub criterion: Criterion,
    /// Limit of the condition number under [`Criterion::Constrained`].
    pub condition_limit: f64,
    /// A result beyond that limit is none. Otherwise the best one counts where no start keeps it.
    pub condition_required: bool,
    /// Seed of the starts.
    pub seed: u64,
    /// Starts.
    pub starts: usize,
    /// Most iterations of a round for the finalists, one start in four; the rounds before are shorter.
    pub iterations: usize,
    /// Range of every joint around zero, rad, on top of the robot's own.
    pub range_rad: f64,
    /// Threads; the result does not depend on them. `None`: all cores.
    pub threads: Option<NonZeroUsize>,
}

impl Default for SearchConfig {
    fn default() -> Self {
        Self {
            period_s: 10.0,
            criterion: Criterion::Constrained,
            condition_limit: 60.0,
            condition_required: true,
            seed: 1,
            starts: 24,
            iterations: 240,
            range_rad: PI,
            threads: None,
        }
    }
}

#[derive(Clone, Debug)]
pub(super) struct Objective {
    pub(super) rows: Rows,
    pub(super) experiment: Experiment,
    pub(super) clearances: Clearances,
    /// Required distance of each pair, m: the limit plus a margin for the motion between the certificate's points.
    pub(super) required_m: Vec<f64>,
    /// Limits of the joints, as the search keeps them.
    pub(super) limits: Vec<Extremes>,
    /// Torque limits less what friction beyond the columns may add, N·m.
    pub(super) torque: PerJoint<f64>,
    /// Nominal parameters of all columns.
    pub(super) parameters: DVector<f64>,
    pub(super) criterion: Criterion,
    pub(super) ln_condition_limit: f64,
    pub(super) basis: Vec<[[f64; 3]; VARIABLES]>,
}

/// q, qd, qdd of each variable at each instant of a period.
pub(super) fn basis(bases: &Bases, period_s: f64) -> Vec<[[f64; 3]; VARIABLES]> {
    let at = |k: usize, variable: usize| {
        let mut one = [0.0; VARIABLES];
        one[variable] = 1.0;
        let t_s = period_s * k as f64 / INSTANTS as f64;
        let (q, qd, qdd) = bases.series(&one).at(t_s, TAU / period_s);
        [q, qd, qdd]
    };
    let instants = (0..INSTANTS).map(|k| std::array::from_fn(|variable| at(k, variable)));
    instants.collect()
}

impl Objective {
    fn state(&self, instant: usize, variables: &[f64]) -> Motion {
        let mut state = Motion::zeros(self.torque.len());
        for (j, own) in variables.chunks_exact(VARIABLES).enumerate() {
            for (x, [of_q, of_qd, of_qdd]) in own.iter().zip(&self.basis[instant]) {
                state.q[j] += x * of_q;
                state.qd[j] += x * of_qd;
                state.qdd[j] += x * of_qdd;
            }
        }
        state
    }

    /// Value at `variables` (9 a joint) with this weight of the penalties, and its gradient where `gradient` is given.
    pub(super) fn value(
        &self,
        variables: &[f64],
        weight: f64,
        gradient: Option<&mut [f64]>,
    ) -> f64 {
        let (width, joints) = (self.rows.count(), self.rows.joints());
        let states: Vec<Motion> = (0..INSTANTS).map(|k| self.state(k, variables)).collect();
        let transposed = self.rows.transposed(&states, SIGN_WIDTH_RAD_S);
        let with_gradient = gradient.is_some();
        let mut adjoint = DMatrix::zeros(width, if with_gradient { INSTANTS * joints } else { 0 });
        let shares = |worth: &Worth| self.shares(worth, weight).1;
        let worth =
            self.experiment
                .worth(&transposed, shares, with_gradient.then_some(&mut adjoint));
        let Some(worth) = worth else {
            if let Some(gradient) = gradient {
                gradient.fill(0.0);
            }
            return UNSEEN;
        };
        let mut value = self.shares(&worth, weight).0;
        // Derivatives of the penalties with respect to q, qd, qdd at every instant.
        let mut slopes = vec![PerJoint::repeat(joints, [0.0; 3]); INSTANTS];
        let each = weight / INSTANTS as f64;
        let mut distances = vec![0.0; self.clearances.count()];
        for (k, state) in states.iter().enumerate() {
            value += each * self.joint_penalty(state, each, &mut slopes[k]);
            value += each
                * self.clearance_penalty(state, &mut distances, |j, slope| {
                    slopes[k][j][0] += each * slope;
                });
            for j in 0..joints {
                let row = transposed.column(k * joints + j);
                let tau = row.dot(&self.parameters);
                let over = tau.abs() / self.torque[j] - 1.0;
                if over > 0.0 {
                    value += each * over * over;
                    if with_gradient {
                        let slope = 2.0 * each * over * tau.signum() / self.torque[j];
                        adjoint
                            .column_mut(k * joints + j)
                            .axpy(slope, &self.parameters, 1.0);
                    }
                }
            }
        }
        if let Some(gradient) = gradient {
            let pulls = adjoint.as_slice().chunks_exact(joints * width);
            for ((state, pull), slopes) in states.iter().zip(pulls).zip(&mut slopes) {
                self.rows.add_slopes(state, SIGN_WIDTH_RAD_S, pull, slopes);
            }
            for (j, own) in gradient.chunks_exact_mut(VARIABLES).enumerate() {
                for (v, sum) in own.iter_mut().enumerate() {
                    let instants = slopes.iter().zip(&self.basis).map(|(slopes, basis)| {
                        let both = slopes[j].iter().zip(&basis[v]);
                        both.map(|(slope, basis)| slope * basis).sum::<f64>()
                    });
                    *sum = instants.sum();
                }
            }
        }
        value
    }

    /// The criterion with the penalty on the condition number, and its derivatives.
    fn shares(&self, worth: &Worth, weight: f64) -> (f64, Worth) {
        let mut share = Worth::default();
        let (value, of_value) = match self.criterion {
            Criterion::Condition => (worth.ln_condition, &mut share.ln_condition),
            Criterion::DOptimal => (worth.ln_spread, &mut share.ln_spread),
            Criterion::VOptimal => (worth.ln_error, &mut share.ln_error),
            Criterion::Constrained => {
                let over = (worth.ln_condition - self.ln_condition_limit).max(0.0);
                share.ln_condition = 2.0 * weight * over;
                (worth.ln_error + weight * over * over, &mut share.ln_error)
            }
        };
        *of_value = 1.0;
        (value, share)
    }

    /// Squared excess over the joints' limits, relative to them; `each` times the slopes is added to `slopes`.
    fn joint_penalty(&self, state: &Motion, each: f64, slopes: &mut [[f64; 3]]) -> f64 {
        let mut penalty = 0.0;
        for (j, allowed) in self.limits.iter().enumerate() {
            let half = 0.5 * (allowed.q.1 - allowed.q.0);
            let from_middle = state.q[j] - 0.5 * (allowed.q.0 + allowed.q.1);
            let limited = [
                (from_middle, half),
                (state.qd[j], allowed.qd),
                (state.qdd[j], allowed.qdd),
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

    /// Squared shortfalls of the clearances; `slope(joint, derivative)` is called where one is not zero.
    fn clearance_penalty(
        &self,
        state: &Motion,
        distances: &mut [f64],
        mut slope: impl FnMut(usize, f64),
    ) -> f64 {
        const STEP_RAD: f64 = 1e-6;
        let mut penalty = |q: &[f64]| -> f64 {
            self.clearances.write(q, distances);
            let pairs = distances.iter().zip(&self.required_m);
            let missing = pairs.map(|(d, required)| required - d);
            missing
                .map(|m| (m / CLEARANCE_SCALE_M).max(0.0).powi(2))
                .sum()
        };
        let here = penalty(&state.q);
        if here > 0.0 {
            for j in 0..state.q.len() {
                let mut q = state.q;
                q[j] += STEP_RAD;
                slope(j, (penalty(&q) - here) / STEP_RAD);
            }
        }
        here
    }
}

/// Pairs that the quasi-Newton method keeps.
const MEMORY: usize = 20;

/// The best point seen in at most `iterations` from `variables` on, with this weight of the penalties.
pub(super) fn descend(
    objective: &Objective,
    weight: f64,
    variables: Vec<f64>,
    iterations: usize,
) -> Vec<f64> {
    let problem = Problem {
        objective,
        weight,
        last: RefCell::default(),
        best: RefCell::new((f64::INFINITY, variables.clone())),
    };
    let solver = LBFGS::new(MoreThuenteLineSearch::new(), MEMORY);
    // A line search that finds no better point ends a round early; the best point seen counts either way.
    let _ = Executor::new(&problem, solver)
        .configure(|state| state.param(variables).max_iters(iterations as u64))
        .timer(false)
        .run();
    problem.best.into_inner().1
}

/// The objective in the form of the solver, which requests value and gradient in turn: one evaluation gives both.
struct Problem<'a> {
    objective: &'a Objective,
    weight: f64,
    last: RefCell<Evaluation>,
    best: RefCell<(f64, Vec<f64>)>,
}

#[derive(Clone, Default)]
struct Evaluation {
    variables: Vec<f64>,
    value: f64,
    gradient: Vec<f64>,
}

impl Problem<'_> {
    fn evaluated(&self, variables: &[f64]) -> Evaluation {
        let mut last = self.last.borrow_mut();
        if last.variables != variables {
            let mut gradient = vec![0.0; variables.len()];
            let value = self
                .objective
                .value(variables, self.weight, Some(&mut gradient));
            let mut best = self.best.borrow_mut();
            if value < best.0 {
                *best = (value, variables.to_vec());
            }
            *last = Evaluation {
                variables: variables.to_vec(),
                value,
                gradient,
            };
        }
        last.clone()
    }
}

impl CostFunction for &Problem<'_> {
    type Param = Vec<f64>;
    type Output = f64;

    fn cost(&self, variables: &Vec<f64>) -> Result<f64, Error> {
        Ok(self.evaluated(variables).value)
    }
}

impl Gradient for &Problem<'_> {
    type Param = Vec<f64>;
    type Gradient = Vec<f64>;

    fn gradient(&self, variables: &Vec<f64>) -> Result<Vec<f64>, Error> {
        Ok(self.evaluated(variables).gradient)
    }
}
