//! Two ports and the frames between them: what arrives at one leaves at the other, in order.

use super::InLine;
use crate::drives::{Event, Frame, JointCommand};
use heapless::Deque;

/// Controller of one bus.
pub trait Port {
    /// Oldest received frame.
    fn receive(&mut self) -> Option<Frame>;
    /// Gives a frame to the controller. `false`: it has no room now.
    fn send(&mut self, frame: &Frame) -> bool;
}

/// Frame of one of the board's joints that passed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Passed {
    /// Motion command, as the host sent it.
    Command(JointCommand),
    /// Content of a frame from a drive.
    Event(Event),
}

/// Board between the port of the host and that of the drives.
///
/// A frame leaves once it has arrived as a whole: that delays it by its own time on the bus, and by one [`Self::pass`].
#[derive(Debug)]
pub struct Bridge<H, D, const N: usize> {
    host: H,
    drives: D,
    /// Torques to add, which the tick sets.
    pub in_line: InLine<N>,
    to_host: Deque<Frame, QUEUE>,
    to_drives: Deque<Frame, QUEUE>,
    lost: u32,
}

/// Frames that wait for a busy bus, each way: 1.7 ms of MIT frames.
const QUEUE: usize = 16;

impl<H: Port, D: Port, const N: usize> Bridge<H, D, N> {
    /// A bridge between two started ports.
    pub const fn new(host: H, drives: D, in_line: InLine<N>) -> Self {
        Self {
            host,
            drives,
            in_line,
            to_host: Deque::new(),
            to_drives: Deque::new(),
            lost: 0,
        }
    }

    /// Passes what has arrived; calls `seen` with every frame of the board's joints. Called when a frame has arrived or a
    /// mailbox is empty again.
    ///
    /// Cost: at most 16 frames each way.
    pub fn pass(&mut self, now_us: u32, mut seen: impl FnMut(usize, Passed)) {
        for _ in 0..QUEUE {
            let Some(mut frame) = self.host.receive() else {
                break;
            };
            if let Some((joint, command)) = self.in_line.to_drives(&mut frame, now_us) {
                seen(joint, Passed::Command(command));
            }
            self.lost = self.lost.wrapping_add(queue(&mut self.to_drives, frame));
        }
        for _ in 0..QUEUE {
            let Some(frame) = self.drives.receive() else {
                break;
            };
            if let Some((joint, event)) = self.in_line.to_host(&frame) {
                seen(joint, Passed::Event(event));
            }
            self.lost = self.lost.wrapping_add(queue(&mut self.to_host, frame));
        }
        drain(&mut self.to_drives, &mut self.drives);
        drain(&mut self.to_host, &mut self.host);
    }

    /// Number of frames dropped because the other bus stood still, modulo 2³².
    pub const fn lost(&self) -> u32 {
        self.lost
    }

    /// The ports: host, drives.
    pub const fn ports(&mut self) -> (&mut H, &mut D) {
        (&mut self.host, &mut self.drives)
    }
}

/// Appends a frame; drops the oldest one, which is late, where the queue is full. Number of frames dropped.
fn queue(queue: &mut Deque<Frame, QUEUE>, frame: Frame) -> u32 {
    let dropped = queue.is_full() && queue.pop_front().is_some();
    let room = queue.push_back(frame);
    debug_assert!(room.is_ok(), "a place was made");
    dropped.into()
}

fn drain(queue: &mut Deque<Frame, QUEUE>, port: &mut impl Port) {
    for _ in 0..QUEUE {
        let sent = queue.front().is_some_and(|frame| port.send(frame));
        if !sent {
            break;
        }
        queue.pop_front();
    }
}
