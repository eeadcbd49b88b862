//! The drives of one arm: replies in, phases of switching on and off, command frames out.

use super::config::{BUSES, BusJoint, alternating, micros, periods};
use super::joint::{JointCounters, JointLink, STATE_PERIODS};
use super::{BusFault, FaultCause};
use super::{DAMPING_S, ENABLE_S, SILENCE_S, SOFT_START_S};
use crate::drives::{DriveState, Frame, Frames, JointCommand, Order};
use crate::safety::{JUMP_MARGIN, SafetyLimits, SafetyReason};
use foretorque::arm::Arm;
use foretorque::joint::{JointMeasurement, JointMotion, JointVector};

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

/// Drives of some or all joints of an arm, on up to two buses. The owner has the torque and its safety.
pub struct BusDrives<const N: usize> {
    links: [Option<JointLink>; N],
    /// Joints in the order of their commands: buses take turns.
    order: [u8; N],
    phase: BusPhase,
    fault: Option<BusFault>,
    losses: u16,
    period_s: f32,
    /// Largest change of a position in one period, N × rad.
    steps: JointVector<N>,
    /// Admissible desired positions, N × rad.
    travel: [(f32, f32); N],
    /// Admissible desired velocities, N × rad/s.
    speed: [f32; N],
    /// Motion of the last command.
    desired: JointMotion<N>,
    /// Positions where drives without gains in their frames are held while they damp, N × rad.
    held: JointVector<N>,
    strays: u32,
    idle: u16,
    /// The frames that switch the drives off are still to be sent.
    off_due: bool,
}

impl<const N: usize> BusDrives<N> {
    /// Drives that are switched off.
    ///
    /// * `joints` joints with a drive on one of the buses
    pub fn new<A: Arm<N, P>, const P: usize>(
        joints: &[Option<BusJoint>; N],
        period_s: f32,
    ) -> Self {
        let mut drives = Self {
            links: joints.map(|joint| joint.map(JointLink::new)),
            order: alternating(joints),
            phase: BusPhase::Off,
            fault: None,
            losses: 0,
            period_s: 0.0,
            steps: JointVector::zeros(),
            travel: A::limits().map(|limits| limits.position),
            speed: A::limits().map(|limits| limits.velocity),
            desired: JointMotion::zero(),
            held: JointVector::zeros(),
            strays: 0,
            idle: 0,
            off_due: false,
        };
        drives.set_period::<A, P>(period_s);
        drives
    }

    /// Changes the period, s.
    pub fn set_period<A: Arm<N, P>, const P: usize>(&mut self, period_s: f32) {
        let limits = SafetyLimits::for_arm::<A, P>(micros(period_s));
        self.steps = limits.step_per_tick.add_scalar(JUMP_MARGIN);
        if let BusPhase::Damping(left) = &mut self.phase {
            *left = (f32::from(*left) * self.period_s / period_s) as u16;
        }
        self.period_s = period_s;
    }

    /// Stage of the loop.
    pub fn phase(&self) -> BusPhase {
        self.phase
    }

    /// Fault that ended the torque, or prevented it; stands until [`clear`](Self::clear).
    pub fn fault(&self) -> Option<BusFault> {
        self.fault
    }

    pub(super) fn joint(&self, index: usize) -> Option<&BusJoint> {
        let link = self.links.get(index)?.as_ref()?;
        Some(&link.joint)
    }

    /// Counters of a joint.
    pub fn counters(&self, joint: usize) -> JointCounters {
        let link = self.links.get(joint).and_then(Option::as_ref);
        link.map_or_else(JointCounters::default, |link| link.counters)
    }

    /// Frames that no drive of the profile sends.
    pub fn strays(&self) -> u32 {
        self.strays
    }

    /// Last known positions, N × rad, where every drive has replied since the start; 0 for joints without a drive.
    pub fn positions(&self) -> Option<JointVector<N>> {
        let mut positions = JointVector::<N>::zeros();
        for (slot, link) in positions.iter_mut().zip(&self.links) {
            if let Some(link) = link {
                *slot = link.reply.position?;
            }
        }
        Some(positions)
    }

    /// The first joint, from 0, whose drive still reports that it is on.
    pub fn still_on(&self) -> Option<u8> {
        let on = |link: &Option<JointLink>| {
            let state = link.as_ref().and_then(|link| link.reply.state);
            state == Some(DriveState::Enabled)
        };
        self.links.iter().position(on).map(|joint| joint as u8)
    }

    /// Temperatures that the drives have reported since the last call, up to 125: joint, °C.
    pub fn temperatures(&mut self) -> impl Iterator<Item = (usize, i8)> {
        let links = self.links.iter_mut().enumerate();
        links.filter_map(|(joint, link)| Some((joint, link.as_mut()?.temperature()?)))
    }

    /// Takes a frame that has arrived; foreign frames are counted.
    pub fn receive(&mut self, bus: u8, frame: &Frame) {
        let mut known = false;
        for link in self.links.iter_mut().flatten() {
            if link.joint.bus == bus
                && let Some(event) = link.joint.drive.decode(frame)
            {
                link.take(event);
                known = true;
            }
        }
        if !known {
            self.strays = self.strays.saturating_add(1);
        }
    }

