//! Prior covariance of the base parameters.
//!
//! Uncertainty belongs to links: mass, centre of mass, inertia, rotor. A base parameter is a sum over several links. One
//! uncertain property of a link is therefore a factor d of the covariance over many base parameters:
//!
//! ```text
//! P = Σ d dᵀ + floor²     d = base map · change of the standard parameters by one standard deviation of the property
//! ```
//! P is far from diagonal: a heavy forearm, found from the torque of the shoulder, also corrects the elbow.

use crate::arm::{Arm, ArmModel, BaseTerm, LINK_PARAMETERS, table};

/// Standard gravity, by which torque limits are converted to masses, m/s².
pub(super) const GRAVITY: f32 = 9.81;

/// Square root by Newton's method, for constant evaluation only.
///
/// Limits: converged for 1e-12 to 1e12; 0 gives 1e-9.
pub(super) const fn sqrt(square: f32) -> f32 {
    let mut guess = 1.0;
    let mut step = 0;
    while step < 30 {
        guess = 0.5 * (guess + square / guess);
        step += 1;
    }
    guess
}

/// Uncertain properties of one link: mass, three coordinates of the centre of mass, six moments and products of inertia,
/// rotor.
const FACTORS_PER_LINK: usize = 11;

/// Standard deviation of mass, moments of inertia and rotor inertia, relative to the description.
const RELATIVE_SIGMA: f32 = 0.2;
/// Standard deviation of a centre of mass along each axis: relative to its distance from the joint, and added to it, m.
const COM_SIGMA: (f32, f32) = (0.05, 0.003);
/// Acceleration torque of an unknown rotor, in units of the torque limit at [`FLOOR_ACCELERATION`]: descriptions often lack
/// rotors.
const ROTOR_TORQUE: f32 = 0.05;
/// Torque of the floor, in units of the torque limit: the part of a base parameter's uncertainty that no link explains.
const FLOOR: f32 = 1.5e-3;
/// Acceleration that converts the floor of an inertia to a torque, rad/s².
const FLOOR_ACCELERATION: f32 = 10.0;

/// Number of prior factors of an arm of `joints` joints.
pub const fn prior_factor_count(joints: usize) -> usize {
    FACTORS_PER_LINK * joints
}

/// Prior factor number `index`: change of the base parameters, in units of their prior standard deviations; `None` if
/// there is none.
pub fn prior_factor<A: Arm<N, P>, const N: usize, const P: usize>(
    index: usize,
) -> Option<[f32; P]> {
    if index >= prior_factor_count(N) {
        return None;
    }
    let links = table!(A, link_uncertainty);
    let mut factor = base_change(&links, A::base_map(), index);
    for (factor, sigma) in factor.iter_mut().zip(table!(A, rigid_sigma)) {
        *factor /= sigma;
    }
    Some(factor)
}

/// Variances of the floor, in units of the prior variances.
#[inline(always)]
pub fn prior_floor<A: Arm<N, P>, const N: usize, const P: usize>() -> [f32; P] {
    table!(A, relative_floor)
}

const fn relative_floor<const N: usize, const P: usize>(arm: &ArmModel<N, P>) -> [f32; P] {
    let (mut floor, sigma) = (floor_squared(arm), rigid_sigma(arm));
    let mut column = 0;
    while column < P {
        floor[column] /= sigma[column] * sigma[column];
        column += 1;
    }
    floor
}

/// Prior standard deviations of the base parameters, in their units.
pub(super) const fn rigid_sigma<const N: usize, const P: usize>(arm: &ArmModel<N, P>) -> [f32; P] {
    let mut square = floor_squared(arm);
    let links = link_uncertainty(arm);
    let mut index = 0;
    while index < prior_factor_count(N) {
        let change: [f32; P] = base_change(&links, arm.base_map, index);
        let mut column = 0;
        while column < P {
            square[column] += change[column] * change[column];
            column += 1;
        }
        index += 1;
    }
    let mut column = 0;
    while column < P {
        square[column] = sqrt(square[column]);
        column += 1;
    }
    square
}

/// Squares of the floor, in the units of the base parameters; 1 where the arm has no base parameter.
const fn floor_squared<const N: usize, const P: usize>(arm: &ArmModel<N, P>) -> [f32; P] {
    let mut squares = [1.0; P];
    let mut joint = 0;
    while joint < N {
        let mut k = 0;
        while k <= LINK_PARAMETERS {
            let column = if k < LINK_PARAMETERS {
                arm.index.link[joint][k]
            } else {
                arm.index.rotor[joint]
            };
            if let Some(column) = column {
                let scale = if k < 4 { GRAVITY } else { FLOOR_ACCELERATION };
                let floor = FLOOR * arm.limits[joint].torque / scale;
                squares[column] = floor * floor;
            }
            k += 1;
        }
        joint += 1;
    }
    squares
}

