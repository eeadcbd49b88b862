mod queries;
mod rows;

use super::parameters::{JointEntries, LinearParameters};
use crate::dynamics::FRICTION_COLUMNS;
use core::array::{from_mut, from_ref};
use core::mem::take;
use rows::{ColumnUpdates, ROWS, add_rows, set};

/// Covariance factors of the linear parameters, `P = U D Uᵀ`, in units of the prior standard deviations.
///
/// U is unit upper triangular and D diagonal. Rounding cannot make the factored covariance indefinite: D stays positive
/// for any rows. The plain update of P fails in f32 [Bierman 1977, ch. V].
///
/// The friction of two joints is coupled only through the rigid body: given that, it is independent, because no row
/// contains both. With friction first, the entries of U between the friction of two joints are therefore zero after any
/// number of rows. They are neither stored nor computed. Likewise the friction of a joint is coupled to the links before it
/// by no row of its own: its entries of U before the first column of its rows are zeros, and stay so.
///
/// U is stored by rows in square arrays; diagonal and lower triangle are zeros. The lower triangle of the rigid rows holds
/// compensation instead: U_ji is the rounding error of U_ij, added with the next row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UdFilter<const N: usize, const P: usize> {
    friction: [[JointEntries<P>; FRICTION_COLUMNS]; N],
    rigid: [[f32; P]; P],
    diagonal: LinearParameters<N, P>,
    /// First column of the rigid body in the rows of each joint, rounded down to a multiple of `ROWS`; P before the first
    /// row.
    first: [usize; N],
}

impl<const N: usize, const P: usize> UdFilter<N, P> {
    /// Covariance of the prior, `P = I`.
    pub const fn new() -> Self {
        Self {
            friction: [[JointEntries::ZERO; FRICTION_COLUMNS]; N],
            rigid: [[0.0; P]; P],
            diagonal: LinearParameters::filled(1.0),
            first: [P; N],
        }
    }

    /// Reset to `P = I`, in place; correlated variances of the base parameters are set afterwards.
    pub fn reset(&mut self) {
        self.friction.as_flattened_mut().fill(JointEntries::ZERO);
        self.rigid.as_flattened_mut().fill(0.0);
        self.diagonal.iter_mut().for_each(|d| *d = 1.0);
        self.first = [P; N];
    }

    /// Measurement update with the row `phi` of `joint` and noise variance `variance`. [Bierman 1977, ch. V.3]
    ///
    /// ```text
    /// f = Uᵀ φ     v = D f     column by column: α' = α + v_j f_j, α = variance at first
    ///              D_j ← D_j α/α'     λ_j = −f_j/α     U_ij ← U_ij + λ_j b_i     b_i ← b_i + v_j U_ij (old)     b_j = v_j
    /// ```
    ///
    /// Departure from Bierman, who updates U by columns: f gives all v and λ before U changes. The rows of U are then
    /// independent, b_i is a running sum along row i, and several rows share v_j and λ_j in registers. f is cheap, because
    /// φ is sparse: friction of its joint alone, and no link before the joint.
    ///
    /// * `gain` becomes P φ with the old P; divided by the returned S it is the Kalman gain
    /// * returns `S = φᵀ P φ + variance`, the variance of the innovation; NaN if there is no such joint
    ///
    /// Assumes: `phi` finite, `variance` positive. Entries of `phi` for the friction of other joints are ignored.
    ///
    /// Cost: at most `(2 N FRICTION_COLUMNS + P) P` multiply-adds, a third less on a serial arm; about an eighth of that for f;
    /// `P + FRICTION_COLUMNS` divisions.
    pub fn update(
        &mut self,
        joint: usize,
        phi: &LinearParameters<N, P>,
        variance: f32,
        gain: &mut LinearParameters<N, P>,
    ) -> f32 {
        phi.of_joint(joint).map_or(f32::NAN, |phi| {
            let f = self.transposed_times(joint, &phi);
            self.update_joint(joint, &phi, f, variance, gain)
        })
    }

