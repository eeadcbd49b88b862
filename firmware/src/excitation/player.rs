use super::check;
use super::program::{AbortReason, ExcitationError, ExcitationProgram, PlayLimits};
use super::series::PreparedSeries;
use crate::arm::Arm;
use crate::joint::{JointMotion, JointSample, JointVector};
use crate::math::sqrt;
use serde::{Deserialize, Serialize};

/// Where an excitation stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Stage {
    /// None is loaded.
    Empty,
    /// It is being checked, some points a tick.
    Checking,
    /// It may be started.
    Ready,
    /// It failed the check.
    Refused(ExcitationError),
    /// On the way from where the arm was to where the series begins.
    Approaching,
    /// The series is played.
    Playing,
    /// Coming to rest on the path, because it was told to.
    Stopping,
    /// At rest, and still in charge of the desired motion.
    Holding,
    /// A limit was met: coming to rest, or at rest, and still in charge.
    Aborted(AbortReason),
}

impl Stage {
    /// The player decides the desired motion.
    pub const fn in_charge(self) -> bool {
        matches!(
            self,
            Self::Approaching | Self::Playing | Self::Stopping | Self::Holding | Self::Aborted(_)
        )
    }
}

/// What a host can ask of the player.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Cue {
    /// Where does it stand?
    Status,
    /// Begin: once the check has passed, from where the host holds the arm, in the next tick that has a measurement.
    Start,
    /// Come to rest on the path.
    Stop,
    /// Give the desired motion back to the host. Only at rest.
    Release,
}

/// Part of the certified speed and acceleration that the approach uses.
const APPROACH_SHARE: f32 = 0.25;
/// Part of the certified acceleration that stopping adds.
const STOP_SHARE: f32 = 0.5;
/// Shortest and longest time in which the path speed goes to zero, s.
const STOP_S: (f32, f32) = (0.25, 5.0);
/// Shortest approach, s.
const APPROACH_S: f32 = 0.25;
/// Measured speed that is too fast, in units of the joint's limit: encoder noise sits on top of it.
const OVERSPEED: f32 = 1.2;
/// Speed in which the host may hold the arm when the player takes over, rad/s.
const HANDOVER_RAD_S: f32 = 0.02;
/// A whole path, in units of its phase.
const WHOLE: f32 = 4_294_967_296.0;

/// Which path the phase runs along.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Path<const N: usize> {
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

/// What the player carries from tick to tick.
#[derive(Clone, Copy, Debug, PartialEq)]
struct PlayerState<const N: usize> {
    stage: Stage,
    /// Points checked.
    checked: u32,
    /// A start waits for the check, or for a measurement.
    wanted: bool,
    path: Path<N>,
    /// Place on the path, in units of 2⁻³² of it.
    phase: u32,
    /// Periods begun.
    periods: u16,
    /// Path speed, as ticks of the ramp: `ramp_ticks` is full speed.
    ramp: u32,
    falling: bool,
    blind: u32,
    /// What was asked of the arm for the tick that is measured now.
    last: JointMotion<N>,
    measured: Option<JointVector<N>>,
}

/// Plays one excitation: loaded, checked, started, watched, stopped.
///
/// Stopping slows the path down instead of leaving it: with the path speed σ going from 1 to 0 as a smooth step, velocity
/// is q′ σ and acceleration q″ σ² + q′ σ̇, so a stop adds at most half of the certified acceleration.
pub struct Player<const N: usize> {
    limits: PlayLimits<N>,
    arm_hash: u32,
    tick_us: u32,
    program: ExcitationProgram<N>,
    series: PreparedSeries,
    ramp_ticks: u32,
    state: PlayerState<N>,
}

impl<const N: usize> Player<N> {
    /// A player with nothing to play.
    ///
    /// * `tick_us` period of the tick, µs
    pub fn new<A: Arm<N, P>, const P: usize>(tick_us: u32) -> Self {
        Self {
            limits: PlayLimits::for_arm::<A, P>(tick_us),
            arm_hash: A::HASH,
            tick_us,
            program: ExcitationProgram::EMPTY,
            series: PreparedSeries::new(1_000_000, tick_us),
            ramp_ticks: 1,
            state: PlayerState {
                stage: Stage::Empty,
                checked: 0,
                wanted: false,
                path: Path::Series,
                phase: 0,
                periods: 0,
                ramp: 0,
                falling: false,
                blind: 0,
                last: JointMotion::zero(),
                measured: None,
            },
        }
    }

