use crate::joint::{JointMeasurement, JointMotion, JointVector, zero_vector};

/// Largest length of the motion filter, samples; a sample is the mean of [`LearnerConfig::decimation`] ticks.
///
/// [`LearnerConfig::decimation`]: crate::learning::LearnerConfig::decimation
pub const TAPS: usize = 31;
/// Largest delay of the motion filter, samples: its output describes the middle of the window.
pub const DELAY: usize = TAPS / 2;
/// Bounds of the delay, samples; the lower one is as far as the mean of the torques reaches.
pub(super) const LEAST_DELAY: u32 = AVERAGED as u32 / 2;
pub(super) const MOST_DELAY: u32 = DELAY as u32;

/// Length of a motion filter with this delay, samples.
pub(super) const fn taps(delay: u32) -> u32 {
    2 * delay + 1
}

/// Factors of the quadratic fit, from the sums over its window k = −d … d.
#[derive(Clone, Copy, Debug, PartialEq)]
struct FitFactors {
    /// Σk²
    sum_2: f32,
    /// 1/Σ1
    inv_sum_0: f32,
    /// Σk²/Σ1
    mean_square: f32,
    /// 1/Σk²
    inv_sum_2: f32,
    /// 1/(Σk⁴ − (Σk²)²/Σ1)
    inv_curvature: f32,
}

impl FitFactors {
    /// Sums of whole numbers below 2²⁴, which f32 has exactly.
    fn new(delay: u32) -> Self {
        let (d, sum_0) = (delay as f32, taps(delay) as f32);
        let sum_2 = d * (d + 1.0) * sum_0 / 3.0;
        let sum_4 = sum_2 * (3.0 * d * d + 3.0 * d - 1.0) / 5.0;
        Self {
            sum_2,
            inv_sum_0: 1.0 / sum_0,
            mean_square: sum_2 / sum_0,
            inv_sum_2: 1.0 / sum_2,
            inv_curvature: 1.0 / (sum_4 - sum_2 * sum_2 / sum_0),
        }
    }
}

/// Square of the first zero of j₂: beyond it, the filter removes cogging from the acceleration.
const ATTENUATION_END: f32 = 33.2;

/// Longest gap that is bridged, ticks. A straight line misses a quadratic by at most `qdd ((MAX_BRIDGED + 1) T)² / 8`:
/// 30 µrad at 10 rad/s² and 1 kHz, less than the steps of most encoders.
pub const MAX_BRIDGED: usize = 4;

/// Torques averaged around the middle of the window, ticks: five, or the odd number of samples next to it.
///
/// A joint has one row in N ticks. With six joints a mean of five or six uses nearly all torques, for the price of one row. Over ±3 ticks
/// the torque is a straight line. Cogging is not: it loses a tenth of its amplitude at 1.5 rad/s and 202 cycles a turn.
pub(super) const AVERAGED: usize = 5;
/// Torques stored, so that they are delayed as much as the motion.
const TORQUES: usize = DELAY + 1 + AVERAGED / 2;

/// Motion and torque of the same instant, the delay of the filter ago.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConditionedSample<const N: usize> {
    /// Position, velocity and acceleration of the fitted quadratic.
    pub motion: JointMotion<N>,
    /// Mean of the torques around that instant, N × N·m. White noise stays white in means without common ticks.
    pub tau: JointVector<N>,
}

