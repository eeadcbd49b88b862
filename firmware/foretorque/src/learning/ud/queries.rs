//! Variances, covariances and gains of a filter, which stays as it is.

use super::UdFilter;
use super::rows::set;
use crate::dynamics::FRICTION_COLUMNS;
use crate::learning::parameters::{JointEntries, LinearParameters, dot};

impl<const N: usize, const P: usize> UdFilter<N, P> {
    /// Variance of friction column `column` of `joint`, in units of the prior variance; `None` if there is none.
    ///
    /// ```text
    /// P_kk = D_k + Σ U_kj² D_j (j > k)
    /// ```
    pub fn friction_variance(&self, joint: usize, column: usize) -> Option<f32> {
        let row = self.friction.get(joint)?.get(column)?;
        let (friction, rigid) = (self.diagonal.friction.get(joint)?, &self.diagonal.rigid);
        let own = *friction.get(column)?;
        Some(own + weighted_squares(&row.own, friction) + weighted_squares(&row.rigid, rigid))
    }

    /// Variance of base parameter `column`, as [`friction_variance`](Self::friction_variance).
    pub fn rigid_variance(&self, column: usize) -> Option<f32> {
        let own = *self.diagonal.rigid.get(column)?;
        let (row, diagonal) = (self.rigid.get(column)?, &self.diagonal.rigid);
        Some(own + weighted_squares(row.get(column..)?, diagonal.get(column..)?))
    }

    /// Prediction variance φᵀPφ of the torque of `joint`, for its row `phi`.
    ///
    /// ```text
    /// φᵀPφ = Σ D_j f_j²     f = Uᵀφ
    /// ```
    ///
    /// Cost: that of Uᵀφ, and `2 (FRICTION_COLUMNS + P)` multiply-adds.
    pub(in crate::learning) fn prediction_variance(
        &self,
        joint: usize,
        phi: &JointEntries<P>,
    ) -> f32 {
        self.variance_of(joint, &self.transposed_times(joint, phi))
    }

    /// Prediction variance φᵀPφ of the torque of `joint`, for f = Uᵀφ of its row; NaN if there is no such joint.
    #[inline(never)]
    pub(in crate::learning) fn variance_of(&self, joint: usize, f: &JointEntries<P>) -> f32 {
        let Some(diagonal) = self.diagonal.friction.get(joint) else {
            return f32::NAN;
        };
        let own = f.own.iter().zip(diagonal);
        let rigid = f.rigid.iter().zip(&self.diagonal.rigid);
        let mut variance = 0.0;
        for (f, d) in own.chain(rigid) {
            variance += d * f * f;
        }
        variance
    }

    /// Covariance of the friction columns `chosen` of `joint`, in units of the prior variances; 0 for the others.
    ///
    /// ```text
    /// P_ik = Σ U_ij D_j U_kj
    /// ```
    ///
    /// Cost: `(c + 1) / 2` products of length `FRICTION_COLUMNS + P` for each of the `c` columns chosen.
    pub(in crate::learning) fn friction_covariance(
        &self,
        joint: usize,
        chosen: &[bool; FRICTION_COLUMNS],
    ) -> [[f32; FRICTION_COLUMNS]; FRICTION_COLUMNS] {
        let mut covariance = [[0.0; FRICTION_COLUMNS]; FRICTION_COLUMNS];
        let (Some(rows), Some(diagonal)) =
            (self.friction.get(joint), self.diagonal.friction.get(joint))
        else {
            return covariance;
        };
        for (i, row) in rows.iter().enumerate() {
            if chosen.get(i) != Some(&true) {
                continue;
            }
            let mut scaled = *row;
            set(&mut scaled.own, i, 1.0);
            scale(&mut scaled.own, diagonal);
            scale(&mut scaled.rigid, &self.diagonal.rigid);
            for (k, other) in rows.iter().enumerate().take(i + 1) {
                if chosen.get(k) == Some(&true) {
                    // The unit diagonal is not stored.
                    let unit = scaled.own.get(i).filter(|_| k == i);
                    let unit = unit.copied().unwrap_or(0.0);
                    let product =
                        unit + dot(&scaled.own, &other.own) + dot(&scaled.rigid, &other.rigid);
                    for (row, column) in [(i, k), (k, i)] {
                        if let Some(row) = covariance.get_mut(row) {
                            set(row, column, product);
                        }
                    }
                }
            }
        }
        covariance
    }

    /// Add P φ to `gain`, for a row φ with friction `phi` of `joint` only; the filter stays as it is.
    ///
    /// ```text
    /// v = D Uᵀφ     P φ = U v
    /// ```
    ///
    /// * `gain` in units of the prior standard deviations
    ///
    /// Cost: `(N FRICTION_COLUMNS + P / 2) P` multiply-adds, no division.
    #[inline(never)]
    pub(in crate::learning) fn add_friction_gain(
        &self,
        joint: usize,
        phi: &[f32; FRICTION_COLUMNS],
        gain: &mut LinearParameters<N, P>,
    ) {
        let phi = JointEntries {
            own: *phi,
            ..JointEntries::ZERO
        };
        let mut v = self.transposed_times(joint, &phi);
        let Some(diagonal) = self.diagonal.friction.get(joint) else {
            return;
        };
        scale(&mut v.own, diagonal);
        scale(&mut v.rigid, &self.diagonal.rigid);
        for (rows, gain) in self.friction.iter().zip(&mut gain.friction) {
            for (row, gain) in rows.iter().zip(gain) {
                *gain += dot(&row.rigid, &v.rigid);
            }
        }
        if let (Some(rows), Some(gain)) = (self.friction.get(joint), gain.friction.get_mut(joint)) {
            for ((row, gain), own) in rows.iter().zip(gain).zip(&v.own) {
                *gain += dot(&row.own, &v.own) + own;
            }
        }
        // The lower triangle is compensation, not U.
        for (i, (row, gain)) in self.rigid.iter().zip(&mut gain.rigid).enumerate() {
            if let (Some([first, rest @ ..]), Some(row)) = (v.rigid.get(i..), row.get(i + 1..)) {
                *gain += first + dot(row, rest);
            }
        }
    }
}

/// Product of two vectors, entry by entry.
#[inline(always)]
fn scale(vector: &mut [f32], by: &[f32]) {
    vector.iter_mut().zip(by).for_each(|(x, by)| *x *= by);
}

/// Sum Σ u² d.
fn weighted_squares(row: &[f32], diagonal: &[f32]) -> f32 {
    let mut sum = 0.0;
    for (u, d) in row.iter().zip(diagonal) {
        sum += u * u * d;
    }
    sum
}
