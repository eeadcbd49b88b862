//! Least squares: plain, weighted by joint, robust, and with a prior whose weight the training rows choose.

use super::IdentifyError;
use super::columns::{FrictionTerm, Layout};
use super::filter::median;
use super::normal::SampleRow;
use super::normal::{JointSums, NormalEquations, solve};
use crate::Refusal;
use crate::dynamics::PerJoint;
use crate::parallel::in_parallel;
use crate::robot::Robot;
use foretorque::dynamics::FrictionColumn;
use nalgebra::{DMatrix, DVector};
use std::fmt;
use std::str::FromStr;

/// A way to identify.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum MethodName {
    /// Ordinary least squares.
    Ols,
    /// Every joint's equations divided by their noise.
    Wls,
    /// Iteratively reweighted, Huber's weights, spikes taken out beforehand.
    Irls,
    /// The robust fit, moved to physically consistent parameters.
    Consistent,
    /// The robust fit with a prior whose weight the training rows choose.
    Evidence,
    /// One linear BP layer whose weights are the parameters.
    BpPhysical,
    /// A BP network on all positions, velocities and accelerations.
    BpBlackBox,
    /// The linear model of the board and one small BP network a joint for its residual.
    BpResidual,
}

/// All methods, in the order of the report.
pub const METHODS: [(MethodName, &str); 8] = [
    (MethodName::Ols, "ols"),
    (MethodName::Wls, "wls"),
    (MethodName::Irls, "irls"),
    (MethodName::Consistent, "consistent"),
    (MethodName::Evidence, "evidence"),
    (MethodName::BpPhysical, "bp_physical"),
    (MethodName::BpBlackBox, "bp_black_box"),
    (MethodName::BpResidual, "bp_residual"),
];

impl fmt::Display for MethodName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let known = METHODS.iter().find(|(method, _)| method == self);
        f.write_str(known.map_or("", |(_, name)| name))
    }
}

impl FromStr for MethodName {
    type Err = Refusal;

    fn from_str(text: &str) -> Result<Self, Refusal> {
        let known = METHODS.iter().find(|(_, name)| *name == text);
        let names = METHODS.map(|(_, name)| name).join(", ");
        let unknown = || Refusal(format!("unknown method '{text}': one of {names}"));
        known.map(|(method, _)| *method).ok_or_else(unknown)
    }
}

/// Parameters of the linear model with their uncertainty.
#[derive(Clone, Debug, PartialEq)]
pub struct Fit {
    /// One value a parameter of the layout, SI.
    pub theta: DVector<f64>,
    /// Covariance of `theta`.
    pub covariance: DMatrix<f64>,
    /// Noise of every joint's equations, N·m.
    pub sigma: PerJoint<f64>,
    /// Times the equations were solved.
    pub iterations: usize,
}

/// Noise may not be estimated smaller than this, N·m: a joint without error would take all the weight.
const SIGMA_FLOOR: f64 = 1e-9;
/// Rounds in which weights and parameters settle.
const WEIGHT_ROUNDS: usize = 4;
/// Residuals beyond this many standard deviations weigh less [Huber 1981]: 95 % efficiency at the normal distribution.
const HUBER: f64 = 1.345;
/// Most rounds of reweighting, and the change of torque error at which they end.
const IRLS_ROUNDS: usize = 30;
const IRLS_SETTLED: f64 = 1e-6;

/// Ordinary least squares; the standard deviations allow every joint its own noise.
pub(super) fn ols(sums: &NormalEquations, layout: &Layout) -> Result<Fit, IdentifyError> {
    let (gram, moment) = sums.weighted(layout, &vec![1.0; layout.joints()]);
    let (theta, inverse) = solve(&gram, &moment)?;
    let sigma = noise(sums, layout, &theta);
    // (XᵀX)⁻¹ (Σ σ_j² X_jᵀX_j) (XᵀX)⁻¹
    let (scatter, _) = sums.weighted(layout, &sigma.map(|sigma| 1.0 / sigma));
    Ok(Fit {
        covariance: &inverse * scatter * &inverse,
        theta,
        sigma,
        iterations: 1,
    })
}

