use super::bp::{loaded, opaque};
use core::array;
use nalgebra::{SMatrix, SVector};

/// `W ← W − rate · delta sourceᵀ` and `b ← b − rate · delta`, in blocks of eight and six rows whose deltas stay in registers
/// while the columns go by.
#[inline]
pub(super) fn descend<const R: usize, const C: usize>(
    weights: &mut SMatrix<f32, R, C>,
    bias: &mut SVector<f32, R>,
    source: &SVector<f32, C>,
    delta: &SVector<f32, R>,
    rate: f32,
) {
    let columns = opaque(&mut weights.data.0, R * C);
    let source: &[f32; C] = opaque(&source.data.0[0], R * C);
    let (eights, rest) = delta.as_slice().as_chunks::<8>();
    let (bias_eights, bias_rest) = bias.as_mut_slice().as_chunks_mut::<8>();
    for (index, (delta, bias)) in eights.iter().zip(bias_eights).enumerate() {
        descend_block(columns, bias, source, delta, rate, |column| {
            column.as_chunks_mut::<8>().0.get_mut(index)
        });
    }
    let (sixes, rest) = rest.as_chunks::<6>();
    let (bias_sixes, bias_rest) = bias_rest.as_chunks_mut::<6>();
    for (delta, bias) in sixes.iter().zip(bias_sixes) {
        descend_block(columns, bias, source, delta, rate, |column| {
            column.as_chunks_mut::<8>().1.first_chunk_mut()
        });
    }
    let from = R - rest.len();
    for (row, (delta, bias)) in rest.iter().zip(bias_rest).enumerate() {
        descend_block(
            columns,
            array::from_mut(bias),
            source,
            &[*delta],
            rate,
            |column| column.get_mut(from + row..)?.first_chunk_mut(),
        );
    }
}

/// One block of rows, four columns a turn.
#[inline(always)]
fn descend_block<const B: usize, const R: usize, const C: usize>(
    columns: &mut [[f32; R]; C],
    bias: &mut [f32; B],
    source: &[f32; C],
    delta: &[f32; B],
    rate: f32,
    rows: impl Fn(&mut [f32; R]) -> Option<&mut [f32; B]>,
) {
    let delta = *delta;
    for (bias, delta) in bias.iter_mut().zip(&delta) {
        *bias -= rate * delta;
    }
    let (fours, last) = columns.as_chunks_mut::<4>();
    let (source_fours, source_last) = source.as_chunks::<4>();
    for ([a, b, c, d], [x_a, x_b, x_c, x_d]) in fours.iter_mut().zip(source_fours) {
        descend_column(rows(a), &delta, rate, x_a, R * C);
        descend_column(rows(b), &delta, rate, x_b, R * C);
        descend_column(rows(c), &delta, rate, x_c, R * C);
        descend_column(rows(d), &delta, rate, x_d, R * C);
    }
    for (column, source) in last.iter_mut().zip(source_last) {
        descend_column(rows(column), &delta, rate, source, R * C);
    }
}

/// One column of a block of rows, in a matrix of `entries`.
#[inline(always)]
fn descend_column<const B: usize>(
    weights: Option<&mut [f32; B]>,
    delta: &[f32; B],
    rate: f32,
    source: &f32,
    entries: usize,
) {
    let Some(weights) = weights else {
        return;
    };
    let mut moved = *weights;
    loaded(entries);
    let scale = rate * source;
    for (weight, delta) in moved.iter_mut().zip(delta) {
        *weight -= scale * delta;
    }
    *weights = moved;
    loaded(entries);
}