/// Motion filter: the last 2 `delay` + 1 samples, each the mean of `decimation` ticks.
///
/// Its length is a time, not a number of ticks: arms with elastic gears are rigid bodies at some Hz only.
/// Motion and torque are averaged alike, so both belong to the same instant.
///
/// A missing measurement is a gap. An exact copy of the measurement before is one too: the sensor is slower than the tick, or
/// its report is late. A short gap is bridged with a straight line to the next measurement.
///
/// Late reports are put on the time of their measurement. The first one after a copy may have been measured in any tick of
/// the gap. The displacement of the joints over their velocity gives the ticks since the measurement before, as a whole
/// number. So errors of that velocity do not enter, and without copies no measurement is moved.
///
/// Positions are stored twice, `TAPS` apart, so that the window is contiguous wherever it begins.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasurementWindow<const N: usize> {
    q: [[f32; 2 * TAPS]; N],
    tau: [JointVector<N>; TORQUES],
    next: usize,
    filled: usize,
    torque_next: usize,
    /// Ticks of a sample, and those in the sample in progress.
    decimation: u32,
    ticks: u32,
    /// Samples from the middle of the window to its ends.
    delay: u32,
    /// Ticks since the newest sample was complete.
    since_sample: usize,
    /// Sum over the sample in progress.
    sum: JointMeasurement<N>,
    /// Measurement of the last tick, accepted or bridged.
    last: JointMeasurement<N>,
    /// Ticks since the last accepted measurement, and those of them with a copy of it.
    gap: usize,
    copies: usize,
    /// Age of the last accepted measurement over that of the newest reports, ticks.
    age: usize,
    /// The window has to fill twice: its first samples are late by an unknown time, where copies come among them or before.
    refill: bool,
}

/// Samples over which the velocity is taken that gives the ticks between late measurements: 16 ms. Over two samples, a step of
/// 12 bits errs a velocity by 0.4 rad/s.
const RECENT: usize = 8;

impl<const N: usize> MeasurementWindow<N> {
    /// Empty window.
    ///
    /// * `decimation` ticks of a sample, from 1 on
    /// * `delay` samples from the middle of the window to its ends, cut to 2 … [`DELAY`]
    pub const fn new(decimation: u32, delay: u32) -> Self {
        let delay = match delay {
            0..LEAST_DELAY => LEAST_DELAY,
            MOST_DELAY.. => MOST_DELAY,
            _ => delay,
        };
        Self {
            q: [[0.0; 2 * TAPS]; N],
            tau: [zero_vector(); TORQUES],
            next: 0,
            filled: 0,
            torque_next: 0,
            decimation,
            ticks: 0,
            delay,
            since_sample: 0,
            sum: JointMeasurement::zero(),
            last: JointMeasurement::zero(),
            gap: 0,
            copies: 0,
            age: 0,
            refill: false,
        }
    }

    /// Discard all measurements.
    pub fn reset(&mut self) {
        self.filled = 0;
        self.ticks = 0;
        (self.gap, self.copies, self.age) = (0, 0, 0);
    }

    fn is_empty(&self) -> bool {
        self.filled == 0 && self.ticks == 0
    }

    /// True if every tick is measured or bridged; a gap at the end may still be open.
    pub fn is_full(&self) -> bool {
        self.filled >= taps(self.delay) as usize
    }

    /// True if every joint can be at `q`: its change is at most its step for each tick since the last measurement.
    ///
    /// * `steps` largest plausible change of each joint in a tick, rad
    pub(super) fn reaches(&self, q: &JointVector<N>, steps: impl Iterator<Item = f32>) -> bool {
        let ticks = (self.gap + 1) as f32;
        let changes = q.iter().zip(&self.last.q).map(|(q, last)| (q - last).abs());
        self.is_empty()
            || changes
                .zip(steps)
                .all(|(change, step)| change <= step * ticks)
    }

    /// Append the measurement of the next tick; `None` or a number that is not finite is a gap.
    ///
    /// A gap longer than [`MAX_BRIDGED`] empties the window.
    pub fn push(&mut self, measured: Option<&JointMeasurement<N>>) {
        self.since_sample = self.since_sample.saturating_add(1);
        let arrived = measured.copied().filter(is_finite);
        let accepted = arrived.filter(|arrived| self.is_empty() || *arrived != self.last);
        let Some(measured) = accepted else {
            self.gap += 1;
            self.copies += usize::from(arrived.is_some());
            if self.is_empty() || self.gap > MAX_BRIDGED {
                self.refill |= self.copies > 0 && !self.is_empty();
                self.reset();
            }
            return;
        };
        self.refill |= self.copies > 0 && self.filled <= RECENT;
        let ticks = self.ticks_to(&measured.q);
        self.age = (self.age + self.gap + 1 - ticks).min(MAX_BRIDGED);
        (self.gap, self.copies) = (0, 0);
        self.bridge(&measured, ticks);
        self.append(&measured);
    }

