//! Arms on a bus of drives: transports, simulated drives, profiles, and the loop around them.

mod commission;
mod player;
mod profile;
pub mod sim;
mod sockets;
mod text;

pub use commission::{Ask, Commissioning, Found, Step};
pub use player::BusPlayer;
pub use profile::{BitRates, Profile, frame_time_s};

use foretorque_link::bus::BusFault;
use foretorque_link::drives::Frame;
use foretorque_link::safety::SafetyReason;
use sockets::{SocketCan, UdpMulticast};
use std::str::FromStr;
use std::thread::{Scope, ScopedJoinHandle};
use std::time::{Duration, Instant};
use std::{fmt, io};
use text::{TextForm, TextLine};
use thread_priority::unix::{
    RealtimeThreadSchedulePolicy, ThreadSchedulePolicy, set_thread_priority_and_policy,
    thread_native_id,
};
use thread_priority::{ThreadPriority, ThreadPriorityValue};

/// Buses of one arm, with the clock of their loop.
pub trait Network: Send {
    /// Name for messages.
    fn name(&self) -> String;

    /// Sends a frame; one that the queue has no room for is lost.
    ///
    /// Errors: the bus has gone.
    fn send(&mut self, bus: u8, frame: &Frame) -> Result<(), BusError>;

    /// Next frame that has arrived, without waiting.
    ///
    /// Errors: the bus has gone.
    fn receive(&mut self) -> Result<Option<(u8, Frame)>, BusError>;

    /// Waits for the next period: how late it begins.
    fn wait(&mut self) -> Duration;

    /// A controller has left its bus because of too many errors.
    fn is_off(&self) -> bool;

    /// Asks somebody who stands beside the arm to move it; returns when it is done.
    ///
    /// Errors: nobody is there.
    fn ask(&mut self, _: &Ask) -> Result<(), BusError> {
        let unsupported = io::ErrorKind::Unsupported.into();
        Err(BusError::Failed(self.name(), unsupported))
    }
}

/// Reason for which an arm on a bus cannot be driven.
#[derive(Debug, thiserror::Error)]
pub enum BusError {
    /// The profile in this file cannot be read, or contradicts itself or the arm: reason, with the field.
    #[error("{0}: {1}")]
    Profile(String, String),
    /// The bus of this name cannot be opened.
    #[error("bus {0}: {1}")]
    Open(String, io::Error),
    /// The bus of this name has failed.
    #[error("bus {0} has failed, torque off: {1}")]
    Failed(String, io::Error),
    /// Nothing answers.
    #[error("bus {0} is silent, torque off: no drive of the profile answers")]
    Quiet(String),
    /// The user has ended it.
    #[error("interrupted after {0} periods, torque off")]
    Interrupted(u32),
    /// Commissioning has found a mistake: joint, from 0, and the mistake, with the value of the profile and the one found.
    #[error("joint {}: {}", .0 + 1, .1)]
    Mistake(usize, String),
    /// A drive or the bus has a fault.
    #[error("torque off: {0}")]
    Fault(BusFault),
    /// The torque has ended for another reason.
    #[error("torque off: {0}")]
    Stopped(SafetyReason),
}

/// A frame that has come; `None` for an identifier or a length that no frame has.
fn frame_of(id: u32, extended: bool, data: &[u8]) -> Option<Frame> {
    let most = match extended {
        true => Frame::EXTENDED_MAX,
        false => Frame::STANDARD_MAX,
    };
    let fits = id <= most && data.len() <= Frame::CAPACITY;
    fits.then(|| Frame::new(id, extended, data))
}

/// Priority of the loop among those of real time.
const PRIORITY: u8 = 80;

