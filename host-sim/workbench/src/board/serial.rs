//! A real board on a serial port.

use super::Transport;
use serialport::{ErrorKind, SerialPort};
use std::io::{self, ErrorKind as Io, Read, Write};
use std::time::Duration;

/// Bit rate of the link, as the firmware sets it.
pub use foretorque_f405::chip::LINK_BAUD as BAUD;
/// How long a port may take no bytes.
const TIMEOUT: Duration = Duration::from_secs(2);

/// The link to a board on a serial port: 8 data bits, no parity, one stop bit, no flow control.
pub struct Serial {
    port: Box<dyn SerialPort>,
    path: String,
}

impl Serial {
    /// Opens `path`, for this program alone, at [`BAUD`] or another rate.
    ///
    /// Errors: a port that is missing, in use, or may not be opened.
    pub fn open(path: &str, baud: u32) -> io::Result<Self> {
        let opened = serialport::new(path, baud).timeout(TIMEOUT).open();
        let port = opened.map_err(|error| refusal(path, &error))?;
        // What a predecessor left unread is none of ours; a port that cannot discard it fails at the first read.
        let _ = port.clear(serialport::ClearBuffer::Input);
        Ok(Self {
            port,
            path: path.into(),
        })
    }
}

impl Transport for Serial {
    fn name(&self) -> String {
        format!("serial:{}", self.path)
    }

    fn keeps_time(&self) -> bool {
        true
    }

    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        if self.port.timeout() != TIMEOUT {
            self.port.set_timeout(TIMEOUT)?;
        }
        self.port.write_all(bytes)
    }

    fn receive(&mut self, buffer: &mut [u8], timeout: Duration) -> io::Result<usize> {
        if self.port.timeout() != timeout {
            self.port.set_timeout(timeout)?;
        }
        match self.port.read(buffer) {
            Ok(0) => {
                let problem = "the port was unplugged";
                Err(io::Error::new(Io::UnexpectedEof, problem))
            }
            Err(error) if matches!(error.kind(), Io::TimedOut | Io::Interrupted) => Ok(0),
            outcome => outcome,
        }
    }
}

/// The system's error in words.
fn refusal(path: &str, error: &serialport::Error) -> io::Error {
    if !std::path::Path::new(path).exists() {
        let known = serialport::available_ports().unwrap_or_default();
        let known: Vec<String> = known.into_iter().map(|port| port.port_name).collect();
        let others = match known.as_slice() {
            [] => ", nor any other".to_owned(),
            known => format!("; there is {}", known.join(", ")),
        };
        let text = format!("there is no serial port {path}{others}");
        return io::Error::new(Io::NotFound, text);
    }
    let (kind, problem) = match error.kind() {
        // The crate makes NoDevice of EBUSY.
        ErrorKind::NoDevice | ErrorKind::Io(Io::ResourceBusy | Io::WouldBlock) => {
            (Io::ResourceBusy, " is in use by another program".to_owned())
        }
        ErrorKind::Io(Io::PermissionDenied) => (
            Io::PermissionDenied,
            " may not be opened: join the group that owns it".to_owned(),
        ),
        _ => (Io::Other, format!(": {}", error.description)),
    };
    io::Error::new(kind, format!("serial port {path}{problem}"))
}

/// One end of a pseudo-terminal, and the path of the other, which is free.
#[cfg(test)]
pub(crate) fn pseudo_terminal() -> (serialport::TTYPort, String) {
    let (near, far) = serialport::TTYPort::pair().expect("the system has pseudo-terminals");
    (near, far.name().expect("it has a name"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_port_in_use_is_busy() {
        let (_board, path) = pseudo_terminal();
        let _first = Serial::open(&path, 115_200).expect("it is free");
        let error = Serial::open(&path, 115_200).err().expect("it is in use");
        assert_eq!(error.kind(), io::ErrorKind::ResourceBusy, "{error}");
    }

    #[test]
    fn bytes_pass_both_ways_and_silence_is_no_error() {
        let (mut board, path) = pseudo_terminal();
        let mut serial = Serial::open(&path, 115_200).expect("it is free");
        let mut buffer = [0; 8];
        let silent = serial.receive(&mut buffer, Duration::from_millis(10));
        assert_eq!(silent.unwrap(), 0);
        serial.send(&[1, 0, 13]).unwrap();
        let mut received = [0; 3];
        board.read_exact(&mut received).unwrap();
        assert_eq!(received, [1, 0, 13]);
        board.write_all(&[9, 10]).unwrap();
        let answered = serial.receive(&mut buffer, Duration::from_secs(1));
        assert_eq!(answered.unwrap(), 2);
        assert_eq!(buffer[..2], [9, 10]);
    }
}
