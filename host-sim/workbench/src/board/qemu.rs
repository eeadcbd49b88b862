//! The firmware in the emulator: the flashable ELF over its USART, or the bulk ELF over two pipes.

use super::Transport;
use super::child::Guarded;
use nix::fcntl::{FcntlArg, OFlag, fcntl};
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::socket::{AddressFamily, SockFlag, SockType, socketpair};
use nix::unistd::pipe2;
use std::io;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, OwnedFd};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

const EMULATOR: &str = "qemu-system-arm";
/// Longest time to the board's first byte.
const BOOT: Duration = Duration::from_secs(10);
/// Addresses of memory.x: write key, drives of a board on a drive bus, store.
const KEY_START: u32 = 0x080A_0000;
const WIRING_START: u32 = 0x0808_0000;
const STORE_START: u32 = 0x080C_0000;
/// Longest wait for the end of an emulator that has failed.
const EXIT_WAIT: Duration = Duration::from_secs(2);
/// Longest time in which a board may take no bytes.
pub const TIMEOUT: Duration = Duration::from_secs(10);

/// A board in the emulator. Going out of scope ends the emulator.
#[derive(Debug)]
pub struct Emulator {
    process: Guarded,
    to_board: OwnedFd,
    /// Bytes from the board; `None` when the link is one socket for both directions.
    from_board: Option<OwnedFd>,
    image: Image,
    frame_ports: Option<[OwnedFd; 2]>,
    /// Bytes received while waiting for the board, not yet read.
    first_bytes: Vec<u8>,
}

impl Emulator {
    /// Starts the emulator and waits for the first byte of the board's hello, before which the board receives nothing.
    ///
    /// Errors: emulator or firmware missing, an emulator that does not start, a board that does not greet; then no emulator is
    /// left.
    pub fn start(options: &QemuOptions) -> io::Result<Self> {
        if !options.elf.is_file() {
            let elf = options.elf.display();
            let problem = format!(
                "no firmware at {elf}: `cargo firmware` builds that of the UR5, `cargo xtask arm` that of others"
            );
            return Err(io::Error::other(problem));
        }
        let mut command = Command::new(EMULATOR);
        command
            .args("-machine netduinoplus2 -display none -monitor none".split(' '))
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .arg("-kernel")
            .arg(&options.elf);
        let contents = [
            (&options.store, STORE_START),
            (&options.key, KEY_START),
            (&options.wiring, WIRING_START),
        ];
        for (file, start) in contents {
            if let Some(file) = file {
                let file = file.display();
                let loader = format!("loader,file={file},addr={start:#x},force-raw=on");
                command.args(["-device", &loader]);
            }
        }
        if let Some(trace) = &options.trace {
            command.args(["-d", "unimp", "-D"]).arg(trace);
        }
        if let Some(shift) = options.icount_shift {
            command.args(["-icount", &format!("shift={shift},sleep=off")]);
        }
        let (to_board, from_board, mut kept) = match options.image {
            Image::Joint => usart_link(&mut command, options.log.as_deref())?,
            Image::Bulk => pipe_link(&mut command)?,
        };
        let mut frame_ports = None;
        if options.wiring.is_some() {
            let (ports, theirs) = frame_links(&mut command)?;
            frame_ports = Some(ports);
            kept.extend(theirs);
        }
        let process =
            Guarded::start(command, kept, options.core).map_err(|error| match error.kind() {
                io::ErrorKind::NotFound => io::Error::other(format!(
                    "{EMULATOR} is not installed: run `cargo xtask setup`"
                )),
                _ => io::Error::other(format!("the emulator did not start: {error}")),
            })?;
        let mut emulator = Self {
            process,
            to_board,
            from_board,
            image: options.image,
            frame_ports,
            first_bytes: Vec::new(),
        };
        for end in std::iter::once(&emulator.to_board).chain(&emulator.from_board) {
            fcntl(end, FcntlArg::F_SETFL(OFlag::O_NONBLOCK)).map_err(link)?;
        }
        let mut buffer = [0; 256];
        match emulator.receive(&mut buffer, BOOT)? {
            0 => {
                let waited_s = BOOT.as_secs_f64();
                Err(io::Error::other(format!(
                    "the emulated board sent no hello within {waited_s:.1} s: is the ELF a firmware of this project?"
                )))
            }
            count => {
                emulator.first_bytes.extend_from_slice(&buffer[..count]);
                Ok(emulator)
            }
        }
    }

    /// Process id of the emulator.
    pub fn process_id(&self) -> u32 {
        self.process.id()
    }

    /// The ports of the frames, where the board has a wiring: USART6 and UART4.
    pub fn take_frame_ports(&mut self) -> Option<[OwnedFd; 2]> {
        self.frame_ports.take()
    }

    /// Why the link is gone: nearly always because the emulator is.
    fn broken(&mut self, error: nix::Error) -> io::Error {
        match self.process.ended(EXIT_WAIT) {
            Ok(Some(status)) => {
                let last = self.process.last_message();
                let last = last.unwrap_or_else(|| "without a message".into());
                io::Error::other(format!("the emulator died: {status}; {last}"))
            }
            _ => link(error),
        }
    }
}

impl Transport for Emulator {
    fn name(&self) -> String {
        format!("qemu ({})", self.image.name())
    }

    /// Errors: an emulator that died; a board that takes nothing for [`TIMEOUT`].
    fn send(&mut self, mut bytes: &[u8]) -> io::Result<()> {
        while !bytes.is_empty() {
            match nix::unistd::write(&self.to_board, bytes) {
                Ok(sent) => bytes = &bytes[sent..],
                Err(nix::Error::EINTR) => {}
                Err(nix::Error::EAGAIN) => {
                    if !ready(self.to_board.as_fd(), PollFlags::POLLOUT, TIMEOUT)? {
                        let waited_s = TIMEOUT.as_secs_f64();
                        return Err(io::Error::other(format!(
                            "the emulated board took no bytes for {waited_s:.1} s"
                        )));
                    }
                }
                Err(error) => return Err(self.broken(error)),
            }
        }
        Ok(())
    }

