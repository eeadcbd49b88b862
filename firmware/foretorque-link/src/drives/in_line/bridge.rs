//! Two ports of a board: queues of the frames that leave, and in line what arrives at one leaves at the other, in order.

use super::InLine;
use crate::drives::Frame;
use heapless::Deque;

/// Controller of one bus.
pub trait Port {
    /// Oldest received frame.
    fn receive(&mut self) -> Option<Frame>;
    /// Gives a frame to the controller. `false`: it has no room now.
    fn send(&mut self, frame: &Frame) -> bool;
}

/// Both ports of a board. In line, port 0 is that of the host and port 1 that of the drives.
///
/// A frame leaves once it has arrived as a whole: that delays it by its own time on the bus, and by one [`Self::pass`].
#[derive(Debug)]
pub struct Bridge<P, const N: usize> {
    ports: [P; 2],
    queues: [Deque<Frame, QUEUE>; 2],
    /// Torques to add in line; `None` where the board is the master and no frame passes.
    in_line: Option<InLine<N>>,
    lost: u32,
}

/// Frames that wait for a busy bus, each way: 1.7 ms of MIT frames.
const QUEUE: usize = 16;

impl<P: Port, const N: usize> Bridge<P, N> {
    /// A bridge between two started ports.
    pub const fn new(ports: [P; 2], in_line: Option<InLine<N>>) -> Self {
        Self {
            ports,
            queues: [const { Deque::new() }; 2],
            in_line,
            lost: 0,
        }
    }

    /// Queues a frame of the board itself.
    pub fn send(&mut self, port: u8, frame: Frame) {
        if let Some(queue) = self.queues.get_mut(usize::from(port)) {
            self.lost = self.lost.wrapping_add(append(queue, frame));
        }
    }

    /// Sets the torques to add, N × N·m, or passes all frames unchanged.
    pub fn add(&mut self, torques: Option<&[f32; N]>, now: u32) {
        match (&mut self.in_line, torques) {
            (Some(in_line), Some(torques)) => in_line.set(torques, now),
            (Some(in_line), None) => in_line.clear(),
            (None, _) => {}
        }
    }

    /// Takes and passes what has arrived; calls `seen` with port and frame as it arrived. Called when a frame has arrived
    /// or a mailbox is empty again.
    ///
    /// * `now` count of the clock of [`InLine`]
    ///
    /// Cost: at most 16 frames each way.
    pub fn pass(&mut self, now: u32, mut seen: impl FnMut(u8, &Frame)) {
        let [host, drives] = &mut self.ports;
        let [to_host, to_drives] = &mut self.queues;
        let ways = [(host, to_drives), (drives, to_host)];
        for (way, (port, queue)) in ways.into_iter().enumerate() {
            for _ in 0..QUEUE {
                let Some(mut frame) = port.receive() else {
                    break;
                };
                seen(way as u8, &frame);
                if let Some(in_line) = &mut self.in_line {
                    if way == 0 {
                        in_line.to_drives(&mut frame, now);
                    }
                    self.lost = self.lost.wrapping_add(append(queue, frame));
                }
            }
        }
        for (queue, port) in self.queues.iter_mut().zip(&mut self.ports) {
            for _ in 0..QUEUE {
                let sent = queue.front().is_some_and(|frame| port.send(frame));
                if !sent {
                    break;
                }
                queue.pop_front();
            }
        }
    }

    /// Number of frames dropped because a bus stood still, modulo 2³².
    pub const fn lost(&self) -> u32 {
        self.lost
    }

    /// The ports.
    pub const fn ports(&mut self) -> &mut [P; 2] {
        &mut self.ports
    }
}

/// Appends a frame; drops the oldest one, which is late, where the queue is full. Number of frames dropped.
fn append(queue: &mut Deque<Frame, QUEUE>, frame: Frame) -> u32 {
    let dropped = queue.is_full() && queue.pop_front().is_some();
    let room = queue.push_back(frame);
    debug_assert!(room.is_ok(), "a place was made");
    dropped.into()
}
