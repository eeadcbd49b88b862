//! State machine of the torque enable, hard limits and plausibility of the input: the last step before the motor stage.
//!
//! ```text
//!             arm                    disarm, time-out, fault
//! Disarmed ─────────► Armed ───────────────────────────────► RampDown ──► Disarmed
//!     ▲                 │ stop                                   │ if a fault is latched
//!     └── clear ── Fault ◄───────────────────────────────────────┘
//!
//! every state ── stop, fault of drive or stage ──► Fault
//! ```
//!
//! Only a command of the host arms a board, after fresh, plausible samples. The limits are constants of arm and firmware;
//! no bank or command exceeds them. `docs/safety.md` lists the meaning of every reason and the action.

mod input;
mod limits;
pub mod promises;
mod reason;
mod task_check_in;

pub(crate) use input::follow;
pub use input::{ARM_DISTANCE, ARM_SAMPLES};
pub(crate) use limits::PLAUSIBLE_C;
pub use limits::{
    COMMAND_TIMEOUT_US, HOT_C, HYSTERESIS_C, JUMP_MARGIN, MEASUREMENT_TIMEOUT_US, SafetyLimits,
    WARM_C,
};
pub use reason::{SafetyReason, SafetyState, SafetyStatus};
pub use task_check_in::{Task, TaskCheckIn};

use foretorque::arm::Arm;
use foretorque::feedforward::{FeedForward, FeedForwardState, Torque};
use foretorque::joint::{JointSample, JointVector};
use foretorque::limits::{Flags, cut, limit};
use input::InputState;
use limits::ThermalDerating;

/// The safety of one board: state machine, hard limits, plausibility of the input.
///
/// Every period of the board's own time: [`period`](Self::period). Every tick: [`admit`](Self::admit) the sample, then
/// [`step`](Self::step), or compute and [`release`](Self::release) the torque. Ages and the slew limit count periods, plausibility counts samples, so neither
/// depends on the number of calls. Where nothing but the samples keeps time, each of them is a period.
///
/// ```
/// use foretorque::arm::ur5::{JOINTS, Ur5};
/// use foretorque_link::safety::{Safety, SafetyLimits, SafetyReason, SafetyState};
/// use foretorque::joint::{JointMeasurement, JointMotion, JointSample, JointVector};
/// let mut safety = Safety::<JOINTS>::new(SafetyLimits::for_arm::<Ur5, _>(1000), SafetyReason::None);
/// let still = JointMeasurement { q: JointVector::zeros(), tau: JointVector::zeros() };
/// let sample = JointSample { desired: JointMotion::zero(), measured: Some(still) };
/// let torque = JointVector::<JOINTS>::repeat(1.0);
/// assert_eq!(safety.arm(), Err(SafetyReason::NoSample));
/// for _ in 0..3 {
///     safety.period();
///     safety.admit(Some(sample), 1, SafetyReason::None);
///     assert_eq!(safety.release(&torque), JointVector::<JOINTS>::zeros());
/// }
/// assert_eq!(safety.arm(), Ok(()));
/// safety.period();
/// safety.admit(Some(sample), 1, SafetyReason::None);
/// assert_eq!(safety.release(&torque), torque);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Safety<const N: usize> {
    limits: SafetyLimits<N>,
    state: SafetyState,
    /// The fault that has to be cleared; `None` when there is none.
    latched: SafetyReason,
    /// The reason that ended the torque last.
    ended: SafetyReason,
    /// Armed, and no sample has come since.
    unconfirmed: bool,
    input: InputState<N>,
    derating: ThermalDerating<N>,
    /// Torque of the last tick within the limits, N × N·m.
    output: JointVector<N>,
    /// Torque at the beginning of the period, from which the slew limit counts, N × N·m.
    slewed_from: JointVector<N>,
    /// Torque that is kept while a brake closes, N × N·m, and for how many periods more.
    gravity: JointVector<N>,
    braking: u32,
}