    /// [`update`](Self::update) with the entries of `joint` and `f` = Uᵀφ. With an infinite `variance` P stays as it is.
    pub(super) fn update_joint(
        &mut self,
        joint: usize,
        phi: &JointEntries<P>,
        f: JointEntries<P>,
        variance: f32,
        gain: &mut LinearParameters<N, P>,
    ) -> f32 {
        let leading = phi.rigid.as_chunks::<ROWS>().0;
        let leading = leading.iter().take_while(|block| **block == [0.0; ROWS]);
        let row_first = ROWS * leading.count();
        let Some(first) = self.first.get_mut(joint) else {
            return f32::NAN;
        };
        *first = row_first.min(*first);
        let first = *first;
        // f, replaced by λ.
        let mut lambda = f;
        let mut v = JointEntries::ZERO;
        let Some(d) = self.diagonal.friction.get_mut(joint) else {
            return f32::NAN;
        };
        let mut alpha = Alpha::new(variance);
        alpha.absorb_all(&mut lambda.own, &mut v.own, d);
        let parts = [&mut lambda.rigid, &mut v.rigid, &mut self.diagonal.rigid];
        // Before the first column f is zero.
        if let [Some(lambda), Some(v), Some(d)] = parts.map(|part| part.get_mut(first..)) {
            alpha.absorb_all(lambda, v, d);
        }
        self.update_factors(joint, &lambda, &v, gain);
        alpha.value
    }

    /// Product f = Uᵀ φ, by rows: `f ← f + φ_i U_i`.
    #[inline(never)]
    pub(super) fn transposed_times(&self, joint: usize, phi: &JointEntries<P>) -> JointEntries<P> {
        let mut f = *phi;
        let JointEntries {
            own: friction,
            rigid,
        } = phi;
        if let (Some(rows), Some(&first)) = (self.friction.get(joint), self.first.get(joint)) {
            add_rows(&mut f.own, rows, |row| &row.own, friction, 0);
            add_rows(&mut f.rigid, rows, |row| &row.rigid, friction, first);
        }
        let (rows, rest) = self.rigid.as_chunks::<ROWS>();
        let (weights, rest_weights) = rigid.as_chunks::<ROWS>();
        for (block, (rows, weights)) in rows.iter().zip(weights).enumerate() {
            // Links before the joint do not enter its torque.
            if *weights != [0.0; ROWS] {
                add_rows(&mut f.rigid, rows, |row| row, weights, block * ROWS);
            }
        }
        let start = P - rest.len();
        for (row, weight) in rest.iter().zip(rest_weights) {
            add_rows(
                &mut f.rigid,
                from_ref(row),
                |row| row,
                from_ref(weight),
                start,
            );
        }
        f
    }

    /// Update of U; b becomes `gain`.
    ///
    /// The b of a row is zero before the diagonal, where U is zero too, and v at the diagonal.
    #[inline(always)]
    fn update_factors(
        &mut self,
        joint: usize,
        lambda: &JointEntries<P>,
        v: &JointEntries<P>,
        gain: &mut LinearParameters<N, P>,
    ) {
        let own = ColumnUpdates {
            lambda: &lambda.own,
            v: &v.own,
        };
        let beyond = ColumnUpdates {
            lambda: &lambda.rigid,
            v: &v.rigid,
        };
        gain.friction.as_flattened_mut().fill(0.0);
        let rows = self.friction.get_mut(joint);
        if let (Some(rows), Some(gain)) = (rows, gain.friction.get_mut(joint)) {
            *gain = own.corner(rows, |row| &mut row.own, 0);
        }
        let first = self.first.get(joint).copied().unwrap_or(0);
        let joints = self.friction.iter_mut().zip(&mut gain.friction);
        for ((rows, gain), &own_first) in joints.zip(&self.first) {
            beyond.sweep(rows, |row| &mut row.rigid, own_first.max(first), gain);
        }
        let (gains, rest_gains) = gain.rigid.as_chunks_mut::<ROWS>();
        let start = gains.len() * ROWS;
        let mut rest = self.rigid.as_mut_slice();
        for (block, gain) in gains.iter_mut().enumerate() {
            let Some((rows, below)) = take(&mut rest).split_first_chunk_mut::<ROWS>() else {
                break;
            };
            *gain = beyond.corner(rows, |row| row, block * ROWS);
            beyond.sweep_compensated(rows, below, block, first / ROWS, gain);
            rest = below;
        }
        for (place, (row, gain)) in rest.iter_mut().zip(rest_gains).enumerate() {
            let (row, gain) = (from_mut(row), from_mut(gain));
            *gain = beyond.corner(row, |row| row, start + place);
            beyond.sweep(row, |row| row, start + place + 1, gain);
        }
    }

