//! One round of the search: L-BFGS on the objective.

use super::objective::{Objective, PenaltyWeights};
use argmin::core::{CostFunction, Error, Executor, Gradient};
use argmin::solver::linesearch::MoreThuenteLineSearch;
use argmin::solver::quasinewton::LBFGS;
use std::cell::RefCell;

/// Pairs that the quasi-Newton method remembers.
const MEMORY: usize = 20;

/// The best point seen in at most `iterations` from `variables` on.
pub(super) fn descend<const N: usize>(
    objective: &Objective<N>,
    penalties: &PenaltyWeights,
    variables: Vec<f64>,
    iterations: usize,
) -> Vec<f64> {
    let problem = Problem {
        objective,
        penalties,
        last: RefCell::new(None),
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

/// Variables, value and gradient of one look at the objective.
type Evaluation = (Vec<f64>, f64, Vec<f64>);

/// The objective as the solver sees it. Value and gradient come from one evaluation, asked for one after the other.
struct Problem<'a, const N: usize> {
    objective: &'a Objective<N>,
    penalties: &'a PenaltyWeights,
    last: RefCell<Option<Evaluation>>,
    best: RefCell<(f64, Vec<f64>)>,
}

impl<const N: usize> Problem<'_, N> {
    fn evaluated<T>(&self, variables: &[f64], pick: impl Fn(f64, &[f64]) -> T) -> T {
        if let Some((known, value, gradient)) = &*self.last.borrow()
            && known == variables
        {
            return pick(*value, gradient);
        }
        let mut gradient = vec![0.0; variables.len()];
        let value = self
            .objective
            .value(variables, self.penalties, Some(&mut gradient));
        let picked = pick(value, &gradient);
        let mut best = self.best.borrow_mut();
        if value < best.0 {
            *best = (value, variables.to_vec());
        }
        *self.last.borrow_mut() = Some((variables.to_vec(), value, gradient));
        picked
    }
}

impl<const N: usize> CostFunction for &Problem<'_, N> {
    type Param = Vec<f64>;
    type Output = f64;

    fn cost(&self, variables: &Vec<f64>) -> Result<f64, Error> {
        Ok(self.evaluated(variables, |value, _| value))
    }
}

impl<const N: usize> Gradient for &Problem<'_, N> {
    type Param = Vec<f64>;
    type Gradient = Vec<f64>;

    fn gradient(&self, variables: &Vec<f64>) -> Result<Vec<f64>, Error> {
        Ok(self.evaluated(variables, |_, gradient| gradient.to_vec()))
    }
}
