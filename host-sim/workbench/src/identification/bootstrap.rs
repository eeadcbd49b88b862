//! Confidence intervals by resampling blocks of rows [Künsch 1989]: neighbouring errors are correlated, blocks hardly.

use super::columns::Layout;
use super::dataset::SampleRow;
use super::methods::MethodName;
use super::normal::solve;
use super::problem::{MethodResult, TrainingData};
use nalgebra::{DMatrix, DVector};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Number of draws.
const DRAWS: usize = 200;
/// Number of blocks of training rows.
const BLOCKS: usize = 40;
/// Most rows of the sample that are used.
const ROWS: usize = 8000;

/// Scores of 200 draws of all blocks with replacement; `score` takes the numbers of a draw.
pub(super) fn resample<T>(
    blocks: usize,
    seed: u64,
    mut score: impl FnMut(&[usize]) -> Option<T>,
) -> Vec<T> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut draw = vec![0; blocks];
    let mut out = Vec::with_capacity(DRAWS);
    for _ in 0..DRAWS {
        for place in &mut draw {
            *place = random.random_range(0..blocks);
        }
        out.extend(score(&draw));
    }
    out
}

/// The middle 95 % of `values`; `None` of fewer than two.
pub(super) fn middle(values: impl Iterator<Item = f64>) -> Option<[f64; 2]> {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    let last = values.len().checked_sub(1).filter(|last| *last > 0)?;
    Some([0.025, 0.975].map(|share| values[(last as f64 * share).round() as usize]))
}

/// 95 % intervals of the parameters of a least-squares method; `None` for others.
pub(super) fn parameter_intervals<const N: usize>(
    layout: &Layout<N>,
    data: &TrainingData<'_, N>,
    result: &MethodResult<N>,
    seed: u64,
) -> Option<Vec<[f64; 2]>> {
    let robust = match result.name {
        MethodName::Ols | MethodName::Wls => false,
        MethodName::Irls => true,
        _ => return None,
    };
    let fit = result.fit.as_ref()?;
    let sigma = match result.name {
        MethodName::Ols => [1.0; N],
        _ => fit.sigma,
    };
    let stride = data.sample.len().div_ceil(ROWS).max(1);
    let rows: Vec<&SampleRow<N>> = data.sample.iter().copied().step_by(stride).collect();
    let length = rows.len().div_ceil(BLOCKS).max(1);
    let blocks: Vec<_> = rows
        .chunks(length)
        .map(|block| {
            let own = TrainingData::of(layout, block.to_vec());
            let robust = robust.then(|| own.robust_sums(layout, &fit.theta, &sigma));
            robust.unwrap_or(own.sums.all).weighted(layout, &sigma)
        })
        .collect();
    let size = layout.parameters.len();
    let draws = resample(blocks.len(), seed, |draw| {
        let (mut gram, mut moment) = (DMatrix::zeros(size, size), DVector::zeros(size));
        for &place in draw {
            gram += &blocks[place].0;
            moment += &blocks[place].1;
        }
        // A draw may miss the blocks which show a parameter.
        Some(solve(&gram, &moment)?.0)
    });
    let values = |place| draws.iter().map(move |theta: &DVector<f64>| theta[place]);
    (0..size).map(|place| middle(values(place))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn interval_of_a_mean_spans_two_deviations_each_way() {
        // 400 blocks of uniform numbers: the mean has a deviation of 1 / sqrt(12 · 400).
        let mut random = ChaCha8Rng::seed_from_u64(2);
        let values: Vec<f64> = (0..400).map(|_| random.random_range(0.0..1.0)).collect();
        let means = resample(values.len(), 1, |draw| {
            Some(draw.iter().map(|&k| values[k]).sum::<f64>() / draw.len() as f64)
        });
        let [low, high] = middle(means.into_iter()).expect("many draws");
        let wide = 2.0 * 1.96 / (12.0_f64 * 400.0).sqrt();
        assert!(
            (0.75..1.25).contains(&((high - low) / wide)),
            "{low} {high}"
        );
        assert!(low < 0.5 && 0.5 < high);
    }
}