    /// Add `noise` to the variance of friction column `column` of `joint`. [Agee and Turner 1972]
    ///
    /// ```text
    /// P + c e eᵀ, column by column from e's down to the first of its joint:
    ///   D_j' = D_j + c a_j²     a_i ← a_i − a_j U_ij     U_ij ← U_ij + (c a_j / D_j') a_i     c ← c D_j / D_j'
    /// ```
    ///
    /// Cost: `column²` multiply-adds.
    pub fn add_process_noise(&mut self, joint: usize, column: usize, noise: f32) {
        let (Some(rows), Some(diagonal)) = (
            self.friction.get_mut(joint),
            self.diagonal.friction.get_mut(joint),
        ) else {
            return;
        };
        let mut direction = [0.0; FRICTION_COLUMNS];
        set(&mut direction, column, 1.0);
        let mut c = noise;
        for (j, d) in diagonal.iter_mut().enumerate().take(column + 1).rev() {
            let a_j = direction.get(j).copied().unwrap_or(0.0);
            let entries = rows.iter_mut().zip(direction.iter_mut()).take(j);
            let entries = entries.filter_map(|(row, a)| Some((row.own.get_mut(j)?, a)));
            add_column(&mut c, a_j, d, entries);
        }
    }

    /// Set the variances, in units of the prior variances.
    ///
    /// Assumes: no correlations, as after a reset.
    pub(super) fn set_variances(&mut self, variances: &LinearParameters<N, P>) {
        self.diagonal = *variances;
    }

    /// Add the prior factor `direction` of the base parameters: P + d dᵀ, as
    /// [`add_process_noise`](Self::add_process_noise).
    ///
    /// * `direction` d, in units of the prior standard deviations; overwritten
    ///
    /// Cost: `2 j` multiply-adds for each column j that the direction reaches, `P²` at most.
    pub(super) fn add_rigid_factor(&mut self, direction: &mut [f32; P]) {
        let mut c = 1.0;
        for j in (0..P).rev() {
            let (Some(&a_j), Some(d)) = (direction.get(j), self.diagonal.rigid.get_mut(j)) else {
                continue;
            };
            if a_j == 0.0 {
                continue;
            }
            let entries = self.rigid.iter_mut().zip(direction.iter_mut()).take(j);
            let entries = entries.filter_map(|(row, a)| Some((row.get_mut(j)?, a)));
            add_column(&mut c, a_j, d, entries);
        }
    }

    /// Diagonal D, friction first; all entries are positive.
    pub fn diagonal(&self) -> &LinearParameters<N, P> {
        &self.diagonal
    }
}

impl<const N: usize, const P: usize> Default for UdFilter<N, P> {
    fn default() -> Self {
        Self::new()
    }
}

/// Partial innovation variance α, from the measurement noise to S, and its reciprocal.
struct Alpha {
    value: f32,
    inverse: f32,
}

impl Alpha {
    fn new(variance: f32) -> Self {
        Self {
            value: variance,
            inverse: ALMOST_ONE / variance,
        }
    }

    /// Accumulate several columns: `f` becomes λ.
    #[inline(always)]
    fn absorb_all(&mut self, f: &mut [f32], v: &mut [f32], d: &mut [f32]) {
        for ((f, v), d) in f.iter_mut().zip(v).zip(d) {
            (*v, *f) = self.absorb(*f, d);
        }
    }

    /// Accumulate one column with `f`, and reduce its `d`; returns `v` and `λ = −f/α`.
    ///
    /// `D α/α' = D − v²/α'`. The product would lose variance: `α · 1/α` is often rounded below one and never above, so
    /// every row would reduce all of D.
    #[inline(always)]
    fn absorb(&mut self, f: f32, d: &mut f32) -> (f32, f32) {
        let v = *d * f;
        let lambda = -f * self.inverse;
        self.value += v * f;
        self.inverse = ALMOST_ONE / self.value;
        *d -= v * (v * self.inverse);
        (v, lambda)
    }
}

/// Factor that keeps D positive for any row: a row leaves at least 2⁻²¹ of D, more than rounding can take.
const ALMOST_ONE: f32 = 1.0 - 4.0 * f32::EPSILON;

