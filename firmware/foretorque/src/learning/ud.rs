mod rows;

use super::stacked::LinearParameters;
use crate::dynamics::FRICTION_COLUMNS;
use core::array::{from_mut, from_ref};
use core::mem::take;
use rows::{ROWS, Turns, add_rows};

/// Entries for the friction of one joint and for the rigid body: all that a torque row of the joint has.
#[derive(Clone, Copy, Debug, PartialEq)]
struct JointEntries<const P: usize> {
    own: [f32; FRICTION_COLUMNS],
    rigid: [f32; P],
}

impl<const P: usize> JointEntries<P> {
    const ZERO: Self = Self {
        own: [0.0; FRICTION_COLUMNS],
        rigid: [0.0; P],
    };
}

/// Covariance of the linear parameters in factors, `P = U D Uᵀ` with U unit upper triangular and D diagonal, in units
/// of the prior's standard deviations.
///
/// Factored it cannot become indefinite by rounding: D stays positive, whatever the rows are. The plain update of P
/// does not survive f32 [Bierman 1977, ch. V].
///
/// Joints know of each other's friction only through the rigid body they share: were that known, the friction of two
/// joints would be independent, because no row holds both. Friction comes first, and so U says just this: its entries
/// between the friction of two joints are zero after any number of rows, and are neither kept nor gone through.
///
/// U is kept row by row in square room; the diagonal and what lies left of it are kept as zeros. So is a rigid row's, but for
/// what rounding takes off U_ij on its way through millions of rows: that lies at U_ji, and goes in with the next row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UdFilter<const N: usize, const P: usize> {
    friction: [[JointEntries<P>; FRICTION_COLUMNS]; N],
    rigid: [[f32; P]; P],
    diagonal: LinearParameters<N, P>,
}

impl<const N: usize, const P: usize> UdFilter<N, P> {
    /// As uncertain as the prior: `P = I`.
    pub const fn new() -> Self {
        Self {
            friction: [[JointEntries::ZERO; FRICTION_COLUMNS]; N],
            rigid: [[0.0; P]; P],
            diagonal: LinearParameters::filled(1.0),
        }
    }

    /// Back to `P = I`, in place; base parameters whose doubts are correlated are set after it.
    pub fn reset(&mut self) {
        self.friction.as_flattened_mut().fill(JointEntries::ZERO);
        self.rigid.as_flattened_mut().fill(0.0);
        self.diagonal.iter_mut().for_each(|d| *d = 1.0);
    }

    /// Takes the row `phi` of a measurement of `joint` with variance `variance` into the covariance.
    /// [Bierman 1977, ch. V.3]
    ///
    /// ```text
    /// f = Uᵀ φ     v = D f     column by column: α' = α + v_j f_j, α = variance at first
    ///              D_j ← D_j α/α'     λ_j = −f_j/α     U_ij ← U_ij + λ_j b_i     b_i ← b_i + v_j U_ij (old)     b_j = v_j
    /// ```
    ///
    /// Bierman goes column by column. But f needs only the old U, and with f all v and λ are known before the first
    /// entry of U is touched: then the rows of U do not know of each other any more, b_i becomes a running sum along row
    /// i, and a few rows at once share v_j and λ_j in registers. f is cheap, because φ is sparse: of all friction it has
    /// that of its own joint alone, and no link before the joint. So has f, and a column where f is zero stays as it is.
    ///
    /// * `gain` becomes P φ of before; the gain of the filter is that over what is returned
    /// * returns `S = φᵀ P φ + variance`, the variance of the innovation; not a number if there is no such joint
    ///
    /// Assumes: `phi` finite, `variance` positive. What `phi` has for the friction of other joints does not count.
    ///
    /// Cost: `(2 N FRICTION_COLUMNS + P) P` multiply-adds; about an eighth of that for f; `P + FRICTION_COLUMNS` divisions.
    pub fn update(
        &mut self,
        joint: usize,
        phi: &LinearParameters<N, P>,
        variance: f32,
        gain: &mut LinearParameters<N, P>,
    ) -> f32 {
        let Some(friction) = phi.friction.get(joint) else {
            return f32::NAN;
        };
        // f, then λ in its place.
        let mut lambda = self.transposed_times(joint, friction, &phi.rigid);
        let mut v = JointEntries::ZERO;
        let Some(d) = self.diagonal.friction.get_mut(joint) else {
            return f32::NAN;
        };
        let mut alpha = Alpha::new(variance);
        alpha.absorb_all(&mut lambda.own, &mut v.own, d);
        alpha.absorb_all(&mut lambda.rigid, &mut v.rigid, &mut self.diagonal.rigid);
        self.turn(joint, &lambda, &v, gain);
        alpha.value
    }

