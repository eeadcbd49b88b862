//! Loops over U, several rows at once: half of the time of a learning step.

use core::hint::black_box;

/// Unrolled loop `each_row!(K < W { body })` over K = 0 … W − 1, with `K` a constant in the body.
///
/// Written out, the running sums of the rows stay in registers even where the compiler does not unroll. A larger W does not
/// compile.
macro_rules! each_row {
    ($k:ident < $w:ident $body:block) => {
        each_row!($k < $w $body, 0 1 2 3 4 5 6 7 8 9 10 11)
    };
    ($k:ident < $w:ident $body:block, $($row:literal)*) => {
        const { assert!($w <= [$($row),*].len()) };
        $({
            const $k: usize = $row;
            if $k < $w $body
        })*
    };
}

/// Loop `each_column!(j in start, end { body })`, unrolled by four: loop overhead costs as much as a column.
macro_rules! each_column {
    ($j:ident in $start:ident, $end:ident $body:block) => {
        let mut next = $start;
        while next + 4 <= $end {
            each_column!(@ $j, next, $body, 0 1 2 3);
            next += 4;
        }
        while next < $end {
            each_column!(@ $j, next, $body, 0);
            next += 1;
        }
    };
    (@ $j:ident, $next:ident, $body:block, $($place:literal)*) => {
        $({
            let $j = $next + $place;
            $body
        })*
    };
}

/// Rows of U updated at once: as many as the registers hold with their running sums.
pub(super) const ROWS: usize = 4;

/// λ and v of several columns.
pub(super) struct ColumnUpdates<'a> {
    pub(super) lambda: &'a [f32],
    pub(super) v: &'a [f32],
}

impl ColumnUpdates<'_> {
    /// Update of the columns from `start` on: `U_ij ← U_ij + λ_j b_i`, `b_i ← b_i + v_j U_ij` (old U).
    ///
    /// A product v_j U_ij is added one turn later: in one basic block the compiler joins product and sum, which takes the
    /// Cortex-M4 three cycles instead of two. The order of the sums stays.
    ///
    /// * `part` entries of a row that belong to these columns
    #[inline(always)]
    pub(super) fn sweep<R, const W: usize>(
        &self,
        rows: &mut [R; W],
        part: impl Fn(&mut R) -> &mut [f32],
        start: usize,
        b: &mut [f32; W],
    ) {
        let mut sums = *b;
        // −0 + x is x.
        let mut products = [-0.0; W];
        for j in start..self.v.len() {
            let (Some(&lambda), Some(&v)) = (self.lambda.get(j), self.v.get(j)) else {
                break;
            };
            let mut before = [0.0; W];
            each_row!(K < W {
                if let Some(u) = rows.get_mut(K).and_then(|row| part(row).get_mut(j)) {
                    before[K] = *u;
                }
            });
            loaded();
            each_row!(K < W {
                sums[K] += products[K];
            });
            each_row!(K < W {
                products[K] = v * before[K];
                if let Some(u) = rows.get_mut(K).and_then(|row| part(row).get_mut(j)) {
                    *u = before[K] + lambda * sums[K];
                }
            });
        }
        each_row!(K < W {
            b[K] = sums[K] + products[K];
        });
    }

    /// Update as [`sweep`](Self::sweep) of block `block` of the rigid rows, in compensated sums [Kahan 1965].
    ///
    /// * `below` the rows after the block; their lower triangles hold the compensation. The last `P % ROWS` columns are not
    ///   compensated
    /// * `first` block of columns before which λ and v are zero
    #[inline(always)]
    pub(super) fn sweep_compensated<const P: usize>(
        &self,
        rows: &mut [[f32; P]; ROWS],
        below: &mut [[f32; P]],
        block: usize,
        first: usize,
        b: &mut [f32; ROWS],
    ) {
        let mut sums = *b;
        let [(lambda, _), (v, _)] = [self.lambda, self.v].map(<[f32]>::as_chunks::<ROWS>);
        let from = first.max(block + 1);
        let turns = lambda.iter().zip(v).enumerate().skip(from);
        let (below, _) = below.as_chunks_mut::<ROWS>();
        let below = below.iter_mut().skip(from - block - 1);
        for ((place, (lambda, v)), below) in turns.zip(below) {
            each_row!(C < ROWS {
                let compensation = below.get_mut(C).and_then(|row| row.as_chunks_mut::<ROWS>().0.get_mut(block));
                if let (Some(&lambda), Some(&v), Some(compensation)) = (lambda.get(C), v.get(C), compensation) {
                    update_column_compensated(rows, (place, C), compensation, &mut sums, [lambda, v]);
                }
            });
        }
        *b = sums;
        self.sweep(rows, |row| row, P / ROWS * ROWS, b);
    }

    /// Update of the diagonal block of the rows, whose first column is `start`; returns b after it.
    #[inline(always)]
    pub(super) fn corner<R, const W: usize>(
        &self,
        rows: &mut [R; W],
        part: impl Fn(&mut R) -> &mut [f32],
        start: usize,
    ) -> [f32; W] {
        let mut sums = [0.0; W];
        each_row!(D < W {
            let j = start + D;
            if let (Some(lambda), Some(v)) = (self.lambda.get(j), self.v.get(j)) {
                each_row!(K < D {
                    let u = rows.get_mut(K).and_then(|row| part(row).get_mut(j));
                    if let (Some(u), Some(b)) = (u, sums.get_mut(K)) {
                        let before = *u;
                        *u = before + lambda * *b;
                        *b += v * before;
                    }
                });
                set(&mut sums, D, *v);
            }
        });
        sums
    }
}

