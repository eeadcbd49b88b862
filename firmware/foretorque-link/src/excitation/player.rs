use super::check;
use super::path::Path;
use super::path_speed::PathSpeed;
use super::program::{AbortReason, ExcitationError, ExcitationProgram, PlayLimits};
use super::series::PreparedSeries;
use super::state::{ExcitationCommand, ExcitationState};
use super::watch::Watch;
use foretorque::arm::Arm;
use foretorque::joint::{JointMotion, JointSample, JointVector};

/// Speed in which the host may hold the arm when the player takes over, rad/s.
const HANDOVER_RAD_S: f32 = 0.02;

/// What the player carries from tick to tick.
#[derive(Clone, Copy, Debug, PartialEq)]
struct PlayerState<const N: usize> {
    stage: ExcitationState,
    /// Points checked.
    checked: u32,
    /// A start waits for the check, or for a measurement.
    wanted: bool,
    path: Path<N>,
    /// Place on the path, in units of 2⁻³² of it.
    phase: u32,
    /// Periods begun.
    periods: u16,
    speed: PathSpeed,
    watch: Watch<N>,
    /// What was asked of the arm for the tick that is measured now.
    last: JointMotion<N>,
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
            state: PlayerState {
                stage: ExcitationState::Empty,
                checked: 0,
                wanted: false,
                path: Path::Series,
                phase: 0,
                periods: 0,
                speed: PathSpeed::NONE,
                watch: Watch::new(),
                last: JointMotion::zero(),
            },
        }
    }

    /// Where it stands.
    pub fn state(&self) -> ExcitationState {
        self.state.stage
    }

    /// What was asked of the arm last, while the player is in charge.
    pub fn desired(&self) -> Option<&JointMotion<N>> {
        self.state.stage.is_active().then_some(&self.state.last)
    }

    /// Takes `program`; its check begins with the next tick.
    ///
    /// Errors: what can be seen at once; then the one before stays. `Running` while the player is in charge.
    pub fn load(&mut self, program: &ExcitationProgram<N>) -> Result<(), ExcitationError> {
        if self.state.stage.is_active() {
            return Err(ExcitationError::Running);
        }
        check::at_once(program, &self.limits, self.arm_hash, self.tick_us)?;
        let series = PreparedSeries::new(program.period_us, self.tick_us);
        check::begins_at_rest(program, &series)?;
        self.program = *program;
        self.series = series;
        self.state.speed.prepare(&program.certificate, self.tick_us);
        self.state.stage = ExcitationState::Checking;
        self.state.checked = 0;
        self.state.wanted = false;
        Ok(())
    }

    /// Does what a host asks.
    ///
    /// Errors: `NotLoaded`; the reason of a refused program; `Running` when it cannot be started or released now.
    pub fn command(&mut self, command: ExcitationCommand) -> Result<(), ExcitationError> {
        match (command, self.state.stage) {
            (ExcitationCommand::Status, _) => Ok(()),
            (_, ExcitationState::Empty) => Err(ExcitationError::NotLoaded),
            (_, ExcitationState::Refused(reason)) => Err(reason),
            (ExcitationCommand::Start, _) => {
                if self.moving() {
                    return Err(ExcitationError::Running);
                }
                self.state.wanted = true;
                Ok(())
            }
            (ExcitationCommand::Stop, stage) => {
                self.state.wanted = false;
                if matches!(
                    stage,
                    ExcitationState::Approaching | ExcitationState::Playing
                ) {
                    self.state.stage = ExcitationState::Stopping;
                    self.state.speed.stop();
                }
                Ok(())
            }
            (ExcitationCommand::Release, stage) => {
                if self.moving() {
                    return Err(ExcitationError::Running);
                }
                if stage.is_active() {
                    self.state.stage = ExcitationState::Ready;
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
        if self.state.stage == ExcitationState::Checking {
            self.check();
        }
        let measured = sample.and_then(|sample| sample.measured.map(|measured| measured.q));
        if self.state.wanted
            && matches!(
                self.state.stage,
                ExcitationState::Ready | ExcitationState::Holding | ExcitationState::Aborted(_)
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
        self.state.watch.note(measured);
        self.desired().copied()
    }

    fn check(&mut self) {
        for _ in 0..check::POINTS_A_TICK {
            let seen = check::point(&self.program, &self.series, self.state.checked);
            if let Err(reason) = seen {
                self.state.stage = ExcitationState::Refused(reason);
                self.state.wanted = false;
                return;
            }
            self.state.checked += 1;
        }
        if self.state.checked >= check::POINTS {
            self.state.stage = ExcitationState::Ready;
        }
    }

    fn moving(&self) -> bool {
        self.state.stage.is_active() && self.state.speed.moving()
    }

    fn abort(&mut self, reason: AbortReason) {
        if !matches!(self.state.stage, ExcitationState::Aborted(_)) {
            self.state.stage = ExcitationState::Aborted(reason);
            self.state.speed.stop();
        }
    }

    /// Puts the player in charge, at rest where the arm is held, if it is held.
    fn begin(&mut self, sample: &JointSample<N>, measured: &JointVector<N>) {
        let state = &mut self.state;
        state.wanted = false;
        let held = state.stage.is_active();
        let asked = if held { state.last } else { sample.desired };
        state.last = JointMotion {
            q: asked.q,
            ..JointMotion::zero()
        };
        let fast = asked
            .qd
            .iter()
            .position(|qd| qd.is_nan() || qd.abs() > HANDOVER_RAD_S);
        state.speed.rest();
        state.watch.restart();
        state.stage = ExcitationState::Approaching;
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
                self.state.stage = ExcitationState::Ready;
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

    /// One tick along the path.
    fn advance(&mut self) {
        let (speed, _) = self.state.speed.now(self.tick_us);
        self.state.speed.advance();
        let (next_speed, slowing) = self.state.speed.now(self.tick_us);
        // Trapezoid; at full speed 2¹⁶, so that the step is whole.
        let mean = (0.5 * (speed + next_speed) * 65_536.0) as u32;
        let step = self.state.path.phase_step(&self.series);
        let step = ((u64::from(step) * u64::from(mean)) >> 16) as u32;
        let (phase, arrived) = self.state.phase.overflowing_add(step);
        self.state.phase = phase;
        if arrived {
            self.arrive();
        }
        if !self.state.speed.moving() && self.state.stage == ExcitationState::Stopping {
            self.state.stage = ExcitationState::Holding;
        }
        self.state.last = self.motion(next_speed, slowing);
    }

    /// The end of the approach, or of a period.
    fn arrive(&mut self) {
        if let Path::Approach { .. } = self.state.path {
            // At rest on both sides of the seam, whatever the speed along them.
            self.state.path = Path::Series;
            self.state.phase = 0;
            if self.state.stage == ExcitationState::Approaching {
                self.state.stage = ExcitationState::Playing;
            }
            return;
        }
        self.state.periods = self.state.periods.saturating_add(1);
        if self.program.periods != 0 && self.state.periods >= self.program.periods {
            self.state.phase = 0;
            self.state.speed.rest();
            if self.state.stage == ExcitationState::Playing {
                self.state.stage = ExcitationState::Holding;
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

    fn watch(&mut self, measured: Option<&JointVector<N>>) -> Option<AbortReason> {
        let state = &mut self.state;
        let tracking = self.program.tracking_rad;
        (state.watch).broken(&self.limits, &state.last, measured, tracking, self.tick_us)
    }
}

#[cfg(test)]
mod tests;
