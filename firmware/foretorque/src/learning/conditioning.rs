use crate::joint::{JointMeasurement, JointMotion, JointVector, zero_vector};

/// Length of the smoothing filter, ticks.
pub const TAPS: usize = 31;
/// Delay of the conditioned signals: they describe the middle of the window.
pub const DELAY: usize = TAPS / 2;

// Sums over the window k = −DELAY … DELAY that the quadratic fit needs: Σ1, Σk², Σk⁴.
const SUM_0: f32 = TAPS as f32;
const SUM_2: f32 = (DELAY * (DELAY + 1) * TAPS / 3) as f32;
const SUM_4: f32 =
    (DELAY * (DELAY + 1) * TAPS / 3 * (3 * DELAY * DELAY + 3 * DELAY - 1) / 5) as f32;
const INV_SUM_2: f32 = 1.0 / SUM_2;
const INV_CURVATURE: f32 = 1.0 / (SUM_4 - SUM_2 * SUM_2 / SUM_0);

/// Where nothing of a ripple is left in the acceleration: square of the first zero of j₂.
const RIPPLE_END: f32 = 33.2;

/// Longest gap that is bridged, ticks. A straight line misses a quadratic by `qdd ((MAX_BRIDGED + 1) T)² / 8` at most: 30 µrad at
/// 10 rad/s² and 1 kHz, less than the steps of most encoders.
pub const MAX_BRIDGED: usize = 4;

/// Torque samples that are averaged around the middle of the window. One joint's row is learnt in a tick, so its next row is
/// six ticks away in an arm of six joints: a mean of five samples has news of five ticks for the price of one row. Over
/// ±2 ticks the torque is a straight line, but for cogging, which loses a tenth of its height at 1.5 rad/s and 202 cycles a
/// turn.
pub(super) const AVERAGED: usize = 5;
/// Torques kept to delay them as the filter delays the motion.
const TORQUES: usize = DELAY + 1 + AVERAGED / 2;

/// Motion and torque of the same instant, `DELAY` ticks ago.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConditionedSample<const N: usize> {
    /// Smoothed position, and velocity and acceleration of the same quadratic.
    pub motion: JointMotion<N>,
    /// Mean of five torques around that instant: the noise of means that have no sample in common is white.
    pub tau: JointVector<N>,
}

/// The last `TAPS` measurements, one for each tick.
///
/// A measurement that is missing is a gap. So is one that says to the last bit what the one before said, torque noise
/// and all: it came late, and the measurement of its tick is still on its way. The first one after a gap may have been
/// due in it and is not believed either: a position that is shifted by a tick bends the quadratic, and a torque that is
/// fitted to it is worse than none. A short gap is bridged with a straight line between its ends; an instant whose own torque
/// is such a guess has no row.
///
/// Positions are stored twice, `TAPS` apart, so that the window is one run of memory wherever it begins.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasurementWindow<const N: usize> {
    q: [[f32; 2 * TAPS]; N],
    tau: [JointVector<N>; TORQUES],
    next: usize,
    filled: usize,
    torque_next: usize,
    /// A bit for each tick, the newest lowest: it was measured, and not bridged.
    measured: u32,
    /// What arrived last, believed or not.
    newest: Option<JointMeasurement<N>>,
    /// Ticks since the last measurement that was believed.
    gap: usize,
}

impl<const N: usize> MeasurementWindow<N> {
    /// A window without measurements.
    pub const fn new() -> Self {
        Self {
            q: [[0.0; 2 * TAPS]; N],
            tau: [zero_vector(); TORQUES],
            next: 0,
            filled: 0,
            torque_next: 0,
            measured: 0,
            newest: None,
            gap: 0,
        }
    }

    /// Forgets everything: what follows does not join on to what came before.
    pub fn reset(&mut self) {
        self.filled = 0;
        self.gap = 0;
        self.newest = None;
    }

    /// All its ticks are known or bridged, but for a gap at its end that may still be bridged.
    pub fn is_whole(&self) -> bool {
        self.filled == TAPS
    }

    /// Takes the measurement of the next tick. One that is missing or not finite is a gap; a long gap empties the window.
    pub fn push(&mut self, measured: Option<&JointMeasurement<N>>) {
        let arrived = measured.copied().filter(is_finite);
        let before = core::mem::replace(&mut self.newest, arrived);
        let follows = self.filled == 0 || before.is_some();
        let believed = arrived.filter(|arrived| follows && before.as_ref() != Some(arrived));
        let Some(measured) = believed else {
            // A copy is as good as nothing: what comes next may be late as well.
            self.newest = self.newest.filter(|_| !follows);
            self.gap += 1;
            if self.filled == 0 || self.gap > MAX_BRIDGED {
                self.reset();
            }
            return;
        };
        self.bridge(&measured);
        self.append(&measured, true);
    }

    /// Fills the gap before `end` with a straight line.
    fn bridge(&mut self, end: &JointMeasurement<N>) {
        let steps = core::mem::take(&mut self.gap) + 1;
        if steps == 1 {
            return;
        }
        let newest = (self.next + TAPS - 1) % TAPS;
        let mut between = *end;
        for (start, q) in between.q.iter_mut().zip(&self.q) {
            *start = q.get(newest).copied().unwrap_or(*start);
        }
        between.tau = self.tau[(self.torque_next + TORQUES - 1) % TORQUES];
        let part = 1.0 / steps as f32;
        let (q, tau) = ((end.q - between.q) * part, (end.tau - between.tau) * part);
        for _ in 1..steps {
            between.q += q;
            between.tau += tau;
            self.append(&between, false);
        }
    }

