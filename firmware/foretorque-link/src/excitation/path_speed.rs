use super::path::seconds_to_ticks;
use super::program::MotionBounds;

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