    /// Ticks between the last accepted measurement and the one at `q`: those of the clock, or, where one of both may be
    /// late, those that the displacement shows.
    fn ticks_to(&self, q: &JointVector<N>) -> usize {
        let clock = self.gap + 1;
        if self.age + self.copies == 0 || self.filled <= RECENT {
            return clock;
        }
        let (mut product, mut square) = (0.0, 0.0);
        for (joint, positions) in self.q.iter().enumerate() {
            let at = |sample: usize| positions.get(self.next + sample).copied().unwrap_or(0.0);
            let velocity = at(TAPS - 1) - at(TAPS - 1 - RECENT);
            let change = q.get(joint).zip(self.last.q.get(joint));
            product += velocity * change.map_or(0.0, |(q, last)| q - last);
            square += velocity * velocity;
        }
        if square == 0.0 {
            return clock;
        }
        let ticks = RECENT as f32 * self.decimation as f32;
        // To the nearest whole number; a cast saturates.
        let shown = (ticks * product / square + 0.5) as usize;
        let (least, most) = (clock - self.copies, clock + self.age);
        shown.min(most).min(MAX_BRIDGED + 1).max(least)
    }

    /// Fill the `ticks` to `end` with a straight line.
    fn bridge(&mut self, end: &JointMeasurement<N>, ticks: usize) {
        if ticks == 1 {
            return;
        }
        let mut between = self.last;
        let part = 1.0 / ticks as f32;
        let (q, tau) = ((end.q - between.q) * part, (end.tau - between.tau) * part);
        for _ in 1..ticks {
            between.q += q;
            between.tau += tau;
            self.append(&between);
        }
    }

    /// Add the measurement of a tick to the sample in progress; the last one completes it.
    fn append(&mut self, measurement: &JointMeasurement<N>) {
        self.last = *measurement;
        if self.ticks == 0 {
            self.sum = *measurement;
        } else {
            self.sum.q += measurement.q;
            self.sum.tau += measurement.tau;
        }
        self.ticks += 1;
        if self.ticks >= self.decimation {
            self.complete_sample();
        }
    }

    /// Append the mean of the sample in progress.
    fn complete_sample(&mut self) {
        let sum = self.sum;
        let part = 1.0 / self.ticks as f32;
        (self.ticks, self.since_sample) = (0, 0);
        for (q, &sum) in self.q.iter_mut().zip(sum.q.as_slice()) {
            let (first, second) = q.split_at_mut(TAPS);
            for half in [first, second] {
                if let Some(slot) = half.get_mut(self.next) {
                    *slot = part * sum;
                }
            }
        }
        self.next = (self.next + 1) % TAPS;
        self.tau[self.torque_next % TORQUES] = sum.tau * part;
        self.torque_next = (self.torque_next + 1) % TORQUES;
        self.filled = (self.filled + 1).min(TAPS);
        if self.is_full() && core::mem::take(&mut self.refill) {
            self.filled = self.filled.min(RECENT + 1);
        }
    }