impl<const N: usize> Safety<N> {
    /// Disarmed, or in the fault that was kept over the reset.
    pub fn new(limits: SafetyLimits<N>, kept: SafetyReason) -> Self {
        Self {
            limits,
            state: match kept {
                SafetyReason::None => SafetyState::Disarmed,
                _ => SafetyState::Fault,
            },
            latched: kept,
            ended: SafetyReason::None,
            unconfirmed: false,
            input: InputState::default(),
            derating: ThermalDerating::new(),
            output: JointVector::zeros(),
            slewed_from: JointVector::zeros(),
            gravity: JointVector::zeros(),
            braking: 0,
        }
    }

    /// The hard limits.
    pub fn limits(&self) -> &SafetyLimits<N> {
        &self.limits
    }

    /// State and reason as replies carry them.
    pub fn status(&self) -> SafetyStatus {
        let warm = if self.derating.warm() {
            SafetyReason::MotorWarm
        } else {
            SafetyReason::None
        };
        let reasons = [self.latched, self.input.fault, warm, self.ended];
        let first = reasons
            .into_iter()
            .find(|&reason| reason != SafetyReason::None);
        SafetyStatus {
            state: self.state,
            reason: first.unwrap_or_default(),
        }
    }

    /// The fault that has to be cleared before the board can be armed, and that a board keeps over a reset.
    pub fn latched(&self) -> SafetyReason {
        self.latched
    }

    /// The enable pin may be on.
    pub fn enabled(&self) -> bool {
        matches!(self.state, SafetyState::Armed | SafetyState::RampDown)
    }

    /// The torque has ended last by an emergency stop.
    pub fn stopped(&self) -> bool {
        self.ended == SafetyReason::Stopped
    }

    /// Torque zero and none to come: parameters may be written.
    pub fn at_rest(&self) -> bool {
        !self.enabled()
    }

    /// Torque of the last tick within the limits, N × N·m.
    pub fn output(&self) -> &JointVector<N> {
        &self.output
    }

    /// False only while torque flows and its samples are older than the time-out.
    pub fn input_in_time(&self) -> bool {
        self.state != SafetyState::Armed || !self.input.timed_out(&self.limits)
    }

    /// Samples of which a part was not plausible, since the start or [`restart`](Self::restart).
    pub fn implausible(&self) -> u32 {
        self.input.implausible
    }

    /// Takes the temperature of one motor, °C; an implausible one changes nothing.
    pub fn note_temperature(&mut self, joint: usize, celsius: i8) {
        self.derating.record(joint, celsius);
    }

    /// Takes one period of the board's own time: the input ages, and the torque may change by one more slew step.
    pub fn period(&mut self) {
        self.slewed_from = self.output;
        self.miss(1);
    }

    /// Takes periods of the board's own time in which nothing ran: the input ages, the torque may change no more than before.
    pub fn miss(&mut self, periods: u32) {
        self.input.age(&self.limits, periods);
        self.derating.age(self.limits.temperature_ticks, periods);
        if self.state == SafetyState::RampDown {
            self.braking = self.braking.saturating_sub(periods);
        }
    }

    /// The part of `sample` that the tick may use; `None` is no usable sample.
    ///
    /// * `periods` periods since the sample before, as far as the host counts them: samples may have been lost on the way
    /// * `sensor` fault of the board's own sensor in this tick, [`SafetyReason::None`] without one
    ///
    /// An implausible measurement is dropped. A desired motion that jumps is no motion. One that is not finite passes,
    /// so that the tick flags it.
    // Has several callers, which share one copy: another costs 100 B of flash.
    #[inline(never)]
    pub fn admit(
        &mut self,
        sample: Option<JointSample<N>>,
        periods: u32,
        sensor: SafetyReason,
    ) -> Option<JointSample<N>> {
        let admitted = self.input.take(&self.limits, sample, periods, sensor);
        self.supervise();
        if self.state == SafetyState::Armed && self.unconfirmed && self.input.arrived() {
            // The arm or the desired motion may have moved since the samples that armed the board.
            match self.input.allows_torque() {
                Ok(()) => self.unconfirmed = false,
                Err(reason) => self.end(reason),
            }
        }
        admitted
    }

