//! Measured variance of the torque of a joint.

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
