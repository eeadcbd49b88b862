//! Variables of a search: series that rest at both ends of the period.
//!
//! Rest at t = 0, and so at the period's end, takes two coefficients of each joint: Σ a_l = 0 (velocity) and Σ l b_l = 0
//! (acceleration). Of 11 a joint 9 remain: the offset, and 4 for each of a and b on orthonormal bases of what is left.

use super::series::{JointSeries, ORDER};

/// Variables of one joint.
pub(super) const VARIABLES: usize = 2 * ORDER - 1;
const FREE: usize = ORDER - 1;

/// Orthonormal bases of all a with Σ a_l = 0 and of all b with Σ l b_l = 0.
#[derive(Clone, Debug)]
pub(super) struct Bases {
    a: [[f64; ORDER]; FREE],
    b: [[f64; ORDER]; FREE],
}

impl Bases {
    pub(super) fn new() -> Self {
        Self {
            a: complement([1.0; ORDER]),
            b: complement(std::array::from_fn(|l| (l + 1) as f64)),
        }
    }

    /// The series of one joint's variables: offset, 4 of a, 4 of b.
    pub(super) fn series(&self, variables: &[f64]) -> JointSeries {
        let combine = |basis: &[[f64; ORDER]; FREE], shares: &[f64]| {
            std::array::from_fn(|l| basis.iter().zip(shares).map(|(v, s)| v[l] * s).sum())
        };
        JointSeries {
            q0_rad: variables[0],
            a_rad_s: combine(&self.a, &variables[1..=FREE]),
            b_rad_s: combine(&self.b, &variables[1 + FREE..VARIABLES]),
        }
    }

    /// The variables of a series; what of it does not rest at the ends is lost.
    pub(super) fn variables(&self, series: &JointSeries) -> [f64; VARIABLES] {
        let dot = |v: &[f64; ORDER], c: &[f64; ORDER]| v.iter().zip(c).map(|(x, y)| x * y).sum();
        std::array::from_fn(|i| match i {
            0 => series.q0_rad,
            i if i <= FREE => dot(&self.a[i - 1], &series.a_rad_s),
            i => dot(&self.b[i - 1 - FREE], &series.b_rad_s),
        })
    }
}

/// An orthonormal basis of everything orthogonal to `normal` (Gram–Schmidt on the unit vectors).
fn complement(normal: [f64; ORDER]) -> [[f64; ORDER]; FREE] {
    let mut found = vec![unit(normal)];
    for axis in 0..FREE {
        let mut rest = [0.0; ORDER];
        rest[axis] = 1.0;
        for direction in &found {
            let share: f64 = direction.iter().zip(&rest).map(|(x, y)| x * y).sum();
            for (r, d) in rest.iter_mut().zip(direction) {
                *r -= share * d;
            }
        }
        found.push(unit(rest));
    }
    std::array::from_fn(|i| found[i + 1])
}

fn unit(v: [f64; ORDER]) -> [f64; ORDER] {
    let length = v.iter().map(|x| x * x).sum::<f64>().sqrt();
    v.map(|x| x / length)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_variables_rest_at_both_ends_and_come_back() {
        let bases = Bases::new();
        let variables: [f64; VARIABLES] = std::array::from_fn(|i| (1.7 * i as f64).sin() + 0.3);
        let series = bases.series(&variables);
        for t_s in [0.0, 10.0] {
            let (_, qd, qdd) = series.at(t_s, std::f64::consts::TAU / 10.0);
            assert!(qd.abs() < 1e-12 && qdd.abs() < 1e-12);
        }
        for (back, variable) in bases.variables(&series).iter().zip(&variables) {
            assert!((back - variable).abs() < 1e-12);
        }
    }
}
