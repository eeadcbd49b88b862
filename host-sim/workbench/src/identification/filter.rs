//! Zero-phase filtering of tables, Fourier series of periodic ones, and the removal of spikes.

use std::f64::consts::{PI, TAU};

/// A Butterworth low pass of order 4 that runs forwards and then backwards: no delay, twice the attenuation.
///
/// Two second-order sections by the bilinear transform [Oppenheim and Schafer 2010, section 7.2]. Attenuation at the
/// cut-off is −6 dB, because of the two directions.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Butterworth {
    /// b0, b1, b2, a1, a2 of each section; every section has gain 1 at rest.
    sections: [[f64; 5]; 2],
    /// Rows after which the impulse response has decayed below 1e-9 of its peak.
    pub(super) settling_rows: usize,
    /// Cut-off frequency, Hz.
    pub(super) cutoff_hz: f64,
}

impl Butterworth {
    /// Cut-offs are below this share of the rate of the rows.
    pub(super) const RATE_SHARE: f64 = 0.45;

    /// A low pass at `cutoff_hz` for rows `period_s` apart; `None` unless the cut-off is below 0.45 / period.
    pub(super) fn new(cutoff_hz: f64, period_s: f64) -> Option<Self> {
        if !(cutoff_hz > 0.0 && cutoff_hz * period_s < Self::RATE_SHARE) {
            return None;
        }
        let k = (PI * cutoff_hz * period_s).tan();
        let section = |angle: f64| {
            let damping = 2.0 * angle.cos();
            let scale = 1.0 / (1.0 + damping * k + k * k);
            let b = k * k * scale;
            [
                b,
                2.0 * b,
                b,
                2.0 * (k * k - 1.0) * scale,
                (1.0 - damping * k + k * k) * scale,
            ]
        };
        let sections = [section(PI / 8.0), section(3.0 * PI / 8.0)];
        // The slower pole pair has radius sqrt(a2) of the section with the smaller damping.
        let radius = sections.iter().map(|s| s[4].sqrt()).fold(0.0, f64::max);
        Some(Self {
            sections,
            settling_rows: (1e-9_f64.ln() / radius.ln()).ceil() as usize,
            cutoff_hz,
        })
    }

    /// Filters every column of a table of `width` columns, row after row in `table`, in place.
    ///
    /// The table is continued at both ends by its point reflection, so that constants and ramps are unchanged.
    /// Cost: 20 multiply-adds an entry.
    pub(super) fn smooth(&self, table: &mut [f64], width: usize) {
        let rows = table.len() / width.max(1);
        if rows < 2 {
            return;
        }
        let pad = self.settling_rows.min(rows - 1);
        let mut padded = Vec::with_capacity((rows + 2 * pad) * width);
        let reflected = |end: usize, row: usize| {
            let table = &*table;
            (0..width).map(move |c| 2.0 * table[end * width + c] - table[row * width + c])
        };
        padded.extend((1..=pad).rev().flat_map(|row| reflected(0, row)));
        padded.extend_from_slice(table);
        let end = rows - 1;
        padded.extend((end - pad..end).rev().flat_map(|row| reflected(end, row)));
        let mut z = vec![0.0; 2 * width];
        for section in &self.sections {
            Self::sweep(section, padded.chunks_exact_mut(width), &mut z);
            Self::sweep(section, padded.chunks_exact_mut(width).rev(), &mut z);
        }
        table.copy_from_slice(&padded[pad * width..(pad + rows) * width]);
    }

    /// One section over the rows in the order given (transposed direct form II), from the steady state of the first.
    fn sweep<'a>(
        &[b0, b1, b2, a1, a2]: &[f64; 5],
        rows: impl Iterator<Item = &'a mut [f64]>,
        z: &mut [f64],
    ) {
        let mut rows = rows.peekable();
        let width = z.len() / 2;
        let (z1, z2) = z.split_at_mut(width);
        if let Some(first) = rows.peek() {
            for ((z1, z2), x) in z1.iter_mut().zip(z2.iter_mut()).zip(first.iter()) {
                *z2 = (b2 - a2) * x;
                *z1 = (b1 - a1) * x + *z2;
            }
        }
        for row in rows {
            for ((x, z1), z2) in row.iter_mut().zip(z1.iter_mut()).zip(z2.iter_mut()) {
                let y = b0 * *x + *z1;
                *z1 = b1 * *x - a1 * y + *z2;
                *z2 = b2 * *x - a2 * y;
                *x = y;
            }
        }
    }
}

