//! Physically consistent parameters: a convex programme over all bodies of the arm.
//!
//! A robust fit of base parameters β and friction φ costs `½ (y − ŷ)ᵀ C⁻¹ (y − ŷ)` at y = (β, φ). Here β = B x, x holds all
//! standard parameters and rotor inertias, and x must be physical: every link's pseudo-inertia
//!
//! ```text
//! P = | Σ    m c |      Σ = ½ tr(I) 1 − I,   I about the link origin
//!     | m cᵀ  m  |
//! ```
//! is positive definite [Wensing, Kim and Slotine 2018, eq. 21], rotor inertias and plain friction are positive. Torque does
//! not observe all of x: the rest stays near the description in the affine-invariant sense of the Bregman divergence
//! `tr(P₀⁻¹P) − log det(P₀⁻¹P) − 4` [Lee, Wensing and Park 2020], which is also the barrier of the cone, so that one
//! path-following Newton method minimises the whole. A conic solver from a library would need LAPACK for its semidefinite
//! cones; 4 × 4 blocks need only the Cholesky factors of nalgebra.

use super::columns::FrictionTerm::Board;
use super::columns::Layout;
use super::filter::median;
use super::methods::Fit;
use super::normal::solve;
use crate::dynamics::BaseMap;
use crate::robot::{LINK_PARAMETERS, Link, Robot};
use foretorque::dynamics::{FrictionColumn, SHEAR_WIDTH, STRIBECK_WIDTH};
use nalgebra::{DMatrix, DVector, Matrix4};

/// Weight of the divergence from the description at the start of the path, in nats, and at its end. The optimum is missed
/// by less than the last weight times the number of barriers (6 a joint), far below the effect of noise.
const WEIGHTS: (f64, f64) = (1e6, 1e-2);
/// Each weight over the one before.
const WEIGHT_STEP: f64 = 0.1;
/// Most Newton steps at one weight, and the decrement (nats) at which they end.
const STEPS: usize = 60;
const SETTLED: f64 = 1e-8;
/// Largest distance of the description from the data, nats: torques without noise would put the barriers below the
/// rounding of their own costs, and the path would end early.
const SHARPEST: f64 = 1e10;
/// Least second moment of a link of the description, as a share of their sum: thin bodies lie on the edge of the cone, and
/// the path must start inside.
const THINNEST: f64 = 1e-3;
/// Least value of a positive scalar of the description from which the path may start, SI.
const LEAST: f64 = 1e-3;

/// The consistent parameters nearest to `free` in the metric of its covariance, the description with them, and the cost of
/// consistency, nats; `None` when a matrix that must be positive definite is not.
///
/// The cost is `½ (y − ŷ)ᵀ C⁻¹ (y − ŷ)`; its mean under noise alone is half the number of parameters.
pub(super) fn consistent(robot: &Robot, layout: &Layout, free: &Fit) -> Option<(Fit, Robot, f64)> {
    let (_, information) = solve_damped(&free.covariance, &DVector::zeros(free.theta.len()))?;
    let map = parameter_map(&robot.base_map(), layout);
    let cone = Cone::around(&with_likely_rotors(robot, layout, free), layout);
    let distance = |theta: &DVector<f64>| {
        let apart = theta - &free.theta;
        0.5 * apart.dot(&(&information * &apart))
    };
    let share = (SHARPEST / distance(&(&map * &cone.centre))).min(1.0);
    let hessian = map.tr_mul(&(&information * &map)) * share;
    let moment = map.tr_mul(&(&information * &free.theta)) * share;
    let cost = |z: &DVector<f64>| 0.5 * z.dot(&(&hessian * z)) - moment.dot(z);
    let mut z = cone.centre.clone();
    let (mut weight, mut steps) = (WEIGHTS.0, 0);
    let mut covariance = DMatrix::zeros(z.len(), z.len());
    while weight >= 0.99 * WEIGHTS.1 {
        for _ in 0..STEPS {
            let mut slope = &hessian * &z - &moment;
            let mut curvature = hessian.clone();
            cone.differentiate(&z, weight, &mut slope, &mut curvature)?;
            let (step, inverse) = solve_damped(&curvature, &-&slope)?;
            covariance = inverse;
            steps += 1;
            let decrement = -slope.dot(&step);
            if decrement < SETTLED {
                break;
            }
            let before = cost(&z) + weight * cone.divergence(&z)?;
            // Short enough to stay inside the cone and to descend: convexity guarantees both.
            let lengths = std::iter::successors(Some(1.0), |length| Some(0.5 * length));
            let next = lengths
                .take_while(|length| *length > 1e-12)
                .find_map(|length| {
                    let next = &z + &step * length;
                    let after = cost(&next) + weight * cone.divergence(&next)?;
                    (after <= before - 0.1 * length * decrement).then_some(next)
                });
            match next {
                Some(next) => z = next,
                // The decrease is below rounding.
                None => break,
            }
        }
        weight *= WEIGHT_STEP;
    }
    let theta = &map * &z;
    let nats = distance(&theta);
    let fit = Fit {
        covariance: &map * covariance * map.transpose() * share,
        theta,
        sigma: free.sigma,
        iterations: free.iterations + steps,
    };
    Some((fit, described(robot, layout, &z), nats))
}

