use super::program::MotionBounds;
use super::series::{JointSeries, PreparedSeries};
use foretorque::joint::{JointMotion, JointVector};
use foretorque::math::sqrt;

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
            Self::Series => series.phase_step(),
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

    /// False at rest.
    pub(super) fn moving(&self) -> bool {
        self.left > 0
    }

    /// Sets the speed to 0.
    pub(super) fn rest(&mut self) {
        self.left = 0;
    }

    /// Sets the speed to 1.
    pub(super) fn start(&mut self) {
        (self.left, self.falling) = (self.ticks, false);
    }

    /// Starts the fall to 0.
    pub(super) fn stop(&mut self) {
        self.falling = true;
    }

    /// Advances by one tick.
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