    /// Where it stands.
    pub fn stage(&self) -> Stage {
        self.state.stage
    }

    /// What was asked of the arm last, while the player is in charge.
    pub fn desired(&self) -> Option<&JointMotion<N>> {
        self.state.stage.in_charge().then_some(&self.state.last)
    }

    /// Takes `program`; its check begins with the next tick.
    ///
    /// Errors: what can be seen at once; then the one before stays. `Running` while the player is in charge.
    pub fn load(&mut self, program: &ExcitationProgram<N>) -> Result<(), ExcitationError> {
        if self.state.stage.in_charge() {
            return Err(ExcitationError::Running);
        }
        check::at_once(program, &self.limits, self.arm_hash, self.tick_us)?;
        let series = PreparedSeries::new(program.period_us, self.tick_us);
        check::begins_at_rest(program, &series)?;
        self.program = *program;
        self.series = series;
        self.ramp_ticks = self.seconds_to_ticks(stop_s(program));
        self.state.stage = Stage::Checking;
        self.state.checked = 0;
        self.state.wanted = false;
        Ok(())
    }

    /// Does what a host asks.
    ///
    /// Errors: `NotLoaded`; the reason of a refused program; `Running` when it cannot be started or released now.
    pub fn cue(&mut self, cue: Cue) -> Result<(), ExcitationError> {
        match (cue, self.state.stage) {
            (Cue::Status, _) => Ok(()),
            (_, Stage::Empty) => Err(ExcitationError::NotLoaded),
            (_, Stage::Refused(reason)) => Err(reason),
            (Cue::Start, _) => {
                if self.moving() {
                    return Err(ExcitationError::Running);
                }
                self.state.wanted = true;
                Ok(())
            }
            (Cue::Stop, stage) => {
                self.state.wanted = false;
                if matches!(stage, Stage::Approaching | Stage::Playing) {
                    self.state.stage = Stage::Stopping;
                    self.state.falling = true;
                }
                Ok(())
            }
            (Cue::Release, stage) => {
                if self.moving() {
                    return Err(ExcitationError::Running);
                }
                if stage.in_charge() {
                    self.state.stage = Stage::Ready;
                }
                self.state.wanted = false;
                Ok(())
            }
        }
    }

    /// The desired motion of the tick to come, if the player is in charge of it.
    ///
    /// * `sample` what came in this tick: the measurement is watched, and a start begins where the host holds the arm
    ///
    /// Cost: four points of the check, or one of the path; a `sin_cos` each.
    pub fn step(&mut self, sample: Option<&JointSample<N>>) -> Option<JointMotion<N>> {
        if self.state.stage == Stage::Checking {
            self.check();
        }
        let measured = sample.and_then(|sample| sample.measured.map(|measured| measured.q));
        if self.state.wanted
            && matches!(
                self.state.stage,
                Stage::Ready | Stage::Holding | Stage::Aborted(_)
            )
            && let (Some(sample), Some(measured)) = (sample, &measured)
        {
            self.begin(sample, measured);
        } else if self.moving() {
            if let Some(reason) = self.watch(measured.as_ref()) {
                self.abort(reason);
            }
            self.advance();
        }
        self.state.measured = measured;
        self.desired().copied()
    }

    fn check(&mut self) {
        for _ in 0..check::POINTS_A_TICK {
            let seen = check::point(&self.program, &self.series, self.state.checked);
            if let Err(reason) = seen {
                self.state.stage = Stage::Refused(reason);
                self.state.wanted = false;
                return;
            }
            self.state.checked += 1;
        }
        if self.state.checked >= check::POINTS {
            self.state.stage = Stage::Ready;
        }
    }

    fn moving(&self) -> bool {
        self.state.stage.in_charge() && self.state.ramp > 0
    }