    /// Motion and torque of the middle of the window; `None` before the window is full, and where a gap repeats a sample for a joint.
    ///
    /// Least-squares quadratic through the window, at its middle, with `k` in samples of length T and `y_k = q_k − q_0`:
    /// ```text
    /// qd  = Σ k y_k / Σk² / T      qdd = 2 Σ (k² − Σk²/Σ1) y_k / (Σk⁴ − (Σk²)²/Σ1) / T²
    /// q   = q_0 + (Σ y_k − Σk² · qdd T²/2) / Σ1
    /// ```
    /// [Savitzky and Golay 1964]. The centre is subtracted first: differences of neighbouring positions are exact in f32.
    ///
    /// * `inv_period` ticks per second, 1/s      * returns rad, rad/s, rad/s², N·m
    ///
    /// Cost: 5 multiply-adds a joint for each sample of the delay.
    #[inline(never)]
    pub fn conditioned(&self, inv_period: f32) -> Option<ConditionedSample<N>> {
        // No joint uses a sample twice: the newest one ended after the last turn of this joint.
        let fresh = self.since_sample < N;
        if !self.is_full() || !fresh {
            return None;
        }
        let inv_period = inv_period / self.decimation as f32;
        // Five divisions a row: kept in the window, they cost flash and no fewer instructions.
        let (delay, factors) = (self.delay as usize, FitFactors::new(self.delay));
        // After a push `next` is the slot of the oldest of all samples, and those of the window are the newest.
        let begin = (self.next + TAPS).checked_sub(2 * delay + 1)?;
        let mut motion = JointMotion::<N>::zero();
        for (joint, q) in self.q.iter().enumerate() {
            let (position, slope, curvature) = fit(q.get(begin..)?, delay, &factors)?;
            *motion.q.get_mut(joint)? = position;
            *motion.qd.get_mut(joint)? = slope * inv_period;
            *motion.qdd.get_mut(joint)? = curvature * inv_period * inv_period;
        }
        // After a push `torque_next` is the slot of the oldest torque.
        let middle = self.torque_next + TORQUES - 1 - delay;
        let reach = (AVERAGED / 2).checked_div(self.decimation as usize);
        let reach = reach.unwrap_or_default();
        let mut tau = JointVector::zeros();
        for place in middle.saturating_sub(reach)..=middle + reach {
            tau += self.tau[place % TORQUES];
        }
        tau *= 1.0 / (2 * reach + 1) as f32;
        Some(ConditionedSample { motion, tau })
    }
}

/// Gain of a motion filter of `taps` samples for cogging in the acceleration, at a cogging phase of `angle` rad a sample.
///
/// ```text
/// 15 j₂(x)/x² = 1 − x²/14 (1 − x²/36 (1 − x²/66 (1 − x²/104 (1 − x²/150 …)))),   x = angle · taps/2
/// ```
/// Second derivative of the quadratic fitted to a sine over ±x, over that of the sine; j₂ is the spherical Bessel
/// function, zero at 5.763. The gain of the 31 taps lies within 0.01 of it. It is 0 beyond that zero, 30 Hz with samples of 2 ms.
pub fn cogging_attenuation(angle: f32, taps: u32) -> f32 {
    let half = angle * (0.5 * taps as f32);
    let y = half * half;
    if y < ATTENUATION_END {
        let tail = 1.0 - y * (1.0 / 104.0) * (1.0 - y * (1.0 / 150.0));
        1.0 - y * (1.0 / 14.0) * (1.0 - y * (1.0 / 36.0) * (1.0 - y * (1.0 / 66.0) * tail))
    } else {
        0.0
    }
}

/// Value, first and second derivative (per tick) of the quadratic through the first 2 `delay` + 1 of `samples`, at their middle.
///
/// * `factors` of this delay
#[inline]
fn fit(samples: &[f32], delay: usize, factors: &FitFactors) -> Option<(f32, f32, f32)> {
    let (mut left, rest) = samples.split_at_checked(delay)?;
    let (&centre, right) = rest.split_first()?;
    let (mut distance, mut sum) = (0.0, 0.0);
    let mut first_moment = 0.0;
    let mut second_moment = 0.0;
    // Pairs at the same distance from the middle: their sum enters the even sums, their difference the odd one.
    for after in right.get(..delay)? {
        let before;
        (before, left) = left.split_last()?;
        distance += 1.0;
        let (after, before) = (after - centre, before - centre);
        let even = after + before;
        sum += even;
        first_moment += distance * (after - before);
        second_moment += distance * distance * even;
    }
    let half_curvature = (second_moment - factors.mean_square * sum) * factors.inv_curvature;
    let position = centre + (sum - factors.sum_2 * half_curvature) * factors.inv_sum_0;
    Some((
        position,
        first_moment * factors.inv_sum_2,
        2.0 * half_curvature,
    ))
}

fn is_finite<const N: usize>(measured: &JointMeasurement<N>) -> bool {
    // Slices: iterators of a matrix look for the end of a column at every entry.
    let [q, tau] = [&measured.q, &measured.tau].map(|it| it.as_slice());
    q.iter().all(|x| x.is_finite()) && tau.iter().all(|x| x.is_finite())
}

#[cfg(test)]
mod tests;
