use super::config::{BusConfig, BusConfigError};
use super::drives::{BusDrives, BusPhase};
use super::joint::JointCounters;
use super::{BusFault, FaultCause};
use crate::drives::{Frame, Saturation};
use crate::safety::{Safety, SafetyReason, SafetyState, SafetyStatus};
use crate::session::LearnerMailbox;
use foretorque::arm::Arm;
use foretorque::feedforward::{FeedForward, FeedForwardConfig, Torque};
use foretorque::joint::{JointMeasurement, JointMotion, JointSample, JointVector};
use foretorque::learning::{ParameterSet, Request, RequestPending};

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
    /// Values of all joints that did not fit a frame.
    pub saturation: Saturation,
}

/// Loop of the drives of one arm: desired motion in, command frames out, replies in.
///
/// ```
/// use foretorque::arm::ur5::Ur5;
/// use foretorque::learning::ParameterSet;
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
/// let mut bus = BusController::<Ur5, 6, 40>::new(config, ParameterSet::nominal::<Ur5>(1))?;
/// let (mut mailbox, mut sent) = (LearnerMailbox::new(), 0);
/// let tick = bus.tick(None, &mut mailbox, |_bus, _frame| sent += 1);
/// assert_eq!((tick.phase, sent), (BusPhase::Off, 6));
/// # Ok::<(), foretorque_link::bus::BusConfigError>(())
/// ```
pub struct BusController<A: Arm<N, P>, const N: usize, const P: usize> {
    config: BusConfig<N>,
    feed_forward: FeedForward<A, N, P>,
    safety: Safety<N>,
    drives: BusDrives<N>,
}

impl<A: Arm<N, P>, const N: usize, const P: usize> BusController<A, N, P> {
    /// A loop at tick 0 with `set` active, learning off, drives off.
    ///
    /// Errors: the first contradiction of `config`.
    pub fn new(config: BusConfig<N>, set: ParameterSet<N, P>) -> Result<Self, BusConfigError> {
        config.check::<A, P>()?;
        let period_s = config.period_s;
        let mut limits = FeedForwardConfig::for_arm::<A, P>(period_s);
        for (joint, bounds) in config.joints.iter().zip(&mut limits.limits) {
            bounds.torque = bounds.torque.min(joint.drive.torque_limit);
        }
        let refused = |_| BusConfigError {
            joint: None,
            field: "period_s",
            value: period_s,
            against: "the limits of the arm over a period of",
            bound: period_s,
        };
        Ok(Self {
            feed_forward: FeedForward::new(limits, set).map_err(refused)?,
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

    /// Stage of the loop.
    pub fn phase(&self) -> BusPhase {
        self.drives.phase()
    }

    /// Fault that ended the torque, or prevented it; stands until [`clear`](Self::clear).
    pub fn fault(&self) -> Option<BusFault> {
        self.drives.fault()
    }

    /// Counters of a joint.
    pub fn counters(&self, joint: usize) -> JointCounters {
        self.drives.counters(joint)
    }

    /// Periods since the last reply of a joint.
    pub fn age(&self, joint: usize) -> u16 {
        self.drives.age(joint)
    }

    /// Frames that no drive of the profile sends.
    pub fn strays(&self) -> u32 {
        self.drives.strays()
    }

    /// Last known positions, N × rad, where every drive has replied since the start.
    pub fn positions(&self) -> Option<JointVector<N>> {
        self.drives.positions()
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
        self.feed_forward.request(request, mailbox.exchange())
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
    /// Errors: the first reason against it; drives that do not reply, scales that differ, a fault that is not cleared.
    pub fn arm(&mut self) -> Result<(), BusFault> {
        self.drives.arm()
    }

    /// Every drive replies, and reports no fault and the scales of its profile.
    ///
    /// Errors: the first that does not.
    pub fn ready(&self) -> Result<(), BusFault> {
        self.drives.ready()
    }

    /// Ramps the torque to zero, damps, and switches the drives off.
    pub fn disarm(&mut self) {
        self.safety.disarm();
        if let BusPhase::Enabling(_) = self.phase() {
            self.drives.stop();
        }
    }

    /// Emergency stop: torque zero and drives off with the next frames.
    pub fn stop(&mut self) {
        self.safety.torque_off(SafetyReason::Stopped);
        self.feed_forward.applied(self.safety.output());
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
        self.feed_forward.adopt(mailbox.exchange());
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
        self.drives.advance(enabled, || safety.arm().is_ok());
        if self.fault().is_some() {
            self.safety.trip(SafetyReason::Drive);
        }
        let armed = self.safety.status().state == SafetyState::Armed;
        let saturation = self.drives.command(&torque.total, armed, &mut send);
        BusTick {
            torque,
            measured,
            status: self.safety.status(),
            phase: self.phase(),
            saturation,
        }
    }
}
