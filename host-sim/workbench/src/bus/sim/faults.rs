//! Faults of a simulated bus and of the drives on it.

use foretorque_link::drives::Frame;
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use std::ops::Range;

/// One kind of fault.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LineFault {
    /// Share of commands that do not reach the drive of a joint.
    LostCommands(usize, f64),
    /// Share of replies of a joint that do not reach the host.
    LostReplies(usize, f64),
    /// Replies of a joint come this many replies late.
    LateReplies(usize, usize),
    /// Commands of a joint arrive twice.
    DoubledCommands(usize),
    /// Replies of a joint arrive twice.
    DoubledReplies(usize),
    /// The drive of a joint repeats one reply.
    StuckReply(usize),
    /// The drive of a joint sends the first byte of the reply of another: its identifier.
    WrongIdentifier(usize, u8),
    /// A share of the replies of a joint has one wrong bit, not found by the checksum.
    FlippedBits(usize, f64),
    /// The drive of a joint is dead: it takes and sends nothing.
    Dead(usize),
    /// The drive of a joint starts over at the begin.
    Reset(usize),
    /// The drive of a joint has a fault with this code at the begin.
    DriveFault(usize, u32),
    /// No frame passes a bus.
    BusOff(usize),
    /// A foreign node on a bus sends this identifier all the time, ahead of everybody.
    Babble(usize, u32),
    /// A bus runs at this share of its rate.
    Overload(usize, f64),
    /// The user interrupts at the begin.
    Interrupt,
}

/// A fault with its time, s, and the frames that it holds.
#[derive(Clone, Debug, Default)]
pub struct TimedFault {
    fault: Option<(LineFault, Range<f64>)>,
    late: std::collections::VecDeque<Frame>,
    stuck: Option<Frame>,
}

impl TimedFault {
    /// A fault in force in `time_s`, s.
    pub fn new(fault: LineFault, time_s: Range<f64>) -> Self {
        Self {
            fault: Some((fault, time_s)),
            ..Self::default()
        }
    }

    fn active(&self, now_s: f64) -> Option<LineFault> {
        let (fault, time_s) = self.fault.as_ref()?;
        time_s.contains(&now_s).then_some(*fault)
    }

    /// The fault, if it begins in the step.
    pub(super) fn beginning(&self, now_s: f64, step_s: f64) -> Option<LineFault> {
        let (fault, time_s) = self.fault.as_ref()?;
        let begins = (time_s.start..time_s.start + step_s).contains(&now_s);
        begins.then_some(*fault)
    }

    pub(super) fn bus_is_off(&self, bus: usize, now_s: f64) -> bool {
        self.active(now_s) == Some(LineFault::BusOff(bus))
    }

    pub(super) fn is_dead(&self, joint: usize, now_s: f64) -> bool {
        self.active(now_s) == Some(LineFault::Dead(joint))
    }

    pub(super) fn babble(&self, bus: usize, now_s: f64) -> Option<Frame> {
        match self.active(now_s) {
            Some(LineFault::Babble(on, id)) if on == bus => Some(Frame::standard(id, &[0; 8])),
            _ => None,
        }
    }

    /// Share of the bit rate that is left.
    pub(super) fn speed(&self, bus: usize, now_s: f64) -> f64 {
        match self.active(now_s) {
            Some(LineFault::Overload(on, share)) if on == bus => share,
            _ => 1.0,
        }
    }

    /// Number of times that a command reaches the drive of `joint`.
    pub(super) fn command_copies(
        &self,
        joint: usize,
        now_s: f64,
        random: &mut ChaCha8Rng,
    ) -> usize {
        match self.active(now_s) {
            Some(LineFault::LostCommands(of, share)) if of == joint => {
                usize::from(!random.random_bool(share))
            }
            Some(LineFault::DoubledCommands(of)) if of == joint => 2,
            _ => 1,
        }
    }

    /// Frames that arrive at the host in the place of `frame`.
    pub(super) fn reply(
        &mut self,
        joint: usize,
        mut frame: Frame,
        now_s: f64,
        random: &mut ChaCha8Rng,
    ) -> Vec<Frame> {
        match self.active(now_s) {
            Some(LineFault::LostReplies(of, share)) if of == joint => {
                let arrives = !random.random_bool(share);
                return vec![frame; usize::from(arrives)];
            }
            Some(LineFault::DoubledReplies(of)) if of == joint => return vec![frame; 2],
            Some(LineFault::StuckReply(of)) if of == joint => {
                frame = *self.stuck.get_or_insert(frame);
            }
            Some(LineFault::WrongIdentifier(of, byte)) if of == joint => {
                if let Some(first) = frame.bytes_mut().first_mut() {
                    *first = *first & 0xf0 | byte;
                }
            }
            Some(LineFault::FlippedBits(of, share)) if of == joint && random.random_bool(share) => {
                // Position or torque: the first five bytes behind the identifier.
                let place = random.random_range(1..6);
                if let Some(byte) = frame.bytes_mut().get_mut(place) {
                    *byte ^= 1 << random.random_range(0..8);
                }
            }
            Some(LineFault::LateReplies(of, replies)) if of == joint => {
                self.late.push_back(frame);
                if self.late.len() <= replies {
                    return Vec::new();
                }
                frame = self.late.pop_front().unwrap_or(frame);
            }
            _ => {}
        }
        vec![frame]
    }
}