/// Derivative of every column of a table over rows `period_s` apart: five-point central differences, one-sided at the ends.
pub(super) fn derivative(table: &[f64], width: usize, period_s: f64) -> Vec<f64> {
    let rows = table.len() / width.max(1);
    let at = |row: usize, c: usize| table[row * width + c];
    let mut out = Vec::with_capacity(table.len());
    for row in 0..rows {
        for c in 0..width {
            out.push(if row >= 2 && row + 2 < rows {
                let near = at(row + 1, c) - at(row - 1, c);
                let far = at(row + 2, c) - at(row - 2, c);
                (8.0 * near - far) / (12.0 * period_s)
            } else {
                let (low, high) = (row.saturating_sub(1), (row + 1).min(rows - 1));
                (at(high, c) - at(low, c)) / ((high - low).max(1) as f64 * period_s)
            });
        }
    }
    out
}

/// Distance of a spike from the running median, standard deviations.
const SPIKE_LIMIT: f64 = 4.0;
/// Standard deviation of a normal variable over its median absolute deviation.
const MAD: f64 = 1.4826;

/// A table with its spikes replaced by the running median [Hampel 1974], and their number.
///
/// The spread is that of the whole column: its distance from the running median has the size of the noise nearly
/// everywhere, and one window is too short for an estimate.
///
/// * `reach` half width of the running median, rows; peaks of the signal itself must be wider
pub fn despiked(table: &[f64], width: usize, reach: usize) -> (Vec<f64>, usize) {
    let rows = table.len() / width.max(1);
    let mut out = table.to_vec();
    let mut count = 0;
    let mut window = Vec::with_capacity(2 * reach + 1);
    for c in 0..width {
        let mut medians = Vec::with_capacity(rows);
        for row in 0..rows {
            // Symmetric at the ends too, or a slope would look like a spike there.
            let reach = reach.min(row).min(rows - 1 - row);
            window.clear();
            window.extend((row - reach..=row + reach).map(|r| table[r * width + c]));
            medians.push(median(&mut window));
        }
        let distance = |row: usize| (table[row * width + c] - medians[row]).abs();
        let mut distances: Vec<f64> = (0..rows).map(distance).collect();
        let limit = SPIKE_LIMIT * MAD * median(&mut distances);
        for row in (0..rows).filter(|&row| limit > 0.0 && distance(row) > limit) {
            out[row * width + c] = medians[row];
            count += 1;
        }
    }
    (out, count)
}

