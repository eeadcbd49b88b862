//! The loop of an arm whose joints are drives on one or two CAN buses.
//!
//! ```text
//! period k    tick: replies of k−1 ─► sample ─► safety, feed-forward ─► commands of all joints, torque included
//!             afterwards: the learner takes its sample; replies to the commands of k arrive
//! ```
//! Sans-IO: the owner passes in frames as they arrive, calls [`BusController::tick`] once a period, and sends what it
//! passes out. The torque of a tick belongs to the desired motion of that tick and leaves at once; the measurement is that
//! of the commands one period before. `docs/bus.md` lists the latencies.
//!
//! A drive that is silent, reports a fault, resets, or reports another scale than its profile ends the torque: it ramps to
//! zero within 10 ms, the drives damp the arm for [`DAMPING_S`], then they are switched off.

mod board;
mod config;
mod drives;
mod joint;

use crate::bank::{Parameters, feed_forward_config};
use crate::drives::{Contradiction, Frame, Scale};
use crate::safety::{Safety, SafetyReason, SafetyState, SafetyStatus};
use crate::session::LearnerMailbox;
pub use board::{BoardDrives, Role, Wires, Wiring};
pub use config::{BusConfig, BusJoint};
use core::fmt;
pub use drives::{BusDrives, BusPhase};
use foretorque::arm::Arm;
use foretorque::feedforward::{FeedForward, Torque};
use foretorque::joint::{JointMeasurement, JointMotion, JointSample};
use foretorque::learning::{Request, RequestPending};
pub use joint::JointCounters;

/// Time without a reply of a drive after which the torque ends, s.
pub const SILENCE_S: f32 = 0.02;
/// Time in which stiffness and damping rise to those of the profile, s.
pub const SOFT_START_S: f32 = 0.5;
/// Time for which the drives damp the arm after the torque has ended, s.
pub const DAMPING_S: f32 = 1.0;
/// Time that the drives have to report that they are enabled, s.
pub const ENABLE_S: f32 = 0.5;
/// Distance between desired and measured position that ends the torque, rad.
pub const FOLLOWING_RAD: f32 = 0.3;
/// Change of the desired position during which a reply that repeats itself counts as stuck, rad.
pub const STUCK_RAD: f32 = 0.05;

errors! {
    /// Cause of a fault of the bus.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub enum FaultCause {
        /// (Within [`SILENCE_S`].)
        Silent = "the drive does not answer";
        Drive(code: u32) = "the drive reports fault {code:#x}";
        /// (Without an order: it has reset, or its watchdog has ended.)
        Disabled = "the drive has switched itself off";
        NotEnabled = "the drive does not switch on";
        StillOn = "the drive does not switch off";
        Scale(scale: Scale, profile: f32, drive: f32) = "{scale} is {profile} in the profile, {drive} in the drive";
        /// (Its protocol can.)
        ScaleUnknown(scale: Scale) = "the drive does not report {scale}";
        /// (More than [`FOLLOWING_RAD`] apart.)
        NotFollowing(desired: f32, measured: f32) = "desired position {desired:.3} rad, measured {measured:.3} rad";
        /// (While the desired position moves.)
        Stuck = "the reply of the drive repeats itself";
        Ambiguous(one: f32, other: f32) =
            "two replies in one period, {one:.3} rad and {other:.3} rad: is the identifier used twice?";
        /// (It is overloaded or disturbed.)
        Losses = "the bus loses more than one period in five";
        BusOff = "the bus is off";
        /// (The drives are ready.)
        Refused(reason: SafetyReason) = "torque may not flow: {reason}";
    }
}

/// Fault of the bus, or of the drive of one joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BusFault {
    /// Joint, from 0; `None` where no single joint is at fault.
    pub joint: Option<u8>,
    /// Cause.
    pub cause: FaultCause,
}

impl From<SafetyReason> for BusFault {
    fn from(reason: SafetyReason) -> Self {
        let cause = FaultCause::Refused(reason);
        Self { joint: None, cause }
    }
}

