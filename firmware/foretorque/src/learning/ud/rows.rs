//! U, a few rows at once: the loops in which a lesson spends half of its time.

use super::set;

/// `each_row!(K < W { body })` runs the body for row K = 0 to W − 1, each time with `K` a constant: written out, the rows'
/// running sums stay in registers whether the compiler unrolls loops or not. More rows than are written out do not compile.
macro_rules! each_row {
    ($k:ident < $w:ident $body:block) => {
        each_row!($k < $w $body, 0 1 2 3 4 5 6 7)
    };
    ($k:ident < $w:ident $body:block, $($row:literal)*) => {
        const { assert!($w <= [$($row),*].len()) };
        $({
            const $k: usize = $row;
            if $k < $w $body
        })*
    };
}

/// `each_column!(j in start, end { body })` runs the body for each column, written out by fours: counting costs as much as a
/// column's multiply-adds.
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

/// Rows of U worked on at once: their running sums fit the registers beside what they share.
pub(super) const ROWS: usize = 4;

/// λ and v of some columns.
pub(super) struct Turns<'a> {
    pub(super) lambda: &'a [f32],
    pub(super) v: &'a [f32],
}

impl Turns<'_> {
    /// The columns from `start` on: `U_ij ← U_ij + λ_j b_i`, `b_i ← b_i + v_j U_ij` of before.
    ///
    /// * `part` the entries of a row that these columns are
    #[inline(always)]
    pub(super) fn sweep<R, const W: usize>(
        &self,
        rows: &mut [R; W],
        part: impl Fn(&mut R) -> &mut [f32],
        start: usize,
        b: &mut [f32; W],
    ) {
        let (mut sums, end) = (*b, self.v.len());
        each_column!(j in start, end {
            if let (Some(lambda), Some(v)) = (self.lambda.get(j), self.v.get(j)) {
                each_row!(K < W {
                    let u = rows.get_mut(K).and_then(|row| part(row).get_mut(j));
                    if let (Some(u), Some(b)) = (u, sums.get_mut(K)) {
                        turn_one(u, b, *lambda, *v);
                    }
                });
            }
        });
        *b = sums;
    }

    /// As [`sweep`](Self::sweep) with rigid rows, number `block` of their kind, in compensated sums [Kahan 1965].
    ///
    /// * `below` the rows behind them, left of whose diagonals lies what rounding has taken off. Columns that do not make
    ///   another block at the end go without
    #[inline(always)]
    pub(super) fn sweep_compensated<const P: usize>(
        &self,
        rows: &mut [[f32; P]; ROWS],
        below: &mut [[f32; P]],
        block: usize,
        b: &mut [f32; ROWS],
    ) {
        let mut sums = *b;
        let [(lambda, _), (v, _)] = [self.lambda, self.v].map(<[f32]>::as_chunks::<ROWS>);
        let turns = lambda.iter().zip(v).enumerate().skip(block + 1);
        let (below, _) = below.as_chunks_mut::<ROWS>();
        for ((place, (lambda, v)), below) in turns.zip(below) {
            each_row!(C < ROWS {
                if let (Some(lambda), Some(v)) = (lambda.get(C), v.get(C)) {
                    each_row!(K < ROWS {
                        let u = rows.get_mut(K).and_then(|row| entry(row, place, C));
                        let lost = below.get_mut(C).and_then(|row| entry(row, block, K));
                        if let (Some(u), Some(lost), Some(b)) = (u, lost, sums.get_mut(K)) {
                            turn_one_compensated(u, lost, b, *lambda, *v);
                        }
                    });
                }
            });
        }
        *b = sums;
        self.sweep(rows, |row| row, P / ROWS * ROWS, b);
    }

    /// The columns of the rows' own diagonals, the first of them at `start`; returns b behind them.
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
                        turn_one(u, b, *lambda, *v);
                    }
                });
                set(&mut sums, D, *v);
            }
        });
        sums
    }
}

/// `sum ← sum + Σ weight · row`, from entry `start` on.
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

/// One entry of U, and the running sum of its row.
#[inline(always)]
fn turn_one(u: &mut f32, b: &mut f32, lambda: f32, v: f32) {
    let before = *u;
    *u = before + lambda * *b;
    *b += v * before;
}

/// The same, with what rounding takes off the entry kept in `lost` for the next time.
#[inline(always)]
fn turn_one_compensated(u: &mut f32, lost: &mut f32, b: &mut f32, lambda: f32, v: f32) {
    let before = *u;
    let step = *lost + lambda * *b;
    let after = before + step;
    *lost = step - (after - before);
    *u = after;
    *b += v * before;
}

/// Entry `place` of block `block` of a row.
#[inline(always)]
fn entry(row: &mut [f32], block: usize, place: usize) -> Option<&mut f32> {
    row.as_chunks_mut::<ROWS>().0.get_mut(block)?.get_mut(place)
}