/// The description with a rotor where it gives none: the assumed one, times the median of those found at other joints over
/// theirs. A joint that has link and rotor in one inertia, as the first, tells none; without a rotor all would be link.
fn with_likely_rotors(robot: &Robot, layout: &Layout, free: &Fit) -> Robot {
    let (mut assumed, joints) = robot.with_assumed_rotors();
    let rotors = LINK_PARAMETERS * layout.joints();
    let places = robot.base_map().columns.into_iter().enumerate();
    let mut shares: Vec<f64> = places
        .filter_map(|(place, column)| {
            let joint = column.checked_sub(rotors)?;
            Some(free.theta[place] / assumed.joints[joint].drive.rotor_inertia)
        })
        .collect();
    if shares.is_empty() {
        return robot.clone();
    }
    let share = median(&mut shares).max(0.0);
    for joint in joints {
        assumed.joints[joint - 1].drive.rotor_inertia *= share;
    }
    assumed
}

/// [`solve`] with the least damping of the diagonal that the factorisation needs: directions that torque does not observe
/// have the curvature of the divergence alone, which may lie below rounding. A damped Newton step still descends.
fn solve_damped(
    matrix: &DMatrix<f64>,
    right: &DVector<f64>,
) -> Option<(DVector<f64>, DMatrix<f64>)> {
    let damped = |damping: f64| {
        let mut matrix = matrix.clone();
        for k in 0..matrix.nrows() {
            matrix[(k, k)] *= 1.0 + damping;
        }
        solve(&matrix, right).ok()
    };
    [0.0, 1e-14, 1e-13, 1e-12, 1e-11, 1e-10]
        .into_iter()
        .find_map(damped)
}

/// Map from (standard parameters, rotor inertias, friction) to the parameters of the layout.
fn parameter_map(base: &BaseMap, layout: &Layout) -> DMatrix<f64> {
    let full = (LINK_PARAMETERS + 1) * layout.joints();
    let friction = layout.parameters.len() - layout.base;
    let mut map = DMatrix::zeros(layout.parameters.len(), full + friction);
    for term in &base.terms {
        map[(term.base, term.standard)] = term.weight;
    }
    for k in 0..friction {
        map[(layout.base + k, full + k)] = 1.0;
    }
    map
}

/// Cone of physical parameters: pseudo-inertias and some scalars positive, each with its value in the description.
struct Cone {
    /// Inverse pseudo-inertia of each link of the description; link k has parameters from 10 k.
    links: Vec<Matrix4<f64>>,
    /// Places of the positive scalars.
    scalars: Vec<usize>,
    /// The description, moved inside.
    centre: DVector<f64>,
}

impl Cone {
    fn around(robot: &Robot, layout: &Layout) -> Self {
        let rotors = LINK_PARAMETERS * layout.joints();
        let full = rotors + layout.joints();
        let mut centre = DVector::zeros(full + layout.parameters.len() - layout.base);
        let mut links = Vec::new();
        for (index, joint) in robot.joints.iter().enumerate() {
            let inside = inside(&joint.link).standard_parameters();
            centre
                .rows_mut(LINK_PARAMETERS * index, LINK_PARAMETERS)
                .copy_from_slice(&inside);
            // `inside` has made it positive definite.
            links.extend(pseudo_inertia(&inside).try_inverse());
            centre[rotors + index] = joint.drive.rotor_inertia.max(LEAST);
        }
        let mut scalars: Vec<usize> = (rotors..full).collect();
        for (k, parameter) in layout.parameters.iter().skip(layout.base).enumerate() {
            // Peaks, offsets and cogging have no sign; load friction has one, but no value in the description.
            let Some(described) = parameter.plain_friction(robot) else {
                continue;
            };
            scalars.push(full + k);
            centre[full + k] = described.max(LEAST);
        }
        Self {
            links,
            scalars,
            centre,
        }
    }

    /// Divergence from the description, nats; `None` outside the cone.
    fn divergence(&self, z: &DVector<f64>) -> Option<f64> {
        let mut sum = 0.0;
        for (link, inverse) in self.links.iter().enumerate() {
            let p = pseudo_inertia(&z.as_slice()[LINK_PARAMETERS * link..]);
            let factor = p.cholesky()?.l();
            let log_det = 2.0 * factor.diagonal().map(f64::ln).sum();
            sum += (inverse * p).trace() - log_det;
        }
        for &place in &self.scalars {
            let value = z[place];
            if value <= 0.0 {
                return None;
            }
            sum += value / self.centre[place] - value.ln();
        }
        sum.is_finite().then_some(sum)
    }