impl fmt::Display for BusFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(joint) = self.joint {
            write!(f, "joint {}: ", joint + 1)?;
        }
        write!(f, "{}", self.cause)
    }
}

#[cfg(test)]
mod board_tests;
#[cfg(test)]
mod tests;

/// Result of one period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BusTick<const N: usize> {
    /// Torque of the period, N × N·m; the total is what the commands carry.
    pub torque: Torque<N>,
    /// Measurement of the period before, where every drive has replied.
    pub measured: Option<JointMeasurement<N>>,
    /// State of the torque.
    pub status: SafetyStatus,
    /// Stage.
    pub phase: BusPhase,
}

/// Loop of the drives of one arm: desired motion in, command frames out, replies in.
///
/// ```
/// use foretorque::arm::ur5::Ur5;
/// use foretorque_link::bank::Parameters;
/// use foretorque_link::bus::{BusConfig, BusController, BusJoint, BusPhase};
/// use foretorque_link::drives::{DriveProfile, Protocol, Ranges};
/// use foretorque_link::session::LearnerMailbox;
/// let ranges = Ranges { position: 12.5, velocity: 30.0, torque: 200.0, kp: 5000.0, kd: 500.0 };
/// let joint = |id| BusJoint {
///     drive: DriveProfile {
///         protocol: Protocol::MiniCheetah(ranges),
///         id, host_id: 0, sign: 1.0, zero: 0.0, gear: 1.0, torque_limit: 28.0,
///     },
///     bus: 0, kp: 100.0, kd: 5.0,
/// };
/// let config = BusConfig { period_s: 2e-3, joints: [1, 2, 3, 4, 5, 6].map(joint) };
/// let mut bus = BusController::<Ur5, 6, 40>::new(config, &Parameters::nominal::<Ur5>())?;
/// let (mut mailbox, mut sent) = (LearnerMailbox::default(), 0);
/// let tick = bus.tick(None, &mut mailbox, |_bus, _frame| sent += 1);
/// assert_eq!((tick.phase, sent), (BusPhase::Off, 6));
/// # Ok::<(), foretorque_link::drives::Contradiction>(())
/// ```
pub struct BusController<A: Arm<N, P>, const N: usize, const P: usize> {
    config: BusConfig<N>,
    feed_forward: FeedForward<A, N, P>,
    safety: Safety<N>,
    drives: BusDrives<N>,
}

impl<A: Arm<N, P>, const N: usize, const P: usize> BusController<A, N, P> {
    /// A loop at tick 0 with `parameters` in force, learning off, drives off. A joint has the lower one of the torque limits
    /// of its drive and of the parameters.
    ///
    /// Errors: the first contradiction of `config`; limits beyond the arm's.
    pub fn new(
        mut config: BusConfig<N>,
        parameters: &Parameters<N, P>,
    ) -> Result<Self, Contradiction> {
        config.check::<A, P>()?;
        let period_s = config.period_s;
        let against = "the limits of the arm over a period of";
        let refused = Contradiction::new("period_s", period_s, against, period_s);
        let limits = feed_forward_config::<A, N, P>(&parameters.bounds, period_s);
        let mut limits = limits.map_err(|_| refused)?;
        for (number, joint) in config.joints.iter_mut().enumerate() {
            let torque = &mut joint.drive.torque_limit;
            *torque = torque.min(limits.limits[number].torque);
            limits.limit_torque(number, *torque);
        }
        Ok(Self {
            feed_forward: FeedForward::new(limits, parameters.set).map_err(|_| refused)?,
            safety: Safety::new(config.safety_limits::<A, P>(), SafetyReason::None),
            drives: BusDrives::new::<A, P>(&config.joints.map(Some), period_s),
            config,
        })
    }

    /// Drives and period.
    pub fn config(&self) -> &BusConfig<N> {
        &self.config
    }

    /// The feed-forward of the ticks.
    pub fn feed_forward(&self) -> &FeedForward<A, N, P> {
        &self.feed_forward
    }

    /// State of the torque, and its reason.
    pub fn status(&self) -> SafetyStatus {
        self.safety.status()
    }

