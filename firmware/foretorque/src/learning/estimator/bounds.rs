//! Estimate within the sign bounds of friction: a quadratic programme in the columns of one joint.

use crate::dynamics::{DISSIPATION_BOUNDS, FRICTION_COLUMNS};
use crate::learning::parameters::dot;
use crate::math::sqrt;

const BOUNDS: usize = DISSIPATION_BOUNDS.len();

/// Violation of a bound attributed to rounding, prior standard deviations.
const TOLERANCE: f32 = 1e-4;
/// Sweeps over the bounds at most: 32 leave less than 0.01 prior standard deviations.
const SWEEPS: usize = 32;

/// Columns with a bound, whose covariances decide.
pub(super) const BOUNDED: [bool; FRICTION_COLUMNS] = {
    let (mut bounded, mut k) = ([false; FRICTION_COLUMNS], 0);
    while k < FRICTION_COLUMNS {
        let mut i = 0;
        while i < BOUNDS {
            bounded[k] |= DISSIPATION_BOUNDS[i][k] != 0.0;
            i += 1;
        }
        k += 1;
    }
    bounded
};

/// Bounds of one joint at an estimate that violates one of them.
pub(super) struct Violation {
    /// Bounds a, in units of the prior standard deviations, of length 1; zeros where no column is learnt.
    directions: [[f32; FRICTION_COLUMNS]; BOUNDS],
    /// Values aᵀθ.
    values: [f32; BOUNDS],
}

impl Violation {
    /// Bounds at the friction `own` with prior standard deviations `sigma`; `None` within all of them.
    pub(super) fn of(
        own: &[f32; FRICTION_COLUMNS],
        sigma: &[f32; FRICTION_COLUMNS],
    ) -> Option<Self> {
        let mut bounds = DISSIPATION_BOUNDS.iter();
        if bounds.all(|bound| dot(bound, own) >= 0.0) {
            return None;
        }
        let mut all = Self {
            directions: DISSIPATION_BOUNDS,
            values: [0.0; BOUNDS],
        };
        let mut violated = false;
        for (direction, value) in all.directions.iter_mut().zip(&mut all.values) {
            let unscaled = dot(direction, own);
            for (a, sigma) in direction.iter_mut().zip(sigma) {
                *a *= sigma;
            }
            let inverse = 1.0 / sqrt(dot(direction, direction));
            // Infinite where no column of the bound is learnt: these stay.
            let scale = if inverse.is_finite() { inverse } else { 0.0 };
            direction.iter_mut().for_each(|a| *a *= scale);
            *value = unscaled * scale;
            violated |= *value < -TOLERANCE;
        }
        violated.then_some(all)
    }

    /// Sum Σ λ a of the bounds that hold the estimate: `θ + P Σ λ a` is the most likely estimate within all bounds.
    ///
    /// ```text
    /// min (x − θ)ᵀ P⁻¹ (x − θ), A x ≥ 0     dual: λ_i ← max(0, λ_i − (A θ + A P Aᵀ λ)_i / (A P Aᵀ)_ii), in turn
    /// ```
    /// Coordinate ascent on the dual [Hildreth 1957].
    ///
    /// * `covariance` P of the joint's friction, in units of the prior variances
    pub(super) fn multipliers(
        &self,
        covariance: &[[f32; FRICTION_COLUMNS]; FRICTION_COLUMNS],
    ) -> [f32; FRICTION_COLUMNS] {
        let mut products = [[0.0; BOUNDS]; BOUNDS];
        for (row, a) in products.iter_mut().zip(&self.directions) {
            let mut image = [0.0; FRICTION_COLUMNS];
            for (p, &a) in covariance.iter().zip(a).filter(|(_, a)| **a != 0.0) {
                for (image, p) in image.iter_mut().zip(p) {
                    *image += a * p;
                }
            }
            for (product, b) in row.iter_mut().zip(&self.directions) {
                *product = dot(&image, b);
            }
        }
        let mut lambda = [0.0f32; BOUNDS];
        for _ in 0..SWEEPS {
            let mut moved = false;
            for (i, (row, value)) in products.iter().zip(&self.values).enumerate() {
                let inside = value + dot(row, &lambda);
                let variance = row.get(i).copied().unwrap_or(0.0);
                let Some(lambda) = lambda.get_mut(i).filter(|_| variance > 0.0) else {
                    continue;
                };
                let next = *lambda - inside / variance;
                let next = if next > 0.0 { next } else { 0.0 };
                moved |= (next - *lambda).abs() * variance > TOLERANCE;
                *lambda = next;
            }
            if !moved {
                break;
            }
        }
        let mut sum = [0.0; FRICTION_COLUMNS];
        for (a, lambda) in self.directions.iter().zip(lambda) {
            for (sum, a) in sum.iter_mut().zip(a) {
                *sum += lambda * a;
            }
        }
        sum
    }
}
