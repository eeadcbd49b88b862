//! Least squares with a prior whose weight the training rows choose: empirical Bayes [MacKay 1992, section 3].
//!
//! The masses, centres and inertias of the description are a guess, good to a factor that is not known; a friction column
//! beyond viscous and Coulomb may be there or not. Each such group of parameters has a prior of known shape and unknown
//! size g. The sizes are those under which the training rows are most likely: a group that explains nothing gets g → 0 and
//! vanishes, one that the rows show well is left alone, so asking for columns in vain costs next to nothing. No held-out
//! row takes part.
//!
//! ```text
//! theta ~ N(mu, blocks g_k C_k)      (A + Λ) d = b − A mu,  theta = mu + d
//! g_k ← d_kᵀ C_k⁻¹ d_k / γ_k,        γ_k = n_k − tr(C_k⁻¹ P_kk) / g_k,   P = (A + Λ)⁻¹
//! ```

use super::columns::{FrictionColumn, Layout};
use super::methods::Fit;
use super::normal::{NormalEquations, solve};
use crate::robot::{LINK_PARAMETERS, Robot};
use nalgebra::{DMatrix, DVector};

/// Doubt of the inertial parameters at g = 1, share of the description's.
const INERTIAL_DOUBT: f64 = 0.2;
/// Rotor inertias are as good as unknown: multiples of what the description gives rotor and link.
const ROTOR_DOUBT: f64 = 10.0;
/// Doubt of a friction column at g = 1, share of the torque limit for each unit of the column.
const FRICTION_DOUBT: f64 = 0.01;
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

/// * `sums` equations, robustly weighted or not; `sigma` the noise of each joint's, N·m
///
/// `None` when the equations cannot be solved.
pub(super) fn evidence<const N: usize>(
    robot: &Robot,
    layout: &Layout<N>,
    sums: &NormalEquations<N>,
    sigma: &[f64; N],
) -> Option<Fit<N>> {
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
            let own = distance.select_rows(&group.places);
            let doubt = covariance
                .select_rows(&group.places)
                .select_columns(&group.places);
            let known = group.places.len() as f64
                - group.precision.component_mul(&doubt).sum() / group.size;
            let length = own.dot(&(&group.precision * &own));
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
        sigma: *sigma,
        iterations: ROUNDS,
    })
}

