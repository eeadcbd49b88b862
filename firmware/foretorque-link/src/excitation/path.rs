use super::MotionBounds;
use crate::div_u64_by_u32;
use foretorque::joint::{JointMotion, JointVector};
use foretorque::math::{sin_cos, sqrt};
use serde::{Deserialize, Serialize};

/// Speed and acceleration of the approach, parts of the certified ones.
const APPROACH_SHARE: f32 = 0.25;
/// Shortest approach, s.
const APPROACH_S: f32 = 0.25;
/// Phase of a whole path.
const WHOLE: f32 = 4_294_967_296.0;

/// Path of the phase, which counts units of 2⁻³² of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Path<const N: usize> {
    /// A quintic at rest at both ends, over `1 / inv_time_s`.
    Approach {
        from: JointVector<N>,
        to: JointVector<N>,
        inv_time_s: f32,
        phase_step: u32,
    },
    /// The series.
    Series,
}

impl<const N: usize> Path<N> {
    /// Approach from `from` to `to`, at a quarter of the certified speed and acceleration.
    ///
    /// * `tick_us` period of the tick, µs
    pub(super) fn approach(
        from: JointVector<N>,
        to: JointVector<N>,
        certificate: &[MotionBounds; N],
        tick_us: u32,
    ) -> Self {
        let time_s = approach_s(&(to - from), certificate);
        let ticks = seconds_to_ticks(time_s, tick_us);
        Self::Approach {
            from,
            to,
            inv_time_s: 1.0 / time_s,
            phase_step: u32::MAX.checked_div(ticks).unwrap_or(u32::MAX),
        }
    }

    /// Phase step of one tick at full speed.
    pub(super) fn phase_step(&self, series: &PreparedSeries) -> u32 {
        match self {
            Self::Approach { phase_step, .. } => *phase_step,
            Self::Series => series.phase_step,
        }
    }

    /// Motion at `phase`, at full speed.
    pub(super) fn at(
        &self,
        phase: u32,
        series: &PreparedSeries,
        joints: &[JointSeries; N],
    ) -> JointMotion<N> {
        let Self::Approach {
            from,
            to,
            inv_time_s,
            ..
        } = self
        else {
            return series.at(joints, phase);
        };
        let s = phase as f32 * (1.0 / WHOLE);
        let way = to - from;
        let (s2, rest) = (s * s, 1.0 - s);
        JointMotion {
            q: from + way * (s2 * s * (10.0 + s * (6.0 * s - 15.0))),
            qd: way * (30.0 * s2 * rest * rest * inv_time_s),
            qdd: way * (60.0 * s * rest * (1.0 - 2.0 * s) * inv_time_s * inv_time_s),
        }
    }
}

/// Time for `way`, s: quintics have peaks of 1.875 way / T and 5.7735 way / T².
fn approach_s<const N: usize>(way: &JointVector<N>, certificate: &[MotionBounds; N]) -> f32 {
    let mut longest = APPROACH_S;
    for (way, bounds) in way.iter().zip(certificate) {
        let speed = APPROACH_SHARE * bounds.velocity_rad_s;
        let acceleration = APPROACH_SHARE * bounds.acceleration_rad_s2;
        for time in [
            1.875 * way.abs() / speed,
            sqrt(5.7735 * way.abs() / acceleration),
        ] {
            if time > longest {
                longest = time;
            }
        }
    }
    longest
}

/// Whole ticks in `seconds`, at least one, because callers divide by them.
pub(super) fn seconds_to_ticks(seconds: f32, tick_us: u32) -> u32 {
    let ticks = (seconds * 1e6 / tick_us as f32) as u32;
    if ticks == 0 { 1 } else { ticks }
}

/// Acceleration that stopping adds, parts of the certified one.
pub(super) const STOP_SHARE: f32 = 0.5;
/// Shortest and longest stopping time, s.
pub(super) const STOP_S: (f32, f32) = (0.25, 5.0);

/// Path speed σ: 1, falling to 0 as a smooth step, or 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PathSpeed {
    /// Ticks from full speed to rest.
    ticks: u32,
    /// Ticks that are left of them.
    left: u32,
    falling: bool,
}

impl PathSpeed {
    /// At rest, with nothing to play.
    pub(super) const NONE: Self = Self {
        ticks: 1,
        left: 0,
        falling: false,
    };

    /// Sets the stopping time so that a stop adds half of the certified acceleration. Only at rest.
    ///
    /// * `tick_us` period of the tick, µs
    pub(super) fn prepare<const N: usize>(
        &mut self,
        certificate: &[MotionBounds; N],
        tick_us: u32,
    ) {
        self.ticks = seconds_to_ticks(stop_s(certificate), tick_us);
    }

    pub(super) fn moving(&self) -> bool {
        self.left > 0
    }

