use super::ExcitationState::{self, *};
use super::path::{JointSeries, Path, PathSpeed, PreparedSeries};
use super::{
    AbortReason, CHECK_POINTS, CHECK_POINTS_A_TICK, ExcitationCommand,
    ExcitationCommand as Command, ExcitationError, ExcitationProgram, MotionBounds, PlayLimits,
    Supervision, check_at_once, check_point, check_start,
};
use foretorque::arm::Arm;
use foretorque::joint::{JointMotion, JointSample, JointVector};

/// Largest desired speed at which the player takes over from the host, rad/s.
const HANDOVER_RAD_S: f32 = 0.02;

#[derive(Clone, Copy, Debug, PartialEq)]
struct PlayerState<const N: usize> {
    excitation: ExcitationState,
    checked: u32,
    /// A start waits for the check or for a measurement.
    start_waits: bool,
    path: Path<N>,
    /// Position on the path, in units of 2⁻³² of it.
    phase: u32,
    /// Periods begun.
    periods: u16,
    speed: PathSpeed,
    supervision: Supervision<N>,
    /// Desired motion of the last tick, which is measured now.
    last: JointMotion<N>,
}

/// Player of one excitation.
///
/// A stop stays on the path: its speed σ falls from 1 to 0 as a smooth step. Velocity is q′ σ and acceleration
/// q″ σ² + q′ σ̇, so a stop adds at most half of the certified acceleration.
pub struct Player<const N: usize> {
    limits: PlayLimits<N>,
    arm_hash: u32,
    tick_us: u32,
    program: ExcitationProgram<N>,
    series: PreparedSeries,
    state: PlayerState<N>,
}

impl<const N: usize> Player<N> {
    /// A player without an excitation.
    ///
    /// * `tick_us` period of the tick, µs
    pub fn new<A: Arm<N, P>, const P: usize>(tick_us: u32) -> Self {
        Self {
            limits: PlayLimits::for_arm::<A, P>(tick_us),
            arm_hash: A::hash(),
            tick_us,
            program: ExcitationProgram {
                arm_hash: 0,
                period_us: 0,
                periods: 0,
                tracking_rad: 0.0,
                joints: [JointSeries::default(); N],
                certificate: [MotionBounds::default(); N],
            },
            series: PreparedSeries::new(1_000_000, tick_us),
            state: PlayerState {
                excitation: Empty,
                checked: 0,
                start_waits: false,
                path: Path::Series,
                phase: 0,
                periods: 0,
                speed: PathSpeed::NONE,
                supervision: Supervision::default(),
                last: JointMotion::zero(),
            },
        }
    }

    /// State of the excitation.
    pub fn state(&self) -> ExcitationState {
        self.state.excitation
    }

    /// Last desired motion, while the player decides it.
    pub fn desired(&self) -> Option<&JointMotion<N>> {
        self.state().is_active().then_some(&self.state.last)
    }

    /// Loads `program`; its check begins with the next tick.
    ///
    /// Errors: those of the parameters, and the earlier one stays; `Running` while the player is active.
    pub fn load(&mut self, program: &ExcitationProgram<N>) -> Result<(), ExcitationError> {
        if self.state().is_active() {
            return Err(ExcitationError::Running);
        }
        check_at_once(program, &self.limits, self.arm_hash, self.tick_us)?;
        let series = PreparedSeries::new(program.period_us, self.tick_us);
        check_start(program, &series)?;
        self.program = *program;
        self.series = series;
        self.state.speed.prepare(&program.certificate, self.tick_us);
        self.state.excitation = Checking;
        self.state.checked = 0;
        self.state.start_waits = false;
        Ok(())
    }

    /// Executes a command of the host.
    ///
    /// Errors: `NotLoaded`; the error of a refused program; `Running` where the excitation must be at rest.
    pub fn command(&mut self, command: ExcitationCommand) -> Result<(), ExcitationError> {
        match (command, self.state()) {
            (Command::Status, _) => return Ok(()),
            (_, Empty) => return Err(ExcitationError::NotLoaded),
            (_, Refused(error)) => return Err(error),
            (Command::Start | Command::Release, _) if self.moving() => {
                return Err(ExcitationError::Running);
            }
            (Command::Stop, Approaching | Playing) => {
                self.state.excitation = Stopping;
                self.state.speed.stop();
            }
            (Command::Release, state) if state.is_active() => self.state.excitation = Ready,
            _ => {}
        }
        self.state.start_waits = command == Command::Start;
        Ok(())
    }

