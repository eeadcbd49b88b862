//! Least squares with a prior whose weight the training rows choose: empirical Bayes [MacKay 1992, section 3].
//!
//! The masses, centres and inertias of the description are good to an unknown factor, and a friction column beyond viscous
//! and Coulomb may be absent. Each such group of parameters has a prior of known shape and unknown size g. The sizes
//! maximise the likelihood of the training rows: a group without support gets g → 0 and vanishes, a well observed one
//! stays as it is. No held-out row takes part.
//!
//! ```text
//! theta ~ N(mu, blocks g_k C_k)      (A + Λ) d = b − A mu,  theta = mu + d
//! g_k ← d_kᵀ C_k⁻¹ d_k / γ_k,        γ_k = n_k − tr(C_k⁻¹ P_kk) / g_k,   P = (A + Λ)⁻¹
//! ```

use super::columns::Layout;
use super::methods::Fit;
use super::normal::{NormalEquations, solve};
use super::terms::FrictionTerm;
use crate::robot::Robot;
use foretorque::dynamics::FrictionColumn;
use nalgebra::{DMatrix, DVector};

/// Standard deviation of the inertial parameters at g = 1, share of the description's.
const INERTIAL_DEVIATION: f64 = 0.2;
/// Standard deviation of a rotor inertia, multiple of the inertia of rotor and link in the description: nearly unknown.
const ROTOR_DEVIATION: f64 = 10.0;
/// Standard deviation of a friction column at g = 1, share of the torque limit for each unit of the column.
const FRICTION_DEVIATION: f64 = 0.01;
/// Rounds, and the smallest size of a group.
const ROUNDS: usize = 60;
const LEAST: f64 = 1e-10;

/// Parameters that share a prior size.
struct Group {
    places: Vec<usize>,
    /// C⁻¹.
    precision: DMatrix<f64>,
    size: f64,
}

/// Fit with a prior from the description; `None` when the equations cannot be solved.
///
/// * `sums` equations, robustly weighted or not; `sigma` the noise of each joint's, N·m
pub(super) fn evidence(
    robot: &Robot,
    layout: &Layout,
    sums: &NormalEquations,
    sigma: &[f64],
) -> Option<Fit> {
    let mut mean = DVector::zeros(layout.parameters.len());
    mean.rows_mut(0, layout.base)
        .copy_from_slice(&robot.base_parameters());
    let mut groups = vec![inertial(robot, layout.base)?];
    groups.extend(friction(robot, layout));
    let (gram, moment) = sums.weighted(layout, sigma);
    let moment = moment - &gram * &mean;
    let mut found = None;
    for _ in 0..ROUNDS {
        let mut sum = gram.clone();
        for group in &groups {
            for (a, &row) in group.places.iter().enumerate() {
                for (b, &column) in group.places.iter().enumerate() {
                    sum[(row, column)] += group.precision[(a, b)] / group.size;
                }
            }
        }
        let (distance, covariance) = solve(&sum, &moment)?;
        for group in &mut groups {
            let (places, precision) = (&group.places, &group.precision);
            let own = distance.select_rows(places);
            let variance = covariance.select_rows(places).select_columns(places);
            let known = places.len() as f64 - precision.component_mul(&variance).sum() / group.size;
            let length = own.dot(&(precision * &own));
            group.size = if known > 1e-9 {
                (length / known).max(LEAST)
            } else {
                LEAST
            };
        }
        found = Some((distance, covariance));
    }
    let (distance, covariance) = found?;
    Some(Fit {
        theta: mean + distance,
        covariance,
        sigma: sigma.into(),
        iterations: ROUNDS,
    })
}