/// One CAN adapter.
pub trait Line: Send {
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

/// An adapter with its name for messages.
pub type NamedLine = (String, Box<dyn Line>);

/// Adapters of one arm with the system's clock. One that has failed is reported once, and the others go on.
pub struct WiredNetwork {
    names: Vec<String>,
    lines: Vec<Option<Box<dyn Line>>>,
    period: Duration,
    next: Option<Instant>,
}

impl WiredNetwork {
    /// A network that ticks every `period_s`, s.
    pub fn new(lines: Vec<NamedLine>, period_s: f64) -> Self {
        let lines = lines.into_iter().map(|(name, line)| (name, Some(line)));
        let (names, lines) = lines.unzip();
        Self {
            names,
            lines,
            period: Duration::from_secs_f64(period_s),
            next: None,
        }
    }

    fn drop_line(&mut self, bus: usize, error: io::Error) -> BusError {
        self.lines[bus] = None;
        BusError::Failed(self.names[bus].clone(), error)
    }
}

impl Network for WiredNetwork {
    fn name(&self) -> String {
        self.names.join(",")
    }

    fn send(&mut self, bus: u8, frame: &Frame) -> Result<(), BusError> {
        let bus = usize::from(bus);
        match self.lines.get_mut(bus) {
            Some(Some(line)) => {
                let sent = line.send(frame);
                sent.map_err(|error| self.drop_line(bus, error))
            }
            _ => Ok(()),
        }
    }

    fn receive(&mut self) -> Result<Option<(u8, Frame)>, BusError> {
        for bus in 0..self.lines.len() {
            let Some(line) = &mut self.lines[bus] else {
                continue;
            };
            match line.receive() {
                Ok(Some(frame)) => return Ok(Some((bus as u8, frame))),
                Ok(None) => {}
                Err(error) => return Err(self.drop_line(bus, error)),
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
        self.lines.iter().flatten().any(|line| line.is_off())
    }
}

/// Start the loop around the drives in a thread of its own: files and pages are written by another.
///
/// * `wired` the drives are real: the thread gets a priority of real time (`SCHED_FIFO`), and the memory of the program stays
///   in RAM until its end. `work` gets the reason where the system refuses.
pub fn spawn_loop<'scope, T: Send + 'scope>(
    scope: &'scope Scope<'scope, '_>,
    wired: bool,
    work: impl FnOnce(Option<String>) -> T + Send + 'scope,
) -> ScopedJoinHandle<'scope, T> {
    scope.spawn(move || {
        let outcome = work(wired.then(real_time).and_then(Result::err));
        if wired {
            // Fails where nothing was locked.
            let _ = nix::sys::mman::munlockall();
        }
        outcome
    })
}

fn real_time() -> Result<(), String> {
    let fifo = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
    let priority = ThreadPriorityValue::try_from(PRIORITY).map_err(|error| error.to_string())?;
    let wanted = ThreadPriority::Crossplatform(priority);
    set_thread_priority_and_policy(thread_native_id(), wanted, fifo)
        .map_err(|error| format!("{error:?}"))?;
    let all =
        nix::sys::mman::MlockAllFlags::MCL_CURRENT | nix::sys::mman::MlockAllFlags::MCL_FUTURE;
    nix::sys::mman::mlockall(all).map_err(|error| error.to_string())
}

/// Discard what was typed at the terminal so far: it is no answer to a later request.
pub fn discard_typed() {
    // Fails where the input is no terminal: then nothing is dropped.
    let _ = nix::sys::termios::tcflush(io::stdin(), nix::sys::termios::FlushArg::TCIFLUSH);
}

/// A bus that a command may name; two names, separated by a comma, are two buses of one arm.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BusChoice {
    /// One of [`KINDS`].
    kind: &'static str,
    /// Interfaces, ports or groups; none of simulated drives.
    names: Vec<String>,
}

/// Simulated drives; interfaces of Linux; adapters on serial ports, those of mjbots; multicast groups.
const KINDS: [&str; 5] = ["sim", "socketcan", "slcan", "fdcanusb", "udp"];

impl FromStr for BusChoice {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        const WRONG: &str =
            "not one of sim, socketcan:IF, slcan:PORT, fdcanusb:PORT, udp:GROUP; two buses: IF,IF";
        let (kind, names) = match text.split_once(':') {
            Some((kind, names)) => (kind, names.split(',').map(str::to_owned).collect()),
            None => (text, Vec::new()),
        };
        let known = KINDS.into_iter().find(|known| *known == kind);
        let kind = known.ok_or(WRONG)?;
        let counts = if kind == "sim" { 0..=0 } else { 1..=2 };
        let sound = counts.contains(&names.len()) && !names.iter().any(String::is_empty);
        sound.then_some(Self { kind, names }).ok_or(WRONG)
    }
}