    fn abort(&mut self, reason: AbortReason) {
        if !matches!(self.state.stage, Stage::Aborted(_)) {
            self.state.stage = Stage::Aborted(reason);
            self.state.falling = true;
        }
    }

    /// Puts the player in charge, at rest where the arm is held, if it is held.
    fn begin(&mut self, sample: &JointSample<N>, measured: &JointVector<N>) {
        let state = &mut self.state;
        state.wanted = false;
        let held = state.stage.in_charge();
        let asked = if held { state.last } else { sample.desired };
        state.last = JointMotion {
            q: asked.q,
            ..JointMotion::zero()
        };
        let fast = asked
            .qd
            .iter()
            .position(|qd| qd.is_nan() || qd.abs() > HANDOVER_RAD_S);
        (state.ramp, state.falling, state.blind) = (0, false, 0);
        state.stage = Stage::Approaching;
        let refused = match fast {
            Some(joint) => Some(AbortReason::Velocity(joint as u8)),
            None => self.watch(Some(measured)),
        };
        if let Some(reason) = refused {
            // Where the arm is, not where it was asked to be: the asked position may be no number.
            let finite = measured.iter().all(|q| q.is_finite());
            if !held && finite {
                self.state.last.q = *measured;
            }
            if !held && !finite {
                self.state.stage = Stage::Ready;
                return;
            }
            self.abort(reason);
            return;
        }
        let to = self.series.at(&self.program.joints, 0).q;
        let time_s = self.approach_s(&(to - self.state.last.q));
        let ticks = self.seconds_to_ticks(time_s);
        self.state.path = Path::Approach {
            from: self.state.last.q,
            to,
            inv_time_s: 1.0 / time_s,
            phase_step: u32::MAX.checked_div(ticks).unwrap_or(u32::MAX),
        };
        (self.state.phase, self.state.periods) = (0, 0);
        self.state.ramp = self.ramp_ticks;
    }

