//! Uncertainty that correlated residuals leave: confidence intervals by resampling, and standard deviations, over blocks.
//!
//! Rows of a log are not independent: what the model misses stays for tenths of seconds. Taken as white, it shrinks the
//! covariance too fast. Neighbouring errors are correlated, blocks hardly [Künsch 1989]; and the variance of block sums over
//! that of independent values [Conway 1963, batch means] is the factor by which each joint's rows count less.

use super::columns::Layout;
use super::methods::{Fit, MethodName};
use super::normal::SampleRow;
use super::normal::{NormalEquations, solve};
use super::problem::{MethodResult, TrainingData};
use crate::dynamics::PerJoint;
use crate::metrics::{even_sample, scaled};
use nalgebra::{DMatrix, DVector};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

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
pub(super) fn parameter_intervals(
    layout: &Layout,
    data: &TrainingData<'_>,
    result: &MethodResult,
    seed: u64,
) -> Option<Vec<[f64; 2]>> {
    let fit = result.fit.as_ref()?;
    let (robust, prior, sigma) = match result.name {
        MethodName::Ols => (false, false, PerJoint::repeat(layout.joints(), 1.0)),
        MethodName::Wls => (false, true, fit.sigma),
        MethodName::Irls => (true, true, fit.sigma),
        _ => return None,
    };
    let rows: Vec<&SampleRow> = even_sample(&data.sample, ROWS).copied().collect();
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
        if prior {
            layout.add_prior(&mut gram);
        }
        // A draw may miss the blocks which show a parameter.
        Some(solve(&gram, &moment).ok()?.0)
    });
    let values = |place| draws.iter().map(move |theta: &DVector<f64>| theta[place]);
    (0..size).map(|place| middle(values(place))).collect()
}

/// Most rows of a block.
const MOST_ROWS: usize = 500;

/// Variance of a block's sum over that of as many independent values, at least 1.
fn inflation(residuals: &[f64]) -> f64 {
    let length = (residuals.len() / BLOCKS).clamp(1, MOST_ROWS);
    let blocks = residuals.chunks_exact(length);
    let count = blocks.len() * length;
    let sums: f64 = blocks.map(|block| block.iter().sum::<f64>().powi(2)).sum();
    let squares: f64 = residuals[..count].iter().map(|e| e * e).sum();
    if squares > 0.0 {
        (sums / squares).max(1.0)
    } else {
        1.0
    }
}

/// This fit with the covariance that the residuals of `sample` really leave.
///
/// * `sums` equations of all rows, in `layout`; `sample` rows in `wide`, a layout of the same robot
pub(super) fn with_block_deviations(
    fit: Fit,
    (sums, layout): (&NormalEquations, &Layout),
    (sample, wide): (&[SampleRow], &Layout),
) -> Fit {
    let mut theta = DVector::zeros(wide.parameters.len());
    for (value, place) in fit.theta.iter().zip(wide.places_of(layout)) {
        theta[place] = *value;
    }
    let sigma = PerJoint::from_fn(layout.joints(), |joint| {
        let moving = sample.iter().filter(|row| row.moving[joint]);
        let residuals: Vec<f64> = moving
            .map(|row| row.clean[joint] - row.linear(wide, &theta, joint))
            .collect();
        // Of rows that were left out between two, each is as correlated with its neighbours as these are.
        let stride = sums.joints[joint].count / (residuals.len() as f64).max(1.0);
        fit.sigma[joint] * (1.0 + stride.max(1.0) * (inflation(&residuals) - 1.0)).sqrt()
    });
    let (mut gram, moment) = sums.weighted(layout, &sigma);
    layout.add_prior(&mut gram);
    let Ok((_, covariance)) = solve(&gram, &moment) else {
        return fit;
    };
    // A prior may have made the fit surer than its rows.
    let free = fit.covariance.diagonal();
    let scale = free.zip_map(&covariance.diagonal(), |own, found| {
        let surer = found > 0.0 && own > found;
        if surer { (own / found).sqrt() } else { 1.0 }
    });
    Fit {
        covariance: scaled(&covariance, &scale),
        ..fit
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identification::columns::ColumnSet;
    use crate::identification::dataset::{RowSums, random_rows};
    use crate::identification::methods::wls;
    use crate::robot::Robot;
    use rand::{Rng, SeedableRng};

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

    #[test]
    fn deviations_cover_the_errors_that_correlated_residuals_make() {
        let robot = Robot::load("ur5").expect("built in");
        let layout = Layout::new(&robot, &ColumnSet::plain());
        // Residuals that stay for 20 rows, on motion that hardly changes sign in that time.
        let (mut white, mut blocks, mut thinned) = (0.0, 0.0, 0.0);
        for seed in 0..4 {
            let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
            let mut state = [0.0; 6];
            let mut rows = random_rows(&layout, 6000, seed, [2.0, 1.0, 3.0], 1e-9, |_, _| 0.0);
            let motions: Vec<_> = rows.iter().step_by(20).cloned().collect();
            for (k, row) in rows.iter_mut().enumerate() {
                *row = motions[k / 20].clone();
                for (state, tau) in state.iter_mut().zip(row.clean.iter_mut()) {
                    *state = 0.95 * *state + random.random_range(-0.3..0.3);
                    *tau = *state;
                }
                row.tau = row.clean;
            }
            let sums = RowSums::of(&layout, &rows);
            let fit = wls(&sums.clean, &layout).expect("solvable");
            let error = |fit: &Fit| {
                let ratios = fit.theta.component_div(&fit.deviations());
                ratios.norm_squared() / ratios.len() as f64
            };
            white += error(&fit) / 4.0;
            let of = |rows: &[SampleRow]| {
                let fit = fit.clone();
                error(&with_block_deviations(
                    fit,
                    (&sums.clean, &layout),
                    (rows, &layout),
                )) / 4.0
            };
            blocks += of(&rows);
            let every_fourth: Vec<_> = rows.iter().step_by(4).cloned().collect();
            thinned += of(&every_fourth);
        }
        // The truth is zero: errors in standard deviations have mean square 1 where those are honest.
        assert!(white > 6.0, "{white}");
        for honest in [blocks, thinned] {
            assert!((0.4..2.0).contains(&honest), "{blocks} {thinned}");
        }
    }
}