/// Column j of the rank-one update `P + c a aᵀ`; `entries` are U_ij and a_i of the rows above the diagonal.
#[inline(always)]
fn add_column<'a>(
    c: &mut f32,
    a_j: f32,
    d: &mut f32,
    entries: impl Iterator<Item = (&'a mut f32, &'a mut f32)>,
) {
    let before = *d;
    *d = before + *c * a_j * a_j;
    let inverse = 1.0 / *d;
    let step = *c * a_j * inverse;
    for (u, a) in entries {
        *a -= a_j * *u;
        *u += step * *a;
    }
    *c *= before * inverse;
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Random;
    use nalgebra::{SMatrix, SVector, UDU};

    /// Filter after `rows` rows with the first friction column of joint 0 alone and varying noise, and its information
    /// `Σ φ²/R`.
    fn after(rows: u32) -> (UdFilter<2, 1>, f64) {
        let mut filter = UdFilter::new();
        let mut phi = LinearParameters::filled(0.0);
        let mut gain = LinearParameters::filled(0.0);
        let mut information = 0.0;
        for row in 0..rows {
            let weight = 0.5 + 0.01 * (row % 97) as f32;
            let variance = 0.7 + 0.013 * (row % 89) as f32;
            phi.friction[0][0] = weight;
            filter.update(0, &phi, variance, &mut gain);
            information += f64::from(weight).powi(2) / f64::from(variance);
        }
        (filter, information)
    }

    #[test]
    fn parameters_outside_all_rows_keep_their_variance() {
        let (filter, _) = after(100_000);
        let touched = 1;
        assert!(filter.diagonal().iter().skip(touched).all(|&d| d == 1.0));
    }

    #[test]
    fn after_many_rows_the_variance_is_exact() {
        for (rows, limit) in [(10_000, 1e-6), (1_000_000, 1e-5), (10_000_000, 5e-3)] {
            let (filter, information) = after(rows);
            let variance = f64::from(filter.diagonal().friction[0][0]);
            let error = variance * (1.0 + information) - 1.0;
            std::println!("{rows} rows: off by {error:.1e}");
            assert!(error.abs() < limit, "{rows} rows: {error}");
        }
    }

    #[test]
    fn a_row_of_any_size_leaves_the_diagonal_positive() {
        for size in [1e-12, 1e-3, 1.0, 1e3, 1e6, 1e9, 1e12] {
            let mut filter = UdFilter::<2, 1>::new();
            let (mut gain, mut random) = (LinearParameters::filled(0.0), Random(1));
            for _ in 0..1000 {
                let mut phi = LinearParameters::filled(0.0);
                for phi in phi.friction[0].iter_mut().chain(&mut phi.rigid) {
                    *phi = size * (1.0 + random.uniform() as f32);
                }
                filter.update(0, &phi, 0.02, &mut gain);
                assert!(filter.diagonal().iter().all(|&d| d > 0.0), "{size}");
            }
        }
    }

    #[test]
    fn a_row_without_evidence_leaves_the_factors_and_gives_the_gain() {
        let (mut filter, mut random) = (UdFilter::<2, 3>::new(), Random(1));
        let (mut gain, mut plain) = (LinearParameters::filled(0.0), LinearParameters::filled(0.0));
        for row in 0..100 {
            let mut phi = JointEntries::ZERO;
            for phi in phi.own.iter_mut().chain(&mut phi.rigid) {
                *phi = random.uniform() as f32;
            }
            let (before, joint) = (filter, row % 2);
            let f = filter.transposed_times(joint, &phi);
            filter.update_joint(joint, &phi, f, f32::INFINITY, &mut gain);
            // The joint's first column is known from now on.
            filter.first = before.first;
            assert_eq!(filter, before);
            filter.update_joint(joint, &phi, f, 0.5, &mut plain);
            assert_eq!(gain, plain);
            assert_ne!(filter.diagonal, before.diagonal);
        }
    }

    /// Reference: the factor U of the covariance (I + Σ φφᵀ/R)⁻¹, in f64.
    #[test]
    fn a_million_rows_do_not_degrade_the_correlations() {
        const P: usize = 12;
        let mut filter = UdFilter::<1, P>::new();
        let mut information = SMatrix::<f64, P, P>::identity();
        let (mut gain, mut random) = (LinearParameters::filled(0.0), Random(1));
        for _ in 0..1_000_000 {
            let mut phi = LinearParameters::<1, P>::filled(0.0);
            for phi in &mut phi.rigid {
                *phi = 1.0 + 0.5 * random.uniform() as f32;
            }
            filter.update(0, &phi, 5.0, &mut gain);
            let phi = SVector::from(phi.rigid).cast::<f64>();
            information.ger(1.0 / 5.0, &phi, &phi, 1.0);
        }
        let exact = UDU::new(information.try_inverse().unwrap()).unwrap().u;
        let mut worst = 0.0_f64;
        for (i, row) in filter.rigid.iter().enumerate() {
            // Diagonal blocks are not compensated.
            for j in (i / ROWS + 1) * ROWS..P {
                worst = worst.max((f64::from(row[j]) - exact[(i, j)]).abs());
            }
        }
        std::println!("off by {worst:.1e}");
        assert!(worst < 3e-6, "{worst}");
    }
}