    /// Begins to switch the drives on.
    ///
    /// Errors: the first reason against it; drives that do not reply or still damp, scales that differ, a fault that is not
    /// cleared.
    pub fn arm(&mut self) -> Result<(), BusFault> {
        if let Some(fault) = self.fault {
            return Err(fault);
        }
        match self.phase {
            BusPhase::Off if self.off_due => Err(SafetyReason::StillRamping.into()),
            BusPhase::Off => {
                self.ready()?;
                // A state from before the order proves nothing: some drives report theirs ten times a second.
                for link in self.links.iter_mut().flatten() {
                    link.reply.state = link.reply.state.and(Some(DriveState::Disabled));
                }
                self.phase = BusPhase::Enabling(0);
                Ok(())
            }
            BusPhase::Enabling(_) | BusPhase::Running(_) => Ok(()),
            BusPhase::Damping(_) => Err(SafetyReason::StillRamping.into()),
        }
    }

    /// Every drive replies, and reports no fault and the scales of its profile.
    ///
    /// Errors: the first that does not.
    pub fn ready(&self) -> Result<(), BusFault> {
        let silence = self.silence();
        for (index, link) in self.links.iter().enumerate() {
            if let Some(cause) = link.as_ref().and_then(|link| link.refusal(silence)) {
                let joint = Some(index as u8);
                return Err(BusFault { joint, cause });
            }
        }
        Ok(())
    }

    /// Switches the drives off with the next frames, without damping.
    pub fn stop(&mut self) -> BusPhase {
        self.off_due = true;
        self.phase = BusPhase::Off;
        self.phase
    }

    /// Ends the phase in which the drives follow, if they do: they damp.
    pub(super) fn damp(&mut self) -> BusPhase {
        if let BusPhase::Running(_) = self.phase {
            self.phase = BusPhase::Damping(periods(DAMPING_S, self.period_s));
        }
        self.phase
    }

    /// Clears a fault; every scale is read again.
    pub fn clear(&mut self) {
        self.fault = None;
        self.losses = 0;
        self.links.iter_mut().flatten().for_each(JointLink::restart);
    }

    /// Records a fault of the drive of `joint`, or of the bus. The owner ends the torque.
    pub fn fail(&mut self, joint: Option<u8>, cause: FaultCause) {
        self.fault.get_or_insert(BusFault { joint, cause });
    }

    /// Closes the period: writes the measurements of the joints that have drives into `measured`. `false`: a reply is
    /// missing or not sound.
    pub fn measure(&mut self, measured: &mut JointMeasurement<N>) -> bool {
        let mut whole = true;
        let slots = measured.q.iter_mut().zip(measured.tau.iter_mut());
        let links = self.links.iter_mut().zip(self.steps.iter());
        for ((link, &step), (q, tau)) in links.zip(slots) {
            match link.as_mut().map(|link| link.close(step)) {
                Some(Some((position, torque))) => (*q, *tau) = (position, torque),
                Some(None) => whole = false,
                None => {}
            }
        }
        self.losses = if whole {
            self.losses.saturating_sub(1)
        } else {
            self.losses.saturating_add(LOSS_WEIGHT)
        };
        whole
    }

    /// Every joint of the arm has a drive here.
    pub fn complete(&self) -> bool {
        self.links.iter().all(Option::is_some)
    }

    /// Looks for a reason to end the torque. `true`: there is a fault.
    #[must_use]
    pub fn supervise(&mut self) -> bool {
        let silence = self.silence();
        let started = match self.phase {
            BusPhase::Off => {
                self.losses = 0;
                // A drive that was away may have come back with another scale.
                let links = self.links.iter_mut().flatten();
                let away = links.filter(|link| link.age >= silence);
                away.for_each(JointLink::invalidate_scales);
                return self.fault.is_some();
            }
            BusPhase::Damping(_) => {
                self.losses = 0;
                return self.fault.is_some();
            }
            BusPhase::Enabling(_) => false,
            BusPhase::Running(_) => true,
        };
        for (index, link) in self.links.iter_mut().enumerate() {
            let Some(link) = link else { continue };
            let here = link.reply.position.unwrap_or_default();
            let desired = self.desired.q.get(index).copied();
            let desired = desired.filter(|_| started).unwrap_or(here);
            let off = started && link.is_off();
            let cause = link.fault(desired, silence);
            if let Some(cause) = cause.or(off.then_some(FaultCause::Disabled)) {
                self.fail(Some(index as u8), cause);
                return true;
            }
        }
        // Silence of 50 ms counts as much as the loss of every fifth period.
        if self.losses >= LOSS_WEIGHT * periods(0.05, self.period_s) {
            self.fail(None, FaultCause::Losses);
        }
        self.fault.is_some()
    }