    /// f = Uᵀ φ, row by row: `f ← f + φ_i U_i`.
    ///
    /// * `friction`, `rigid` what φ has for the friction of `joint` and for the rigid body
    #[inline(never)]
    fn transposed_times(
        &self,
        joint: usize,
        friction: &[f32; FRICTION_COLUMNS],
        rigid: &[f32; P],
    ) -> JointEntries<P> {
        let mut f = JointEntries {
            own: *friction,
            rigid: *rigid,
        };
        if let Some(rows) = self.friction.get(joint) {
            add_rows(&mut f.own, rows, |row| &row.own, friction, 0);
            add_rows(&mut f.rigid, rows, |row| &row.rigid, friction, 0);
        }
        let (rows, rest) = self.rigid.as_chunks::<ROWS>();
        let (weights, rest_weights) = rigid.as_chunks::<ROWS>();
        for (block, (rows, weights)) in rows.iter().zip(weights).enumerate() {
            // Links before the joint do not move with it.
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

    /// The new U, and b as the gain.
    ///
    /// A row's b begins with v at its diagonal. Before, it is zero, and so is U: what lies left of the diagonal stays
    /// zero by itself.
    #[inline(always)]
    fn turn(
        &mut self,
        joint: usize,
        lambda: &JointEntries<P>,
        v: &JointEntries<P>,
        gain: &mut LinearParameters<N, P>,
    ) {
        let own = Turns {
            lambda: &lambda.own,
            v: &v.own,
        };
        let beyond = Turns {
            lambda: &lambda.rigid,
            v: &v.rigid,
        };
        gain.friction.as_flattened_mut().fill(0.0);
        let rows = self.friction.get_mut(joint);
        if let (Some(rows), Some(gain)) = (rows, gain.friction.get_mut(joint)) {
            *gain = own.corner(rows, |row| &mut row.own, 0);
        }
        let (rows, rest) = self.friction.as_flattened_mut().as_chunks_mut::<ROWS>();
        let (gains, rest_gains) = gain.friction.as_flattened_mut().as_chunks_mut::<ROWS>();
        for (rows, gain) in rows.iter_mut().zip(gains) {
            beyond.sweep(rows, |row| &mut row.rigid, 0, gain);
        }
        for (row, gain) in rest.iter_mut().zip(rest_gains) {
            beyond.sweep(from_mut(row), |row| &mut row.rigid, 0, from_mut(gain));
        }
        let (gains, rest_gains) = gain.rigid.as_chunks_mut::<ROWS>();
        let start = gains.len() * ROWS;
        let mut rest = self.rigid.as_mut_slice();
        for (block, gain) in gains.iter_mut().enumerate() {
            let Some((rows, below)) = take(&mut rest).split_first_chunk_mut::<ROWS>() else {
                break;
            };
            *gain = beyond.corner(rows, |row| row, block * ROWS);
            beyond.sweep_compensated(rows, below, block, gain);
            rest = below;
        }
        for (place, (row, gain)) in rest.iter_mut().zip(rest_gains).enumerate() {
            let (row, gain) = (from_mut(row), from_mut(gain));
            *gain = beyond.corner(row, |row| row, start + place);
            beyond.sweep(row, |row| row, start + place + 1, gain);
        }
    }

    /// Variance of friction column `column` of `joint`, in units of the prior's; `None` if there is no such.
    ///
    /// ```text
    /// P_kk = D_k + Σ U_kj² D_j (j > k)
    /// ```
    pub fn friction_variance(&self, joint: usize, column: usize) -> Option<f32> {
        let row = self.friction.get(joint)?.get(column)?;
        let (friction, rigid) = (self.diagonal.friction.get(joint)?, &self.diagonal.rigid);
        let own = *friction.get(column)?;
        Some(own + spread(&row.own, friction) + spread(&row.rigid, rigid))
    }

    /// Variance of base parameter `column`, in units of the prior's; `None` if there is no such. As
    /// [`friction_variance`](Self::friction_variance).
    pub fn rigid_variance(&self, column: usize) -> Option<f32> {
        let own = *self.diagonal.rigid.get(column)?;
        let (row, diagonal) = (self.rigid.get(column)?, &self.diagonal.rigid);
        Some(own + spread(row.get(column..)?, diagonal.get(column..)?))
    }

    /// Variance of what the friction of `joint` contributes to a torque whose row has `phi` for it.
    ///
    /// ```text
    /// φᵀPφ = Σ D_j f_j²,  f = Uᵀφ
    /// ```
    ///
    /// Cost: `(FRICTION_COLUMNS + 2) (FRICTION_COLUMNS + P)` multiply-adds.
    pub(super) fn friction_doubt(&self, joint: usize, phi: &[f32; FRICTION_COLUMNS]) -> f32 {
        let f = self.transposed_times(joint, phi, &[0.0; P]);
        let Some(diagonal) = self.diagonal.friction.get(joint) else {
            return 0.0;
        };
        let own = f.own.iter().zip(diagonal);
        let rigid = f.rigid.iter().zip(&self.diagonal.rigid);
        let mut variance = 0.0;
        for (f, d) in own.chain(rigid) {
            variance += d * f * f;
        }
        variance
    }

    /// P φ for a row that has only friction of `joint`, without taking the row in.
    ///
    /// ```text
    /// f = Uᵀφ     v = D f     P φ = U v     φᵀPφ = vᵀf
    /// ```
    ///
    /// * `gain` becomes P φ, in units of the prior's standard deviations
    /// * returns φᵀPφ; 0 if there is no such joint
    ///
    /// Cost: `(N FRICTION_COLUMNS + P / 2) P` multiply-adds, no division.
    pub(super) fn friction_gain(
        &self,
        joint: usize,
        phi: &[f32; FRICTION_COLUMNS],
        gain: &mut LinearParameters<N, P>,
    ) -> f32 {
        let f = self.transposed_times(joint, phi, &[0.0; P]);
        let mut v = f;
        let Some(diagonal) = self.diagonal.friction.get(joint) else {
            return 0.0;
        };
        let scale = |v: &mut [f32], d: &[f32]| v.iter_mut().zip(d).for_each(|(v, d)| *v *= d);
        scale(&mut v.own, diagonal);
        scale(&mut v.rigid, &self.diagonal.rigid);
        for (place, (rows, gain)) in self.friction.iter().zip(&mut gain.friction).enumerate() {
            for (row, gain) in rows.iter().zip(gain.iter_mut()) {
                *gain = dot(&row.rigid, &v.rigid);
                if place == joint {
                    *gain += dot(&row.own, &v.own);
                }
            }
            if place == joint {
                gain.iter_mut().zip(&v.own).for_each(|(gain, v)| *gain += v);
            }
        }
        // What lies left of the diagonal is the compensation of the rows below, not a part of U.
        for (i, (row, gain)) in self.rigid.iter().zip(&mut gain.rigid).enumerate() {
            if let (Some([first, rest @ ..]), Some(row)) = (v.rigid.get(i..), row.get(i + 1..)) {
                *gain = first + dot(row, rest);
            }
        }
        dot(&v.own, &f.own) + dot(&v.rigid, &f.rigid)
    }

    /// Adds `noise` to the variance of friction column `column` of `joint`. [Agee and Turner 1972]
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
            let before = *d;
            let after = before + c * a_j * a_j;
            let inverse = 1.0 / after;
            *d = after;
            let step = c * a_j * inverse;
            for (row, a) in rows.iter_mut().zip(direction.iter_mut()).take(j) {
                if let Some(u) = row.own.get_mut(j) {
                    *a -= a_j * *u;
                    *u += step * *a;
                }
            }
            c *= before * inverse;
        }
    }