/// The middle value; reorders `values`. Zero for none.
pub(super) fn median(values: &mut [f64]) -> f64 {
    let middle = values.len() / 2;
    if values.is_empty() {
        return 0.0;
    }
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// Fourier series of the columns of a table that holds one period: mean, then cosine and sine of each harmonic.
pub(super) struct Harmonics {
    width: usize,
    coefficients: Vec<f64>,
    /// sin and cos of each phase.
    turn: Vec<(f64, f64)>,
}

impl Harmonics {
    pub(super) fn of(table: &[f64], width: usize, count: usize) -> Self {
        let phases = table.len() / width;
        let turn = |phase: usize| (TAU * phase as f64 / phases as f64).sin_cos();
        let turn: Vec<(f64, f64)> = (0..phases).map(turn).collect();
        let mut coefficients = vec![0.0; (2 * count + 1) * width];
        for (phase, row) in table.chunks_exact(width).enumerate() {
            for (k, place) in coefficients.chunks_exact_mut(width).enumerate() {
                let (sin, cos) = turn[k.div_ceil(2) * phase % phases];
                let scale = if k == 0 { 1.0 } else { 2.0 } / phases as f64;
                let factor = scale * if k % 2 == 1 || k == 0 { cos } else { sin };
                for (sum, value) in place.iter_mut().zip(row) {
                    *sum += factor * value;
                }
            }
        }
        Self {
            width,
            coefficients,
            turn,
        }
    }

    /// The series, or its first or second derivative over time, at every phase.
    pub(super) fn evaluate(&self, derivative: i32, period_s: f64) -> Vec<f64> {
        let phases = self.turn.len();
        let mut table = vec![0.0; phases * self.width];
        for (phase, row) in table.chunks_exact_mut(self.width).enumerate() {
            for (k, own) in self.coefficients.chunks_exact(self.width).enumerate() {
                let harmonic = k.div_ceil(2);
                let (mut sin, mut cos) = self.turn[harmonic * phase % phases];
                let w = TAU * harmonic as f64 / period_s;
                let even = k % 2 == 1 || k == 0;
                // Each derivative is a quarter turn and a factor w.
                for _ in 0..derivative {
                    (sin, cos) = (cos, -sin);
                }
                let factor = w.powi(derivative) * if even { cos } else { sin };
                for (value, own) in row.iter_mut().zip(own) {
                    *value += factor * own;
                }
            }
        }
        table
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tone(hz: f64, period_s: f64, rows: usize) -> Vec<f64> {
        let angle = 2.0 * PI * hz * period_s;
        (0..rows).map(|k| (angle * k as f64).sin()).collect()
    }

    fn smoothed(cutoff_hz: f64, period_s: f64, table: &[f64]) -> Vec<f64> {
        let filter = Butterworth::new(cutoff_hz, period_s).expect("below Nyquist");
        let mut table = table.to_vec();
        filter.smooth(&mut table, 1);
        table
    }

    #[test]
    fn tones_pass_by_their_frequency_without_delay() {
        // Cut-off, tone, time between rows, gain, tolerance.
        let cases = [
            (10.0, 1.0, 1e-3, 1.0, 1e-3),
            (10.0, 60.0, 1e-3, 0.0, 1e-5),
            (10.0, 10.0, 8e-3, 0.5, 5e-3),
        ];
        for (cutoff_hz, hz, period_s, gain, tolerance) in cases {
            let tone = tone(hz, period_s, 4000);
            let out = smoothed(cutoff_hz, period_s, &tone);
            for k in 1000..3000 {
                assert!((out[k] - gain * tone[k]).abs() < tolerance, "{hz} Hz, {k}");
            }
        }
        assert!(Butterworth::new(60.0, 1e-2).is_none());
    }

    #[test]
    fn a_ramp_is_unchanged() {
        let ramp: Vec<f64> = (0..300).map(|k| 1.0 + 0.1 * f64::from(k)).collect();
        let out = smoothed(5.0, 1e-2, &ramp);
        assert!(out.iter().zip(&ramp).all(|(a, b)| (a - b).abs() < 1e-6));
    }

    #[test]
    fn the_derivative_of_a_tone_is_the_other_tone() {
        let rates = derivative(&tone(1.0, 1e-2, 200), 1, 1e-2);
        for (k, rate) in rates.iter().enumerate().skip(2).take(196) {
            let true_rate = 2.0 * PI * (2.0 * PI * 1e-2 * k as f64).cos();
            assert!((rate - true_rate).abs() < 1e-5 * 2.0 * PI + 1e-4);
        }
    }

    #[test]
    fn spikes_go_and_the_curve_stays() {
        let mut table = tone(0.1, 1e-2, 400);
        for (k, value) in table.iter_mut().enumerate() {
            *value += 0.01 * ((k * 7919 % 101) as f64 / 50.0 - 1.0);
        }
        let clean = table.clone();
        table[100] += 3.0;
        table[233] -= 3.0;
        let (out, count) = despiked(&table, 1, 7);
        assert!((2..12).contains(&count), "{count}");
        assert!(out.iter().zip(&clean).all(|(a, b)| (a - b).abs() < 0.1));
    }

    #[test]
    fn harmonics_are_exact_and_noise_between_them_goes() {
        let (phases, period_s) = (200, 4.0);
        let w = TAU / period_s;
        let t = |phase: usize| period_s * phase as f64 / phases as f64;
        let wave = |t: f64| 0.3 + (w * t).sin() - 0.4 * (3.0 * w * t).cos();
        let table: Vec<f64> = (0..phases)
            .map(|phase| wave(t(phase)) + 0.1 * (40.0 * w * t(phase)).sin())
            .collect();
        let series = Harmonics::of(&table, 1, 5);
        let exact: [&dyn Fn(f64) -> f64; 3] = [
            &wave,
            &|t| w * (w * t).cos() + 1.2 * w * (3.0 * w * t).sin(),
            &|t| -w * w * (w * t).sin() + 3.6 * w * w * (3.0 * w * t).cos(),
        ];
        for (order, exact) in (0..).zip(exact) {
            for (phase, value) in series.evaluate(order, period_s).iter().enumerate() {
                assert!((value - exact(t(phase))).abs() < 1e-9, "{order} {phase}");
            }
        }
    }
}
