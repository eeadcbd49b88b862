use crate::joint::{JointMeasurement, JointMotion, JointVector, zero_vector};

/// Length of the motion filter, samples; a sample is the mean of [`LearnerConfig::decimation`] ticks.
///
/// [`LearnerConfig::decimation`]: crate::learning::LearnerConfig::decimation
pub const TAPS: usize = 31;
/// Delay of the motion filter, samples: its output describes the middle of the window.
pub const DELAY: usize = TAPS / 2;

// Sums over the window k = −DELAY … DELAY that the quadratic fit needs: Σ1, Σk², Σk⁴.
const SUM_0: f32 = TAPS as f32;
const SUM_2: f32 = (DELAY * (DELAY + 1) * TAPS / 3) as f32;
const SUM_4: f32 =
    (DELAY * (DELAY + 1) * TAPS / 3 * (3 * DELAY * DELAY + 3 * DELAY - 1) / 5) as f32;
const INV_SUM_2: f32 = 1.0 / SUM_2;
const INV_CURVATURE: f32 = 1.0 / (SUM_4 - SUM_2 * SUM_2 / SUM_0);

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

/// Motion and torque of the same instant, `DELAY` samples ago.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConditionedSample<const N: usize> {
    /// Position, velocity and acceleration of the fitted quadratic.
    pub motion: JointMotion<N>,
    /// Mean of the torques around that instant; noise of means without common samples is white.
    pub tau: JointVector<N>,
}

/// Motion filter: the last `TAPS` samples, each the mean of `decimation` ticks.
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
    /// Empty window of samples of `decimation` ticks, from 1 on.
    pub const fn new(decimation: u32) -> Self {
        let zero = JointMeasurement {
            q: zero_vector(),
            tau: zero_vector(),
        };
        Self {
            q: [[0.0; 2 * TAPS]; N],
            tau: [zero_vector(); TORQUES],
            next: 0,
            filled: 0,
            torque_next: 0,
            decimation,
            ticks: 0,
            sum: zero,
            last: zero,
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

    /// True before the first measurement.
    fn is_empty(&self) -> bool {
        self.filled == 0 && self.ticks == 0
    }

    /// True if every tick is measured or bridged; a gap at the end may still be open.
    pub fn is_full(&self) -> bool {
        self.filled == TAPS
    }

    /// True if the joints can be at `q` in the next tick: an encoder error is not.
    ///
    /// * `steps` largest change of each joint in a tick, rad
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
        self.ticks = 0;
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
        if self.filled == TAPS && core::mem::take(&mut self.refill) {
            self.filled = RECENT + 1;
        }
    }

    /// Motion and torque `DELAY` samples ago; `None` before the window is full, and where a gap repeats a sample for a joint.
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
    /// Cost: `5 · DELAY` multiply-adds a joint.
    #[inline(never)]
    pub fn conditioned(&self, inv_period: f32) -> Option<ConditionedSample<N>> {
        // No joint uses a sample twice.
        let fresh = self.gap == 0 || self.gap + self.decimation as usize <= N;
        if self.filled < TAPS || !fresh {
            return None;
        }
        let inv_period = inv_period / self.decimation as f32;
        let mut motion = JointMotion::<N>::zero();
        for (joint, q) in self.q.iter().enumerate() {
            // After a push `next` is the slot of the oldest measurement.
            let window: &[f32; TAPS] = q.get(self.next..)?.first_chunk()?;
            let (position, slope, curvature) = fit(window);
            *motion.q.get_mut(joint)? = position;
            *motion.qd.get_mut(joint)? = slope * inv_period;
            *motion.qdd.get_mut(joint)? = curvature * inv_period * inv_period;
        }
        // After a push `torque_next` is the slot of the oldest torque, `AVERAGED / 2` before the middle of the window.
        let reach = ((AVERAGED / 2) as u32).checked_div(self.decimation);
        let reach = reach.unwrap_or_default();
        let mut tau = JointVector::zeros();
        for age in 0..AVERAGED {
            if (age as u32).abs_diff((AVERAGED / 2) as u32) <= reach {
                tau += self.tau[(self.torque_next + age) % TORQUES];
            }
        }
        tau *= 1.0 / (2 * reach + 1) as f32;
        Some(ConditionedSample { motion, tau })
    }
}

