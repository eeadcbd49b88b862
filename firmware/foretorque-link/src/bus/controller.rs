use super::config::{BusConfig, BusConfigError, BusJoint};
use super::fault::{BusFault, FaultCause};
use super::joint::{JointCounters, JointLink, STATE_PERIODS};
use super::{DAMPING_S, ENABLE_S, SILENCE_S, SOFT_START_S};
use crate::drives::{DriveState, Frame, Frames, JointCommand, Order, Saturation};
use crate::safety::{Safety, SafetyReason, SafetyState, SafetyStatus};
use crate::session::LearnerMailbox;
use foretorque::arm::Arm;
use foretorque::feedforward::{FeedForward, FeedForwardConfig, Torque};
use foretorque::joint::{JointMeasurement, JointMotion, JointSample, JointVector};
use foretorque::learning::{ParameterSet, Request, RequestPending};
use foretorque::limits::Flags;

/// Weight of a period that lacks a reply; a whole one takes back 1. So one in five is too many.
const LOSS_WEIGHT: u16 = 4;
/// Periods of a round in which an idle drive is asked for its scales and for a report.
const IDLE_ROUND: u16 = 4;

/// Stage of the loop.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum BusPhase {
    /// The drives are switched off.
    #[default]
    Off,
    /// The drives are being switched on, without torque; periods so far.
    Enabling(u16),
    /// The drives follow; periods so far.
    Running(u32),
    /// The torque has ended, the drives damp; periods left.
    Damping(u16),
}

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
    links: [JointLink; N],
    /// Joints in the order of their commands: buses take turns.
    order: [u8; N],
    phase: BusPhase,
    fault: Option<BusFault>,
    losses: u16,
    silence: u16,
    /// Largest change of a position in one period, N × rad.
    steps: JointVector<N>,
    /// Motion of the last command.
    desired: JointMotion<N>,
    /// Positions where drives without gains in their frames are held while they damp, N × rad.
    held: JointVector<N>,
    strays: u32,
    idle: u16,
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
        let safety = config.safety_limits::<A, P>();
        let refused = |_| BusConfigError {
            joint: None,
            field: "period_s",
            value: period_s,
            against: "the limits of the arm over a period of",
            bound: period_s,
        };
        let mut steps = safety.step_per_tick;
        steps.add_scalar_mut(safety.jump_margin);
        Ok(Self {
            feed_forward: FeedForward::new(limits, set).map_err(refused)?,
            safety: Safety::new(safety, SafetyReason::None),
            links: config.joints.each_ref().map(JointLink::new),
            order: alternating(&config.joints),
            phase: BusPhase::Off,
            fault: None,
            losses: 0,
            silence: periods(SILENCE_S, period_s),
            steps,
            desired: JointMotion::zero(),
            held: JointVector::zeros(),
            strays: 0,
            idle: 0,
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
        self.phase
    }

    /// Fault that ended the torque, or prevented it; stands until [`clear`](Self::clear).
    pub fn fault(&self) -> Option<BusFault> {
        self.fault
    }

    /// Counters of a joint.
    pub fn counters(&self, joint: usize) -> JointCounters {
        self.links
            .get(joint)
            .map_or_else(JointCounters::default, |link| link.counters)
    }

    /// Periods since the last reply of a joint.
    pub fn age(&self, joint: usize) -> u16 {
        self.links.get(joint).map_or(u16::MAX, |link| link.age)
    }

    /// Frames that no drive of the profile sends.
    pub fn strays(&self) -> u32 {
        self.strays
    }

    /// Last known positions, N × rad, where every drive has replied since the start.
    pub fn positions(&self) -> Option<JointVector<N>> {
        let mut positions = JointVector::<N>::zeros();
        for (slot, link) in positions.iter_mut().zip(&self.links) {
            *slot = link.position()?;
        }
        Some(positions)
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
        let mut known = false;
        for (joint, link) in self.config.joints.iter().zip(&mut self.links) {
            if joint.bus == bus
                && let Some(event) = joint.drive.decode(frame)
            {
                link.take(joint, event);
                known = true;
            }
        }
        if !known {
            self.strays = self.strays.saturating_add(1);
        }
    }

    /// Ends the torque because a bus is off.
    pub fn bus_off(&mut self) {
        self.fail(None, FaultCause::BusOff);
    }

    /// Begins to switch the drives on.
    ///
    /// Errors: the first reason against it; drives that do not reply, scales that differ, a fault that is not cleared.
    pub fn arm(&mut self) -> Result<(), BusFault> {
        if let Some(fault) = self.fault {
            return Err(fault);
        }
        if self.phase != BusPhase::Off {
            return Ok(());
        }
        self.ready()?;
        self.phase = BusPhase::Enabling(0);
        Ok(())
    }

    /// Every drive replies, and reports no fault and the scales of its profile.
    ///
    /// Errors: the first that does not.
    pub fn ready(&self) -> Result<(), BusFault> {
        for (index, (joint, link)) in self.config.joints.iter().zip(&self.links).enumerate() {
            if let Some(cause) = link.refusal(joint, self.silence) {
                let joint = Some(index as u8);
                return Err(BusFault { joint, cause });
            }
        }
        Ok(())
    }

    /// Ramps the torque to zero, damps, and switches the drives off.
    pub fn disarm(&mut self) {
        self.safety.disarm();
        if let BusPhase::Enabling(_) = self.phase {
            self.phase = BusPhase::Off;
        }
    }

    /// Emergency stop: torque zero and drives off with the next frames.
    pub fn stop(&mut self) {
        self.safety.torque_off(SafetyReason::Stopped);
        self.feed_forward.applied(self.safety.output());
        self.phase = BusPhase::Off;
    }

    /// Clears a fault; every scale is read again.
    ///
    /// Errors: torque still ramps to zero, or a motor is still too hot.
    pub fn clear(&mut self) -> Result<(), SafetyReason> {
        self.safety.clear()?;
        self.fault = None;
        self.losses = 0;
        for (link, joint) in self.links.iter_mut().zip(&self.config.joints) {
            link.restart(joint);
        }
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
        let measured = self.close_period();
        self.supervise();
        let sample = desired.map(|desired| JointSample {
            desired: *desired,
            measured,
        });
        let sample = self.safety.admit(sample, 1, SafetyReason::None);
        let mut torque = match &sample {
            Some(sample) => self.feed_forward.step(sample),
            None => self.feed_forward.step_stale(),
        };
        // Without the share that carries it, a joint falls.
        if torque.flags.contains(Flags::GRAVITY_LOST) {
            self.safety.check(SafetyReason::GravityLost);
        }
        torque.total = self.safety.release(&torque.total);
        self.feed_forward.applied(&torque.total);
        let used = sample.as_ref().and_then(|sample| sample.measured);
        mailbox.post(self.feed_forward.learning_sample(used));
        match sample {
            Some(sample) if finite(&sample.desired) => self.desired = sample.desired,
            // Without a motion the last position is held.
            _ => self.desired.qd.fill(0.0),
        }
        self.advance();
        let saturation = self.command(&torque.total, &mut send);
        BusTick {
            torque,
            measured,
            status: self.safety.status(),
            phase: self.phase,
            saturation,
        }
    }

    fn close_period(&mut self) -> Option<JointMeasurement<N>> {
        let mut measured = JointMeasurement::<N> {
            q: JointVector::zeros(),
            tau: JointVector::zeros(),
        };
        let mut whole = true;
        let slots = measured.q.iter_mut().zip(measured.tau.iter_mut());
        let links = self.links.iter_mut().zip(self.steps.iter());
        for (joint, ((link, &step), (q, tau))) in links.zip(slots).enumerate() {
            match link.close(step) {
                Some((position, torque)) => (*q, *tau) = (position, torque),
                None => whole = false,
            }
            if let Some(celsius) = link.temperature() {
                self.safety.note_temperature(joint, celsius);
            }
        }
        self.losses = if whole {
            self.losses.saturating_sub(1)
        } else {
            self.losses.saturating_add(LOSS_WEIGHT)
        };
        whole.then_some(measured)
    }

    /// Ends the torque when the drives give reason to.
    fn supervise(&mut self) {
        let started = match self.phase {
            BusPhase::Off | BusPhase::Damping(_) => {
                self.losses = 0;
                return;
            }
            BusPhase::Enabling(_) => false,
            BusPhase::Running(_) => true,
        };
        for index in 0..N {
            let joint = self.config.joints.get(index);
            let link = self.links.get_mut(index);
            let (Some(joint), Some(link)) = (joint, link) else {
                continue;
            };
            let here = link.position().unwrap_or_default();
            let desired = self.desired.q.get(index).copied();
            let desired = desired.filter(|_| started).unwrap_or(here);
            let off = started && link.state == Some(DriveState::Disabled);
            let cause = link.fault(joint, desired, self.silence);
            if let Some(cause) = cause.or(off.then_some(FaultCause::Disabled)) {
                self.fail(Some(index as u8), cause);
                return;
            }
        }
        // Silence of 50 ms counts as much as the loss of every fifth period.
        if self.losses >= LOSS_WEIGHT * periods(0.05, self.config.period_s) {
            self.fail(None, FaultCause::Losses);
        }
    }

    fn fail(&mut self, joint: Option<u8>, cause: FaultCause) {
        self.fault.get_or_insert(BusFault { joint, cause });
        self.safety.trip(SafetyReason::Drive);
    }

    /// Enters the next phase where this one is over.
    fn advance(&mut self) {
        let period_s = self.config.period_s;
        self.phase = match self.phase {
            BusPhase::Off => BusPhase::Off,
            BusPhase::Enabling(_) if self.fault.is_some() => BusPhase::Off,
            BusPhase::Enabling(count) => {
                let waiting = self.links.iter().position(|link| match link.state {
                    Some(state) => state != DriveState::Enabled,
                    None => count < 2 * STATE_PERIODS,
                });
                let refusal = match waiting {
                    None => self.safety.arm().err(),
                    Some(_) => Some(SafetyReason::NoSample),
                };
                match refusal {
                    None => BusPhase::Running(0),
                    Some(_) if count < periods(ENABLE_S, period_s) => {
                        BusPhase::Enabling(count.saturating_add(1))
                    }
                    Some(_) => {
                        let joint = waiting.map(|joint| joint as u8);
                        self.fail(joint, FaultCause::NotEnabled);
                        BusPhase::Off
                    }
                }
            }
            BusPhase::Running(count) if self.safety.enabled() => {
                BusPhase::Running(count.saturating_add(1))
            }
            BusPhase::Running(_) => BusPhase::Damping(periods(DAMPING_S, period_s)),
            BusPhase::Damping(0) => BusPhase::Off,
            BusPhase::Damping(left) => BusPhase::Damping(left - 1),
        };
    }

    /// Sends the frames of every joint.
    fn command(
        &mut self,
        torque: &JointVector<N>,
        send: &mut impl FnMut(u8, &Frame),
    ) -> Saturation {
        self.idle = (self.idle + 1) % IDLE_ROUND;
        let armed = self.safety.status().state == SafetyState::Armed;
        let gains = match self.phase {
            BusPhase::Running(count) => {
                (count as f32 * self.config.period_s / SOFT_START_S).min(1.0)
            }
            _ => 1.0,
        };
        let mut saturation = Saturation::default();
        let mut frames = Frames::new();
        for index in self.order.map(usize::from) {
            let (joint, link) = (self.config.joints.get(index), self.links.get_mut(index));
            let (Some(joint), Some(link)) = (joint, link) else {
                continue;
            };
            frames.clear();
            let here = link.position().unwrap_or_default();
            let held = self.held.get_mut(index);
            let hold = match held {
                Some(held) if armed => {
                    *held = here;
                    here
                }
                Some(held) => *held,
                None => here,
            };
            let bounds = A::limits().get(index).map(|limits| limits.position);
            let (low, high) = bounds.unwrap_or_default();
            let value = |vector: &JointVector<N>| vector.get(index).copied().unwrap_or_default();
            let resting = JointCommand {
                position: if joint.drive.carries_gains() {
                    here
                } else {
                    hold
                },
                ..JointCommand::default()
            };
            let command = match self.phase {
                BusPhase::Off => None,
                BusPhase::Enabling(_) if link.state == Some(DriveState::Enabled) => Some(resting),
                BusPhase::Enabling(_) => None,
                BusPhase::Running(_) if armed => Some(JointCommand {
                    position: value(&self.desired.q).clamp(low, high),
                    velocity: value(&self.desired.qd),
                    torque: value(torque),
                    kp: gains * joint.kp,
                    kd: gains * joint.kd,
                }),
                BusPhase::Running(_) => Some(JointCommand {
                    torque: value(torque),
                    kd: joint.kd,
                    ..resting
                }),
                BusPhase::Damping(_) => Some(JointCommand {
                    kd: joint.kd,
                    ..resting
                }),
            };
            match command {
                Some(command) => {
                    saturation.insert(joint.drive.command(&command, &mut link.carry, &mut frames));
                }
                None if matches!(self.phase, BusPhase::Enabling(_)) => {
                    joint.drive.order(Order::Enable, &mut frames);
                }
                None => {
                    let scale = link.unknown_scale().filter(|_| self.idle % 2 == 1);
                    let known = scale.is_some_and(|scale| {
                        joint.drive.order(Order::ReadScale(scale), &mut frames)
                    });
                    let reported =
                        known || self.idle != 0 && joint.drive.order(Order::Report, &mut frames);
                    if !reported {
                        joint.drive.order(Order::Disable, &mut frames);
                    }
                }
            }
            for frame in &frames {
                send(joint.bus, frame);
            }
        }
        saturation
    }
}

/// Periods in a time, rounded up.
fn periods(time_s: f32, period_s: f32) -> u16 {
    (time_s / period_s) as u16 + 1
}

fn finite<const N: usize>(motion: &JointMotion<N>) -> bool {
    let mut values = motion.q.iter().chain(motion.qd.iter());
    values.all(|value| value.is_finite())
}

/// Joints in an order in which the buses take turns.
fn alternating<const N: usize>(joints: &[BusJoint; N]) -> [u8; N] {
    let mut order = [0; N];
    let mut next = [0_usize; super::config::BUSES as usize];
    let mut turn = 0_u8;
    for slot in &mut order {
        for _ in 0..super::config::BUSES {
            let bus = turn;
            turn = (turn + 1) % super::config::BUSES;
            let Some(from) = next.get_mut(usize::from(bus)) else {
                continue;
            };
            let mut left = joints.iter().enumerate().skip(*from);
            if let Some((joint, _)) = left.find(|(_, joint)| joint.bus == bus) {
                *from = joint + 1;
                *slot = joint as u8;
                break;
            }
            *from = N;
        }
    }
    order
}