    /// The drives: stage, fault, counters, positions.
    pub fn drives(&self) -> &BusDrives<N> {
        &self.drives
    }

    /// Switches learning on or off from the next tick on.
    pub fn set_learning(&mut self, on: bool) {
        self.feed_forward.set_learning(on);
    }

    /// Asks the learner for `request`.
    ///
    /// Errors: the request before has not been taken yet.
    pub fn request(
        &mut self,
        request: Request,
        mailbox: &mut LearnerMailbox<N, P>,
    ) -> Result<(), RequestPending> {
        self.feed_forward.request(request, &mut mailbox.exchange)
    }

    /// Takes a frame that has arrived; foreign frames are counted.
    pub fn receive(&mut self, bus: u8, frame: &Frame) {
        self.drives.receive(bus, frame);
    }

    /// Ends the torque because a bus is off.
    pub fn bus_off(&mut self) {
        self.drives.fail(None, FaultCause::BusOff);
        self.safety.trip(SafetyReason::Drive);
    }

    /// Begins to switch the drives on.
    ///
    /// Errors: the first reason against it; a fault that is not cleared, torque that still ramps, a hot motor, drives that
    /// do not reply or still damp, scales that differ.
    pub fn arm(&mut self) -> Result<(), BusFault> {
        self.drives.fault().map_or(Ok(()), Err)?;
        self.safety.ready()?;
        self.drives.arm()
    }

    /// Ramps the torque to zero, damps, and switches the drives off.
    pub fn disarm(&mut self) {
        self.safety.disarm();
        if let BusPhase::Enabling(_) = self.drives.phase() {
            self.drives.stop();
        }
    }

    /// Emergency stop: torque zero and drives off with the next frames. Learning stops, until it is switched off.
    pub fn stop(&mut self, mailbox: &mut LearnerMailbox<N, P>) {
        self.safety.torque_off(SafetyReason::Stopped);
        self.feed_forward.applied(self.safety.output());
        let exchange = &mut mailbox.exchange;
        self.feed_forward.request_over(Request::Stop, exchange);
        self.drives.stop();
    }

    /// Clears a fault; every scale is read again.
    ///
    /// Errors: torque still ramps to zero, or a motor is still too hot.
    pub fn clear(&mut self) -> Result<(), SafetyReason> {
        self.safety.clear()?;
        self.drives.clear();
        Ok(())
    }

    /// Runs one period: replies so far in, command frames out through `send` with the number of their bus.
    ///
    /// * `desired` motion in the middle of the time in which the commands hold; `None` when the host gives none
    pub fn tick(
        &mut self,
        desired: Option<&JointMotion<N>>,
        mailbox: &mut LearnerMailbox<N, P>,
        mut send: impl FnMut(u8, &Frame),
    ) -> BusTick<N> {
        self.safety.period();
        self.feed_forward.adopt(&mut mailbox.exchange);
        let mut measured = JointMeasurement::zero();
        let measured = self.drives.measure(&mut measured).then_some(measured);
        for (joint, celsius) in self.drives.temperatures() {
            self.safety.note_temperature(joint, celsius);
        }
        if self.drives.supervise() {
            self.safety.trip(SafetyReason::Drive);
        }
        let sample = desired.map(|desired| JointSample {
            desired: *desired,
            measured,
        });
        let sample = self.safety.admit(sample, 1, SafetyReason::None);
        let torque = self.safety.step(&mut self.feed_forward, sample.as_ref());
        let used = sample.as_ref().and_then(|sample| sample.measured);
        mailbox.post(self.feed_forward.learning_sample(used));
        self.drives
            .follow(sample.as_ref().map(|sample| &sample.desired));
        let (enabled, safety) = (self.safety.enabled(), &mut self.safety);
        self.drives.advance(enabled, || safety.arm());
        if self.drives.fault().is_some() {
            self.safety.trip(SafetyReason::Drive);
        }
        let armed = self.safety.status().state == SafetyState::Armed;
        self.drives.command(&torque.total, armed, &mut send);
        BusTick {
            torque,
            measured,
            status: self.safety.status(),
            phase: self.drives.phase(),
        }
    }
}