impl fmt::Display for BusChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.is_simulated() {
            true => f.write_str(self.kind),
            false => write!(f, "{}:{}", self.kind, self.names.join(",")),
        }
    }
}

impl BusChoice {
    /// The drives are simulated.
    pub fn is_simulated(&self) -> bool {
        self.kind == "sim"
    }

    /// Opens the adapters of buses with these bit rates, each with its name; none for the simulated ones.
    ///
    /// Errors: another number of names, the first that cannot be opened.
    pub fn open(&self, rates: &[BitRates]) -> Result<Vec<NamedLine>, BusError> {
        let refused = |error| BusError::Open(self.to_string(), error);
        let (count, buses) = (self.names.len(), rates.len());
        if count != buses && !self.is_simulated() {
            let text = format!("{count} named, the profile has {buses} buses");
            return Err(refused(std::io::Error::other(text)));
        }
        let open = |(name, rates): (&String, &BitRates)| -> std::io::Result<_> {
            let line: Box<dyn Line> = match self.kind {
                "udp" => Box::new(UdpMulticast::open(name)?),
                "slcan" => Box::new(TextLine::open(name, TextForm::Slcan, rates)?),
                "fdcanusb" => Box::new(TextLine::open(name, TextForm::Fdcanusb, rates)?),
                _ => Box::new(SocketCan::open(name)?),
            };
            Ok((format!("{}:{name}", self.kind), line))
        };
        let buses = self.names.iter().zip(rates);
        buses.map(|bus| open(bus).map_err(refused)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buses_are_named_as_they_are_written() {
        let sound = "sim socketcan:can0 socketcan:can0,can1 slcan:/dev/ttyACM0 fdcanusb:/dev/ttyACM1 udp:239.74.163.2";
        for name in sound.split(' ') {
            assert_eq!(name.parse::<BusChoice>().expect(name).to_string(), name);
        }
        for name in [
            "",
            "can0",
            "socketcan:",
            "socketcan:a,b,c",
            "serial:x",
            "udp:,",
        ] {
            assert!(name.parse::<BusChoice>().is_err(), "{name}");
        }
    }

    /// Adapter that fails after so many calls, and counts the frames that it has sent.
    struct Fake(u32, std::sync::Arc<std::sync::atomic::AtomicU32>);

    impl Line for Fake {
        fn send(&mut self, _: &Frame) -> io::Result<()> {
            self.1.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
            Ok(())
        }
        fn receive(&mut self) -> io::Result<Option<Frame>> {
            self.0 = self.0.checked_sub(1).ok_or(io::ErrorKind::BrokenPipe)?;
            Ok(None)
        }
    }

    #[test]
    fn an_adapter_that_has_failed_is_reported_once_and_the_other_goes_on() {
        let sent = [(); 2].map(|()| std::sync::Arc::default());
        let [first, second] = sent.clone();
        let lines: [NamedLine; 2] = [
            ("a".to_owned(), Box::new(Fake(2, first))),
            ("b".to_owned(), Box::new(Fake(1000, second))),
        ];
        let mut network = WiredNetwork::new(lines.into(), 1e-3);
        let mut failed = 0;
        for _ in 0..10 {
            failed += u32::from(network.receive().is_err());
            for bus in 0..2 {
                network
                    .send(bus, &Frame::standard(1, &[]))
                    .expect("sent or lost");
            }
        }
        assert_eq!((failed, network.name().as_str()), (1, "a,b"));
        let sent = sent.map(|count| count.load(std::sync::atomic::Ordering::Relaxed));
        assert_eq!(sent, [2, 10]);
    }
}
