use super::stacked::Stacked;
use crate::dynamics::FRICTION_COLUMNS;

/// Friction entries of all joints.
type Friction<const N: usize> = [[f32; FRICTION_COLUMNS]; N];

/// Covariance of the linear parameters in factors, `P = U D Uᵀ` with U unit upper triangular and D diagonal, in units
/// of the prior's standard deviations.
///
/// Factored it cannot become indefinite by rounding: D stays positive, whatever the rows are. The plain update of P
/// does not survive f32 [Bierman 1977, ch. V]. Friction comes first, so that noise on it touches only the first columns.
///
/// U is kept column by column in square room; the diagonal and what lies below it are kept as zeros.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UdFilter<const N: usize, const P: usize> {
    friction: [[Friction<N>; FRICTION_COLUMNS]; N],
    rigid: [Stacked<N, P>; P],
    diagonal: Stacked<N, P>,
}

impl<const N: usize, const P: usize> UdFilter<N, P> {
    /// As uncertain as the prior: `P = I`.
    pub const fn new() -> Self {
        Self {
            friction: [[[[0.0; FRICTION_COLUMNS]; N]; FRICTION_COLUMNS]; N],
            rigid: [Stacked::filled(0.0); P],
            diagonal: Stacked::filled(1.0),
        }
    }

    /// Back to `P = I`, in place.
    pub fn reset(&mut self) {
        for column in self.friction.as_flattened_mut() {
            column.as_flattened_mut().fill(0.0);
        }
        for column in &mut self.rigid {
            column.iter_mut().for_each(|u| *u = 0.0);
        }
        self.diagonal.iter_mut().for_each(|d| *d = 1.0);
    }

    /// Takes the row `phi` of a measurement with variance `variance` into the covariance. [Bierman 1977, ch. V.3]
    ///
    /// ```text
    /// column by column:  f = φ_j + Σ U_ij φ_i (i < j)        v = D_j f        α' = α + v f,  α = variance at first
    ///                    D_j ← D_j α/α'    U_ij ← U_ij − (f/α) b_i    b_i ← b_i + v U_ij (old)    b_j = v
    /// ```
    ///
    /// * `gain` becomes P φ of before; the gain of the filter is that over what is returned
    /// * returns `S = φᵀ P φ + variance`, the variance of the innovation
    ///
    /// Assumes: `phi` finite, `variance` positive.
    ///
    /// Cost: `3/2 n²` multiply-adds and n divisions, `n = P + N · FRICTION_COLUMNS`.
    pub fn update(&mut self, phi: &Stacked<N, P>, variance: f32, gain: &mut Stacked<N, P>) -> f32 {
        let mut alpha = Alpha::new(variance);
        *gain = Stacked::filled(0.0);
        let phi_friction = phi.friction.as_flattened();
        let gain_friction = gain.friction.as_flattened_mut();
        let columns = self.friction.as_flattened_mut().iter_mut();
        let diagonal = self.diagonal.friction.as_flattened_mut();
        for (j, (column, d)) in columns.zip(diagonal).enumerate() {
            let (Some(&phi_j), Some(above)) = (phi_friction.get(j), phi_friction.get(..j)) else {
                continue;
            };
            let column = above_diagonal(column.as_flattened_mut(), j);
            let f = phi_j + dot(column, above);
            let (v, lambda) = alpha.absorb(f, d);
            turn(column, above_diagonal(gain_friction, j), v, lambda);
            set(gain_friction, j, v);
        }
        let columns = self.rigid.iter_mut().zip(&mut self.diagonal.rigid);
        for (j, ((column, d), &phi_j)) in columns.zip(&phi.rigid).enumerate() {
            let friction = column.friction.as_flattened_mut();
            // Up to whole lanes: what lies below the diagonal is zero, in U as in the gain, and stays so.
            let end = j.next_multiple_of(LANES).min(P);
            let rigid = above_diagonal(&mut column.rigid, end);
            let above = phi.rigid.get(..end).unwrap_or_default();
            let f = phi_j + dot(friction, phi_friction) + dot(rigid, above);
            let (v, lambda) = alpha.absorb(f, d);
            turn(friction, gain_friction, v, lambda);
            turn(rigid, above_diagonal(&mut gain.rigid, end), v, lambda);
            set(&mut gain.rigid, j, v);
        }
        alpha.value
    }