    pub(super) fn rest(&mut self) {
        self.left = 0;
    }

    pub(super) fn start(&mut self) {
        (self.left, self.falling) = (self.ticks, false);
    }

    pub(super) fn stop(&mut self) {
        self.falling = true;
    }

    pub(super) fn advance(&mut self) {
        if self.falling {
            self.left = self.left.saturating_sub(1);
        }
    }

    /// σ, and its derivative, 1/s.
    // Called twice in a tick; a second copy costs 100 B of flash.
    #[inline(never)]
    pub(super) fn now(&self, tick_us: u32) -> (f32, f32) {
        let part = self.left as f32 / self.ticks as f32;
        let speed = part * part * (3.0 - 2.0 * part);
        if !self.falling {
            return (speed, 0.0);
        }
        let ramp_s = self.ticks as f32 * (tick_us as f32 * 1e-6);
        (speed, -6.0 * part * (1.0 - part) / ramp_s)
    }
}

/// Stopping time, s: a smooth step of duration T has a slope of 1.5 / T at most.
pub(super) fn stop_s<const N: usize>(certificate: &[MotionBounds; N]) -> f32 {
    let times = certificate
        .iter()
        .map(|bounds| 1.5 * bounds.velocity_rad_s / (STOP_SHARE * bounds.acceleration_rad_s2));
    times.fold(STOP_S.0, f32::max)
}

/// Harmonics of the series, N of eq. 17.
pub const HARMONICS: usize = 5;

/// The finite Fourier series of one joint (eq. 17): 2 · 5 + 1 coefficients.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct JointSeries {
    /// Offset, rad.
    pub q0_rad: f32,
    /// Sine amplitudes of the position line, rad/s.
    pub a_rad_s: [f32; HARMONICS],
    /// Cosine amplitudes of the position line, rad/s.
    pub b_rad_s: [f32; HARMONICS],
}

impl JointSeries {
    /// All coefficients, offset first.
    pub(super) fn coefficients(&self) -> impl Iterator<Item = f32> {
        let swings = self.a_rad_s.into_iter().chain(self.b_rad_s);
        core::iter::once(self.q0_rad).chain(swings)
    }
}

/// Harmonics of a period, prepared for the tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PreparedSeries {
    /// ω l, rad/s.
    pub(super) rate: [f32; HARMONICS],
    /// 1 / (ω l), s/rad.
    inv_rate: [f32; HARMONICS],
    /// Phase step of one tick, in units of 2⁻³² periods.
    phase_step: u32,
}

impl PreparedSeries {
    /// * `period_us` period of the fundamental, µs, more than two ticks      * `tick_us` period of the tick, µs
    pub fn new(period_us: u32, tick_us: u32) -> Self {
        let omega = core::f32::consts::TAU / (period_us as f32 * 1e-6);
        let mut rate = [0.0; HARMONICS];
        let mut inv_rate = [0.0; HARMONICS];
        let mut harmonic = 0.0;
        for (rate, inv_rate) in rate.iter_mut().zip(&mut inv_rate) {
            harmonic += 1.0;
            *rate = omega * harmonic;
            *inv_rate = 1.0 / *rate;
        }
        let period = period_us.max(1);
        let tick = (u64::from(tick_us) << 32) + u64::from(period / 2);
        Self {
            rate,
            inv_rate,
            phase_step: div_u64_by_u32(tick, period),
        }
    }

