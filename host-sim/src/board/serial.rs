//! A board on a serial port: 2 Mbaud, 8N1, raw.

use super::Transport;
use nix::fcntl::OFlag;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::termios::{self, BaudRate, SetArg};
use std::fs::File;
use std::io::{self, Read, Write};
use std::os::fd::AsFd;
use std::os::unix::fs::OpenOptionsExt;
use std::time::Duration;

/// How long the port may refuse bytes.
const PATIENCE: Duration = Duration::from_secs(2);

/// A serial port, held alone.
#[derive(Debug)]
struct Port {
    name: String,
    file: File,
}

/// Opens the port and takes it for this process alone.
///
/// Errors: missing, in use by another program, or no serial port.
pub fn open(path: &str) -> io::Result<Box<dyn Transport>> {
    let named =
        |error: io::Error| io::Error::new(error.kind(), format!("serial port {path}: {error}"));
    let file = File::options()
        .read(true)
        .write(true)
        .custom_flags((OFlag::O_NOCTTY | OFlag::O_NONBLOCK | OFlag::O_CLOEXEC).bits())
        .open(path)
        .map_err(named)?;
    let mut settings = termios::tcgetattr(&file).map_err(|error| named(error.into()))?;
    // Two programs that speak at once would each see half of every answer.
    if file.try_lock().is_err() {
        return Err(named(io::Error::from(io::ErrorKind::ResourceBusy)));
    }
    termios::cfmakeraw(&mut settings);
    termios::cfsetspeed(&mut settings, BaudRate::B2000000).map_err(|error| named(error.into()))?;
    termios::tcsetattr(&file, SetArg::TCSAFLUSH, &settings).map_err(|error| named(error.into()))?;
    Ok(Box::new(Port {
        name: format!("serial:{path}"),
        file,
    }))
}

impl Port {
    /// False when `what` did not become possible within `timeout`.
    fn ready(&self, what: PollFlags, timeout: Duration) -> io::Result<bool> {
        let milliseconds = timeout.as_millis().clamp(1, 60_000) as u16;
        let mut ends = [PollFd::new(self.file.as_fd(), what)];
        match poll(&mut ends, PollTimeout::from(milliseconds)) {
            Ok(count) => Ok(count > 0),
            Err(nix::Error::EINTR) => Ok(false),
            Err(error) => Err(error.into()),
        }
    }
}

impl Transport for Port {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn send(&mut self, mut bytes: &[u8]) -> io::Result<()> {
        while !bytes.is_empty() {
            match self.file.write(bytes) {
                Ok(sent) => bytes = &bytes[sent..],
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                    if !self.ready(PollFlags::POLLOUT, PATIENCE)? {
                        return Err(io::ErrorKind::TimedOut.into());
                    }
                }
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    fn receive(&mut self, room: &mut [u8], timeout: Duration) -> io::Result<usize> {
        if !self.ready(PollFlags::POLLIN, timeout)? {
            return Ok(0);
        }
        match self.file.read(room) {
            Ok(0) => Err(io::ErrorKind::UnexpectedEof.into()),
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => Ok(0),
            other => other,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_port_that_is_missing_or_no_port_is_named_in_the_error() {
        for path in ["/dev/no-such-port", "/dev/null"] {
            let error = open(path).map(|_| ()).expect_err(path).to_string();
            assert!(error.contains(path), "{error}");
            assert_eq!(error.lines().count(), 1);
        }
    }
}
