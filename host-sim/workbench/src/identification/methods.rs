//! Least squares: plain, weighted by joint, robust.

use super::columns::Layout;
use super::dataset::SampleRow;
use super::filter::median;
use super::normal::{JointSums, NormalEquations, solve};
use crate::Refusal;
use crate::dynamics::PerJoint;
use crate::parallel::in_parallel;
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

/// Ordinary least squares; the standard deviations allow every joint its own noise. `None` when a parameter is unseen.
pub(super) fn ols(sums: &NormalEquations, layout: &Layout) -> Option<Fit> {
    let (gram, moment) = sums.weighted(layout, &vec![1.0; layout.joints()]);
    let (theta, inverse) = solve(&gram, &moment)?;
    let sigma = noise(sums, layout, &theta);
    // (XᵀX)⁻¹ (Σ σ_j² X_jᵀX_j) (XᵀX)⁻¹
    let (scatter, _) = sums.weighted(layout, &sigma.map(|sigma| 1.0 / sigma));
    Some(Fit {
        covariance: &inverse * scatter * &inverse,
        theta,
        sigma,
        iterations: 1,
    })
}

/// Weighted least squares: the noise of each joint from the fit before, and the board's prior of friction.
pub(super) fn wls(sums: &NormalEquations, layout: &Layout) -> Option<Fit> {
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
    Some(fit)
}

/// Huber's estimate over a sample of rows, from the weighted fit of the sums without spikes.
pub(super) fn irls(clean: &NormalEquations, sample: &[&SampleRow], layout: &Layout) -> Option<Fit> {
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
    Some(fit)
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
