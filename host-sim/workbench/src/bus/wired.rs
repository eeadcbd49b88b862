//! Buses behind adapters, and the clock of their loop.

use super::{BusError, Network};
use foretorque_link::drives::Frame;
use std::io;
use std::time::{Duration, Instant};
use thread_priority::unix::{
    RealtimeThreadSchedulePolicy, ThreadSchedulePolicy, set_thread_priority_and_policy,
    thread_native_id,
};
use thread_priority::{ThreadPriority, ThreadPriorityValue};

/// Priority of the loop among those of real time.
const PRIORITY: u8 = 80;

/// One CAN adapter.
pub trait Line: Send {
    /// Name for messages.
    fn name(&self) -> String;

    /// Sends a frame; one that the queue has no room for is lost.
    ///
    /// Errors: the adapter has gone.
    fn send(&mut self, frame: &Frame) -> io::Result<()>;

    /// Next frame that has arrived, without waiting.
    ///
    /// Errors: the adapter has gone.
    fn receive(&mut self) -> io::Result<Option<Frame>>;

    /// The controller has left its bus because of too many errors.
    fn is_off(&self) -> bool {
        false
    }
}

/// Adapters of one arm with the system's clock.
pub struct WiredNetwork {
    lines: Vec<Box<dyn Line>>,
    period: Duration,
    next: Option<Instant>,
}

impl WiredNetwork {
    /// A network that ticks every `period_s`, s.
    pub fn new(lines: Vec<Box<dyn Line>>, period_s: f64) -> Self {
        Self {
            lines,
            period: Duration::from_secs_f64(period_s),
            next: None,
        }
    }
}

impl Network for WiredNetwork {
    fn name(&self) -> String {
        let names: Vec<String> = self.lines.iter().map(|line| line.name()).collect();
        names.join(",")
    }

    fn send(&mut self, bus: u8, frame: &Frame) -> Result<(), BusError> {
        let Some(line) = self.lines.get_mut(usize::from(bus)) else {
            return Ok(());
        };
        line.send(frame).map_err(|error| BusError::Gone {
            name: line.name(),
            error,
        })
    }

    fn receive(&mut self) -> Result<Option<(u8, Frame)>, BusError> {
        for (bus, line) in self.lines.iter_mut().enumerate() {
            let frame = line.receive().map_err(|error| BusError::Gone {
                name: line.name(),
                error,
            })?;
            if let Some(frame) = frame {
                return Ok(Some((bus as u8, frame)));
            }
        }
        Ok(None)
    }

    fn wait(&mut self) -> Duration {
        let now = Instant::now();
        let due = self.next.unwrap_or(now);
        std::thread::sleep(due.saturating_duration_since(now));
        let begun = Instant::now();
        let late = begun.saturating_duration_since(due);
        // A period that was missed is left out: commands never come in a burst.
        self.next = Some(if late < self.period {
            due + self.period
        } else {
            begun + self.period
        });
        late
    }

    fn is_off(&self) -> bool {
        self.lines.iter().any(|line| line.is_off())
    }
}

/// Gives this thread a priority of real time (`SCHED_FIFO`) and keeps the memory of the program in RAM.
///
/// Errors: what the system does not permit; the loop then runs with the priority that it has.
pub fn real_time() -> Result<(), String> {
    let fifo = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
    let priority = ThreadPriorityValue::try_from(PRIORITY).map_err(|error| error.to_string())?;
    let wanted = ThreadPriority::Crossplatform(priority);
    set_thread_priority_and_policy(thread_native_id(), wanted, fifo)
        .map_err(|error| format!("{error:?}"))?;
    let all =
        nix::sys::mman::MlockAllFlags::MCL_CURRENT | nix::sys::mman::MlockAllFlags::MCL_FUTURE;
    nix::sys::mman::mlockall(all).map_err(|error| error.to_string())
}