/// Inertial parameters of the base set: B D Bᵀ of independent doubts of the standard parameters.
fn inertial(robot: &Robot, base: usize) -> Option<Group> {
    let mut doubts = Vec::with_capacity((LINK_PARAMETERS + 1) * robot.joint_count());
    let mut rotors = Vec::new();
    for joint in &robot.joints {
        let standard = joint.link.standard_parameters();
        let (mass, moment) = (standard[0], standard[4] + standard[5] + standard[6]);
        // The centre of mass is in doubt by a share of the body's size, wherever the frame lies.
        let reach = (moment / (2.0 * mass)).sqrt();
        doubts.push(INERTIAL_DOUBT * mass);
        doubts.extend([INERTIAL_DOUBT * mass * reach; 3]);
        doubts.extend([INERTIAL_DOUBT * moment; 6]);
        rotors.push(ROTOR_DOUBT * (joint.drive.rotor_inertia + moment));
    }
    doubts.extend(rotors);
    let map = robot.base_map();
    let mut weights = DMatrix::zeros(base, doubts.len());
    for term in &map.terms {
        weights[(term.base, term.standard)] = term.weight * doubts[term.standard];
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
fn friction<const N: usize>(robot: &Robot, layout: &Layout<N>) -> Vec<Group> {
    let mut kinds: Vec<FrictionColumn> = Vec::new();
    for (kind, _) in layout.parameters.iter().filter_map(|p| p.friction) {
        let certain = matches!(kind, FrictionColumn::Viscous | FrictionColumn::Coulomb);
        if !certain && !kinds.contains(&kind) {
            kinds.push(kind);
        }
    }
    let group = |kind: FrictionColumn| {
        let parameters = layout.parameters.iter().enumerate();
        let own: Vec<(usize, usize)> = parameters
            .filter_map(|(place, parameter)| {
                let (of, joint) = parameter.friction?;
                (of == kind).then_some((place, joint))
            })
            .collect();
        let precision = own.iter().map(|&(_, joint)| {
            let unit = match kind {
                // A share of the load already.
                FrictionColumn::Load => 1.0,
                _ => robot.joints[joint].limits.torque,
            };
            (FRICTION_DOUBT * unit).powi(-2)
        });
        Group {
            precision: DMatrix::from_diagonal(&DVector::from_iterator(own.len(), precision)),
            places: own.iter().map(|&(place, _)| place).collect(),
            size: 1.0,
        }
    };
    kinds.into_iter().map(group).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identification::methods::wls;
    use crate::robot::Perturbation;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// Equations of a few noisy random rows of an arm `truth`, with the true parameters.
    fn equations(
        truth: &Robot,
        layout: &Layout<6>,
        rows: usize,
    ) -> (NormalEquations<6>, DVector<f64>) {
        let mut random = ChaCha8Rng::seed_from_u64(5);
        let mut theta = DVector::zeros(layout.parameters.len());
        theta
            .rows_mut(0, layout.base)
            .copy_from_slice(&truth.base_parameters());
        for (place, parameter) in layout.parameters.iter().enumerate() {
            if let Some((FrictionColumn::Viscous | FrictionColumn::Coulomb, _)) = parameter.friction
            {
                theta[place] = 5.0;
            }
        }
        let mut sums = NormalEquations::new(layout);
        let mut scratch = DMatrix::zeros(6, (LINK_PARAMETERS + 1) * 6);
        for row in 0..rows {
            let mut draw = |reach: f64| {
                crate::dynamics::Joints::from_fn(|_, _| random.random_range(-reach..reach))
            };
            let state = crate::dynamics::State {
                q: draw(3.0),
                qd: draw(2.0),
                qdd: draw(5.0),
            };
            let noise = draw(1.0);
            let mut panel = Vec::new();
            layout.append_row(&state, 0.01 * row as f64, &mut scratch, &mut panel);
            for joint in 0..6 {
                let x = &panel[layout.offset[joint]..][..layout.active[joint].len()];
                let active = layout.active[joint].iter();
                let tau: f64 = x.iter().zip(active).map(|(x, &p)| x * theta[p]).sum();
                sums.joints[joint].add(x, &[tau + noise[joint]]);
            }
        }
        (sums, theta)
    }

    #[test]
    fn columns_asked_for_in_vain_vanish_and_the_description_steadies_the_rest() {
        let robot = Robot::load("ur5").expect("built in");
        let truth = robot.perturbed(3, &Perturbation::PLANT);
        let full = "full".parse().expect("known");
        let layout = Layout::<6>::new(&robot, &full).expect("six joints");
        let (sums, theta) = equations(&truth, &layout, 120);
        let free = wls(&sums, &layout).expect("solvable");
        let found = evidence(&robot, &layout, &sums, &free.sigma).expect("solvable");
        let (other, _) = equations(&truth, &layout, 2000);
        let error = |fit: &Fit<6>| {
            let distance = &fit.theta - &theta;
            let (gram, _) = other.weighted(&layout, &[1.0; 6]);
            distance.dot(&(gram * &distance)).sqrt()
        };
        assert!(
            error(&found) < 0.6 * error(&free),
            "{} {}",
            error(&found),
            error(&free)
        );
        // Nothing but viscous and Coulomb friction is there.
        let vain = |fit: &Fit<6>| -> f64 {
            let places = layout
                .parameters
                .iter()
                .enumerate()
                .filter(|(_, parameter)| {
                    let kind = parameter.friction.map(|(kind, _)| kind);
                    !matches!(
                        kind,
                        None | Some(FrictionColumn::Viscous | FrictionColumn::Coulomb)
                    )
                });
            let free = free.deviations();
            places
                .map(|(place, _)| (fit.theta[place] / free[place]).powi(2))
                .sum()
        };
        assert!(
            vain(&found) < 0.5 * vain(&free),
            "{} {}",
            vain(&found),
            vain(&free)
        );
    }
}
