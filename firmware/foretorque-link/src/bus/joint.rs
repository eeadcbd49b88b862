//! One joint of the bus: its replies, their age, the faults they show.

use super::FaultCause;
use super::config::BusJoint;
use super::{FOLLOWING_RAD, STUCK_RAD};
use crate::drives::{Carry, DriveState, Event, Frames, JointReply, Order, Scale};
use crate::safety::PLAUSIBLE_C;

/// Periods for which a torque stands that came in a frame of its own.
const TORQUE_PERIODS: u16 = 4;
/// Periods with contradicting replies that make a fault.
const CONFLICTS: u8 = 5;
/// Replies in a row too far from the desired position that make a fault.
const FAR_REPLIES: u8 = 3;
/// Periods in which a drive may still report the state before an order.
pub(super) const STATE_PERIODS: u16 = 3;
/// Highest temperature that the safety takes, °C: a drive may report more.
const MOST_C: f32 = *PLAUSIBLE_C.end() as f32;

/// Counters of one joint. All saturate.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct JointCounters {
    /// Replies.
    pub replies: u32,
    /// Periods without a reply.
    pub lost: u32,
    /// Replies beyond the first of their period.
    pub doubled: u32,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum ScaleCheck {
    /// The protocol has no question for it.
    Unreadable,
    Unknown,
    Equal,
    Different(f32),
}

pub(super) struct JointLink {
    pub(super) joint: BusJoint,
    pub(super) carry: Carry,
    pub(super) counters: JointCounters,
    /// Newest of all that the drive has replied.
    pub(super) reply: JointReply,
    /// Periods since the last reply.
    pub(super) age: u16,
    torque_age: u16,
    /// Replies of this period, and the first of their positions.
    replies: u8,
    first: Option<f32>,
    conflicts: u8,
    /// Last contradicting positions, rad.
    conflict: (f32, f32),
    scales: [ScaleCheck; 3],
    /// Reply that repeats itself, how often, and the desired position at its first time.
    repeated: (Option<f32>, Option<f32>),
    repeats: u16,
    desired_before: f32,
    /// Replies in a row that are too far from the desired position.
    far: u8,
    /// The drive has a fault that the owner has cleared.
    pub(super) clears: bool,
}

impl JointLink {
    pub(super) fn new(joint: BusJoint) -> Self {
        let mut frames = Frames::new();
        let scales = Scale::ALL.map(|scale| {
            frames.clear();
            let readable = joint.scale(scale).is_some()
                && joint.drive.order(Order::ReadScale(scale), &mut frames);
            if readable {
                ScaleCheck::Unknown
            } else {
                ScaleCheck::Unreadable
            }
        });
        Self {
            joint,
            carry: Carry::default(),
            counters: JointCounters::default(),
            reply: JointReply::default(),
            age: u16::MAX,
            torque_age: u16::MAX,
            replies: 0,
            first: None,
            conflicts: 0,
            conflict: (0.0, 0.0),
            scales,
            repeated: (None, None),
            repeats: 0,
            desired_before: 0.0,
            far: 0,
            clears: false,
        }
    }

    pub(super) fn take(&mut self, event: Event) {
        match event {
            Event::Reply(reply) => self.take_reply(&reply),
            Event::Scale(scale, value) => {
                let Some(profile) = self.joint.scale(scale) else {
                    return;
                };
                let above = self.joint.reports_limit() && scale == Scale::Torque && value > profile;
                let equal = above || (value - profile).abs() <= 1e-3 * profile;
                let check = if equal {
                    ScaleCheck::Equal
                } else {
                    ScaleCheck::Different(value)
                };
                if let Some(slot) = self.scales.get_mut(scale as usize) {
                    *slot = check;
                }
            }
        }
    }

    fn take_reply(&mut self, reply: &JointReply) {
        self.reply.update(reply);
        if reply.torque.is_some() {
            self.torque_age = 0;
        }
        let Some(position) = reply.position else {
            return;
        };
        self.first.get_or_insert(position);
        self.replies = self.replies.saturating_add(1);
        increment(&mut self.counters.replies);
        if self.replies > 1 {
            increment(&mut self.counters.doubled);
        }
    }

    /// Temperature that has come since the last call, up to 125 °C.
    pub(super) fn temperature(&mut self) -> Option<i8> {
        let celsius = self.reply.temperature.take()?;
        Some(celsius.min(MOST_C) as i8)
    }

