//! A real board on a serial port.

use std::io::{self, Read, Write};
use std::time::Duration;

use serialport::{ErrorKind, SerialPort};

use super::Transport;

/// Bit rate of the link, as the firmware sets it.
pub use foretorque_f405::chip::LINK_BAUD as BAUD;
/// How long a port may take no bytes.
const PATIENCE: Duration = Duration::from_secs(2);

/// Why a port could not be opened.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SerialError {
    /// There is no such port; the ports there are.
    #[error("there is no serial port {}{}", .0, others(.1))]
    Missing(String, Vec<String>),
    /// Somebody else has it.
    #[error("serial port {0} is in use by another program")]
    Busy(String),
    /// Opening it is not allowed.
    #[error("serial port {0} may not be opened: join the group that owns it")]
    Denied(String),
    /// Anything else, in the system's words.
    #[error("serial port {0}: {1}")]
    Other(String, String),
}

fn others(known: &[String]) -> String {
    match known {
        [] => ", nor any other".to_owned(),
        known => format!("; there is {}", known.join(", ")),
    }
}

/// The link to a board on a serial port: 8 data bits, no parity, one stop bit, no flow control.
pub struct Serial {
    port: Box<dyn SerialPort>,
    path: String,
}

impl Serial {
    /// Opens `path`, for this program alone, at [`BAUD`] or another rate.
    pub fn open(path: &str, baud: u32) -> Result<Self, SerialError> {
        let opened = serialport::new(path, baud).timeout(PATIENCE).open();
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
        if self.port.timeout() != PATIENCE {
            self.port.set_timeout(PATIENCE)?;
        }
        self.port.write_all(bytes)
    }

    fn receive(&mut self, buffer: &mut [u8], timeout: Duration) -> io::Result<usize> {
        if self.port.timeout() != timeout {
            self.port.set_timeout(timeout)?;
        }
        match self.port.read(buffer) {
            Ok(0) => Err(io::Error::new(
                io::ErrorKind::UnexpectedEof,
                "the port was unplugged",
            )),
            Ok(count) => Ok(count),
            Err(error) if error.kind() == io::ErrorKind::TimedOut => Ok(0),
            Err(error) if error.kind() == io::ErrorKind::Interrupted => Ok(0),
            Err(error) => Err(error),
        }
    }
}

/// Meaning of the system's error.
fn refusal(path: &str, error: &serialport::Error) -> SerialError {
    let path = path.to_owned();
    if !std::path::Path::new(&path).exists() {
        let known = serialport::available_ports().unwrap_or_default();
        return SerialError::Missing(path, known.into_iter().map(|port| port.port_name).collect());
    }
    match error.kind() {
        ErrorKind::Io(io::ErrorKind::ResourceBusy | io::ErrorKind::WouldBlock) => {
            SerialError::Busy(path)
        }
        // What the crate makes of EBUSY.
        ErrorKind::NoDevice => SerialError::Busy(path),
        ErrorKind::Io(io::ErrorKind::PermissionDenied) => SerialError::Denied(path),
        _ => SerialError::Other(path, error.description.clone()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serialport::TTYPort;
    use std::io::{Read, Write};

    #[test]
    fn a_port_that_is_not_there_is_named() {
        let error = Serial::open("/dev/ttyNOWHERE7", BAUD).err();
        assert!(
            matches!(&error, Some(SerialError::Missing(port, _)) if port == "/dev/ttyNOWHERE7")
        );
    }

    #[test]
    fn a_port_in_use_is_busy() {
        let (_board, end) = TTYPort::pair().expect("the system has pseudo-terminals");
        let path = end.name().expect("it has a name");
        drop(end);
        let _first = Serial::open(&path, 115_200).expect("it is free");
        assert_eq!(
            Serial::open(&path, 115_200).err(),
            Some(SerialError::Busy(path))
        );
    }

    #[test]
    fn bytes_pass_both_ways_and_silence_is_no_error() {
        let (mut board, end) = TTYPort::pair().expect("the system has pseudo-terminals");
        let path = end.name().expect("it has a name");
        drop(end);
        let mut serial = Serial::open(&path, 115_200).expect("it is free");
        let mut buffer = [0; 8];
        assert_eq!(
            serial
                .receive(&mut buffer, Duration::from_millis(10))
                .unwrap(),
            0
        );
        serial.send(&[1, 0, 13]).unwrap();
        let mut received = [0; 3];
        board.read_exact(&mut received).unwrap();
        assert_eq!(received, [1, 0, 13]);
        board.write_all(&[9, 10]).unwrap();
        assert_eq!(
            serial.receive(&mut buffer, Duration::from_secs(1)).unwrap(),
            2
        );
        assert_eq!(buffer[..2], [9, 10]);
    }
}
