//! How far the description of an arm may be off: the prior covariance of its base parameters.
//!
//! What an engineer doubts are links: how heavy each is, where its centre lies, how its mass is spread. A base parameter
//! is a sum over several links, so doubts about one link show in many of them at once, and the covariance
//!
//! ```text
//! P = Σ d dᵀ + floor²,   d = base map · change of the standard parameters, one for every way in which a link may be off
//! ```
//! is far from diagonal: a forearm that turns out too heavy for the shoulder says how heavy it is for the elbow.

use super::guard_config::{GRAVITY, root};
use crate::arm::{Arm, LINK_PARAMETERS};

/// Ways in which one link may differ from its description: its mass, three coordinates of its centre, six moments and
/// products of inertia, its rotor.
const WAYS: usize = 11;

/// Doubt about mass, moments of inertia and rotor inertia, in proportion to what the description says.
const RELATIVE_DOUBT: f32 = 0.2;
/// Doubt about a centre of mass along each axis: in proportion to its distance from the joint, and besides, m.
const PLACE_DOUBT: (f32, f32) = (0.05, 0.003);
/// Share of the torque limit that a base parameter may account for besides, for reasons that are no link's.
const FLOOR: f32 = 1.5e-3;
/// Acceleration at which an unknown inertia shows, rad/s².
const DOUBT_ACCELERATION: f32 = 10.0;

/// Number of ways in which the links of an arm of `joints` joints may differ from their descriptions.
pub const fn prior_factor_count(joints: usize) -> usize {
    WAYS * joints
}

/// One way, number `place`, in which the links may differ: change of the base parameters, in units of their prior
/// standard deviations. `None` if there is no such.
pub fn prior_factor<A: Arm<N, P>, const N: usize, const P: usize>(
    place: usize,
) -> Option<[f32; P]> {
    if place >= prior_factor_count(N) {
        return None;
    }
    let mut doubt = base_change::<A, N, P>(place);
    for (doubt, sigma) in doubt.iter_mut().zip(const { rigid_sigma::<A, N, P>() }) {
        *doubt /= sigma;
    }
    Some(doubt)
}

/// Variances that base parameters have for no link's reason, in units of the prior's.
pub fn prior_floor<A: Arm<N, P>, const N: usize, const P: usize>() -> [f32; P] {
    const { relative_floor::<A, N, P>() }
}

/// Prior standard deviations of the base parameters, in their units.
pub(super) const fn rigid_sigma<A: Arm<N, P>, const N: usize, const P: usize>() -> [f32; P] {
    let mut square = floor_squared::<A, N, P>();
    let mut place = 0;
    while place < prior_factor_count(N) {
        let change = base_change::<A, N, P>(place);
        let mut column = 0;
        while column < P {
            square[column] += change[column] * change[column];
            column += 1;
        }
        place += 1;
    }
    let mut column = 0;
    while column < P {
        square[column] = root(square[column]);
        column += 1;
    }
    square
}

const fn relative_floor<A: Arm<N, P>, const N: usize, const P: usize>() -> [f32; P] {
    let (mut floor, sigma) = (floor_squared::<A, N, P>(), rigid_sigma::<A, N, P>());
    let mut column = 0;
    while column < P {
        floor[column] /= sigma[column] * sigma[column];
        column += 1;
    }
    floor
}

/// Squares of the doubts that are no link's, in the units of the base parameters.
const fn floor_squared<A: Arm<N, P>, const N: usize, const P: usize>() -> [f32; P] {
    let mut squares = [0.0; P];
    let mut column = 0;
    // Columns of the links first, rotor inertias after them: the order of the base set.
    let mut place = 0;
    while place < (LINK_PARAMETERS + 1) * N {
        let rotor = place >= LINK_PARAMETERS * N;
        let (joint, k) = if rotor {
            (place - LINK_PARAMETERS * N, LINK_PARAMETERS)
        } else {
            (place / LINK_PARAMETERS, place % LINK_PARAMETERS)
        };
        let columns = A::COLUMNS[joint];
        let independent = if rotor {
            columns.rotor
        } else {
            columns.inertial[k]
        };
        if independent && column < P {
            let scale = if k < 4 { GRAVITY } else { DOUBT_ACCELERATION };
            let floor = FLOOR * A::LIMITS[joint].torque / scale;
            squares[column] = floor * floor;
            column += 1;
        }
        place += 1;
    }
    squares
}