/// Weighted sum of rows, `sum ← sum + Σ weight · row`, from entry `start` on.
#[inline(always)]
pub(super) fn add_rows<R, const W: usize>(
    sum: &mut [f32],
    rows: &[R; W],
    part: impl Fn(&R) -> &[f32],
    weights: &[f32; W],
    start: usize,
) {
    let end = sum.len();
    each_column!(j in start, end {
        if let Some(sum) = sum.get_mut(j) {
            each_row!(K < W {
                let u = rows.get(K).and_then(|row| part(row).get(j));
                if let (Some(u), Some(weight)) = (u, weights.get(K)) {
                    *sum += weight * u;
                }
            });
        }
    });
}

/// Update of the entries of one column, at `place` of all rows, with their rounding errors carried in `compensation`.
#[inline(always)]
fn update_column_compensated<const P: usize, const W: usize>(
    rows: &mut [[f32; P]; W],
    place: (usize, usize),
    compensation: &mut [f32; W],
    sums: &mut [f32; W],
    [lambda, v]: [f32; 2],
) {
    let mut before = [0.0; W];
    each_row!(K < W {
        if let Some(u) = rows.get_mut(K).and_then(|row| entry(row, place.0, place.1)) {
            before[K] = *u;
        }
    });
    let mut steps = *compensation;
    loaded();
    each_row!(K < W {
        steps[K] += lambda * sums[K];
        let after = before[K] + steps[K];
        steps[K] -= after - before[K];
        sums[K] += v * before[K];
        if let Some(u) = rows.get_mut(K).and_then(|row| entry(row, place.0, place.1)) {
            *u = after;
        }
    });
    *compensation = steps;
}

/// Barrier that keeps earlier loads earlier: loads one after the other take a Cortex-M4 one cycle each, loads between
/// multiplications two. It costs nothing.
#[inline(always)]
fn loaded() {
    black_box(());
}

/// Assignment of `value` to an entry, if it exists.
#[inline(always)]
pub(super) fn set(values: &mut [f32], index: usize, value: f32) {
    if let Some(slot) = values.get_mut(index) {
        *slot = value;
    }
}

#[inline(always)]
fn entry(row: &mut [f32], block: usize, place: usize) -> Option<&mut f32> {
    row.as_chunks_mut::<ROWS>().0.get_mut(block)?.get_mut(place)
}
