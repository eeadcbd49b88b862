//! Whether torque may leave the board: the last room between the tick and the motor stage.
//!
//! ```text
//!             arm                    disarm, time-out, fault
//! Disarmed ─────────► Armed ───────────────────────────────► RampDown ──► Disarmed
//!     ▲                 │ stop                                   │ if a fault is latched
//!     └── clear ── Fault ◄───────────────────────────────────────┘
//! ```
//!
//! Nothing but the host's own command arms a board, and it must send fresh, plausible samples before. The limits here are
//! constants of arm and firmware; what a bank or a command says is inside them or has no effect. `docs/safety.md` says
//! what every reason means and what to do about it.

mod input;
mod limits;
mod plausibility;
mod reason;
mod task_check_in;
mod thermal_derating;

pub use input::{ARM_DISTANCE, ARM_SAMPLES};
pub use limits::{COMMAND_TIMEOUT_S, SafetyLimits};
pub use reason::{SafetyReason, SafetyState, SafetyStatus};
pub use task_check_in::{Task, TaskCheckIn};
pub use thermal_derating::{HOT_C, HYSTERESIS_C, WARM_C};

use foretorque::joint::{JointSample, JointVector};
use foretorque::limits::{cut, limit};
use input::InputState;
use thermal_derating::ThermalDerating;

