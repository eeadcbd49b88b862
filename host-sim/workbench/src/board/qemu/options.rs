//! Settings of an emulated board.

use std::path::{Path, PathBuf};

/// Firmware of the emulated board, and so its link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Image {
    /// The flashable firmware, over USART2.
    Joint,
    /// The tick between two pipes (semihosting), for long runs.
    Bulk,
}

impl Image {
    /// Name of the binary.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Joint => "joint",
            Self::Bulk => "bulk",
        }
    }

    /// Place where the build leaves the ELF: `target/thumbv7em-none-eabihf/firmware/` under the workspace root.
    pub fn default_elf(self) -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("../../target/thumbv7em-none-eabihf/firmware")
            .join(self.name())
    }

    /// The ELF for the arm called `arm`: that of `cargo xtask arm` where there is one, else [`Self::default_elf`].
    pub fn elf_of(self, arm: &str) -> PathBuf {
        let arms = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../target/foretorque/arms");
        let own = arms.join(arm).join(self.name());
        if own.is_file() {
            own
        } else {
            self.default_elf()
        }
    }
}

/// Settings of the emulator.
#[derive(Clone, Debug)]
pub struct QemuOptions {
    /// The firmware.
    pub image: Image,
    /// Its ELF.
    pub elf: PathBuf,
    /// Virtual time per instruction, 2^shift ns, without which runs do not repeat. 3 is 125 million instructions a
    /// second, about what 168 MHz give on silicon. `None` lets virtual time follow the clock on the wall.
    pub icount_shift: Option<u8>,
    /// Core shared by the emulator and the calling thread: they take turns, and waking a neighbour core costs more
    /// than the turn itself. `None` leaves both where they are.
    pub core: Option<usize>,
    /// File for the raw defmt stream of the flashable firmware.
    pub log: Option<PathBuf>,
    /// File with the content of the store's sectors, which the emulated board can read and not change; `None` for zeros.
    pub store: Option<PathBuf>,
    /// File with the bytes of the board's write key; `None` for a board without one.
    pub key: Option<PathBuf>,
    /// File with the drives of a board on a drive bus; its frames are lines on [`Emulator::take_frame_ports`](super::Emulator::take_frame_ports).
    pub wiring: Option<PathBuf>,
    /// File for the accesses to parts of the chip that the emulator does not model, pins among them.
    pub trace: Option<PathBuf>,
}

impl QemuOptions {
    /// Repeatable, on one core, without a log.
    pub fn new(image: Image) -> Self {
        Self {
            image,
            elf: image.default_elf(),
            icount_shift: Some(3),
            core: nix::sched::sched_getcpu().ok(),
            log: None,
            store: None,
            key: None,
            wiring: None,
            trace: None,
        }
    }
}