    /// Closes a period: position and torque of its last reply, `None` without one that is sound.
    ///
    /// * `step` largest distance of two positions of one period, rad
    pub(super) fn close(&mut self, step: f32) -> Option<(f32, f32)> {
        let (replies, first) = (self.replies, self.first.take());
        self.replies = 0;
        self.torque_age = self.torque_age.saturating_add(1);
        if replies == 0 {
            self.age = self.age.saturating_add(1);
            if self.counters.replies > 0 {
                increment(&mut self.counters.lost);
            }
            return None;
        }
        self.age = 0;
        let (position, torque) = (self.reply.position?, self.reply.torque?);
        let first = first.unwrap_or(position);
        let agrees = (first - position).abs() <= step;
        if agrees {
            self.conflicts = self.conflicts.saturating_sub(1);
        } else {
            self.conflicts = self.conflicts.saturating_add(2);
            self.conflict = (first, position);
        }
        let fresh = agrees && self.torque_age <= TORQUE_PERIODS;
        fresh.then_some((position, torque))
    }

    /// Fault of the last replies while the drive is to follow `desired`, rad.
    ///
    /// * `silence` periods without a reply that make a fault
    pub(super) fn fault(&mut self, desired: f32, silence: u16) -> Option<FaultCause> {
        let (position, torque) = (self.reply.position, self.reply.torque);
        if self.age == 0 && (position, torque) == self.repeated {
            self.repeats = self.repeats.saturating_add(1);
        } else if self.age == 0 {
            self.repeated = (position, torque);
            self.repeats = 0;
            self.desired_before = desired;
        }
        if self.age >= silence {
            return Some(FaultCause::Silent);
        }
        if let Some(DriveState::Fault(code)) = self.reply.state {
            return Some(FaultCause::Drive(code));
        }
        if self.conflicts >= 2 * CONFLICTS {
            let (one, other) = self.conflict;
            return Some(FaultCause::Ambiguous(one, other));
        }
        if self.repeats >= silence && (desired - self.desired_before).abs() > STUCK_RAD {
            return Some(FaultCause::Stuck);
        }
        let here = position.filter(|here| (desired - here).abs() > FOLLOWING_RAD);
        // A single one may be damaged.
        self.far = match here {
            Some(_) => self.far.saturating_add(u8::from(self.age == 0)),
            None => 0,
        };
        let here = here.filter(|_| self.far >= FAR_REPLIES);
        here.map(|here| FaultCause::NotFollowing(desired, here))
            .or_else(|| self.different_scale())
    }

    fn different_scale(&self) -> Option<FaultCause> {
        Scale::ALL
            .into_iter()
            .zip(self.scales)
            .find_map(|(scale, check)| match check {
                ScaleCheck::Different(drive) => {
                    let profile = self.joint.scale(scale).unwrap_or_default();
                    Some(FaultCause::Scale(scale, profile, drive))
                }
                _ => None,
            })
    }

    /// Reason against switching the drive on.
    pub(super) fn refusal(&self, silence: u16) -> Option<FaultCause> {
        if self.age >= silence || self.reply.position.is_none() {
            return Some(FaultCause::Silent);
        }
        if let Some(DriveState::Fault(code)) = self.reply.state {
            return Some(FaultCause::Drive(code));
        }
        self.different_scale()
            .or_else(|| self.unknown_scale().map(FaultCause::ScaleUnknown))
    }

    /// The drive reports a state, and not that its torque follows the commands.
    pub(super) fn is_off(&self) -> bool {
        let state = self.reply.state;
        state.is_some_and(|state| state != DriveState::Enabled)
    }

    /// The first scale that the drive can report and has not.
    pub(super) fn unknown_scale(&self) -> Option<Scale> {
        let mut checks = Scale::ALL.into_iter().zip(self.scales);
        let found = checks.find(|(_, check)| *check == ScaleCheck::Unknown);
        found.map(|(scale, _)| scale)
    }

    /// Drops the scales, so that they are read again.
    pub(super) fn invalidate_scales(&mut self) {
        for check in &mut self.scales {
            if *check != ScaleCheck::Unreadable {
                *check = ScaleCheck::Unknown;
            }
        }
    }

    /// Drops all but the counters after a fault; scales are read again.
    pub(super) fn restart(&mut self) {
        let counters = self.counters;
        let clears = matches!(self.reply.state, Some(DriveState::Fault(_)));
        *self = Self::new(self.joint);
        (self.counters, self.clears) = (counters, clears);
    }
}

fn increment(counter: &mut u32) {
    *counter = counter.saturating_add(1);
}