/// Weighted least squares: the noise of each joint from the fit before, and the board's prior of friction.
pub(super) fn wls(sums: &NormalEquations, layout: &Layout) -> Result<Fit, IdentifyError> {
    let mut fit = ols(sums, layout)?;
    for _ in 0..WEIGHT_ROUNDS {
        let (mut gram, moment) = sums.weighted(layout, &fit.sigma);
        layout.add_prior(&mut gram);
        let (theta, covariance) = solve(&gram, &moment)?;
        fit = Fit {
            sigma: noise(sums, layout, &theta),
            theta,
            covariance,
            iterations: fit.iterations + 1,
        };
    }
    Ok(fit)
}

/// Huber's estimate over a sample of rows, from the weighted fit of the sums without spikes.
pub(super) fn irls(
    clean: &NormalEquations,
    sample: &[&SampleRow],
    layout: &Layout,
) -> Result<Fit, IdentifyError> {
    let mut fit = wls(clean, layout)?;
    let places: Vec<usize> = (0..layout.joints()).collect();
    for _ in 0..IRLS_ROUNDS {
        let theta = &fit.theta;
        let own = |joint: &usize| reweighted(*joint, sample, layout, theta);
        let rounds = in_parallel(places.len(), &places, own, || ());
        let (joints, sigma): (Vec<JointSums>, Vec<f64>) = rounds.into_iter().unzip();
        let (sigma, sums) = (PerJoint::from(&*sigma), NormalEquations { joints });
        let (mut gram, moment) = sums.weighted(layout, &sigma);
        layout.add_prior(&mut gram);
        let (theta, covariance) = solve(&gram, &moment)?;
        let step = &theta - &fit.theta;
        let settled = step.dot(&(&gram * &step)) <= IRLS_SETTLED * IRLS_SETTLED * sums.count();
        fit = Fit {
            theta,
            covariance,
            sigma,
            iterations: fit.iterations + 1,
        };
        if settled {
            break;
        }
    }
    Ok(fit)
}

/// One joint's sums under Huber's weights for the residuals of `theta`, and the spread of these residuals, N·m.
fn reweighted(
    joint: usize,
    sample: &[&SampleRow],
    layout: &Layout,
    theta: &DVector<f64>,
) -> (JointSums, f64) {
    let moving = sample.iter().filter(|row| row.moving[joint]);
    let mut sizes: Vec<f64> = moving
        .map(|row| (row.clean[joint] - row.linear(layout, theta, joint)).abs())
        .collect();
    let sigma = (1.4826 * median(&mut sizes)).max(SIGMA_FLOOR);
    (huber(joint, sample, layout, theta, sigma), sigma)
}

/// One joint's sums; rows whose residual exceeds 1.345 `sigma`, N·m, weigh less [Huber 1981].
pub(super) fn huber(
    joint: usize,
    sample: &[&SampleRow],
    layout: &Layout,
    theta: &DVector<f64>,
    sigma: f64,
) -> JointSums {
    let active = layout.active[joint].len();
    let mut x = Vec::with_capacity(sample.len() * active);
    let mut tau = Vec::with_capacity(sample.len());
    for row in sample.iter().filter(|row| row.moving[joint]) {
        let residual = row.clean[joint] - row.linear(layout, theta, joint);
        let weight = (HUBER * sigma / residual.abs()).min(1.0).sqrt();
        let columns = row.columns(layout, joint).iter();
        x.extend(columns.map(|value| weight * value));
        tau.push(weight * row.clean[joint]);
    }
    let mut sums = JointSums::new(active);
    sums.add(&x, &tau);
    sums
}

/// RMS residual of each joint, N·m, corrected for the number of parameters.
fn noise(sums: &NormalEquations, layout: &Layout, theta: &DVector<f64>) -> PerJoint<f64> {
    let rmse = sums.rmse(layout, theta);
    let share = layout.parameters.len() as f64 / sums.count().max(1.0);
    rmse.map(|rmse| (rmse / (1.0 - share).max(0.1).sqrt()).max(SIGMA_FLOOR))
}

impl Fit {
    /// Standard deviation of every parameter.
    pub fn deviations(&self) -> DVector<f64> {
        let variances = self.covariance.diagonal();
        variances.map(|variance| variance.max(0.0).sqrt())
    }
}

