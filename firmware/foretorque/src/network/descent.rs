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

/// One block of rows, two columns at a time.
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
    let (pairs, last) = columns.as_chunks_mut::<2>();
    let (source_pairs, source_last) = source.as_chunks::<2>();
    for ([one, two], [source_one, source_two]) in pairs.iter_mut().zip(source_pairs) {
        if let (Some(one), Some(two)) = (rows(one), rows(two)) {
            descend_column(one, &delta, rate, source_one, R * C);
            descend_column(two, &delta, rate, source_two, R * C);
        }
    }
    for (column, source) in last.iter_mut().zip(source_last) {
        if let Some(weights) = rows(column) {
            descend_column(weights, &delta, rate, source, R * C);
        }
    }
}

/// One column of a block of rows, in a matrix of `entries`.
#[inline(always)]
fn descend_column<const B: usize>(
    weights: &mut [f32; B],
    delta: &[f32; B],
    rate: f32,
    source: &f32,
    entries: usize,
) {
    let mut moved = *weights;
    loaded(entries);
    let scale = rate * source;
    for (weight, delta) in moved.iter_mut().zip(delta) {
        *weight -= scale * delta;
    }
    *weights = moved;
    loaded(entries);
}
