//! Methods on rows that are there already: no log, no filter. What studies over many small sets of rows need.

use super::columns::Layout;
use super::gathered::SampleRow;
use super::methods::MethodName;
use super::solve::{Material, Problem, solve_all};
use super::validation::Candidate;
use crate::dynamics::Joints;
use crate::robot::Robot;
use std::error::Error;

/// One method after its training.
#[derive(Clone, Debug)]
pub struct Trial<const N: usize> {
    /// The method.
    pub name: MethodName,
    /// The model.
    pub candidate: Candidate<N>,
    /// Rows it was trained on.
    pub rows: usize,
    /// Epochs or iterations.
    pub epochs: usize,
    /// Epochs of `bp_physical` to 1.05 times the loss of weighted least squares, accelerated and plain.
    pub epochs_to_wls: Option<[Option<usize>; 2]>,
    /// Time of the fit, the sums over the rows apart, s.
    pub seconds: f64,
}

impl<const N: usize> Trial<N> {
    /// Torque of the model at the state of `row`, N·m.
    pub fn torque(&self, layout: &Layout<N>, row: &SampleRow<N>) -> Joints<N> {
        let network = self.candidate.network(&row.state).unwrap_or([0.0; N]);
        Joints::from_fn(|joint, _| {
            let theta = self.candidate.theta();
            theta.map_or(0.0, |theta| row.linear(layout, theta, joint))
                + self.candidate.ripple(joint, &row.waves[joint])
                + network[joint]
        })
    }
}

/// Trains `methods` on `rows`, whose panels are those of `layout`.
///
/// * `board` the columns among them that the board has: the linear part of `bp_residual`
///
/// Errors: columns that the rows do not show ([`super::IdentificationError`]); a method that cannot be solved.
pub fn fit_rows<const N: usize>(
    robot: &Robot,
    layout: &Layout<N>,
    board: &Layout<N>,
    methods: &[MethodName],
    rows: &[&SampleRow<N>],
    seed: u64,
) -> Result<Vec<Trial<N>>, Box<dyn Error>> {
    let material = Material::of(layout, rows.to_vec());
    material.sums.check_rank(layout)?;
    let problem = Problem {
        robot,
        layout,
        board,
        methods,
        seed,
    };
    let solved = solve_all(&problem, &material, &|_| ())?;
    Ok(solved
        .into_iter()
        .map(|solved| Trial {
            name: solved.name,
            candidate: solved.candidate,
            rows: solved.rows,
            epochs: solved.epochs,
            epochs_to_wls: solved.epochs_to_wls,
            seconds: solved.seconds,
        })
        .collect())
}
