//! A bus of drives with a user at the terminal, who ends the torque by a signal and moves the arm on request.

use super::Failure;
use super::terminal::{SignalGuard, show, write_line};
use foretorque_link::drives::Frame;
use foretorque_workbench::bus::{
    Ask, BusChoice, BusError, Network, Profile, WiredNetwork, real_time,
};
use std::io::{self, BufRead};
use std::time::Duration;

/// Bus whose user may interrupt: the next reading of replies fails once, and the drives are switched off.
pub(super) struct Attended {
    network: Box<dyn Network>,
    /// The arm is simulated and moves itself when asked.
    simulated: bool,
    /// None once the user has interrupted: a second signal ends the program.
    guard: Option<SignalGuard>,
    periods: u32,
}

impl Attended {
    pub(super) fn new(network: Box<dyn Network>, simulated: bool) -> Self {
        Self {
            network,
            simulated,
            guard: Some(SignalGuard::begin()),
            periods: 0,
        }
    }
}

impl Network for Attended {
    fn name(&self) -> String {
        self.network.name()
    }

    fn send(&mut self, bus: u8, frame: &Frame) -> Result<(), BusError> {
        self.network.send(bus, frame)
    }

    fn receive(&mut self) -> Result<Option<(u8, Frame)>, BusError> {
        if self.guard.as_ref().is_some_and(SignalGuard::interrupted) {
            self.guard = None;
            return Err(BusError::Interrupted(self.periods));
        }
        self.network.receive()
    }

    fn wait(&mut self) -> Duration {
        self.periods = self.periods.saturating_add(1);
        self.network.wait()
    }

    fn is_off(&self) -> bool {
        self.network.is_off()
    }

    fn ask(&mut self, ask: &Ask) -> Result<(), BusError> {
        // Drives are off: a signal ends the program at once.
        self.guard = None;
        let outcome = match self.simulated {
            true => {
                if let Ask::Undetermined { joint, reason } = ask {
                    let line = undetermined(*joint, reason);
                    let written = write_line(format_args!("{line}"));
                    written.map_err(|error| BusError::Gone("terminal".to_owned(), error))?;
                }
                self.network.ask(ask)
            }
            false => prompt(&request(ask)).map_err(|e| BusError::Gone("terminal".to_owned(), e)),
        };
        self.guard = Some(SignalGuard::begin());
        outcome
    }
}

/// Asks whoever is at the terminal for something, and waits until it is done.
pub(super) fn prompt(request: &str) -> io::Result<()> {
    write_line(format_args!("{request}, then press Enter"))?;
    let mut line = String::new();
    match io::stdin().lock().read_line(&mut line)? {
        0 => Err(io::ErrorKind::UnexpectedEof.into()),
        _ => Ok(()),
    }
}

fn request(ask: &Ask) -> String {
    match ask {
        Ask::Pose(pose) => format!("put the arm into the pose {pose:?} rad"),
        Ask::Turn { joint, by_rad } => {
            let degrees = by_rad.to_degrees();
            format!("turn joint {} by {degrees:+.0}° by hand", joint + 1)
        }
        Ask::Weight(None) => {
            let room = "give each joint 45° of room around the pose of rest";
            format!("take every load off the arm and {room}")
        }
        Ask::Weight(Some(body)) => {
            let (mass, at): (f64, [f64; 3]) = (body.mass, body.com.into());
            format!("fix {mass} kg to the last link, centre of mass at {at:?} m in its frame")
        }
        Ask::Undetermined { joint, reason } => format!(
            "{}: keep clear when the loop moves it next",
            undetermined(*joint, reason)
        ),
    }
}

fn undetermined(joint: usize, reason: &str) -> String {
    let joint = joint + 1;
    format!("joint {joint}: sign and scale of torque are not determined: {reason}")
}

/// The adapters of an arm, in a thread with real time priority where the system permits it; a note where it does not.
pub(super) fn wired(bus: &BusChoice, profile: &Profile) -> Result<WiredNetwork, Failure> {
    let lines = bus.open(profile.bus.len())?;
    if let Err(reason) = real_time() {
        show!("no priority of real time ({reason}): the ticks may come late")?;
    }
    Ok(WiredNetwork::new(lines, 1.0 / profile.rate_hz))
}
