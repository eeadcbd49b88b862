//! Finite Fourier series of one joint (eq. 17), its scaling into limits, and the variables of a search.
//!
//! Rest at t = 0, and so at the period's end, takes two coefficients of each joint: Σ a_l = 0 (velocity) and Σ l b_l = 0
//! (acceleration). Of 11 a joint 9 remain: the offset, and 4 for each of a and b on orthonormal bases of what is left.

use super::refused;
use crate::Refusal;
use crate::robot::Robot;
use nalgebra::{SMatrix, SVector};
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// Harmonics of the series.
pub const ORDER: usize = 5;

/// Coefficients of one joint: 2 · 5 + 1.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct JointSeries {
    /// Offset, rad.
    pub q0_rad: f64,
    /// Sine amplitudes of the position line, rad/s.
    pub a_rad_s: [f64; ORDER],
    /// Cosine amplitudes of the position line, rad/s.
    pub b_rad_s: [f64; ORDER],
}

/// Extremes of a series, or its limits: range of the position, rad, peaks of speed, rad/s, and acceleration, rad/s².
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Extremes {
    pub(super) q: (f64, f64),
    pub(super) qd: f64,
    pub(super) qdd: f64,
}

impl Extremes {
    /// The limits of all joints, `share` of each. Ranges are no wider than ±`range_rad` about zero, or about the end of the
    /// range that is nearest to zero.
    ///
    /// Errors: the range of a joint is empty.
    pub(super) fn of_limits(
        robot: &Robot,
        range_rad: f64,
        share: f64,
    ) -> Result<Vec<Self>, Refusal> {
        let of_joint = |(number, joint): (usize, &crate::robot::Joint)| {
            let limits = &joint.limits;
            let (low, high) = limits.position;
            let centre = 0.0_f64.max(low).min(high);
            let (low, high) = (low.max(centre - range_rad), high.min(centre + range_rad));
            let (middle, half) = (0.5 * (low + high), 0.5 * (high - low) * share);
            // Not a number must be refused, too.
            if half.partial_cmp(&0.0) != Some(std::cmp::Ordering::Greater) {
                let problem = format!("limits of joint {number} leave no room to move");
                return Err(refused(problem));
            }
            Ok(Self {
                q: (middle - half, middle + half),
                qd: limits.velocity * share,
                qdd: limits.acceleration * share,
            })
        };
        (1..).zip(&robot.joints).map(of_joint).collect()
    }

    /// Largest factor on a swing with the extremes `swing` that keeps these limits.
    fn scale(&self, swing: &Self) -> f64 {
        let span = |of: &Self| of.q.1 - of.q.0;
        let rates = (self.qd / swing.qd).min(self.qdd / swing.qdd);
        rates.min(span(self) / span(swing))
    }
}

impl JointSeries {
    /// Position, velocity and acceleration at `t_s`: rad, rad/s, rad/s².
    pub(super) fn at(&self, t_s: f64, omega: f64) -> (f64, f64, f64) {
        let (sin1, cos1) = (omega * t_s).sin_cos();
        let (mut sin, mut cos) = (sin1, cos1);
        let (mut q, mut qd, mut qdd) = (self.q0_rad, 0.0, 0.0);
        for l in 0..ORDER {
            let (a, b) = (self.a_rad_s[l], self.b_rad_s[l]);
            let rate = omega * (l + 1) as f64;
            q += (a * sin - b * cos) / rate;
            qd += a * cos + b * sin;
            qdd += rate * (b * cos - a * sin);
            (sin, cos) = (sin * cos1 + cos * sin1, cos * cos1 - sin * sin1);
        }
        (q, qd, qdd)
    }

    /// Bounds of the next two derivatives over all times: jerk, rad/s³, and snap, rad/s⁴.
    pub(super) fn higher_bounds(&self, omega: f64) -> (f64, f64) {
        (0..ORDER).fold((0.0, 0.0), |(jerk, snap), l| {
            let rate = omega * (l + 1) as f64;
            let size = self.a_rad_s[l].hypot(self.b_rad_s[l]);
            (jerk + size * rate.powi(2), snap + size * rate.powi(3))
        })
    }

    /// Range of the position and peaks of speed and acceleration, those between `points` instants included.
    ///
    /// A function whose second derivative is bounded by K exceeds the larger of two neighbouring samples by at most
    /// K h² / 8 between them.
    pub(super) fn extremes(&self, omega: f64, points: usize) -> Extremes {
        let step = TAU / omega / points as f64;
        let mut extremes = Extremes {
            q: (f64::INFINITY, f64::NEG_INFINITY),
            qd: 0.0,
            qdd: 0.0,
        };
        for k in 0..points {
            let (q, qd, qdd) = self.at(k as f64 * step, omega);
            extremes.q = (extremes.q.0.min(q), extremes.q.1.max(q));
            extremes.qd = extremes.qd.max(qd.abs());
            extremes.qdd = extremes.qdd.max(qdd.abs());
        }
        let (jerk, snap) = self.higher_bounds(omega);
        let between = step * step / 8.0;
        extremes.qdd += snap * between;
        extremes.qd += jerk * between;
        extremes.q.0 -= extremes.qdd * between;
        extremes.q.1 += extremes.qdd * between;
        extremes
    }

