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

/// Torque samples kept to delay them as the filter delays the motion; a power of two makes the index cheap.
const TORQUES: usize = DELAY + 1;
const _: () = assert!(TORQUES.is_power_of_two());

/// Motion and torque of the same instant, `DELAY` ticks ago.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Conditioned<const N: usize> {
    /// Smoothed position, and velocity and acceleration of the same quadratic.
    pub motion: JointMotion<N>,
    /// Torque as measured, delayed, not smoothed: its noise stays white.
    pub tau: JointVector<N>,
}

/// The last `TAPS` measurements, without a gap.
///
/// Positions are stored twice, `TAPS` apart, so that the window is one run of memory wherever it begins.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasurementWindow<const N: usize> {
    q: [[f32; 2 * TAPS]; N],
    tau: [JointVector<N>; TORQUES],
    next: usize,
    filled: usize,
    torque_next: usize,
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
        }
    }

    /// Forgets everything: what follows does not join on to what came before.
    pub fn reset(&mut self) {
        self.filled = 0;
    }

    /// Takes the measurement of the next tick. One that is missing or not finite is a gap and empties the window.
    pub fn push(&mut self, measured: Option<&JointMeasurement<N>>) {
        let Some(measured) = measured.filter(|m| is_finite(m)) else {
            self.reset();
            return;
        };
        for (q, &value) in self.q.iter_mut().zip(measured.q.as_slice()) {
            let (first, second) = q.split_at_mut(TAPS);
            for half in [first, second] {
                if let Some(slot) = half.get_mut(self.next) {
                    *slot = value;
                }
            }
        }
        self.next = (self.next + 1) % TAPS;
        self.tau[self.torque_next % TORQUES] = measured.tau;
        self.torque_next = (self.torque_next + 1) % TORQUES;
        self.filled = (self.filled + 1).min(TAPS);
    }

    /// Motion and torque `DELAY` ticks ago, once the window is full.
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
    pub fn conditioned(&self, inv_period: f32) -> Option<Conditioned<N>> {
        if self.filled < TAPS {
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
        Some(Conditioned {
            motion,
            tau: self.tau[self.torque_next % TORQUES],
        })
    }
}

impl<const N: usize> Default for MeasurementWindow<N> {
    fn default() -> Self {
        Self::new()
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
        let sum = |power: i32| {
            (-15..=15)
                .map(|k: i32| k.pow(power as u32) as f32)
                .sum::<f32>()
        };
        assert_eq!((SUM_0, SUM_2, SUM_4), (sum(0), sum(2), sum(4)));
    }

    #[test]
    fn a_quadratic_is_read_exactly_with_its_torque() {
        let period = 1e-3f64;
        let (q0, qd0, qdd0) = (5.5, -1.7, 9.0);
        let mut window = MeasurementWindow::<2>::new();
        for tick in 0..200 {
            let t = f64::from(tick) * period;
            let q = q0 + qd0 * t + 0.5 * qdd0 * t * t;
            window.push(Some(&at(q as f32, tick as f32)));
            let Some(seen) = window.conditioned(1e3) else {
                assert!(tick < 30);
                continue;
            };
            let then = t - 0.015;
            assert!(
                (f64::from(seen.motion.q[0]) - (q0 + qd0 * then + 0.5 * qdd0 * then * then)).abs()
                    < 1e-6
            );
            assert!((f64::from(seen.motion.qd[1]) + (qd0 + qdd0 * then)).abs() < 1e-4);
            // An f32 near 5.5 rad is rounded to 2.4e-7 rad; the second difference amplifies it 5000-fold a sample.
            assert!(
                (f64::from(seen.motion.qdd[0]) - qdd0).abs() < 5e-3,
                "{}",
                seen.motion.qdd[0]
            );
            assert_eq!(seen.tau[0], (tick - 15) as f32);
        }
    }

    #[test]
    fn another_period_scales_the_derivatives() {
        let mut window = MeasurementWindow::<2>::new();
        for tick in 0..40 {
            window.push(Some(&at(0.001 * tick as f32, 0.0)));
        }
        let slow = window.conditioned(500.0).unwrap().motion.qd[0];
        assert!((slow - 0.5).abs() < 1e-5, "{slow}");
    }

    #[test]
    fn a_gap_empties_the_window() {
        for bad in [None, Some(at(f32::NAN, 0.0)), Some(at(0.0, f32::INFINITY))] {
            let mut window = MeasurementWindow::<2>::new();
            for _ in 0..50 {
                window.push(Some(&at(1.0, 1.0)));
            }
            assert!(window.conditioned(1e3).is_some());
            window.push(bad.as_ref());
            for _ in 0..30 {
                assert!(window.conditioned(1e3).is_none());
                window.push(Some(&at(2.0, 1.0)));
            }
            window.push(Some(&at(2.0, 1.0)));
            assert!((window.conditioned(1e3).unwrap().motion.q[0] - 2.0).abs() < 1e-6);
        }
    }
}