/// Way number `place`: change of the base parameters, in their units.
const fn base_change<A: Arm<N, P>, const N: usize, const P: usize>(place: usize) -> [f32; P] {
    let mut beta = [0.0; P];
    let (link, way) = (place / WAYS, place % WAYS);
    if link >= N {
        return beta;
    }
    let change = const { doubtful::<A, N, P>() }[link].change(way);
    let first = LINK_PARAMETERS * link;
    let mut terms = A::BASE_MAP;
    while let [term, rest @ ..] = terms {
        terms = rest;
        let own = if term.standard == LINK_PARAMETERS * N + link {
            LINK_PARAMETERS
        } else if term.standard >= first && term.standard < first + LINK_PARAMETERS {
            term.standard - first
        } else {
            WAYS
        };
        if own < WAYS && term.base < P {
            beta[term.base] += term.weight * change[own];
        }
    }
    beta
}

/// What is doubted about a link.
#[derive(Clone, Copy)]
struct Doubtful {
    /// Its standard parameters.
    link: [f32; LINK_PARAMETERS],
    /// Its rotor inertia, kg·m².
    rotor: f32,
    /// How far its centre of mass may lie off along an axis, m.
    shift: f32,
    /// By how much a moment of inertia may be off, kg·m².
    moment: f32,
}

const fn doubtful<A: Arm<N, P>, const N: usize, const P: usize>() -> [Doubtful; N] {
    let mut links = [Doubtful {
        link: [0.0; LINK_PARAMETERS],
        rotor: 0.0,
        shift: 0.0,
        moment: 0.0,
    }; N];
    let mut joint = 0;
    while joint < N {
        let [mass, x, y, z, xx, yy, zz, ..] = A::LINKS[joint];
        let inverse = if mass > 0.0 { 1.0 / mass } else { 0.0 };
        let square = (x * x + y * y + z * z) * inverse;
        links[joint] = Doubtful {
            link: A::LINKS[joint],
            rotor: A::ROTORS[joint],
            shift: PLACE_DOUBT.0 * root(square * inverse) + PLACE_DOUBT.1,
            // Of the mean moment about the centre of mass.
            moment: RELATIVE_DOUBT * (xx + yy + zz - 2.0 * square) / 3.0,
        };
        joint += 1;
    }
    links
}

impl Doubtful {
    /// One way in which the link and its rotor may differ: change of the standard parameters, the rotor's last.
    ///
    /// ```text
    /// mass:     all of m, h = m c, I by the same part
    /// centre:   δh = m δ e,   δI = δ (2 h·e 1 − h eᵀ − e hᵀ), the body shifted as it is, δ along the axis e
    /// inertia:  one entry of I, by a part of the mean moment about the centre of mass, products by half of it
    /// ```
    const fn change(&self, way: usize) -> [f32; WAYS] {
        let mut change = [0.0; WAYS];
        match way {
            0 => {
                let mut k = 0;
                while k < LINK_PARAMETERS {
                    change[k] = RELATIVE_DOUBT * self.link[k];
                    k += 1;
                }
            }
            1..=3 => {
                let [mass, x, y, z, ..] = self.link;
                let h = [x, y, z];
                let axis = way - 1;
                let (next, last) = ((axis + 1) % 3, (axis + 2) % 3);
                change[way] = mass * self.shift;
                change[4 + next] = 2.0 * self.shift * h[axis];
                change[4 + last] = 2.0 * self.shift * h[axis];
                // Products are in the order xy, xz, yz: that of axes a and b is a + b − 1 after the moments.
                change[6 + axis + next] = -self.shift * h[next];
                change[6 + axis + last] = -self.shift * h[last];
            }
            4..=6 => change[way] = self.moment,
            7..=9 => change[way] = 0.5 * self.moment,
            LINK_PARAMETERS => change[way] = RELATIVE_DOUBT * self.rotor,
            _ => {}
        }
        change
    }
}