    /// Ends the torque when the input or a motor gives reason to.
    pub fn supervise(&mut self) {
        if self.state != SafetyState::Armed {
            return;
        }
        if self.derating.hot() {
            self.trip(SafetyReason::MotorHot);
        } else if let Some((reason, latches)) = self.input.ends_torque(&self.limits) {
            if latches {
                self.trip(reason);
            } else {
                self.end(reason);
            }
        }
    }

    /// Latches `fault` and ends the torque, if it flows and `fault` is one.
    fn check(&mut self, fault: SafetyReason) {
        if fault != SafetyReason::None && self.state == SafetyState::Armed {
            self.trip(fault);
        }
    }

    /// Torque of this tick, N × N·m: `wanted` within the hard limits, a ramp to zero, or zero. All calls of one period
    /// together change it by no more than one slew step.
    ///
    /// Finite for any bits in `wanted`. Old input and a hot motor end the torque here, too: an owner without a sample may leave
    /// out [`admit`](Self::admit).
    pub fn release(&mut self, wanted: &JointVector<N>) -> JointVector<N> {
        self.supervise();
        if !wanted.iter().all(|torque| torque.is_finite()) {
            self.check(SafetyReason::TorqueNotFinite);
        }
        let armed = self.brake_released();
        let closing = self.state == SafetyState::RampDown && self.braking > 0;
        let enabled = self.enabled();
        let target = if armed {
            wanted
        } else if closing {
            &self.gravity
        } else {
            &JointVector::zeros()
        };
        let bounds = self
            .limits
            .torque
            .iter()
            .zip(self.limits.slew_per_tick.iter())
            .zip(self.slewed_from.iter());
        let joints = self.output.iter_mut().zip(target.iter()).zip(bounds);
        for (joint, ((output, &target), ((&torque, &slew), &from))) in joints.enumerate() {
            // A hot motor holds the arm until its brake does.
            let part = if closing {
                1.0
            } else {
                self.derating.factor(joint)
            };
            let (target, _) = cut(target, torque * part);
            let (limited, _) = limit(target, from, torque, slew);
            *output = if enabled { limited } else { 0.0 };
        }
        let ended = self.state == SafetyState::RampDown && self.braking == 0;
        if ended && self.output.iter().all(|&torque| torque == 0.0) {
            self.rest();
        }
        self.output
    }

    /// A brake may be open: torque flows, and is not about to end.
    pub fn brake_released(&self) -> bool {
        self.state == SafetyState::Armed && !self.unconfirmed
    }

    /// Runs the feed-forward on an [admitted](Self::admit) sample, or without one, and [releases](Self::release) its torque.
    ///
    /// Cost: another inverse dynamics with brakes, without a usable sample or with a warm motor.
    #[inline(always)]
    pub fn step<A: Arm<N, P>, const P: usize>(
        &mut self,
        feed_forward: &mut FeedForward<A, N, P>,
        sample: Option<&JointSample<N>>,
    ) -> Torque<N> {
        let mut torque = match sample {
            Some(sample) => feed_forward.step(sample),
            None => feed_forward.step_stale(),
        };
        // Without the share that carries it, a joint falls.
        if torque.flags.contains(Flags::GRAVITY_LOST) {
            self.check(SafetyReason::GravityLost);
        }
        let wanted = self.with_brakes::<A, P>(&torque, feed_forward.state());
        torque.total = self.release(&wanted);
        feed_forward.applied_within_limits(&torque.total);
        torque
    }

    /// The torque that a tick wants, N × N·m, or that of gravity by the committed set and the payload at the last plausible
    /// position, where brakes have to close before the torque goes to zero. They close, too, where a warm motor may no
    /// longer carry gravity.
    pub(crate) fn with_brakes<A: Arm<N, P>, const P: usize>(
        &mut self,
        torque: &Torque<N>,
        parameters: &FeedForwardState<N, P>,
    ) -> JointVector<N> {
        if self.limits.brake_ticks == 0 {
            return torque.total;
        }
        let withdrawn = torque
            .flags
            .contains(Flags::STALE_SAMPLE | Flags::WITHDRAWN);
        let warm = self.derating.warm();
        let closes = withdrawn || self.state == SafetyState::RampDown || warm;
        if let Some(q) = self.input.plausible.as_ref().filter(|_| closes) {
            self.gravity = parameters.gravity::<A>(q);
            let mut joints = self.gravity.iter().zip(&self.limits.torque).enumerate();
            let heavy = |(joint, (gravity, torque)): (usize, (&f32, &f32))| {
                gravity.abs() > torque * self.derating.factor(joint)
            };
            if warm && joints.any(heavy) {
                self.check(SafetyReason::MotorHot);
            }
            if withdrawn {
                return self.gravity;
            }
        }
        torque.total
    }

