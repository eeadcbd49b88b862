//! Length of the motion filter that a board needs for a log: as long as ripple and noise of the accelerations require.

use super::IdentifyError;
use super::clock::GAP_PERIODS;
use super::filter::median;
use super::log::LogRow;
use super::whole_log::{PREVIEW, WholeLog};
use crate::metrics::MOVING_RAD_S;
use crate::robot::Robot;
use std::f64::consts::TAU;
use std::ops::RangeInclusive;
use std::path::Path;

/// Largest RMS error of an acceleration by the noise of the positions, share of the acceleration limit.
const NOISE: f64 = 0.05;

/// Cut-off of a low pass, Hz, behind which white noise of the positions of deviation `noise`, rad, in rows `period_s` apart errs
/// the acceleration by `most`, rad/s².
///
/// ```text
/// most² = noise² · 2 period ∫ (2π f)⁴ df     f from 0 to the cut-off
/// ```
fn cut_off_of_noise(noise: f64, most: f64, period_s: f64) -> f64 {
    let power = most * most * 5.0 / (noise * noise * 2.0 * period_s * TAU.powi(4));
    power.powf(0.2)
}

/// Length of the quadratic fit whose accelerations have as much noise as those below the cut-off frequency `cut_off_hz`, Hz, s:
/// the equations of [`cut_off_of_noise`] and [`motion_filter`].
fn length_for_noise(cut_off_hz: f64) -> f64 {
    (720.0 * 5.0 / (2.0 * TAU.powi(4))).powf(0.2) / cut_off_hz
}

/// Largest power of accelerations that are no motion of the arm, share of that of its motion.
const FALSE_POWER: f64 = 0.05;

/// Length of the motion filter that a board needs for the log at `path`, in units of `unit_s`, within `range`.
///
/// The acceleration of a short fit contains ripple, vibration and noise, which no rigid body explains.
/// A fit of twice the length is nearly free of them, and has nearly all of the motion.
/// So the filter is lengthened while that costs the median joint more than 5 % of the power.
/// Each step has to halve this share: that of white noise falls with the fifth power of the length.
/// Otherwise it is motion, faster than the filter, or noise beside which a longer filter shows no motion either.
/// Joints count while they move, in the rows that find the clock of the log.
///
/// It is as long, too, as the noise of the positions requires that [`PrepareConfig`](super::PrepareConfig) filters:
/// ```text
/// 720 noise² period / length⁵ = most²     variance of the second derivative of a quadratic fit
/// ```
///
/// Errors: the log's.
pub fn motion_filter(
    path: &Path,
    robot: &Robot,
    unit_s: f64,
    range: RangeInclusive<u32>,
) -> Result<u32, IdentifyError> {
    let log = WholeLog::open(path, robot)?;
    let rows = longest_piece(&log);
    let rows = &rows[rows.len().saturating_sub(PREVIEW)..];
    let positions = |joint: usize| rows.iter().map(move |row| row.q[joint]).collect();
    let joints: Vec<Vec<f64>> = (0..robot.joints.len()).map(positions).collect();
    let unit = unit_s / log.period_s();
    let still_rad = MOVING_RAD_S * log.period_s();
    let noisiest_hz = noisiest_cut_off(&log, robot);
    let (shortest, longest) = range.into_inner();
    let needed = (length_for_noise(noisiest_hz) / unit_s).ceil() as u32;
    let shortest = shortest.max(needed.min(longest));
    Ok(filter_length(&joints, unit, still_rad, shortest..=longest))
}

/// Lowest cut-off frequency that the noise of a joint's positions requires, Hz; infinite without noise.
pub(super) fn noisiest_cut_off(log: &WholeLog, robot: &Robot) -> f64 {
    let joints = robot.joints.iter().zip(&log.noise);
    let cut_offs = joints.map(|(joint, noise)| {
        let most = NOISE * joint.limits.acceleration;
        cut_off_of_noise(*noise, most, log.period_s())
    });
    cut_offs.fold(f64::INFINITY, f64::min)
}

/// The longest of the first rows of a log without a gap, across which derivatives would be wrong.
pub(super) fn longest_piece(log: &WholeLog) -> &[LogRow] {
    let whole = |a: &LogRow, b: &LogRow| b.t_s - a.t_s <= GAP_PERIODS * log.period_s();
    let pieces = log.preview.chunk_by(whole);
    pieces.max_by_key(|piece| piece.len()).unwrap_or_default()
}

/// Length of the filter for positions of several joints, in units of `unit` rows; see [`motion_filter`].
///
/// * `still_rad` way in a row of a joint that stands still
fn filter_length(
    joints: &[Vec<f64>],
    unit: f64,
    still_rad: f64,
    range: RangeInclusive<u32>,
) -> u32 {
    let share = |length: u32| {
        let half = |length: u32| (0.5 * (f64::from(length) * unit - 1.0)).round() as usize;
        let halves = [half(length), half(2 * length)].map(|half| half.max(1));
        let shares = joints
            .iter()
            .filter_map(|q| false_power(q, halves, still_rad));
        median(&mut shares.collect::<Vec<f64>>())
    };
    let (mut length, longest) = range.into_inner();
    let mut here = share(length);
    while length < longest && here > FALSE_POWER {
        let next = share(length + 1);
        if next > 0.5 * here {
            break;
        }
        (length, here) = (length + 1, next);
    }
    length
}

