//! A bus of drives with a user at the terminal, who ends the torque by a signal and moves the arm on request; and the bytes
//! from which a board on that bus has its drives.

use super::arm::ArmOptions;
use super::boards::on_arm;
use super::terminal::{SignalGuard, show, write_line};
use super::{Failure, bail, not_over, unusable};
use clap::{Args, ValueEnum};
use foretorque::arm::Arm;
use foretorque_link::bus::{BusJoint, Role, Wires, Wiring};
use foretorque_link::drives::{Frame, Protocol};
use foretorque_workbench::board::Described;
use foretorque_workbench::bus::{
    Ask, BusChoice, BusError, Network, Profile, WiredNetwork, discard_typed, spawn_loop,
};
use foretorque_workbench::files::write_whole;
use foretorque_workbench::robot::Robot;
use std::io::{self, BufRead};
use std::panic::resume_unwind;
use std::path::{Path, PathBuf};
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
                    written.map_err(|error| BusError::Failed("terminal".to_owned(), error))?;
                }
                self.network.ask(ask)
            }
            false => prompt(&request(ask)).map_err(|e| BusError::Failed("terminal".to_owned(), e)),
        };
        self.guard = Some(SignalGuard::begin());
        outcome
    }
}

/// Asks whoever is at the terminal for something, and waits until it is done.
pub(super) fn prompt(request: &str) -> io::Result<()> {
    discard_typed();
    write_line(format_args!("{request}, then press Enter"))?;
    let mut line = String::new();
    match io::stdin().lock().read_line(&mut line)? {
        0 => Err(io::ErrorKind::UnexpectedEof.into()),
        _ => Ok(()),
    }
}

fn request(ask: &Ask) -> String {
    match ask {
        Ask::Clear => "keep clear: each joint moves slowly to both sides of the pose".to_owned(),
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

/// Result of the loop around the drives `bus`, which runs in a thread of its own with the arm of this one, while `meanwhile`
/// runs here.
pub(super) fn in_loop<A: Arm<N, P>, const N: usize, const P: usize, T: Send>(
    bus: &BusChoice,
    work: impl FnOnce() -> Result<T, Failure> + Send,
    meanwhile: impl FnOnce() -> Result<(), Failure>,
) -> Result<T, Failure> {
    let arm = A::model();
    std::thread::scope(|scope| {
        let work = move |problem: Option<String>| {
            Described::select(arm);
            if let Some(reason) = problem {
                show!("no priority of real time ({reason}): the ticks may come late")?;
            }
            work()
        };
        let running = spawn_loop(scope, !bus.is_simulated(), work);
        let done = meanwhile();
        let result = running.join().unwrap_or_else(|panic| resume_unwind(panic));
        done.and(result)
    })
}

/// The adapters of an arm.
pub(super) fn wired(bus: &BusChoice, profile: &Profile) -> Result<WiredNetwork, Failure> {
    let lines = bus.open(&profile.bus)?;
    Ok(WiredNetwork::new(lines, 1.0 / profile.rate_hz))
}

/// Write the drives of a profile as bytes for the flash of a board on their bus, the firmware `joint-can`
#[derive(Debug, Args)]
pub(super) struct WiringArguments {
    /// Profile of the arm: its drives, buses and gains (see docs/bus.md)
    #[arg(long, value_name = "FILE")]
    profile: PathBuf,
    /// Place of the board among the drives
    #[arg(long, value_enum)]
    role: RoleName,
    /// The one joint, from 1, whose drive is on this board; without it all
    #[arg(long)]
    joint: Option<usize>,
    #[command(flatten)]
    arm: ArmOptions,
    /// File for the bytes, which belong to address 0x08080000
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum RoleName {
    /// The board sends every command on CAN1 and CAN2
    Master,
    /// Commands pass from CAN1 to CAN2, with the torque of the board
    InLine,
    /// Commands pass from USART6 to UART4, in the text form of moteus
    Uart,
}

impl RoleName {
    /// Reason why a drive does not work with a board in this place.
    fn problem(self, joint: &BusJoint) -> Option<&'static str> {
        match (self, joint.drive.protocol) {
            (Self::Uart, Protocol::Moteus(_)) => None,
            (Self::Uart, _) => Some("on serial ports the drive must be a moteus"),
            (_, Protocol::Moteus(_)) => {
                Some("its drive needs CAN-FD, which this board does not have")
            }
            (Self::InLine, Protocol::Cia402(_)) => {
                Some("in line no torque can be added to the commands of CiA 402 drives")
            }
            (_, protocol) if protocol.is_without_position() => {
                Some("its commands need positions: mode = \"position\"")
            }
            _ => None,
        }
    }
}

pub(super) fn write_wiring(arguments: &WiringArguments) -> Result<(), Failure> {
    let profile = Profile::load(&arguments.profile)?;
    let robot = &arguments.arm.load(&profile.robot)?;
    let mut read = Robot::files(Path::new(&profile.robot));
    read.push(arguments.profile.clone());
    not_over(read, [arguments.out.clone()])?;
    on_arm!(robot, A, N, P => arguments.write::<A, N, P>(&profile))
}

impl WiringArguments {
    fn write<A: Arm<N, P>, const N: usize, const P: usize>(
        &self,
        profile: &Profile,
    ) -> Result<(), Failure> {
        let (role, wires) = match self.role {
            RoleName::Master => (Role::Master, Wires::Can),
            RoleName::InLine => (Role::InLine, Wires::Can),
            RoleName::Uart => (Role::InLine, Wires::Uart),
        };
        if let Some(only) = self.joint.filter(|only| !(1..=N).contains(only)) {
            bail!("--joint {only}: the arm has joints 1 to {N}");
        }
        let wiring = profile.wiring::<A, N, P>(role, wires, self.joint)?;
        let (file, mut buses) = (&profile.file, Vec::new());
        for (joint, slot) in (1..).zip(&wiring.joints) {
            if let Some(problem) = slot.and_then(|own| self.role.problem(&own)) {
                bail!("{file}: joint {joint}: {problem}");
            }
            buses.extend(slot.map(|own| own.bus));
        }
        let apart = buses.iter().any(|bus| *bus != buses[0]);
        if apart && role == Role::InLine || wires == Wires::Uart && buses.len() > 1 {
            bail!("{file}: such a board has one line of drives: choose its joint with --joint");
        }
        let mut buffer = vec![0; Wiring::<N>::BYTES];
        let many = format!("{file}: more drives than the flash of a board holds");
        let bytes = wiring.encode(&mut buffer).map_err(|_| unusable(many))?;
        write_whole(&self.out, bytes)?;
        let (count, out) = (bytes.len(), self.out.display());
        show!(
            "{count} bytes; next: probe-rs download --chip STM32F405RGTx --binary-format bin --base-address 0x08080000 {out}"
        )
    }
}