/// Inertial parameters of the base set: B D Bᵀ of independent deviations of the standard parameters.
fn inertial(robot: &Robot, base: usize) -> Option<Group> {
    let (mut deviations, mut rotors) = (Vec::new(), Vec::new());
    for joint in &robot.joints {
        let standard = joint.link.standard_parameters();
        let (mass, moment) = (standard[0], standard[4] + standard[5] + standard[6]);
        // The centre of mass deviates by a share of the body's size, wherever the frame lies.
        let reach = (moment / (2.0 * mass)).sqrt();
        deviations.push(INERTIAL_DEVIATION * mass);
        deviations.extend([INERTIAL_DEVIATION * mass * reach; 3]);
        deviations.extend([INERTIAL_DEVIATION * moment; 6]);
        rotors.push(ROTOR_DEVIATION * (joint.drive.rotor_inertia + moment));
    }
    deviations.extend(rotors);
    let mut weights = DMatrix::zeros(base, deviations.len());
    for term in &robot.base_map().terms {
        weights[(term.base, term.standard)] = term.weight * deviations[term.standard];
    }
    let covariance = &weights * weights.transpose();
    let (_, precision) = solve(&covariance, &DVector::zeros(base))?;
    Some(Group {
        places: (0..base).collect(),
        precision,
        size: 1.0,
    })
}

/// One group for every kind of column but viscous and Coulomb friction, which every drive has.
fn friction(robot: &Robot, layout: &Layout) -> Vec<Group> {
    let mut kinds: Vec<FrictionTerm> = Vec::new();
    for (kind, _) in layout.parameters.iter().filter_map(|p| p.friction) {
        if !kind.is_plain() && !kinds.contains(&kind) {
            kinds.push(kind);
        }
    }
    let group = |kind: FrictionTerm| {
        let (mut places, mut precision) = (Vec::new(), Vec::new());
        for (place, parameter) in layout.parameters.iter().enumerate() {
            if let Some((_, joint)) = parameter.friction.filter(|(own, _)| *own == kind) {
                let unit = match kind {
                    // A share of the load already.
                    FrictionTerm::Board(FrictionColumn::Load) => 1.0,
                    _ => robot.joints[joint].limits.torque,
                };
                places.push(place);
                precision.push((FRICTION_DEVIATION * unit).powi(-2));
            }
        }
        Group {
            places,
            precision: DMatrix::from_diagonal(&DVector::from_vec(precision)),
            size: 1.0,
        }
    };
    kinds.into_iter().map(group).collect()
}

#[cfg(test)]
mod tests {
    use super::super::columns::Parameter;
    use super::super::dataset::{RowSums, random_rows};
    use super::super::methods::wls;
    use super::*;
    use crate::robot::Perturbation;

    #[test]
    fn unsupported_columns_vanish_and_the_prior_steadies_the_rest() {
        let robot = Robot::load("ur5").expect("built in");
        let truth = robot.perturbed(3, &Perturbation::PLANT);
        let full = "full".parse().expect("known");
        let layout = Layout::new(&robot, &full);
        let plain = |p: &Parameter| p.friction.is_some_and(|(kind, _)| kind.is_plain());
        let base = truth.base_parameters().into_iter();
        let friction = layout.parameters.iter().skip(layout.base);
        let friction = friction.map(|p| if plain(p) { 5.0 } else { 0.0 });
        let theta = DVector::from_vec(base.chain(friction).collect());
        let equations = |rows| {
            let rows = random_rows(&layout, rows, 5, [3.0, 2.0, 5.0], 1.0, |row, joint| {
                row.linear(&layout, &theta, joint)
            });
            let mut sums = RowSums::new(&layout);
            sums.add(&layout, &rows.iter().collect::<Vec<_>>());
            sums.all
        };
        let sums = equations(120);
        let free = wls(&sums, &layout).expect("solvable");
        let found = evidence(&robot, &layout, &sums, &free.sigma).expect("solvable");
        let (gram, _) = equations(2000).weighted(&layout, &[1.0; 6]);
        let error = |fit: &Fit| {
            let distance = &fit.theta - &theta;
            distance.dot(&(&gram * &distance)).sqrt()
        };
        let errors = (error(&found), error(&free));
        assert!(errors.0 < 0.6 * errors.1, "{errors:?}");
        // Nothing but viscous and Coulomb friction is there.
        let unsupported = |fit: &Fit| -> f64 {
            let parameters = layout.parameters.iter().enumerate().skip(layout.base);
            let deviations = free.deviations();
            let squares = parameters.filter(|(_, p)| !plain(p));
            squares
                .map(|(place, _)| (fit.theta[place] / deviations[place]).powi(2))
                .sum()
        };
        let sizes = (unsupported(&found), unsupported(&free));
        assert!(sizes.0 < 0.5 * sizes.1, "{sizes:?}");
    }
}