    fn receive(&mut self, buffer: &mut [u8], timeout: Duration) -> io::Result<usize> {
        if !self.first_bytes.is_empty() {
            let count = buffer.len().min(self.first_bytes.len());
            buffer[..count].copy_from_slice(&self.first_bytes[..count]);
            self.first_bytes.drain(..count);
            return Ok(count);
        }
        loop {
            let end = self.from_board.as_ref().unwrap_or(&self.to_board);
            // Bytes, or the end of them.
            if !ready(end.as_fd(), PollFlags::POLLIN, timeout)? {
                return Ok(0);
            }
            match nix::unistd::read(end, buffer) {
                Ok(0) => return Err(self.broken(nix::Error::EPIPE)),
                Ok(count) => return Ok(count),
                Err(nix::Error::EINTR | nix::Error::EAGAIN) => {}
                Err(error) => return Err(self.broken(error)),
            }
        }
    }
}

fn link(error: nix::Error) -> io::Error {
    let error = io::Error::from(error);
    io::Error::other(format!("link to the emulator: {error}"))
}

/// Waits until `end` can be read or written. False after `timeout`.
fn ready(end: BorrowedFd<'_>, what: PollFlags, timeout: Duration) -> io::Result<bool> {
    let deadline = Instant::now() + timeout;
    loop {
        let left = deadline.saturating_duration_since(Instant::now());
        // Rounded up, or the last millisecond would be spent spinning.
        let milliseconds = i32::try_from(left.as_micros().div_ceil(1000)).unwrap_or(i32::MAX);
        let timeout = PollTimeout::try_from(milliseconds).unwrap_or(PollTimeout::MAX);
        match poll(&mut [PollFd::new(end, what)], timeout) {
            Ok(0) if left.is_zero() => return Ok(false),
            Ok(0) | Err(nix::Error::EINTR) => {}
            Ok(_) => return Ok(true),
            Err(error) => return Err(link(error)),
        }
    }
}

/// To the board, from the board, and what the emulator inherits.
type Ends = (OwnedFd, Option<OwnedFd>, Vec<OwnedFd>);

fn pair() -> io::Result<(OwnedFd, OwnedFd)> {
    let (family, kind) = (AddressFamily::Unix, SockType::Stream);
    socketpair(family, kind, None, SockFlag::SOCK_CLOEXEC).map_err(link)
}

/// UART4 and USART6 on sockets, behind the ports of [`usart_link`].
fn frame_links(command: &mut Command) -> io::Result<([OwnedFd; 2], [OwnedFd; 2])> {
    let (usart6, theirs6) = pair()?;
    let (uart4, theirs4) = pair()?;
    for (id, end) in [("usart6", &theirs6), ("uart4", &theirs4)] {
        let chardev = format!("socket,id={id},fd={}", end.as_raw_fd());
        command.args(["-chardev", &chardev]);
    }
    for port in ["chardev:uart4", "null", "chardev:usart6"] {
        command.args(["-serial", port]);
    }
    Ok(([usart6, uart4], [theirs6, theirs4]))
}

/// USART2 on a socket, the log on USART3. Nothing of it has a name in the file system, so nothing can be left there.
fn usart_link(command: &mut Command, log: Option<&Path>) -> io::Result<Ends> {
    let (ours, theirs) = pair()?;
    command
        .arg("-chardev")
        .arg(format!("socket,id=link,fd={}", theirs.as_raw_fd()))
        .args(["-serial", "null", "-serial", "chardev:link", "-serial"])
        .arg(log.map_or_else(|| "null".into(), |path| format!("file:{}", path.display())));
    Ok((ours, None, vec![theirs]))
}

/// Two pipes, which the firmware opens through semihosting under the names their descriptors have.
fn pipe_link(command: &mut Command) -> io::Result<Ends> {
    let (board_reads, we_write) = pipe2(OFlag::O_CLOEXEC).map_err(link)?;
    let (we_read, board_writes) = pipe2(OFlag::O_CLOEXEC).map_err(link)?;
    command.arg("-semihosting-config").arg(format!(
        "enable=on,target=native,arg=bulk,arg=/dev/fd/{},arg=/dev/fd/{}",
        board_reads.as_raw_fd(),
        board_writes.as_raw_fd()
    ));
    Ok((we_write, Some(we_read), vec![board_reads, board_writes]))
}

/// Firmware of the emulated board, and so its link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Image {
    /// The flashable firmware, over USART2.
    Joint,
    /// The tick between two pipes (semihosting), for long runs.
    Bulk,
}

/// Directory of everything built, under the workspace root.
fn builds() -> PathBuf {
    let package = Path::new(env!("CARGO_MANIFEST_DIR"));
    let root = package.ancestors().nth(2).unwrap_or(package);
    root.join("target")
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
        let elf_dir = builds().join("thumbv7em-none-eabihf/firmware");
        elf_dir.join(self.name())
    }

    /// The ELF for the arm called `arm`: that of `cargo xtask arm` where there is one, else [`Self::default_elf`].
    pub fn elf_of(self, arm: &str) -> PathBuf {
        let arms = builds().join("foretorque/arms");
        let own = Some(arms.join(arm).join(self.name()));
        let own = own.filter(|own| own.is_file());
        own.unwrap_or_else(|| self.default_elf())
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
    /// File with the drives of a board on a drive bus; its frames are lines on [`Emulator::take_frame_ports`].
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
