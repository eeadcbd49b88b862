//! Confidence intervals by resampling blocks of rows [Künsch 1989]: neighbouring errors belong together, blocks hardly.

use super::columns::Layout;
use super::dataset::SampleRow;
use super::methods::MethodName;
use super::normal::solve;
use super::problem::{MethodResult, TrainingData};
use nalgebra::{DMatrix, DVector};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Times the blocks are drawn.
const DRAWS: usize = 200;
/// Blocks the training rows are cut into.
const BLOCKS: usize = 40;
/// Rows of the sample that are used at most.
const ROWS: usize = 8000;

/// Draws as many blocks as there are, with replacement, `DRAWS` times; hands the numbers of each draw to `score`.
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
pub(super) fn middle(values: &mut [f64]) -> Option<[f64; 2]> {
    values.sort_by(f64::total_cmp);
    let at = |share: f64| values.get(((values.len() - 1) as f64 * share).round() as usize);
    if values.len() < 2 {
        return None;
    }
    Some([*at(0.025)?, *at(0.975)?])
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
            let mut own = TrainingData::of(layout, block.to_vec());
            if robust {
                own.weigh(layout, &fit.theta, &sigma);
                return own.clean_sums.weighted(layout, &sigma);
            }
            own.sums.weighted(layout, &sigma)
        })
        .collect();
    let size = layout.parameters.len();
    let draws = resample(blocks.len(), seed, |draw| {
        let (mut gram, mut moment) = (DMatrix::zeros(size, size), DVector::zeros(size));
        for &place in draw {
            gram += &blocks[place].0;
            moment += &blocks[place].1;
        }
        // A draw that misses the blocks which show a parameter says nothing about it.
        Some(solve(&gram, &moment)?.0)
    });
    (0..size)
        .map(|place| middle(&mut draws.iter().map(|theta| theta[place]).collect::<Vec<_>>()))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_interval_of_a_mean_is_two_deviations_wide_each_way() {
        // 400 blocks of uniform numbers: the mean has a deviation of 1 / sqrt(12 · 400).
        let mut random = ChaCha8Rng::seed_from_u64(2);
        let values: Vec<f64> = (0..400).map(|_| random.random_range(0.0..1.0)).collect();
        let mut means = resample(values.len(), 1, |draw| {
            Some(draw.iter().map(|&k| values[k]).sum::<f64>() / draw.len() as f64)
        });
        let [low, high] = middle(&mut means).expect("many draws");
        let wide = 2.0 * 1.96 / (12.0_f64 * 400.0).sqrt();
        assert!(
            (0.75..1.25).contains(&((high - low) / wide)),
            "{low} {high}"
        );
        assert!(low < 0.5 && 0.5 < high);
    }
}
