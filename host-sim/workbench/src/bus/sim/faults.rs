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
}

/// Faults with their times, s.
#[derive(Clone, Debug, Default)]
pub struct LineFaults {
    /// The faults.
    pub list: Vec<(Range<f64>, LineFault)>,
    late: std::collections::VecDeque<Frame>,
    stuck: Option<Frame>,
}

impl LineFaults {
    /// One fault, in force in `time_s`, s.
    pub fn one(fault: LineFault, time_s: Range<f64>) -> Self {
        Self {
            list: vec![(time_s, fault)],
            ..Self::default()
        }
    }

    fn active(&self, now_s: f64) -> impl Iterator<Item = LineFault> {
        let active = self
            .list
            .iter()
            .filter(move |(time_s, _)| time_s.contains(&now_s));
        active.map(|(_, fault)| *fault)
    }

    fn beginning(&self, now_s: f64, step_s: f64) -> impl Iterator<Item = LineFault> {
        let begins =
            move |time_s: &Range<f64>| (time_s.start..time_s.start + step_s).contains(&now_s);
        let beginning = self.list.iter().filter(move |(time_s, _)| begins(time_s));
        beginning.map(|(_, fault)| *fault)
    }

    pub(super) fn resets(&self, now_s: f64, step_s: f64) -> Vec<usize> {
        self.beginning(now_s, step_s)
            .filter_map(|fault| match fault {
                LineFault::Reset(joint) => Some(joint),
                _ => None,
            })
            .collect()
    }

    pub(super) fn drive_faults(&self, now_s: f64, step_s: f64) -> Vec<(usize, u32)> {
        self.beginning(now_s, step_s)
            .filter_map(|fault| match fault {
                LineFault::DriveFault(joint, code) => Some((joint, code)),
                _ => None,
            })
            .collect()
    }

    pub(super) fn bus_is_off(&self, bus: usize, now_s: f64) -> bool {
        self.active(now_s)
            .any(|fault| fault == LineFault::BusOff(bus))
    }

    pub(super) fn is_dead(&self, joint: usize, now_s: f64) -> bool {
        self.active(now_s)
            .any(|fault| fault == LineFault::Dead(joint))
    }

    pub(super) fn babble(&self, bus: usize, now_s: f64) -> Option<Frame> {
        self.active(now_s).find_map(|fault| match fault {
            LineFault::Babble(on, id) if on == bus => Some(Frame::standard(id, &[0; 8])),
            _ => None,
        })
    }

    /// Share of the bit rate that is left.
    pub(super) fn speed(&self, bus: usize, now_s: f64) -> f64 {
        self.active(now_s)
            .find_map(|fault| match fault {
                LineFault::Overload(on, share) if on == bus => Some(share),
                _ => None,
            })
            .unwrap_or(1.0)
    }

    /// Number of times that a command reaches the drive of `joint`.
    pub(super) fn command_copies(
        &self,
        joint: usize,
        now_s: f64,
        random: &mut ChaCha8Rng,
    ) -> usize {
        self.active(now_s).fold(1, |copies, fault| match fault {
            LineFault::LostCommands(of, share) if of == joint && random.random_bool(share) => 0,
            LineFault::DoubledCommands(of) if of == joint => 2,
            _ => copies,
        })
    }

    /// Frames that arrive at the host in the place of `frame`.
    pub(super) fn reply(
        &mut self,
        joint: usize,
        mut frame: Frame,
        now_s: f64,
        random: &mut ChaCha8Rng,
    ) -> Vec<Frame> {
        let active: Vec<LineFault> = self.active(now_s).collect();
        let mut copies = 1;
        for fault in active {
            match fault {
                LineFault::LostReplies(of, share) if of == joint => {
                    copies *= usize::from(!random.random_bool(share));
                }
                LineFault::DoubledReplies(of) if of == joint => copies *= 2,
                LineFault::StuckReply(of) if of == joint => {
                    frame = *self.stuck.get_or_insert(frame);
                }
                LineFault::WrongIdentifier(of, byte) if of == joint => {
                    if let Some(first) = frame.bytes_mut().first_mut() {
                        *first = *first & 0xf0 | byte;
                    }
                }
                LineFault::FlippedBits(of, share) if of == joint && random.random_bool(share) => {
                    // Position or torque: the first five bytes behind the identifier.
                    let place = random.random_range(1..6);
                    if let Some(byte) = frame.bytes_mut().get_mut(place) {
                        *byte ^= 1 << random.random_range(0..8);
                    }
                }
                LineFault::LateReplies(of, replies) if of == joint => {
                    self.late.push_back(frame);
                    if self.late.len() <= replies {
                        return Vec::new();
                    }
                    frame = self.late.pop_front().unwrap_or(frame);
                }
                _ => {}
            }
        }
        vec![frame; copies]
    }
}