    /// Variance of the friction columns of `joint`, in units of the prior's; `None` if there is no such joint.
    ///
    /// ```text
    /// P_kk = D_k + Σ U_kj² D_j (j > k)
    /// ```
    pub fn friction_variance(&self, joint: usize) -> Option<[f32; FRICTION_COLUMNS]> {
        let mut variance = *self.diagonal.friction.get(joint)?;
        let friction = self.friction.as_flattened().iter();
        let rigid = self.rigid.iter().map(|column| &column.friction);
        for (column, d) in friction.chain(rigid).zip(self.diagonal.iter()) {
            for (variance, u) in variance.iter_mut().zip(column.get(joint)?) {
                *variance += u * u * d;
            }
        }
        Some(variance)
    }

    /// Adds `noise` to the variance of friction column `column` of `joint`. [Agee and Turner 1972]
    ///
    /// ```text
    /// P + c e eᵀ, column by column from e's down to the first:
    ///   D_j' = D_j + c a_j²     a_i ← a_i − a_j U_ij     U_ij ← U_ij + (c a_j / D_j') a_i     c ← c D_j / D_j'
    /// ```
    ///
    /// Cost: `k²` multiply-adds, `k = joint · FRICTION_COLUMNS + column`.
    pub fn add_noise(&mut self, joint: usize, column: usize, noise: f32) {
        let mut direction: Friction<N> = [[0.0; FRICTION_COLUMNS]; N];
        let direction = direction.as_flattened_mut();
        let last = joint * FRICTION_COLUMNS + column;
        set(direction, last, 1.0);
        let mut c = noise;
        let columns = self.friction.as_flattened_mut().iter_mut();
        let diagonal = self.diagonal.friction.as_flattened_mut().iter_mut();
        let pairs = columns.zip(diagonal).enumerate().take(last + 1);
        for (j, (column, d)) in pairs.rev() {
            let a_j = direction.get(j).copied().unwrap_or(0.0);
            let before = *d;
            let after = before + c * a_j * a_j;
            let inverse = 1.0 / after;
            *d = after;
            let step = c * a_j * inverse;
            let above = column.as_flattened_mut().iter_mut().take(j);
            for (u, a) in above.zip(direction.iter_mut()) {
                *a -= a_j * *u;
                *u += step * *a;
            }
            c *= before * inverse;
        }
    }

    /// D, friction first: all positive, or the covariance is none.
    pub fn diagonal(&self) -> &Stacked<N, P> {
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
            inverse: 1.0 / variance,
        }
    }

    /// Takes `f` of one column in, shrinks its `d`; returns `v` and `−f/α`.
    #[inline(always)]
    fn absorb(&mut self, f: f32, d: &mut f32) -> (f32, f32) {
        let v = *d * f;
        let lambda = -f * self.inverse;
        let grown = self.value + v * f;
        self.inverse = 1.0 / grown;
        *d *= self.value * self.inverse;
        self.value = grown;
        (v, lambda)
    }
}

#[inline(always)]
fn above_diagonal(column: &mut [f32], end: usize) -> &mut [f32] {
    column.get_mut(..end).unwrap_or_default()
}

#[inline(always)]
fn set(values: &mut [f32], index: usize, value: f32) {
    if let Some(slot) = values.get_mut(index) {
        *slot = value;
    }
}

/// Entries worked on at once: their loads and sums do not wait for each other.
const LANES: usize = 4;

/// Σ a b, in four sums that are added at the end.
#[inline(always)]
pub(super) fn dot(a: &[f32], b: &[f32]) -> f32 {
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
    let mut sums = [0.0; LANES];
    for (a, b) in a.iter().zip(b) {
        for (sum, (a, b)) in sums.iter_mut().zip(a.iter().zip(b)) {
            *sum += a * b;
        }
    }
    let mut rest = 0.0;
    for (a, b) in a_rest.iter().zip(b_rest) {
        rest += a * b;
    }
    (sums[0] + sums[1]) + (sums[2] + sums[3]) + rest
}

/// `u ← u + lambda b`, `b ← b + v u` of before.
#[inline(always)]
fn turn(column: &mut [f32], gain: &mut [f32], v: f32, lambda: f32) {
    let pair = |(u, b): (&mut f32, &mut f32)| {
        let before = *u;
        *u = before + lambda * *b;
        *b += v * before;
    };
    let (column, column_rest) = column.as_chunks_mut::<LANES>();
    let (gain, gain_rest) = gain.as_chunks_mut::<LANES>();
    for (column, gain) in column.iter_mut().zip(gain) {
        column.iter_mut().zip(gain).for_each(pair);
    }
    column_rest.iter_mut().zip(gain_rest).for_each(pair);
}