/// Gain of the motion filter for cogging in the acceleration, at a cogging phase of `angle` rad a sample.
///
/// ```text
/// 15 j₂(x)/x² = 1 − x²/14 (1 − x²/36 (1 − x²/66 (1 − x²/104 (1 − x²/150 …)))),   x = angle · TAPS/2
/// ```
/// Second derivative of the quadratic fitted to a sine over ±x, over that of the sine; j₂ is the spherical Bessel
/// function, zero at 5.763. The gain of the 31 taps lies within 0.01 of it. It is 0 beyond that zero, 30 Hz with samples of 2 ms.
pub fn cogging_attenuation(angle: f32) -> f32 {
    let half = angle * (0.5 * TAPS as f32);
    let y = half * half;
    if y < ATTENUATION_END {
        let tail = 1.0 - y * (1.0 / 104.0) * (1.0 - y * (1.0 / 150.0));
        1.0 - y * (1.0 / 14.0) * (1.0 - y * (1.0 / 36.0) * (1.0 - y * (1.0 / 66.0) * tail))
    } else {
        0.0
    }
}

/// Distances from the middle of the window, ticks, and their squares.
const DISTANCES: [[f32; 2]; DELAY] = {
    let (mut distances, mut k) = ([[0.0; 2]; DELAY], 0);
    while k < DELAY {
        let distance = (k + 1) as f32;
        distances[k] = [distance, distance * distance];
        k += 1;
    }
    distances
};

/// Value, first and second derivative (per tick) of the quadratic through `window`, at its middle.
#[inline]
fn fit(window: &[f32; TAPS]) -> (f32, f32, f32) {
    let centre = window[DELAY];
    let mut sum = 0.0;
    let mut first_moment = 0.0;
    let mut second_moment = 0.0;
    // Pairs at the same distance from the middle: their sum enters the even sums, their difference the odd one.
    let sides = window[..DELAY].iter().rev().zip(&window[DELAY + 1..]);
    for ((before, after), [distance, square]) in sides.zip(&DISTANCES) {
        let (after, before) = (after - centre, before - centre);
        let even = after + before;
        sum += even;
        first_moment += distance * (after - before);
        second_moment += square * even;
    }
    let half_curvature = (second_moment - SUM_2 / SUM_0 * sum) * INV_CURVATURE;
    let position = centre + (sum - SUM_2 * half_curvature) * (1.0 / SUM_0);
    (position, first_moment * INV_SUM_2, 2.0 * half_curvature)
}