    /// Adds gradient and Hessian of the divergence, times `weight`; `None` outside the cone.
    fn differentiate(
        &self,
        z: &DVector<f64>,
        weight: f64,
        slope: &mut DVector<f64>,
        curvature: &mut DMatrix<f64>,
    ) -> Option<()> {
        for (link, described) in self.links.iter().enumerate() {
            let start = LINK_PARAMETERS * link;
            let inverse = pseudo_inertia(&z.as_slice()[start..]).cholesky()?.inverse();
            // ∂/∂x_k = tr((P₀⁻¹ − P⁻¹) E_k),  ∂²/∂x_k∂x_l = tr(P⁻¹ E_k P⁻¹ E_l)
            let turned: Vec<Matrix4<f64>> =
                (0..LINK_PARAMETERS).map(|k| inverse * unit(k)).collect();
            for k in 0..LINK_PARAMETERS {
                slope[start + k] += weight * ((described * unit(k)).trace() - turned[k].trace());
                for l in 0..LINK_PARAMETERS {
                    curvature[(start + k, start + l)] += weight * (turned[k] * turned[l]).trace();
                }
            }
        }
        for &place in &self.scalars {
            let value = z[place];
            if value <= 0.0 {
                return None;
            }
            slope[place] += weight * (1.0 / self.centre[place] - 1.0 / value);
            curvature[(place, place)] += weight / (value * value);
        }
        Some(())
    }
}

/// Pseudo-inertia of a link with these standard parameters.
fn pseudo_inertia(x: &[f64]) -> Matrix4<f64> {
    let [m, mx, my, mz] = [x[0], x[1], x[2], x[3]];
    let [xx, yy, zz, xy, xz, yz] = [x[4], x[5], x[6], x[7], x[8], x[9]];
    let [sx, sy, sz] = [yy - xx + zz, xx - yy + zz, xx + yy - zz].map(|twice| 0.5 * twice);
    Matrix4::from([
        [sx, -xy, -xz, mx],
        [-xy, sy, -yz, my],
        [-xz, -yz, sz, mz],
        [mx, my, mz, m],
    ])
}

/// Pseudo-inertia of one unit of the standard parameter `k`.
fn unit(k: usize) -> Matrix4<f64> {
    let mut x = [0.0; LINK_PARAMETERS];
    x[k] = 1.0;
    pseudo_inertia(&x)
}

/// The link with its second moments of mass raised to a least share of their sum.
fn inside(link: &Link) -> Link {
    let sum = link.second_moments().trace().max(LEAST * LEAST);
    link.with_least_moments(|_| THINNEST * sum)
}

/// The robot with links, rotors and friction from `z`; friction without a column is zero.
fn described(robot: &Robot, layout: &Layout, z: &DVector<f64>) -> Robot {
    let rotors = LINK_PARAMETERS * layout.joints();
    let full = rotors + layout.joints();
    let mut robot = robot.clone();
    for (index, joint) in robot.joints.iter_mut().enumerate() {
        let x: [f64; LINK_PARAMETERS] = std::array::from_fn(|k| z[LINK_PARAMETERS * index + k]);
        joint.link = Link::from_standard_parameters(&x);
        joint.drive.rotor_inertia = z[rotors + index];
        let of = |wanted: FrictionColumn| -> f64 {
            let mut own = layout.parameters.iter().skip(layout.base);
            let place =
                own.position(|parameter| parameter.friction == Some((Board(wanted), index)));
            place.map_or(0.0, |k| z[full + k])
        };
        let friction = &mut joint.friction;
        friction.viscous = of(FrictionColumn::Viscous);
        friction.coulomb = of(FrictionColumn::Coulomb);
        friction.stribeck_ratio = 0.0;
        // Shear thinning as a Gaussian of the same height and area.
        let (narrow, wide) = (STRIBECK_WIDTH, SHEAR_WIDTH * std::f64::consts::PI.sqrt());
        let peaks = (
            of(FrictionColumn::Stribeck),
            of(FrictionColumn::ShearThinning),
        );
        let (height, area) = (peaks.0 + peaks.1, narrow * peaks.0 + wide * peaks.1);
        // One Gaussian of the same height and area; a description cannot hold two, nor a dip.
        if height > 0.0 && area > 0.0 && friction.coulomb > 0.0 {
            friction.stribeck_ratio = height / friction.coulomb;
            friction.stribeck_velocity = area / height;
        }
        // The description's cogging is a sine.
        friction.cogging = of(FrictionColumn::CoggingSine).max(0.0);
    }
    robot
}
