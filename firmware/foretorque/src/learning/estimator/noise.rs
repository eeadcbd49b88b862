//! Noise of the torque of one joint: measured variance, and correlation of its rows.

use crate::learning::conditioning::AVERAGED;

/// Square of the median of |z| for a normal z, at which the measured variance settles.
pub(super) const MEDIAN_SQUARED: f32 = 0.6745 * 0.6745;
/// Growth of a joint's variance for an innovation above the median; below, it shrinks as much. Memory: 1.2 s at 167 rows a
/// second.
const VARIANCE_STEP: f32 = 1.005;
/// Range of the variance, in units of the configured one.
const VARIANCE_RANGE: (f32, f32) = (0.02, 400.0);
/// Initial variance: fifty times that of a mean of white noise. Real wrists scatter by 4 to 12 % of their limits, and an
/// overweighted first row stays in the covariance.
pub(super) const FIRST_VARIANCE: f32 = 50.0 / AVERAGED as f32;
/// Gain of the first steps of the variance, divided by the number of rows: `1 / (2 φ(m) m)` with m = 0.6745 finds the
/// median of a normal z in the fewest rows [Robbins and Monro 1951].
const VARIANCE_GAIN: f32 = 2.3;
/// Rows after which the step of the variance is [`VARIANCE_STEP`].
pub(super) const EFFECTIVE_ROWS: f32 = VARIANCE_GAIN / (VARIANCE_STEP - 1.0);
/// Weight of the initial variance, rows.
pub(super) const FIRST_ROWS: f32 = 4.0;

/// Update of the `measured` variance of a joint by one innovation.
///
/// * `variance` its expected variance      * `beyond` true if it exceeds the median
#[inline(always)]
pub(super) fn update_variance(
    measured: &mut f32,
    effective_rows: &mut f32,
    variance: f32,
    beyond: bool,
) {
    let step = if *effective_rows < EFFECTIVE_ROWS {
        // Only the noise part of an innovation is evidence of noise.
        let noise_part = *measured / variance;
        *effective_rows += noise_part;
        1.0 + VARIANCE_GAIN * noise_part / *effective_rows
    } else {
        VARIANCE_STEP
    };
    let (lower, upper) = VARIANCE_RANGE;
    let next = if beyond {
        *measured * step
    } else {
        *measured / step
    };
    *measured = next.clamp(lower, upper);
}

/// Memory, blocks: the found factor scatters by √(2 / 40), 22 %.
const MEMORY: f32 = 40.0;
/// Factor before the first block, the least of real arms with 6 joints, and its weight in blocks. Two blocks of a stronger
/// correlation outweigh it.
const FIRST: (f32, f32) = (3.0, 4.0);
/// Bound of an innovation, standard deviations, against outliers.
const CLIP: f32 = 6.0;

/// Factor by which the variance of a sum of innovations exceeds that of independent ones.
///
/// ```text
/// ρ = mean of (Σ z over a block)² / rows, over mean of z²     at least 1
/// ```
/// Batch means [Law and Carson 1979]. What a model lacks lasts for tenths of a second on real arms. Taken as white noise,
/// it would shrink the covariance ρ times too fast. Errors of the estimate are correlated too, so a block counts by the part of
/// the variance of its sum that is noise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct NoiseCorrelation {
    /// Sums of the block in progress, and its rows.
    sum: f32,
    squares: f32,
    noise_parts: f32,
    rows: f32,
    /// Means over blocks of (Σ z)² / rows and of z², and the number of blocks behind them.
    of_sums: f32,
    of_rows: f32,
    blocks: f32,
}

impl NoiseCorrelation {
    pub(super) const fn new() -> Self {
        Self {
            sum: 0.0,
            squares: 0.0,
            noise_parts: 0.0,
            rows: 0.0,
            of_sums: FIRST.0,
            of_rows: 1.0,
            blocks: FIRST.1,
        }
    }

    /// Factor ρ on the variance of a row, from 1 on.
    pub(super) fn factor(&self) -> f32 {
        let factor = self.of_sums / self.of_rows;
        // A comparison with a not-a-number is false.
        if factor > 1.0 { factor } else { 1.0 }
    }

    /// Add an innovation `z`, finite, in standard deviations; a block has `length` rows.
    ///
    /// * `noise_part` part of its expected variance that is noise, 0 to 1
    ///
    /// Cost: four additions, and two divisions a block.
    pub(super) fn add(&mut self, z: f32, noise_part: f32, length: f32) {
        let z = z.clamp(-CLIP, CLIP);
        self.sum += z;
        self.squares += z * z;
        self.noise_parts += noise_part;
        self.rows += 1.0;
        if self.rows < length {
            return;
        }
        let inverse = 1.0 / self.rows;
        // Noise part of the sum's variance: ρ R of ρ R + rows φᵀPφ.
        let noise_part = self.noise_parts * inverse;
        let noise = self.factor() * noise_part;
        let weight = noise / (noise + (1.0 - noise_part) * self.rows);
        let blocks = self.blocks + weight;
        self.blocks = if blocks < MEMORY { blocks } else { MEMORY };
        let part = weight / self.blocks;
        self.of_sums += part * (self.sum * self.sum * inverse - self.of_sums);
        self.of_rows += part * (self.squares * inverse - self.of_rows);
        (self.sum, self.squares) = (0.0, 0.0);
        (self.noise_parts, self.rows) = (0.0, 0.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Random;

    #[test]
    fn the_factor_is_that_of_the_noise() {
        // Variance of a mean of an autoregressive noise: (1 + a) / (1 − a).
        for (a, from, to) in [(0.0f32, 1.0, 1.7), (0.6, 2.5, 6.0), (0.9, 11.0, 28.0)] {
            let (mut found, mut random, mut z) = (NoiseCorrelation::new(), Random(3), 0.0);
            assert_eq!(found.factor(), FIRST.0);
            for _ in 0..83 * 400 {
                z = a * z + random.uniform() as f32;
                found.add(z, 1.0, 83.0);
            }
            let factor = found.factor();
            assert!((from..to).contains(&factor), "{a}: {factor}");
        }
    }
}