    /// Sets the variances of the base parameters, in units of the prior's. Assumes: as after a reset, no correlations.
    pub(super) fn set_rigid(&mut self, variances: &[f32; P]) {
        self.diagonal.rigid = *variances;
    }

    /// Adds a doubt about the base parameters that is one number times `direction`, in units of the prior's standard
    /// deviations; leaves nothing of use in `direction`. As [`add_process_noise`](Self::add_process_noise), with `c = 1` and in any
    /// direction.
    ///
    /// Cost: `2 j` multiply-adds for each column j that the direction reaches, `P²` at most.
    pub(super) fn add_rigid(&mut self, direction: &mut [f32; P]) {
        let mut c = 1.0;
        for j in (0..P).rev() {
            let (Some(&a_j), Some(d)) = (direction.get(j), self.diagonal.rigid.get_mut(j)) else {
                continue;
            };
            if a_j == 0.0 {
                continue;
            }
            let before = *d;
            let after = before + c * a_j * a_j;
            let inverse = 1.0 / after;
            *d = after;
            let step = c * a_j * inverse;
            for (row, a) in self.rigid.iter_mut().zip(direction.iter_mut()).take(j) {
                if let Some(u) = row.get_mut(j) {
                    *a -= a_j * *u;
                    *u += step * *a;
                }
            }
            c *= before * inverse;
        }
    }