    /// Desired motion of the next tick, if the player decides it.
    ///
    /// * `sample` sample of this tick: its measurement is supervised, and a start begins where the host holds the arm
    ///
    /// Cost: four points of the check, or one of the path; a `sin_cos` each.
    pub fn step(&mut self, sample: Option<&JointSample<N>>) -> Option<JointMotion<N>> {
        if self.state() == Checking {
            self.check();
        }
        let measured = sample.and_then(|sample| sample.measured.map(|measured| measured.q));
        if self.state.start_waits
            && matches!(self.state(), Ready | Holding | Aborted(_))
            && let (Some(sample), Some(measured)) = (sample, &measured)
        {
            self.begin(sample, measured);
        } else if self.moving() {
            if let Some(reason) = self.exceeded(measured.as_ref()) {
                self.abort(reason);
            }
            self.advance();
        }
        if !self.moving() {
            self.state.supervision.followed = measured;
        }
        self.desired().copied()
    }

    fn check(&mut self) {
        for _ in 0..CHECK_POINTS_A_TICK {
            if let Err(error) = check_point(&self.program, &self.series, self.state.checked) {
                self.state.excitation = Refused(error);
                self.state.start_waits = false;
                return;
            }
            self.state.checked += 1;
        }
        if self.state.checked >= CHECK_POINTS {
            self.state.excitation = Ready;
        }
    }

    fn moving(&self) -> bool {
        self.state().is_active() && self.state.speed.moving()
    }

    fn abort(&mut self, reason: AbortReason) {
        if !matches!(self.state(), Aborted(_)) {
            self.state.excitation = Aborted(reason);
            self.state.speed.stop();
        }
    }

    /// Takes over the desired motion, at rest where the arm is held, if it is held.
    fn begin(&mut self, sample: &JointSample<N>, measured: &JointVector<N>) {
        let state = &mut self.state;
        state.start_waits = false;
        let held = state.excitation.is_active();
        let desired = if held { state.last } else { sample.desired };
        state.last = JointMotion {
            q: desired.q,
            ..JointMotion::zero()
        };
        let mut speeds = desired.qd.iter();
        let fast = speeds.position(|qd| qd.is_nan() || qd.abs() > HANDOVER_RAD_S);
        state.speed.rest();
        state.supervision.blind = 0;
        state.excitation = Approaching;
        let refused = match fast {
            Some(joint) => Some(AbortReason::Velocity(joint as u8)),
            None => self.exceeded(Some(measured)),
        };
        if let Some(reason) = refused {
            // The measured position: the desired one may not be finite.
            let finite = measured.iter().all(|q| q.is_finite());
            if !held && finite {
                self.state.last.q = *measured;
            }
            if !held && !finite {
                self.state.excitation = Ready;
                return;
            }
            self.abort(reason);
            return;
        }
        let to = self.series.at(&self.program.joints, 0).q;
        let certificate = &self.program.certificate;
        self.state.path = Path::approach(self.state.last.q, to, certificate, self.tick_us);
        (self.state.phase, self.state.periods) = (0, 0);
        self.state.speed.start();
    }

    fn advance(&mut self) {
        let (speed, _) = self.state.speed.now(self.tick_us);
        self.state.speed.advance();
        let (next_speed, slowing) = self.state.speed.now(self.tick_us);
        // Trapezoid rule; 2¹⁶ at full speed, so that the step is exact.
        let mean = (0.5 * (speed + next_speed) * 65_536.0) as u32;
        let step = self.state.path.phase_step(&self.series);
        let step = ((u64::from(step) * u64::from(mean)) >> 16) as u32;
        let (phase, arrived) = self.state.phase.overflowing_add(step);
        self.state.phase = phase;
        if arrived {
            self.arrive();
        }
        if !self.state.speed.moving() && self.state() == Stopping {
            self.state.excitation = Holding;
        }
        self.state.last = self.motion(next_speed, slowing);
    }

    /// Handles the end of the approach, or of a period.
    fn arrive(&mut self) {
        let state = &mut self.state;
        if let Path::Approach { .. } = state.path {
            // Approach and series both rest here, at any path speed.
            state.path = Path::Series;
            state.phase = 0;
            if state.excitation == Approaching {
                state.excitation = Playing;
            }
            return;
        }
        state.periods = state.periods.saturating_add(1);
        if self.program.periods != 0 && state.periods >= self.program.periods {
            state.phase = 0;
            state.speed.rest();
            if state.excitation == Playing {
                state.excitation = Holding;
            }
        }
    }

    fn motion(&self, speed: f32, slowing: f32) -> JointMotion<N> {
        let state = &self.state;
        let mut motion = (state.path).at(state.phase, &self.series, &self.program.joints);
        if state.speed.moving() {
            motion.qdd = motion.qdd * (speed * speed) + motion.qd * slowing;
            motion.qd *= speed;
        } else {
            // Exactly at rest.
            motion.qd.fill(0.0);
            motion.qdd.fill(0.0);
        }
        motion
    }

    fn exceeded(&mut self, measured: Option<&JointVector<N>>) -> Option<AbortReason> {
        let state = &mut self.state;
        let tracking = self.program.tracking_rad;
        let tick_us = self.tick_us;
        (state.supervision).exceeded(&self.limits, &state.last, measured, tracking, tick_us)
    }
}

#[cfg(test)]
mod tests;
