//! Base parameters: the identifiable combinations of the standard parameters.

use super::RigidBodies;
use crate::robot::{LINK_PARAMETERS, Robot};
use nalgebra::{DMatrix, DVector};

/// Random states behind the rank decision; each gives N equations, 4 times as many as there are unknowns.
pub const STATES: usize = 44;

/// A column counts as new when what the columns left of it cannot explain exceeds this share of its length. Independent
/// columns leave above 0.5 where all axes are at right angles or parallel, and about sin ε where one is off by an angle ε.
/// Dependent ones leave about 1e-15, or 1e-6 to 1e-2 where calibrated angles, a few mrad off a right
/// angle, take the place of exact ones: no log shows such a column, and to merge it costs less than this share of its
/// torque.
const INDEPENDENT: f64 = 1e-2;

/// A column counts as zero when its length is below this share of the largest entry: it still has the rounding of the
/// right angles in it.
const ROUNDING: f64 = 1e-9;

/// Weights are products of lengths and direction cosines; what stands behind this digit is rounding of the solution.
/// Cutting it off makes the map the same on every machine.
const WEIGHT_GRID: f64 = 1e-12;

/// One entry of the map from standard to base parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BaseMapTerm {
    /// Index of the base parameter.
    pub base: usize,
    /// Index of the standard parameter, in the order of [`Robot::standard_parameters`].
    pub standard: usize,
    /// Weight of the standard parameter in the base parameter.
    pub weight: f64,
}

/// The map from the 10 N + N standard parameters to the base set.
#[derive(Clone, Debug, PartialEq)]
pub struct BaseMap {
    /// Standard parameters that stand for the base set: the first independent columns of the regressor from left to
    /// right, joint 1 to N, rotor inertias last.
    pub columns: Vec<usize>,
    /// Non-zero entries of B in beta = B·x, sorted by base index.
    pub terms: Vec<BaseMapTerm>,
}

impl BaseMap {
    /// Finds the base set of a robot numerically; it depends on geometry and gravity direction only. `None` when the
    /// columns found are not independent.
    ///
    /// Modified Gram–Schmidt from left to right, twice for orthogonality to rounding; then W_b B = W by back-substitution.
    fn of(robot: &Robot) -> Option<Self> {
        let w = stacked_regressor(&RigidBodies::new(robot));
        let (columns, coefficients) = independent_columns(&w);
        let rank = columns.len();
        let triangle = DMatrix::from_fn(rank, rank, |b, k| coefficients[(b, columns[k])]);
        let weights = triangle.solve_upper_triangular(&coefficients.rows(0, rank).into_owned())?;
        let weights = weights.map(|weight| (weight / WEIGHT_GRID).round() * WEIGHT_GRID);
        let places = (0..rank).flat_map(|base| (0..w.ncols()).map(move |of| (base, of)));
        let terms = places.filter(|&at| weights[at] != 0.0);
        let terms = terms.map(|(base, standard)| BaseMapTerm {
            base,
            standard,
            weight: weights[(base, standard)],
        });
        let terms = terms.collect();
        Some(Self { columns, terms })
    }

    /// Number of base parameters.
    pub fn rank(&self) -> usize {
        self.columns.len()
    }

    /// Base parameters of a robot with this geometry: beta = B·x.
    pub fn base_parameters(&self, robot: &Robot) -> Vec<f64> {
        let standard = robot.standard_parameters();
        let mut beta = vec![0.0; self.rank()];
        for term in &self.terms {
            beta[term.base] += term.weight * standard[term.standard];
        }
        beta
    }
}

/// The first independent columns of `w` from left to right, and the coefficients of every column in their orthonormal
/// basis (R of the QR factorisation).
pub fn independent_columns(w: &DMatrix<f64>) -> (Vec<usize>, DMatrix<f64>) {
    let mut basis: Vec<DVector<f64>> = Vec::new();
    let mut columns = Vec::new();
    let scale = w.amax();
    let mut coefficients = DMatrix::<f64>::zeros(w.ncols(), w.ncols());
    for c in 0..w.ncols() {
        let mut rest: DVector<f64> = w.column(c).into_owned();
        let length = rest.norm();
        for _ in 0..2 {
            for (b, direction) in basis.iter().enumerate() {
                let share = direction.dot(&rest);
                coefficients[(b, c)] += share;
                rest.axpy(-share, direction, 1.0);
            }
        }
        let new = rest.norm();
        if length > ROUNDING * scale && new > INDEPENDENT * length {
            coefficients[(basis.len(), c)] = new;
            columns.push(c);
            basis.push(rest / new);
        }
    }
    (columns, coefficients)
}

impl Robot {
    /// Map from the standard parameters of this robot to its base parameters.
    pub fn base_map(&self) -> BaseMap {
        BaseMap::of(self).expect("columns are taken only if they are independent")
    }

    /// Base parameters of this robot.
    pub fn base_parameters(&self) -> Vec<f64> {
        self.base_map().base_parameters(self)
    }
}

fn stacked_regressor(bodies: &RigidBodies) -> DMatrix<f64> {
    let joints = bodies.joints();
    let mut w = DMatrix::zeros(STATES * joints, (LINK_PARAMETERS + 1) * joints);
    for (k, motion) in bodies.random_motions(STATES).iter().enumerate() {
        bodies.regressor_into(motion, &mut w, k * joints);
    }
    w
}