    /// A random series that rests at both ends and uses `share` of its tightest limit.
    pub(super) fn random(
        limits: &Extremes,
        omega: f64,
        points: usize,
        share: f64,
        random: &mut ChaCha8Rng,
    ) -> Self {
        let mut normal = || random.sample::<f64, _>(StandardNormal);
        let mut a: [f64; ORDER] = std::array::from_fn(|_| normal());
        let mut b: [f64; ORDER] = std::array::from_fn(|_| normal());
        let a_mean = a.iter().sum::<f64>() / ORDER as f64;
        let weight = |l: usize| (l + 1) as f64;
        let b_mean = (0..ORDER).map(|l| weight(l) * b[l]).sum::<f64>()
            / (0..ORDER).map(|l| weight(l).powi(2)).sum::<f64>();
        for l in 0..ORDER {
            a[l] -= a_mean;
            b[l] -= b_mean * weight(l);
        }
        let shape = Self {
            q0_rad: 0.0,
            a_rad_s: a,
            b_rad_s: b,
        };
        let extremes = shape.extremes(omega, points);
        let scale = share * limits.scale(&extremes);
        // The offset is drawn from the range that the swing leaves free.
        let swing = (extremes.q.1 - extremes.q.0) * scale;
        let left = ((limits.q.1 - limits.q.0) - swing).max(0.0);
        Self {
            q0_rad: limits.q.0 - extremes.q.0 * scale + left * random.random::<f64>(),
            ..shape.scaled(scale)
        }
    }

    /// This series inside `limits`, its swing shrunk and its offset moved no more than needed.
    pub(super) fn fitted(&self, limits: &Extremes, omega: f64, points: usize) -> Self {
        let extremes = self.extremes(omega, points);
        let scale = limits.scale(&extremes).min(1.0);
        let swing = |end: f64| (end - self.q0_rad) * scale;
        let low = limits.q.0 - swing(extremes.q.0);
        let high = limits.q.1 - swing(extremes.q.1);
        Self {
            q0_rad: self.q0_rad.max(low).min(high),
            ..self.scaled(scale)
        }
    }

    /// This offset with `scale` times the amplitudes.
    pub(super) fn scaled(&self, scale: f64) -> Self {
        Self {
            q0_rad: self.q0_rad,
            a_rad_s: self.a_rad_s.map(|a| a * scale),
            b_rad_s: self.b_rad_s.map(|b| b * scale),
        }
    }
}

/// Variables of one joint.
pub(super) const VARIABLES: usize = 2 * ORDER - 1;
const FREE: usize = ORDER - 1;

/// Orthonormal bases of all a with Σ a_l = 0 and of all b with Σ l b_l = 0, a vector a column.
#[derive(Clone, Debug)]
pub(super) struct Bases {
    a: SMatrix<f64, ORDER, FREE>,
    b: SMatrix<f64, ORDER, FREE>,
}

impl Bases {
    pub(super) fn new() -> Self {
        Self {
            a: complement(SVector::repeat(1.0)),
            b: complement(SVector::from_fn(|l, _| (l + 1) as f64)),
        }
    }

    /// The series of one joint's variables: offset, 4 of a, 4 of b.
    pub(super) fn series(&self, variables: &[f64]) -> JointSeries {
        let (a, b) = variables[1..VARIABLES].split_at(FREE);
        JointSeries {
            q0_rad: variables[0],
            a_rad_s: (self.a * SVector::<f64, FREE>::from_column_slice(a)).into(),
            b_rad_s: (self.b * SVector::<f64, FREE>::from_column_slice(b)).into(),
        }
    }

    /// The variables of a series; what of it does not rest at the ends is lost.
    pub(super) fn variables(&self, series: &JointSeries) -> Vec<f64> {
        let a = self.a.tr_mul(&SVector::<f64, ORDER>::from(series.a_rad_s));
        let b = self.b.tr_mul(&SVector::<f64, ORDER>::from(series.b_rad_s));
        [&[series.q0_rad], a.as_slice(), b.as_slice()].concat()
    }
}

/// An orthonormal basis of everything orthogonal to `normal`, a vector a column.
fn complement(normal: SVector<f64, ORDER>) -> SMatrix<f64, ORDER, FREE> {
    let mut basis = Vec::new();
    SVector::<f64, ORDER>::orthonormal_subspace_basis(&[normal], |vector| {
        basis.push(*vector);
        true
    });
    SMatrix::from_columns(&basis)
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