    fn append(&mut self, seen: &JointMeasurement<N>, measured: bool) {
        for (q, &value) in self.q.iter_mut().zip(seen.q.as_slice()) {
            let (first, second) = q.split_at_mut(TAPS);
            for half in [first, second] {
                if let Some(slot) = half.get_mut(self.next) {
                    *slot = value;
                }
            }
        }
        self.next = (self.next + 1) % TAPS;
        self.tau[self.torque_next % TORQUES] = seen.tau;
        self.torque_next = (self.torque_next + 1) % TORQUES;
        self.measured = self.measured << 1 | u32::from(measured);
        self.filled = (self.filled + 1).min(TAPS);
    }

    /// Motion and torque `DELAY` ticks ago, once the window is full. None in a gap, and where the torque is missing.
    ///
    /// Least-squares quadratic through the window, at its middle, with `k` in ticks and `y_k = q_k − q_0`:
    /// ```text
    /// qd  = Σ k y_k / Σk² / T      qdd = 2 Σ (k² − Σk²/Σ1) y_k / (Σk⁴ − (Σk²)²/Σ1) / T²
    /// q   = q_0 + (Σ y_k − Σk² · qdd T²/2) / Σ1
    /// ```
    /// [Savitzky and Golay 1964]. The centre is subtracted first: differences of neighbouring positions are exact in
    /// f32, their sums of order q are not.
    ///
    /// * `inv_period` 1/T, 1/s      * returns rad, rad/s, rad/s², N·m
    ///
    /// Cost: `5 · DELAY` multiply-adds a joint.
    #[inline(never)]
    pub fn conditioned(&self, inv_period: f32) -> Option<ConditionedSample<N>> {
        let known = self.measured >> DELAY & 1 == 1;
        if self.filled < TAPS || self.gap > 0 || !known {
            return None;
        }
        let mut motion = JointMotion::<N>::zero();
        for (joint, q) in self.q.iter().enumerate() {
            // After a push `next` is the slot of the oldest measurement.
            let window: &[f32; TAPS] = q.get(self.next..)?.first_chunk()?;
            let (position, slope, curvature) = fit(window);
            *motion.q.get_mut(joint)? = position;
            *motion.qd.get_mut(joint)? = slope * inv_period;
            *motion.qdd.get_mut(joint)? = curvature * inv_period * inv_period;
        }
        // After a push `torque_next` is the slot of the oldest torque.
        let mut tau = JointVector::zeros();
        for age in 0..AVERAGED {
            tau += self.tau[(self.torque_next + age) % TORQUES];
        }
        tau *= 1.0 / AVERAGED as f32;
        Some(ConditionedSample { motion, tau })
    }
}

impl<const N: usize> Default for MeasurementWindow<N> {
    fn default() -> Self {
        Self::new()
    }
}

/// Part of a ripple in the acceleration that the filter lets through, the ripple turning by `angle` rad a tick; 0 from
/// where there is none on, 59 Hz at 1 kHz.
///
/// ```text
/// 15 j₂(x)/x² = 1 − x²/14 (1 − x²/36 (1 − x²/66 (1 − x²/104 (1 − x²/150 …)))),   x = angle · TAPS/2
/// ```
/// the second derivative of the quadratic that fits a sine over a window of ±x, over that of the sine; j₂ is the
/// spherical Bessel function, zero at 5.763. The sum over 31 taps lies within 0.01 of it.
pub fn cogging_attenuation(angle: f32) -> f32 {
    let half = angle * (0.5 * TAPS as f32);
    let y = half * half;
    if y < RIPPLE_END {
        let tail = 1.0 - y * (1.0 / 104.0) * (1.0 - y * (1.0 / 150.0));
        1.0 - y * (1.0 / 14.0) * (1.0 - y * (1.0 / 36.0) * (1.0 - y * (1.0 / 66.0) * tail))
    } else {
        0.0
    }
}

/// Value, first and second derivative (per tick) of the quadratic through `window`, at its middle.
#[inline]
fn fit(window: &[f32; TAPS]) -> (f32, f32, f32) {
    let centre = window[DELAY];
    let mut sum = 0.0;
    let mut first_moment = 0.0;
    let mut second_moment = 0.0;
    // Pairs at the same distance from the middle: the even sums see their sum, the odd one their difference.
    for k in 1..=DELAY {
        let distance = k as f32;
        let after = window[DELAY + k] - centre;
        let before = window[DELAY - k] - centre;
        let even = after + before;
        sum += even;
        first_moment += distance * (after - before);
        second_moment += distance * distance * even;
    }
    let half_curvature = (second_moment - SUM_2 / SUM_0 * sum) * INV_CURVATURE;
    let position = centre + (sum - SUM_2 * half_curvature) * (1.0 / SUM_0);
    (position, first_moment * INV_SUM_2, 2.0 * half_curvature)
}

fn is_finite<const N: usize>(measured: &JointMeasurement<N>) -> bool {
    measured
        .q
        .iter()
        .chain(measured.tau.iter())
        .all(|x| x.is_finite())
}

#[cfg(test)]
mod tests;