fn is_finite<const N: usize>(measured: &JointMeasurement<N>) -> bool {
    // Slices: iterators of a matrix look for the end of a column at every entry.
    let [q, tau] = [&measured.q, &measured.tau].map(|it| it.as_slice());
    q.iter().all(|x| x.is_finite()) && tau.iter().all(|x| x.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(q: f32, tau: f32) -> JointMeasurement<2> {
        JointMeasurement {
            q: [q, -q].into(),
            tau: [tau, -tau].into(),
        }
    }

    #[test]
    fn the_sums_are_those_of_the_window() {
        let sum = |power| (-15..=15).map(|k: i32| k.pow(power) as f32).sum::<f32>();
        assert_eq!((SUM_0, SUM_2, SUM_4), (sum(0), sum(2), sum(4)));
    }

    #[test]
    fn a_quadratic_is_read_exactly_with_its_torque() {
        let period = 1e-3f64;
        let (q0, qd0, qdd0) = (5.5, -1.7, 9.0);
        let mut window = MeasurementWindow::<2>::new(1);
        for tick in 0..200 {
            let t = f64::from(tick) * period;
            let q = q0 + qd0 * t + 0.5 * qdd0 * t * t;
            window.push(Some(&at(q as f32, tick as f32)));
            let Some(seen) = window.conditioned(1e3) else {
                assert!(tick < 30);
                continue;
            };
            let then = t - 0.015;
            let q = q0 + qd0 * then + 0.5 * qdd0 * then * then;
            assert!((f64::from(seen.motion.q[0]) - q).abs() < 1e-6);
            assert!((f64::from(seen.motion.qd[1]) + (qd0 + qdd0 * then)).abs() < 1e-4);
            // An f32 near 5.5 rad is rounded to 2.4e-7 rad; the second difference amplifies it 5000-fold a sample.
            let qdd = f64::from(seen.motion.qdd[0]);
            assert!((qdd - qdd0).abs() < 5e-3, "{qdd}");
            assert_eq!(seen.tau[0], (tick - 15) as f32);
        }
    }

    #[test]
    fn a_sample_of_several_ticks_is_their_mean_and_belongs_to_its_middle() {
        for decimation in [1u32, 2, 4] {
            let mut window = MeasurementWindow::<2>::new(decimation);
            let mut rows = 0;
            for tick in 0..400 {
                let t = 1e-3 * tick as f32;
                window.push(Some(&at(2.0 * t * t, tick as f32)));
                let Some(seen) = window.conditioned(1e3) else {
                    assert!(tick < 31 * decimation, "{decimation}: {tick}");
                    continue;
                };
                rows += 1;
                // Motion and torque are of the same instant, whatever the delay.
                let then = 1e-3 * seen.tau[0];
                assert!((seen.motion.qd[0] - 4.0 * then).abs() < 2e-3);
                assert!((seen.motion.qdd[0] - 4.0).abs() < 0.05);
            }
            assert!(rows > 250, "{rows}");
        }
    }

    #[test]
    fn cogging_passes_the_filter_with_the_stated_gain() {
        for angle in [0.01f32, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.6] {
            let mut window = MeasurementWindow::<2>::new(1);
            for tick in 0..TAPS {
                let phase = angle * (tick as f32 - DELAY as f32);
                window.push(Some(&at(phase.cos(), tick as f32)));
            }
            let seen = window.conditioned(1.0).expect("the window is full");
            let gain = -seen.motion.qdd[0] / (angle * angle);
            let stated = cogging_attenuation(angle);
            let allowed = if angle > 0.3 { 0.05 } else { 0.01 };
            let error = (gain - stated).abs();
            assert!(error < allowed, "{angle}: {gain} {stated}");
        }
    }

    #[test]
    fn another_period_scales_the_derivatives() {
        let mut window = MeasurementWindow::<2>::new(1);
        for tick in 0..40 {
            window.push(Some(&at(0.001 * tick as f32, 0.0)));
        }
        let slow = window.conditioned(500.0).unwrap().motion.qd[0];
        assert!((slow - 0.5).abs() < 1e-5, "{slow}");
    }

    /// Swinging joint whose torque is the number of the tick.
    fn swinging(tick: usize) -> JointMeasurement<2> {
        at((0.003 * tick as f32).sin(), tick as f32)
    }

    /// Output of a window after each of 200 ticks, with the measurements of `arrives`.
    fn outputs(
        arrives: impl Fn(usize) -> Option<JointMeasurement<2>>,
    ) -> std::vec::Vec<Option<ConditionedSample<2>>> {
        let mut window = MeasurementWindow::<2>::new(1);
        let output = |tick| {
            window.push(arrives(tick).as_ref());
            window.conditioned(1e3)
        };
        (0..200).map(output).collect()
    }

    #[test]
    fn a_short_gap_is_bridged() {
        let whole = outputs(|tick| Some(swinging(tick)));
        let whole_at = |tick: usize| whole[tick].unwrap();
        let not_a_number = JointMeasurement {
            tau: JointVector::<2>::new(f32::NAN, 0.0),
            ..swinging(0)
        };
        for (missing, length) in [(None, 1), (None, 3), (Some(not_a_number), 2)] {
            let gap = 100..100 + length;
            let seen = outputs(|tick| match gap.contains(&tick) {
                true => missing,
                false => Some(swinging(tick)),
            });
            for (tick, (seen, whole)) in seen.iter().zip(&whole).enumerate().skip(30) {
                if gap.contains(&tick) {
                    // Two joints, so the sample before the gap serves one more tick.
                    assert_eq!(*seen, (tick == 100).then(|| whole_at(99)), "{tick}");
                    continue;
                }
                let (seen, whole) = (seen.unwrap(), whole.unwrap());
                assert!((seen.tau - whole.tau).amax() < 1e-4);
                assert!((seen.motion.q - whole.motion.q).amax() < 2e-5);
                assert!((seen.motion.qdd - whole.motion.qdd).amax() < 0.2, "{tick}");
            }
        }
    }

    /// Sensors read in every second and third tick; reports 0 to 2 ticks old, the newest first; reports late by one tick, some
    /// of them with the one before.
    #[test]
    fn measurements_of_uneven_age_give_rows_in_every_tick() {
        let age = |tick: usize| [0, 2, 1, 0, 0, 1, 2, 2, 0, 1][tick % 10];
        let newest = |tick: usize| (0..=tick).map(|tick| tick.saturating_sub(age(tick))).max();
        let late = |tick: usize| tick - usize::from(matches!(tick % 23, 6 | 12 | 13));
        let cases: [(&str, &dyn Fn(usize) -> usize); 4] = [
            ("every second", &|tick| tick - tick % 2),
            ("every third", &|tick| tick - tick % 3),
            ("by chance", &|tick| newest(tick).unwrap_or(0)),
            ("late", &late),
        ];
        for (name, measured_at) in cases {
            let mut rows = [0; 2];
            let seen = outputs(|tick| Some(swinging(measured_at(tick))));
            for (tick, seen) in seen.iter().enumerate() {
                let Some(ConditionedSample { motion, tau }) = seen else {
                    continue;
                };
                rows[tick % 2] += 1;
                // The torque is the tick of the instant.
                let (sine, cosine) = (0.003 * tau[0]).sin_cos();
                // At the times of their arrival, late measurements err by 0.04 rad/s and 11 rad/s².
                let (qd, qdd) = (motion.qd[0] - 3.0 * cosine, motion.qdd[0] + 9.0 * sine);
                let right = qd.abs() < 0.001 && qdd.abs() < 0.01;
                assert!(right, "{name}: {tick}: {qd} {qdd}");
            }
            assert!(rows.iter().all(|&rows| rows > 25), "{name}: {rows:?}");
        }
    }

    #[test]
    fn a_long_gap_empties_the_window() {
        let mut window = MeasurementWindow::<2>::new(1);
        for tick in 0..50 {
            window.push(Some(&swinging(tick)));
        }
        for gap in 1..=MAX_BRIDGED {
            window.push(None);
            // A sample serves each of two joints once.
            assert_eq!(window.conditioned(1e3).is_some(), gap < 2, "{gap}");
            assert!(window.is_full());
        }
        window.push(None);
        for tick in 60..90 {
            assert!(!window.is_full() && window.conditioned(1e3).is_none());
            window.push(Some(&swinging(tick)));
        }
        window.push(Some(&swinging(90)));
        assert_eq!(window.conditioned(1e3).unwrap().tau[0], 75.0);
    }

    #[test]
    fn after_a_long_gap_of_copies_the_window_fills_twice() {
        let mut window = MeasurementWindow::<2>::new(1);
        (0..50).for_each(|tick| window.push(Some(&swinging(tick))));
        for _ in 0..=MAX_BRIDGED {
            window.push(Some(&swinging(49)));
        }
        let empty = |tick: &usize| {
            window.push(Some(&swinging(*tick)));
            !window.is_full()
        };
        let first = 55;
        let filling = (first..).take_while(empty).count() + 1;
        assert_eq!(filling, 2 * TAPS - RECENT - 1);
    }
}