/// The safety of one board: state machine, hard limits, plausibility of the input.
///
/// Every tick: [`admit`](Self::admit) the sample, compute, [`release`](Self::release) the torque.
///
/// ```
/// use foretorque::arm::ur5::{JOINTS, Ur5};
/// use foretorque_link::safety::{Safety, SafetyLimits, SafetyReason, SafetyState};
/// use foretorque::joint::{JointMeasurement, JointMotion, JointSample, JointVector};
/// let mut safety = Safety::<JOINTS>::new(SafetyLimits::for_arm::<Ur5, _>(1e-3), SafetyReason::None);
/// let still = JointMeasurement { q: JointVector::zeros(), tau: JointVector::zeros() };
/// let sample = JointSample { desired: JointMotion::zero(), measured: Some(still) };
/// let torque = JointVector::<JOINTS>::repeat(1.0);
/// assert_eq!(safety.arm(), Err(SafetyReason::NoSample));
/// for _ in 0..3 {
///     safety.admit(Some(sample), 1);
///     assert_eq!(safety.release(&torque), JointVector::<JOINTS>::zeros());
/// }
/// assert_eq!(safety.arm(), Ok(()));
/// safety.admit(Some(sample), 1);
/// assert_eq!(safety.release(&torque), torque);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Safety<const N: usize> {
    limits: SafetyLimits<N>,
    state: SafetyState,
    /// The fault that has to be cleared; `None` when there is none.
    latched: SafetyReason,
    /// What ended the torque last.
    ended: SafetyReason,
    /// Armed, and no sample has come since.
    unconfirmed: bool,
    input: InputState<N>,
    heat: ThermalDerating<N>,
    /// The torque of the last tick, as it left, N × N·m.
    output: JointVector<N>,
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
            input: InputState::new(),
            heat: ThermalDerating::new(),
            output: JointVector::zeros(),
        }
    }

    /// State and reason as replies carry them.
    pub fn status(&self) -> SafetyStatus {
        let warm = if self.heat.warm() {
            SafetyReason::MotorWarm
        } else {
            SafetyReason::None
        };
        let reasons = [self.latched, self.input.wrong(), warm, self.ended];
        let told = reasons
            .into_iter()
            .find(|&reason| reason != SafetyReason::None);
        SafetyStatus {
            state: self.state,
            reason: told.unwrap_or_default(),
        }
    }

    /// The fault that has to be cleared before the board can be armed; what a board keeps over a reset.
    pub fn latched(&self) -> SafetyReason {
        self.latched
    }

    /// The enable pin may be on.
    pub fn enabled(&self) -> bool {
        matches!(self.state, SafetyState::Armed | SafetyState::RampDown)
    }

    /// Torque zero and none to come: parameters may be written.
    pub fn at_rest(&self) -> bool {
        !self.enabled()
    }

    /// The torque of the last tick, as it left, N × N·m.
    pub fn output(&self) -> &JointVector<N> {
        &self.output
    }

    /// No torque flows, or its samples come in time, or it is on its way to zero because they do not: the time-out works.
    pub fn input_in_time(&self) -> bool {
        self.state != SafetyState::Armed || !self.input.timed_out(&self.limits)
    }

    /// Samples of which a part was not plausible, since the start or [`restart`](Self::restart).
    pub fn implausible(&self) -> u32 {
        self.input.implausible()
    }

    /// Takes the temperature of one motor, °C; one that cannot be true changes nothing.
    pub fn note_temperature(&mut self, joint: usize, celsius: i8) {
        self.heat.note(joint, celsius);
    }

    /// What the tick may use of `sample`; `None` is no usable sample.
    ///
    /// * `periods` periods since the sample before, as far as the link knows: samples may have been lost on the way
    ///
    /// A measurement that is not plausible is dropped. A desired motion that jumps is no motion. One that is not finite
    /// goes on, for the tick to see and say so.
    pub fn admit(
        &mut self,
        sample: Option<JointSample<N>>,
        periods: u32,
    ) -> Option<JointSample<N>> {
        self.admit_from(sample, periods, SafetyReason::None)
    }

    /// The same on a board with a sensor of its own.
    ///
    /// * `sensor` what is wrong with its measurement of this tick
    // Has several callers, which share one copy: another costs 100 B of flash.
    #[inline(never)]
    pub fn admit_from(
        &mut self,
        sample: Option<JointSample<N>>,
        periods: u32,
        sensor: SafetyReason,
    ) -> Option<JointSample<N>> {
        let admitted = self.input.take(&self.limits, sample, periods, sensor);
        self.watch();
        admitted
    }

    /// Ends the torque when the input gives reason to.
    fn watch(&mut self) {
        if self.state != SafetyState::Armed {
            return;
        }
        if self.heat.hot() {
            self.trip(SafetyReason::MotorHot);
        } else if self.input.doubtful(&self.limits) {
            self.trip(self.input.wrong());
        } else if self.input.timed_out(&self.limits) {
            self.end(SafetyReason::CommandTimeout);
        } else if self.unconfirmed && self.input.fresh() {
            // The arm may have moved, or the host have turned to another motion, since the samples that armed the board.
            match self.input.allows_torque() {
                Ok(()) => self.unconfirmed = false,
                Err(reason) => self.end(reason),
            }
        }
    }

    /// The torque that leaves in this tick, N × N·m: `wanted` within the hard limits, on its way to zero, or zero.
    ///
    /// Finite for any bits in `wanted`.
    pub fn release(&mut self, wanted: &JointVector<N>) -> JointVector<N> {
        if self.state == SafetyState::Armed && !wanted.iter().all(|torque| torque.is_finite()) {
            self.trip(SafetyReason::TorqueNotFinite);
        }
        let armed = self.state == SafetyState::Armed && !self.unconfirmed;
        let enabled = self.enabled();
        let bounds = self
            .limits
            .torque
            .iter()
            .zip(self.limits.slew_per_tick.iter());
        let joints = self.output.iter_mut().zip(wanted.iter()).zip(bounds);
        for (joint, ((output, &wanted), (&torque, &slew))) in joints.enumerate() {
            let (target, _) = cut(wanted, torque * self.heat.part(joint));
            let target = if armed { target } else { 0.0 };
            let (limited, _) = limit(target, *output, torque, slew);
            *output = if enabled { limited } else { 0.0 };
        }
        if self.state == SafetyState::RampDown && self.output.iter().all(|&torque| torque == 0.0) {
            self.rest();
        }
        self.output
    }

    /// A period has gone by in which no tick ran, because the samples pace the board and none came. Ends the torque like
    /// [`admit`](Self::admit) and [`release`](Self::release) would; where none flows, samples grow too old to arm on.
    pub fn silence(&mut self) {
        if self.enabled() {
            self.admit(None, 1);
            // The torque is held until the time-out, as the host was told.
            let held = self.output;
            self.release(&held);
        } else {
            self.input.age(&self.limits);
        }
    }

    /// Lets torque through from the next sample on, if that is plausible and near, too; else it disarms again. Arming an
    /// armed board changes nothing.
    ///
    /// Errors: why not; then nothing has changed.
    pub fn arm(&mut self) -> Result<(), SafetyReason> {
        match self.state {
            SafetyState::Armed => return Ok(()),
            SafetyState::RampDown => return Err(SafetyReason::StillRamping),
            SafetyState::Fault => return Err(self.latched),
            SafetyState::Disarmed => {}
        }
        if self.heat.hot() {
            return Err(SafetyReason::MotorHot);
        }
        self.input.allows_arming()?;
        self.input.trust();
        self.state = SafetyState::Armed;
        self.unconfirmed = true;
        self.ended = SafetyReason::None;
        Ok(())
    }

    /// The torque goes to zero, then the board is disarmed. Cannot fail.
    pub fn disarm(&mut self) {
        if self.state == SafetyState::Armed {
            self.end(SafetyReason::Disarmed);
        }
    }

    /// Emergency stop: torque zero and enable pin off at once, in any state; latches. Cannot fail.
    pub fn stop(&mut self) {
        self.torque_off(SafetyReason::Stopped);
    }

    /// Torque zero and enable pin off at once, in any state, for `fault`, which latches unless another has. Cannot fail.
    pub fn torque_off(&mut self, fault: SafetyReason) {
        self.trip(fault);
        self.output = JointVector::zeros();
        self.rest();
    }

    /// Latches a fault, unless there is one already; a torque that flows goes to zero.
    pub fn trip(&mut self, fault: SafetyReason) {
        if self.latched == SafetyReason::None {
            self.latched = fault;
        }
        self.end(fault);
        if self.state == SafetyState::Disarmed {
            self.state = SafetyState::Fault;
        }
    }

    /// Forgets a latched fault; the board is then disarmed.
    ///
    /// Errors: the torque is still on its way to zero, or a motor is still too hot.
    pub fn clear(&mut self) -> Result<(), SafetyReason> {
        if self.state != SafetyState::Fault {
            return match self.latched {
                SafetyReason::None => Ok(()),
                _ => Err(SafetyReason::StillRamping),
            };
        }
        if self.heat.hot() {
            return Err(SafetyReason::MotorHot);
        }
        self.latched = SafetyReason::None;
        self.ended = SafetyReason::None;
        self.state = SafetyState::Disarmed;
        Ok(())
    }

    /// New limits and no memory of earlier samples: the tick starts over. A latched fault and what is known of the motors
    /// stay; a torque that flows does not.
    pub fn restart(&mut self, limits: SafetyLimits<N>) {
        let heat = self.heat;
        *self = Self::new(limits, self.latched);
        self.heat = heat;
    }

    fn end(&mut self, reason: SafetyReason) {
        self.ended = reason;
        if self.state == SafetyState::Armed {
            self.state = SafetyState::RampDown;
            if self.output.iter().all(|&torque| torque == 0.0) {
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