/// Factor number `index`: change of the base parameters, in their units.
const fn base_change<const N: usize, const P: usize>(
    links: &[LinkUncertainty; N],
    mut terms: &[BaseTerm],
    index: usize,
) -> [f32; P] {
    let mut beta = [0.0; P];
    let (link, kind) = (index / FACTORS_PER_LINK, index % FACTORS_PER_LINK);
    if link >= N {
        return beta;
    }
    let change = links[link].factor(kind);
    let first = LINK_PARAMETERS * link;
    while let [term, rest @ ..] = terms {
        terms = rest;
        let own = if term.standard == LINK_PARAMETERS * N + link {
            LINK_PARAMETERS
        } else if term.standard >= first && term.standard < first + LINK_PARAMETERS {
            term.standard - first
        } else {
            FACTORS_PER_LINK
        };
        if own < FACTORS_PER_LINK && term.base < P {
            beta[term.base] += term.weight * change[own];
        }
    }
    beta
}

#[derive(Clone, Copy)]
struct LinkUncertainty {
    /// Standard parameters.
    link: [f32; LINK_PARAMETERS],
    /// Standard deviation of the rotor inertia, kg·m².
    rotor: f32,
    /// Standard deviation of the centre of mass along an axis, m.
    shift: f32,
    /// Standard deviation of a moment of inertia, kg·m².
    moment: f32,
}

const fn link_uncertainty<const N: usize, const P: usize>(
    arm: &ArmModel<N, P>,
) -> [LinkUncertainty; N] {
    let mut links = [LinkUncertainty {
        link: [0.0; LINK_PARAMETERS],
        rotor: 0.0,
        shift: 0.0,
        moment: 0.0,
    }; N];
    let mut joint = 0;
    while joint < N {
        let [mass, x, y, z, xx, yy, zz, ..] = arm.links[joint];
        let inverse = if mass > 0.0 { 1.0 / mass } else { 0.0 };
        let square = (x * x + y * y + z * z) * inverse;
        let known = RELATIVE_SIGMA * arm.rotors[joint];
        let unknown = ROTOR_TORQUE * arm.limits[joint].torque / FLOOR_ACCELERATION;
        links[joint] = LinkUncertainty {
            link: arm.links[joint],
            rotor: sqrt(known * known + unknown * unknown),
            shift: COM_SIGMA.0 * sqrt(square * inverse) + COM_SIGMA.1,
            // Relative to the mean moment about the centre of mass.
            moment: RELATIVE_SIGMA * (xx + yy + zz - 2.0 * square) / 3.0,
        };
        joint += 1;
    }
    links
}

impl LinkUncertainty {
    /// Change of the standard parameters, rotor last, by one standard deviation of property `kind`.
    ///
    /// ```text
    /// mass:     m, h = m c and I, all by the same ratio
    /// centre:   δh = m δ e,   δI = δ (2 h·e 1 − h eᵀ − e hᵀ): the body shifted by δ along the axis e
    /// inertia:  one entry of I, by a part of the mean moment about the centre of mass; products by half of it
    /// ```
    const fn factor(&self, kind: usize) -> [f32; FACTORS_PER_LINK] {
        let mut change = [0.0; FACTORS_PER_LINK];
        match kind {
            0 => {
                let mut k = 0;
                while k < LINK_PARAMETERS {
                    change[k] = RELATIVE_SIGMA * self.link[k];
                    k += 1;
                }
            }
            1..=3 => {
                let [mass, x, y, z, ..] = self.link;
                let h = [x, y, z];
                let axis = kind - 1;
                let (next, last) = ((axis + 1) % 3, (axis + 2) % 3);
                change[kind] = mass * self.shift;
                change[4 + next] = 2.0 * self.shift * h[axis];
                change[4 + last] = 2.0 * self.shift * h[axis];
                // Products are in the order xy, xz, yz: that of axes a and b is entry a + b − 1 after the moments.
                change[6 + axis + next] = -self.shift * h[next];
                change[6 + axis + last] = -self.shift * h[last];
            }
            4..=6 => change[kind] = self.moment,
            7..=9 => change[kind] = 0.5 * self.moment,
            LINK_PARAMETERS => change[kind] = self.rotor,
            _ => {}
        }
        change
    }
}