    /// Takes the desired motion of this period; without one the last position is held.
    pub fn follow(&mut self, desired: Option<&JointMotion<N>>) {
        match desired {
            Some(desired) if finite(desired) => self.desired = *desired,
            _ => self.desired.qd.fill(0.0),
        }
    }

    /// Enters the next phase where this one is over.
    ///
    /// * `enabled` torque may flow
    /// * `arm` lets torque flow, once every drive is switched on; an error is the reason that it may not yet
    pub fn advance(&mut self, enabled: bool, arm: impl FnOnce() -> Result<(), SafetyReason>) {
        let period_s = self.period_s;
        self.phase = match self.phase {
            BusPhase::Off => BusPhase::Off,
            BusPhase::Enabling(_) if self.fault.is_some() => self.stop(),
            BusPhase::Enabling(count) => {
                let waiting = self.links.iter().position(|link| {
                    link.as_ref().is_some_and(|link| match link.reply.state {
                        Some(state) => state != DriveState::Enabled,
                        None => count < 2 * STATE_PERIODS,
                    })
                });
                let refused = match waiting {
                    Some(_) => Some(FaultCause::NotEnabled),
                    None => arm().err().map(FaultCause::Refused),
                };
                match refused {
                    None => BusPhase::Running(0),
                    Some(_) if count < periods(ENABLE_S, period_s) => {
                        BusPhase::Enabling(count.saturating_add(1))
                    }
                    Some(cause) => {
                        self.fail(waiting.map(|joint| joint as u8), cause);
                        self.stop()
                    }
                }
            }
            BusPhase::Running(count) if enabled => BusPhase::Running(count.saturating_add(1)),
            BusPhase::Running(_) => self.damp(),
            BusPhase::Damping(0) => self.stop(),
            BusPhase::Damping(left) => BusPhase::Damping(left - 1),
        };
    }

    /// Sends the frames of every joint.
    ///
    /// * `torque` torque feed-forward, N × N·m
    /// * `armed` the drives follow the desired motion; otherwise they damp
    pub fn command(
        &mut self,
        torque: &JointVector<N>,
        armed: bool,
        send: &mut impl FnMut(u8, &Frame),
    ) {
        self.idle = (self.idle + 1) % IDLE_ROUND;
        let gains = match self.phase {
            BusPhase::Running(count) => (count as f32 * self.period_s / SOFT_START_S).min(1.0),
            _ => 1.0,
        };
        let mut frames = Frames::new();
        // All drives answer one SYNC of CiA 402; no other frame is the same for two of them.
        let mut last = [None; BUSES as usize];
        for index in self.order.map(usize::from) {
            let Some(Some(link)) = self.links.get_mut(index) else {
                continue;
            };
            let joint = link.joint;
            frames.clear();
            let here = link.reply.position.unwrap_or_default();
            let mut hold = here;
            if let Some(held) = self.held.get_mut(index) {
                let moves = match self.phase {
                    BusPhase::Off => true,
                    // The arm may sag until the drive is on.
                    BusPhase::Enabling(_) => link.is_off(),
                    BusPhase::Running(_) => armed,
                    BusPhase::Damping(_) => false,
                };
                if moves {
                    *held = here;
                }
                hold = *held;
            }
            let (low, high) = self.travel.get(index).copied().unwrap_or_default();
            let speed = self.speed.get(index).copied().unwrap_or_default();
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
                BusPhase::Enabling(_) => {
                    use DriveState::{Enabled, SwitchedOn};
                    let on = matches!(link.reply.state, Some(Enabled | SwitchedOn));
                    on.then_some(resting)
                }
                BusPhase::Running(_) if armed => Some(JointCommand {
                    position: value(&self.desired.q).max(low).min(high),
                    velocity: value(&self.desired.qd).max(-speed).min(speed),
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
                    joint.drive.command(&command, &mut link.carry, &mut frames);
                }
                None if matches!(self.phase, BusPhase::Enabling(_)) => {
                    let order = match link.reply.state {
                        Some(DriveState::NotReady) => Order::Disable,
                        _ => Order::Enable,
                    };
                    joint.drive.order(order, &mut frames);
                }
                None if self.off_due => {
                    joint.drive.order(Order::Disable, &mut frames);
                }
                None if core::mem::take(&mut link.clears) => {
                    joint.drive.order(Order::ClearFault, &mut frames);
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
                let Some(last) = last.get_mut(usize::from(joint.bus)) else {
                    continue;
                };
                if last.replace(*frame) != Some(*frame) {
                    send(joint.bus, frame);
                }
            }
        }
        self.off_due &= self.phase != BusPhase::Off;
    }

    /// The drives are off, and the frames for it are sent.
    pub(super) fn is_off(&self) -> bool {
        self.phase == BusPhase::Off && !self.off_due
    }

    /// Periods without a reply that make a fault.
    fn silence(&self) -> u16 {
        periods(SILENCE_S, self.period_s)
    }
}

fn finite<const N: usize>(motion: &JointMotion<N>) -> bool {
    let mut values = motion.q.iter().chain(motion.qd.iter());
    values.all(|value| value.is_finite())
}