    /// Motion of all joints at `phase`, in units of 2⁻³² periods.
    ///
    /// The harmonics follow from one sine and cosine: sin (l+1)x = sin lx cos x + cos lx sin x. Each step adds the error of
    /// the first pair once more.
    ///
    /// Error against the exact series: ≤ 1e-6 of Σ (|a| + |b|) for the velocity, and of the corresponding sums for position
    /// and acceleration; position adds one unit in the last place of q0.
    /// Cost: one `sin_cos`, 16 multiply-adds for the harmonics, 50 a joint.
    pub fn at<const N: usize>(&self, joints: &[JointSeries; N], phase: u32) -> JointMotion<N> {
        /// π / 2³¹: from a phase as a signed number to −π … π, where `sin_cos` is most accurate.
        const RAD: f32 = core::f32::consts::PI / 2_147_483_648.0;
        let first = sin_cos(phase.cast_signed() as f32 * RAD);
        let (mut sin, mut cos) = (first.sin, first.cos);
        let mut waves = [(0.0, 0.0); HARMONICS];
        for wave in &mut waves {
            *wave = (sin, cos);
            (sin, cos) = (
                sin * first.cos + cos * first.sin,
                cos * first.cos - sin * first.sin,
            );
        }
        let motion = |series: &JointSeries| {
            let (mut q, mut qd, mut qdd) = (0.0, 0.0, 0.0);
            let swings = series.a_rad_s.iter().zip(&series.b_rad_s);
            let rates = self.rate.iter().zip(&self.inv_rate);
            for (((a, b), (rate, inv_rate)), (sin, cos)) in swings.zip(rates).zip(&waves) {
                q += (a * sin - b * cos) * inv_rate;
                qd += a * cos + b * sin;
                qdd += (b * cos - a * sin) * rate;
            }
            // The offset last: it is the largest, and would round off each of the others.
            (series.q0_rad + q, qd, qdd)
        };
        let mut out = JointMotion::<N> {
            q: JointVector::zeros(),
            qd: JointVector::zeros(),
            qdd: JointVector::zeros(),
        };
        let slots = out.q.iter_mut().zip(out.qd.iter_mut());
        for ((series, (q, qd)), qdd) in joints.iter().zip(slots).zip(out.qdd.iter_mut()) {
            (*q, *qd, *qdd) = motion(series);
        }
        out
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use core::f64::consts::TAU;

    /// A series at rest at both ends: Σ a = 0, Σ l b = 0.
    pub(in crate::excitation) const SWING: JointSeries = JointSeries {
        q0_rad: -1.2,
        a_rad_s: [0.5, -0.9, 0.3, 0.4, -0.3],
        b_rad_s: [0.7, -0.2, 0.1, 0.1, -0.2],
    };

    /// The series in f64, from the sine of each harmonic.
    fn exact(series: &JointSeries, turn: f64, omega: f64) -> [f64; 3] {
        let mut out = [f64::from(series.q0_rad), 0.0, 0.0];
        for l in 0..HARMONICS {
            let rate = omega * (l + 1) as f64;
            let (sin, cos) = (TAU * turn * (l + 1) as f64).sin_cos();
            let (a, b) = (f64::from(series.a_rad_s[l]), f64::from(series.b_rad_s[l]));
            out[0] += (a * sin - b * cos) / rate;
            out[1] += a * cos + b * sin;
            out[2] += rate * (b * cos - a * sin);
        }
        out
    }

    #[test]
    fn the_series_keeps_its_error_bound_over_the_period() {
        for period_us in [2_000_000, 10_000_000, 33_333_333] {
            let series = PreparedSeries::new(period_us, 1000);
            let omega = TAU / (f64::from(period_us) * 1e-6);
            // Bounds of position, velocity and acceleration.
            let mut scale = [0.0; 3];
            for l in 0..HARMONICS {
                let size = f64::from(SWING.a_rad_s[l].abs() + SWING.b_rad_s[l].abs());
                let rate = omega * (l + 1) as f64;
                scale[0] += size / rate;
                scale[1] += size;
                scale[2] += size * rate;
            }
            let mut worst = [0.0_f64; 3];
            for k in 0..100_003_u32 {
                let phase = k.wrapping_mul(42_949);
                let motion = series.at(&[SWING], phase);
                let exact = exact(&SWING, f64::from(phase) / 4_294_967_296.0, omega);
                let seen = [motion.q[0], motion.qd[0], motion.qdd[0]];
                for line in 0..3 {
                    worst[line] = worst[line].max((f64::from(seen[line]) - exact[line]).abs());
                }
            }
            for ((worst, scale), least) in worst.iter().zip(scale).zip([1.2e-7, 0.0, 0.0]) {
                assert!(*worst <= 1e-6 * scale + least, "{period_us}: {worst}");
            }
        }
    }

    #[test]
    fn a_period_of_ticks_is_a_turn_of_the_phase() {
        for (period_us, tick_us) in [(10_000_000, 1000), (2_000_000, 100), (30_000_000, 2000)] {
            let series = PreparedSeries::new(period_us, tick_us);
            let ticks = period_us / tick_us;
            let whole = u64::from(series.phase_step) * u64::from(ticks);
            let off = whole.abs_diff(1 << 32) as f64 / 4_294_967_296.0;
            assert!(off <= 0.5 * f64::from(ticks) / 4_294_967_296.0, "{off}");
        }
    }

    #[test]
    fn velocity_and_acceleration_are_derivatives_of_position() {
        let series = PreparedSeries::new(10_000_000, 1000);
        let h = 2e-3_f32;
        let step = series.phase_step * 2;
        for k in 0..50_u32 {
            let phase = k * 85_899_345;
            let at = |phase| series.at(&[SWING], phase);
            let (before, now, after) = (
                at(phase.wrapping_sub(step)),
                at(phase),
                at(phase.wrapping_add(step)),
            );
            let slope = |after: f32, before: f32| (after - before) / (2.0 * h);
            assert!((slope(after.q[0], before.q[0]) - now.qd[0]).abs() < 2e-4);
            assert!((slope(after.qd[0], before.qd[0]) - now.qdd[0]).abs() < 2e-3);
        }
    }
}