    /// Time for `way`, s: quintics have peaks of 1.875 way / T and 5.7735 way / T².
    fn approach_s(&self, way: &JointVector<N>) -> f32 {
        let mut longest = APPROACH_S;
        for (way, bounds) in way.iter().zip(&self.program.certificate) {
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

    /// The first limit that measurement or motion breaks.
    fn watch(&mut self, measured: Option<&JointVector<N>>) -> Option<AbortReason> {
        let Some(measured) = measured else {
            self.state.blind = self.state.blind.saturating_add(1);
            return (self.state.blind > self.limits.blind_ticks).then_some(AbortReason::Blind);
        };
        self.state.blind = 0;
        let tick_s = self.tick_us as f32 * 1e-6;
        let slack = self.program.tracking_rad;
        let before = self.state.measured.as_ref();
        let last = &self.state.last;
        let motion = last.q.iter().zip(last.qd.iter()).zip(last.qdd.iter());
        let joints = measured.iter().zip(motion).zip(&self.limits.motion);
        for (joint, ((q, ((asked, qd), qdd)), bounds)) in joints.enumerate() {
            let index = joint as u8;
            let (low, high) = bounds.position_rad;
            let inside = |q: f32| q >= low - slack && q <= high + slack;
            if !q.is_finite() || !asked.is_finite() {
                return Some(AbortReason::NotFinite(index));
            }
            if !(inside(*q) && inside(*asked)) {
                return Some(AbortReason::Position(index));
            }
            if (q - asked).abs() > slack {
                return Some(AbortReason::Tracking(index));
            }
            let moved = before.and_then(|before| before.get(joint));
            let moved = moved.map_or(0.0, |before| (q - before).abs());
            let fastest = OVERSPEED * bounds.velocity_rad_s;
            if moved > fastest * tick_s || qd.abs() > fastest {
                return Some(AbortReason::Velocity(index));
            }
            if qdd.abs() > (1.0 + STOP_SHARE) * bounds.acceleration_rad_s2 {
                return Some(AbortReason::Acceleration(index));
            }
        }
        None
    }

    /// One tick along the path.
    fn advance(&mut self) {
        let (speed, _) = self.path_speed();
        if self.state.falling {
            self.state.ramp = self.state.ramp.saturating_sub(1);
        }
        let (next_speed, slowing) = self.path_speed();
        // Trapezoid; at full speed 2¹⁶, so that the step is whole.
        let mean = (0.5 * (speed + next_speed) * 65_536.0) as u64;
        let step = match self.state.path {
            Path::Approach { phase_step, .. } => phase_step,
            Path::Series => self.series.phase_step(),
        };
        let step = ((u64::from(step) * mean) >> 16) as u32;
        let (phase, arrived) = self.state.phase.overflowing_add(step);
        self.state.phase = phase;
        if arrived {
            self.arrive();
        }
        if self.state.ramp == 0 && self.state.stage == Stage::Stopping {
            self.state.stage = Stage::Holding;
        }
        self.state.last = self.motion(next_speed, slowing);
    }

    /// The end of the approach, or of a period.
    fn arrive(&mut self) {
        if let Path::Approach { .. } = self.state.path {
            // At rest on both sides of the seam, whatever the speed along them.
            self.state.path = Path::Series;
            self.state.phase = 0;
            if self.state.stage == Stage::Approaching {
                self.state.stage = Stage::Playing;
            }
            return;
        }
        self.state.periods = self.state.periods.saturating_add(1);
        if self.program.periods != 0 && self.state.periods >= self.program.periods {
            self.state.phase = 0;
            self.state.ramp = 0;
            if self.state.stage == Stage::Playing {
                self.state.stage = Stage::Holding;
            }
        }
    }

    /// Path speed σ, 1 at full speed, and its derivative, 1/s.
    fn path_speed(&self) -> (f32, f32) {
        let part = self.state.ramp as f32 / self.ramp_ticks as f32;
        let speed = part * part * (3.0 - 2.0 * part);
        if !self.state.falling {
            return (speed, 0.0);
        }
        let ramp_s = self.ramp_ticks as f32 * (self.tick_us as f32 * 1e-6);
        (speed, -6.0 * part * (1.0 - part) / ramp_s)
    }

    fn motion(&self, speed: f32, slowing: f32) -> JointMotion<N> {
        if self.state.ramp == 0 {
            // Exactly at rest.
            return JointMotion {
                q: self.on_path().q,
                ..JointMotion::zero()
            };
        }
        let path = self.on_path();
        JointMotion {
            q: path.q,
            qd: path.qd * speed,
            qdd: path.qdd * (speed * speed) + path.qd * slowing,
        }
    }

    /// The path at full speed.
    fn on_path(&self) -> JointMotion<N> {
        let Path::Approach {
            from,
            to,
            inv_time_s,
            ..
        } = &self.state.path
        else {
            return self.series.at(&self.program.joints, self.state.phase);
        };
        let s = self.state.phase as f32 * (1.0 / WHOLE);
        let way = to - from;
        let (s2, rest) = (s * s, 1.0 - s);
        JointMotion {
            q: from + way * (s2 * s * (10.0 + s * (6.0 * s - 15.0))),
            qd: way * (30.0 * s2 * rest * rest * inv_time_s),
            qdd: way * (60.0 * s * rest * (1.0 - 2.0 * s) * inv_time_s * inv_time_s),
        }
    }

    fn seconds_to_ticks(&self, seconds: f32) -> u32 {
        let ticks = (seconds * 1e6 / self.tick_us as f32) as u32;
        // A division by it must be one.
        if ticks == 0 { 1 } else { ticks }
    }
}

/// Time in which the path speed goes to zero, s: a smooth step of T has a slope of 1.5 / T at most.
fn stop_s<const N: usize>(program: &ExcitationProgram<N>) -> f32 {
    let mut longest = STOP_S.0;
    for bounds in &program.certificate {
        let time = 1.5 * bounds.velocity_rad_s / (STOP_SHARE * bounds.acceleration_rad_s2);
        if time > longest {
            longest = time;
        }
    }
    if longest > STOP_S.1 {
        STOP_S.1
    } else {
        longest
    }
}

#[cfg(test)]
mod tests;