/// Standard deviation of the inertial parameters at g = 1, share of the description's.
const INERTIAL_DEVIATION: f64 = 0.2;
/// Standard deviation of a rotor inertia, multiple of the inertia of rotor and link in the description: nearly unknown.
const ROTOR_DEVIATION: f64 = 10.0;
/// Standard deviation of a friction column at g = 1, share of the torque limit for each unit of the column.
const FRICTION_DEVIATION: f64 = 0.01;
/// Rounds, and the smallest size of a group.
const EVIDENCE_ROUNDS: usize = 60;
const LEAST_SIZE: f64 = 1e-10;

/// Parameters that share a prior size.
struct Group {
    places: Vec<usize>,
    /// C⁻¹.
    precision: DMatrix<f64>,
    size: f64,
}

/// Fit with a prior from the description whose weight the rows choose: empirical Bayes [MacKay 1992, section 3].
///
/// The masses, centres and inertias of the description are good to an unknown factor, and a friction column beyond viscous
/// and Coulomb may be absent. Each such group of parameters has a prior of known shape and unknown size g. The sizes
/// maximise the likelihood of the training rows: a group without support gets g → 0 and vanishes, a well observed one
/// stays as it is. No held-out row takes part.
///
/// ```text
/// theta ~ N(mu, blocks g_k C_k)      (A + Λ) d = b − A mu,  theta = mu + d
/// g_k ← d_kᵀ C_k⁻¹ d_k / γ_k,        γ_k = n_k − tr(C_k⁻¹ P_kk) / g_k,   P = (A + Λ)⁻¹
/// ```
///
/// * `sums` equations, robustly weighted or not; `sigma` the noise of each joint's, N·m
pub(super) fn evidence(
    robot: &Robot,
    layout: &Layout,
    sums: &NormalEquations,
    sigma: &[f64],
) -> Result<Fit, IdentifyError> {
    let mut mean = DVector::zeros(layout.parameters.len());
    mean.rows_mut(0, layout.base)
        .copy_from_slice(&robot.base_parameters());
    let mut groups = vec![inertial(robot, layout.base)?];
    groups.extend(friction(robot, layout));
    let (gram, moment) = sums.weighted(layout, sigma);
    let moment = moment - &gram * &mean;
    let mut found = None;
    for _ in 0..EVIDENCE_ROUNDS {
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
                (length / known).max(LEAST_SIZE)
            } else {
                LEAST_SIZE
            };
        }
        found = Some((distance, covariance));
    }
    let (distance, covariance) = found.ok_or(IdentifyError::Unsolvable)?;
    Ok(Fit {
        theta: mean + distance,
        covariance,
        sigma: sigma.into(),
        iterations: EVIDENCE_ROUNDS,
    })
}

/// Inertial parameters of the base set: B D Bᵀ of independent deviations of the standard parameters.
fn inertial(robot: &Robot, base: usize) -> Result<Group, IdentifyError> {
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
    Ok(Group {
        places: (0..base).collect(),
        precision,
        size: 1.0,
    })
}

/// One group for every kind of column but viscous and Coulomb friction, which every drive has.
fn friction(robot: &Robot, layout: &Layout) -> Vec<Group> {
    let group = |kind: FrictionTerm| {
        let parameters = layout.parameters.iter().enumerate();
        let own = parameters.filter_map(|(place, parameter)| {
            let (_, joint) = parameter.friction.filter(|(own, _)| *own == kind)?;
            let unit = match kind {
                // A share of the load already.
                FrictionTerm::Board(FrictionColumn::Load) => 1.0,
                _ => robot.joints[joint].limits.torque,
            };
            Some((place, (FRICTION_DEVIATION * unit).powi(-2)))
        });
        let (places, precision): (Vec<usize>, Vec<f64>) = own.unzip();
        (!places.is_empty()).then(|| Group {
            places,
            precision: DMatrix::from_diagonal(&DVector::from_vec(precision)),
            size: 1.0,
        })
    };
    let kinds = FrictionTerm::of_sets(|_| true).into_iter();
    let kinds = kinds.filter(|kind| !kind.is_plain());
    kinds.filter_map(group).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identification::columns::Parameter;
    use crate::identification::dataset::{RowSums, random_rows};

    #[test]
    fn unsupported_columns_vanish_and_the_prior_steadies_the_rest() {
        let robot = Robot::load("ur5").expect("built in");
        let truth = robot.perturbed(3);
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
            RowSums::of(&layout, &rows).all
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
