//! Which board, and how it is reached.

use super::{Failure, unusable};
use crate::board::qemu::{Emulator, Image, QemuOptions};
use crate::board::serial::{self, Serial};
use crate::board::{Client, Native, Transport};
use crate::robot::Robot;
use foretorque::arm::Arm;
use std::fmt;
use std::fs;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::Duration;

/// How long a board may take to say its first hello.
const BOOT: Duration = Duration::from_secs(10);

/// Boards that a command may name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum BoardChoice {
    /// The firmware's session in this process.
    Native,
    /// The bulk firmware in the emulator.
    Qemu,
    /// The flashable firmware in the emulator, over its USART.
    QemuUsart,
    /// A board on a serial port.
    Serial(String),
}

impl FromStr for BoardChoice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "native" => Ok(Self::Native),
            "qemu" => Ok(Self::Qemu),
            "qemu-usart" => Ok(Self::QemuUsart),
            _ => match text.strip_prefix("serial:") {
                Some(port) if !port.is_empty() => Ok(Self::Serial(port.to_owned())),
                _ => Err("not one of native, qemu, qemu-usart, serial:PORT".to_owned()),
            },
        }
    }
}

impl fmt::Display for BoardChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Native => f.write_str("native"),
            Self::Qemu => f.write_str("qemu"),
            Self::QemuUsart => f.write_str("qemu-usart"),
            Self::Serial(port) => write!(f, "serial:{port}"),
        }
    }
}

impl BoardChoice {
    /// The ELF that runs on the board, where it is an emulated one.
    fn elf(&self) -> Option<PathBuf> {
        match self {
            Self::Qemu => Some(Image::Bulk.default_elf()),
            Self::QemuUsart => Some(Image::Joint.default_elf()),
            Self::Native | Self::Serial(_) => None,
        }
    }

    /// Starts the board and greets it.
    ///
    /// Errors: emulator or firmware missing, port busy or missing, a board of another robot or protocol.
    pub(super) fn connect<A: Arm<N, P>, const N: usize, const P: usize>(
        &self,
    ) -> Result<Client<N>, Failure> {
        let emulated = |image| -> Result<Box<dyn Transport>, Failure> {
            Ok(Box::new(Emulator::start(&QemuOptions::new(image))?))
        };
        let transport = match self {
            Self::Native => Box::new(Native::<A, N, P>::new()?),
            Self::Qemu => emulated(Image::Bulk)?,
            Self::QemuUsart => emulated(Image::Joint)?,
            Self::Serial(port) => Box::new(Serial::open(port, serial::BAUD)?),
        };
        Ok(Client::connect::<A, P>(transport, BOOT)?)
    }

    /// Version of the compiler that made the board's code, as its ELF says.
    pub(super) fn toolchain(&self) -> String {
        let elf = match self {
            Self::Native => std::env::current_exe().ok(),
            _ => self.elf(),
        };
        elf.and_then(|elf| compiler_of(&elf))
            .unwrap_or_else(|| "unknown".to_owned())
    }
}

/// Looks for the compiler's mark, `rustc version …`, which every ELF made by it carries in its comment section.
fn compiler_of(elf: &Path) -> Option<String> {
    const MARK: &[u8] = b"rustc version ";
    let bytes = fs::read(elf).ok()?;
    let marks = bytes
        .windows(MARK.len())
        .enumerate()
        .filter(|(_, window)| *window == MARK);
    marks
        .map(|(place, _)| &bytes[place + MARK.len()..])
        .find_map(|rest| {
            // The version ends with the commit and its date in brackets; what a packager adds is left out.
            let end = rest.iter().position(|byte| *byte == b')')? + 1;
            let version = std::str::from_utf8(&rest[..end]).ok()?;
            version
                .starts_with(|first: char| first.is_ascii_digit())
                .then(|| format!("rustc {version}"))
        })
}

/// The description of a robot that the firmware has an arm for.
///
/// Errors: unknown robot, or one without firmware.
pub(super) fn robot_on_board<A: Arm<N, P>, const N: usize, const P: usize>(
    name: &str,
) -> Result<Robot, Failure> {
    let robot = Robot::load(name)?;
    if robot.name != A::NAME || robot.joint_count() != N {
        return Err(unusable(format!(
            "robot '{}': the boards of this build drive '{}' only; `host-sim generate` makes the constants for another",
            robot.name,
            A::NAME
        )));
    }
    Ok(robot)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boards_are_named_as_they_are_written() {
        for name in ["native", "qemu", "qemu-usart", "serial:/dev/ttyUSB0"] {
            assert_eq!(name.parse::<BoardChoice>().expect(name).to_string(), name);
        }
        for name in ["", "quemu", "serial:", "serial"] {
            assert!(name.parse::<BoardChoice>().is_err(), "{name}");
        }
    }
}