    /// Check of all that arming requires besides samples.
    ///
    /// Errors: the reason against it.
    pub fn ready(&self) -> Result<(), SafetyReason> {
        match self.state {
            SafetyState::RampDown => Err(SafetyReason::StillRamping),
            SafetyState::Fault => Err(self.latched),
            _ if self.derating.hot() => Err(SafetyReason::MotorHot),
            SafetyState::Armed | SafetyState::Disarmed => Ok(()),
        }
    }

    /// Holds the torque back in this tick, as before the first sample after arming.
    pub fn hold(&mut self) {
        self.unconfirmed |= self.state == SafetyState::Armed;
    }

    /// Lets torque through from the next sample on, if that is plausible and near too; else the board disarms again.
    /// Arming an armed board changes nothing.
    ///
    /// Errors: the reason against it; then nothing has changed.
    pub fn arm(&mut self) -> Result<(), SafetyReason> {
        if self.state == SafetyState::Armed {
            return Ok(());
        }
        self.ready()?;
        self.input.allows_arming()?;
        self.input.clear_counts();
        self.state = SafetyState::Armed;
        self.unconfirmed = true;
        self.ended = SafetyReason::None;
        Ok(())
    }

    /// Ramps the torque to zero, then disarms. Cannot fail.
    pub fn disarm(&mut self) {
        if self.state == SafetyState::Armed {
            self.end(SafetyReason::Disarmed);
        }
    }

    /// Sets torque and enable pin to off at once, in any state; latches `fault` unless another is latched. Cannot fail.
    pub fn torque_off(&mut self, fault: SafetyReason) {
        self.trip(fault);
        self.output = JointVector::zeros();
        self.slewed_from = self.output;
        self.rest();
    }

    /// Latches a fault, unless there is one already; a torque that flows ramps to zero.
    pub fn trip(&mut self, fault: SafetyReason) {
        if self.latched == SafetyReason::None {
            self.latched = fault;
        }
        self.end(fault);
        if self.state == SafetyState::Disarmed {
            self.state = SafetyState::Fault;
        }
    }

    /// Clears a latched fault; the board is then disarmed.
    ///
    /// Errors: the torque still ramps to zero, or a motor is still too hot.
    pub fn clear(&mut self) -> Result<(), SafetyReason> {
        if self.state != SafetyState::Fault {
            return match self.latched {
                SafetyReason::None => Ok(()),
                _ => Err(SafetyReason::StillRamping),
            };
        }
        if self.derating.hot() {
            return Err(SafetyReason::MotorHot);
        }
        self.latched = SafetyReason::None;
        self.ended = SafetyReason::None;
        self.state = SafetyState::Disarmed;
        Ok(())
    }

    /// Starts over with new limits and without earlier samples. A latched fault and the motor temperatures stay; a torque
    /// that flows does not.
    pub fn restart(&mut self, limits: SafetyLimits<N>) {
        *self = Self {
            derating: self.derating,
            ..Self::new(limits, self.latched)
        };
    }

    fn end(&mut self, reason: SafetyReason) {
        self.ended = reason;
        if self.state == SafetyState::Armed {
            self.state = SafetyState::RampDown;
            // Before the first torque a brake is still closed.
            let open = self.limits.brake_ticks > 0 && !self.unconfirmed;
            self.braking = if open { self.limits.brake_ticks } else { 0 };
            // Until the next tick computes it.
            self.gravity = self.output;
            if !open && self.output.iter().all(|&torque| torque == 0.0) {
                self.rest();
            }
        }
    }

    fn rest(&mut self) {
        self.state = match self.latched {
            SafetyReason::None => SafetyState::Disarmed,
            _ => SafetyState::Fault,
        };
    }
}

#[cfg(test)]
mod tests;
