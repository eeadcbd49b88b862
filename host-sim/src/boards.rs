//! Which board, and how it is reached.

use super::Failure;
use foretorque::arm::Arm;
use foretorque_workbench::board::log::Messages;
use foretorque_workbench::board::qemu::{Emulator, Image, QemuOptions};
use foretorque_workbench::board::serial::{self, Serial};
use foretorque_workbench::board::{Client, Native, Transport};
use foretorque_workbench::files::{at, write_whole};
use std::fmt;
use std::fs;
use std::path::Path;
use std::str::FromStr;
use std::time::Duration;

/// Longest time to a board's first hello.
const BOOT: Duration = Duration::from_secs(10);

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
    /// The image that runs on the board, where it is an emulated one.
    fn image(&self) -> Option<Image> {
        match self {
            Self::Qemu => Some(Image::Bulk),
            Self::QemuUsart => Some(Image::Joint),
            Self::Native | Self::Serial(_) => None,
        }
    }

    /// Starts the board and greets it.
    ///
    /// * `stream` file for the raw log of the flashable firmware
    ///
    /// Errors: emulator or firmware missing, port busy or missing, a board of another robot or protocol.
    pub(super) fn connect<A: Arm<N, P>, const N: usize, const P: usize>(
        &self,
        stream: Option<&Path>,
    ) -> Result<Client<N>, Failure> {
        let emulated = |image| -> Result<Box<dyn Transport>, Failure> {
            let mut options = QemuOptions::new(image);
            options.elf = image.elf_of(A::name());
            options.log = stream.map(Path::to_owned);
            Ok(Box::new(Emulator::start(&options)?))
        };
        let transport = match self {
            Self::Native => Box::new(Native::<A, N, P>::new()?),
            Self::Qemu => emulated(Image::Bulk)?,
            Self::QemuUsart => emulated(Image::Joint)?,
            Self::Serial(port) => Box::new(Serial::open(port, serial::BAUD)?),
        };
        Ok(Client::connect::<A, P>(transport, BOOT)?)
    }

    /// Writes the log in `stream` of the board of `arm` as text into `file`, and removes the stream.
    ///
    /// Errors: of the files; a stream that is no log of the board's firmware.
    pub(super) fn write_log(&self, arm: &str, stream: &Path, file: &Path) -> Result<(), Failure> {
        let elf = self.image().map(|image| image.elf_of(arm));
        let bytes = |path: &Path| fs::read(path).map_err(|error| at(path, error));
        let lines = Messages::of(&bytes(&elf.unwrap_or_default())?)?.lines(&bytes(stream)?)?;
        fs::remove_file(stream)?;
        write_whole(file, (lines.join("\n") + "\n").as_bytes())?;
        Ok(())
    }

    /// Version of the compiler of the board's code, from its ELF.
    pub(super) fn toolchain(&self, arm: &str) -> String {
        let elf = match self {
            Self::Native => std::env::current_exe().ok(),
            _ => self.image().map(|image| image.elf_of(arm)),
        };
        elf.and_then(|elf| compiler_of(&elf))
            .unwrap_or_else(|| "unknown".to_owned())
    }
}

/// Looks for the compiler's mark, `rustc version …`, which every ELF made by it carries in its comment section.
fn compiler_of(elf: &Path) -> Option<String> {
    const MARK: &[u8] = b"rustc version ";
    let bytes = fs::read(elf).ok()?;
    let windows = bytes.windows(MARK.len()).enumerate();
    let mut marks = windows.filter(|(_, window)| *window == MARK);
    marks.find_map(|(place, _)| {
        let rest = &bytes[place + MARK.len()..];
        // The version ends with the commit and its date in brackets; what a packager adds is left out.
        let end = rest.iter().position(|byte| *byte == b')')? + 1;
        let version = std::str::from_utf8(&rest[..end]).ok()?;
        let is_version = version.starts_with(|first: char| first.is_ascii_digit());
        is_version.then(|| format!("rustc {version}"))
    })
}

/// `on_arm!(robot, A, N, P => work)`: `work` with the arm `A` of `robot`, the code of the board with the constants of the
/// description.
///
/// Errors: those of the work; a robot that is too large.
macro_rules! on_arm {
    ($robot:expr, $arm:ident, $n:ident, $p:ident => $work:expr) => {
        foretorque_workbench::arms!($robot, $n, $p => {
            type $arm = foretorque_workbench::board::Described<$n, $p>;
            match <$arm>::read($robot) {
                Some(_) => $work,
                None => Err($crate::unsupported($n)),
            }
        }, else Err($crate::unsupported($robot.joint_count())))
    };
}
pub(super) use on_arm;

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