    /// D, friction first: all positive, or the covariance is none.
    pub fn diagonal(&self) -> &LinearParameters<N, P> {
        &self.diagonal
    }
}

impl<const N: usize, const P: usize> Default for UdFilter<N, P> {
    fn default() -> Self {
        Self::new()
    }
}

/// The sum that grows from the variance of the measurement to that of the innovation, with its reciprocal.
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

    /// Takes f of some columns in, `f` becomes λ.
    #[inline(always)]
    fn absorb_all(&mut self, f: &mut [f32], v: &mut [f32], d: &mut [f32]) {
        for ((f, v), d) in f.iter_mut().zip(v).zip(d) {
            (*v, *f) = self.absorb(*f, d);
        }
    }

    /// Takes `f` of one column in, shrinks its `d`; returns `v` and `λ = −f/α`.
    ///
    /// `D α/α' = D − v²/α'`. The product would leak: `α · 1/α` is often rounded to less than one and never to more, so that
    /// every row takes a little off all of D, even off what it does not touch.
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

/// Keeps D positive whatever the rows are: in the worst row, all but 2⁻²¹ of it is taken off, which is more than rounding
/// can add.
const ALMOST_ONE: f32 = 1.0 - 4.0 * f32::EPSILON;

/// Σ u² d.
fn spread(row: &[f32], diagonal: &[f32]) -> f32 {
    let mut sum = 0.0;
    for (u, d) in row.iter().zip(diagonal) {
        sum += u * u * d;
    }
    sum
}

#[inline(always)]
fn set(values: &mut [f32], index: usize, value: f32) {
    if let Some(slot) = values.get_mut(index) {
        *slot = value;
    }
}

/// Entries of a sum worked on at once: their loads and sums do not wait for each other.
const LANES: usize = 4;

/// Σ a b, in four sums that are added at the end.
#[inline(always)]
pub(super) fn dot(a: &[f32], b: &[f32]) -> f32 {
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
    let mut sums = [0.0; LANES];
    for ([a0, a1, a2, a3], [b0, b1, b2, b3]) in a.iter().zip(b) {
        sums[0] += a0 * b0;
        sums[1] += a1 * b1;
        sums[2] += a2 * b2;
        sums[3] += a3 * b3;
    }
    let mut rest = 0.0;
    for (a, b) in a_rest.iter().zip(b_rest) {
        rest += a * b;
    }
    (sums[0] + sums[1]) + (sums[2] + sums[3]) + rest
}

#[cfg(test)]
mod tests;