/// Power of what the acceleration of the shorter fit has and that of the longer has not, over the power of the longer; `None` for
/// a joint that never moves.
///
/// * `halves` rows on each side of the middle, of both      * `still_rad` see [`filter_length`]
fn false_power(q: &[f64], halves: [usize; 2], still_rad: f64) -> Option<f64> {
    let [short, long] = halves.map(curvature_weights);
    let (mut lost, mut kept) = (0.0, 0.0);
    for window in q.windows(long.len()) {
        let extreme = |pick: fn(f64, f64) -> f64| window.iter().copied().reduce(pick);
        let way = extreme(f64::max).zip(extreme(f64::min));
        if way.is_none_or(|(most, least)| most - least <= still_rad * long.len() as f64) {
            continue;
        }
        let middle = halves[1];
        // Differences from the middle: positions are large, curvatures are not.
        let of = |weights: &[f64]| {
            let rows = &window[middle - weights.len() / 2..];
            let terms = rows.iter().zip(weights);
            let terms = terms.map(|(q, weight)| (q - window[middle]) * weight);
            terms.sum::<f64>()
        };
        let (short, long) = (of(&short), of(&long));
        lost += (short - long).powi(2);
        kept += long.powi(2);
    }
    (kept > 0.0).then(|| lost / kept)
}

/// Weights of the positions in a window of `2 half + 1` rows; the weighted sum is the acceleration of the quadratic fit, rad/row².
fn curvature_weights(half: usize) -> Vec<f64> {
    let distances = (0..=2 * half).map(|row| row as f64 - half as f64);
    let squares: Vec<f64> = distances.map(|k| k * k).collect();
    let mean = squares.iter().sum::<f64>() / squares.len() as f64;
    let spread: f64 = squares.iter().map(|square| (square - mean).powi(2)).sum();
    let weights = squares.iter().map(|square| 2.0 * (square - mean) / spread);
    weights.collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_distr::StandardNormal;

    /// Positions in rows 2 ms apart: a sine of 0.5 rad at `omega` with white noise of `noise`, rad.
    fn sine(omega: f64, noise: f64) -> Vec<f64> {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        let rows = (0..8192).map(|k| 0.5 * (omega * 2e-3 * f64::from(k)).sin());
        rows.map(|q| q + noise * random.sample::<f64, _>(StandardNormal))
            .collect()
    }

    #[test]
    fn false_power_of_noise_is_that_of_the_weights() {
        let found = false_power(&sine(3.0, 1e-3), [15, 31], 0.0).expect("moves");
        // The longer fit has hardly any of the noise.
        let squares = curvature_weights(15)
            .into_iter()
            .map(|weight| weight * weight);
        let noise = 1e-3_f64.powi(2) * squares.sum::<f64>();
        let expected = noise / (0.5 * (0.5 * (3.0 * 2e-3_f64).powi(2)).powi(2));
        let over = found / expected;
        assert!((over - 1.0).abs() < 0.15, "{found} for {expected}");
    }

    #[test]
    fn a_fit_has_the_noise_that_a_batch_filter_leaves() {
        let (noise, most, period_s) = (1e-3_f64, 0.5, 2e-3);
        let length_s = length_for_noise(cut_off_of_noise(noise, most, period_s));
        let left = 720.0 * noise.powi(2) * period_s / length_s.powi(5);
        assert!((left.sqrt() / most - 1.0).abs() < 1e-9, "{left}");
        assert_eq!(length_for_noise(f64::INFINITY), 0.0);
    }

    #[test]
    fn a_filter_is_lengthened_for_noise_and_not_for_fast_motion() {
        // Units of 31 ms: two of them are the filter of a board.
        let length = |joints: &[Vec<f64>], row_s: f64| {
            filter_length(joints, 31e-3 / row_s, MOVING_RAD_S * row_s, 2..=6)
        };
        let of = |omega, noise| length(&[sine(omega, noise)], 2e-3);
        assert_eq!(of(3.0, 0.0), 2);
        assert_eq!(of(3.0, 2e-4), 2);
        assert_eq!(of(3.0, 2e-3), 4);
        assert_eq!(of(40.0, 0.0), 2);
        // Rows of 10 ms, on the same path.
        let slow = |noise| length(&[sine(15.0, noise)], 10e-3);
        assert_eq!([1e-4, 9e-4].map(slow), [2, 4]);
        // Joints at rest and logs without rows do not count; of joints that move the median does.
        let (rest, still) = (sine(0.0, 2e-5), sine(3.0, 0.0));
        let noisy = sine(3.0, 2e-3);
        let resting = [rest.clone(), rest.clone(), noisy.clone()];
        assert_eq!(length(&resting, 2e-3), 4);
        let waits = [vec![0.0; 20_000], noisy.clone()].concat();
        assert_eq!(length(&[waits], 2e-3), 4);
        assert_eq!(length(&[still.clone(), still, noisy], 2e-3), 2);
        assert_eq!(length(&[rest], 2e-3), 2);
        assert_eq!(length(&[], 2e-3), 2);
        assert_eq!(length(&[vec![0.0; 5]], 2e-3), 2);
    }
}
