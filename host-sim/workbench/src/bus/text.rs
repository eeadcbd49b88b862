//! CAN adapters that take and give frames as lines of text over a serial port.
//!
//! | adapter | line | source |
//! |---|---|---|
//! | slcan | `t1232AABB`, `T`, `r`; CAN-FD: `d`, `D`, with bit rate switch `b`, `B` | Lawicel CAN232 manual; CANable 2 |
//! | fdcanusb | `can send 8001 AABB BF`, `rcv 100 AABB E B F` | mjbots fdcanusb, docs/reference.md |

use super::profile::BitRates;
use super::{Line, frame_of};
use foretorque_link::drives::Frame;
use serialport::SerialPort;
use std::io::{self, Read, Write};
use std::time::Duration;

/// Longest time for which a port may take no bytes.
const TIMEOUT: Duration = Duration::from_millis(100);
/// Longest line of a frame.
const LINE_BYTES: usize = 256;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum TextForm {
    Slcan,
    Fdcanusb,
}

/// Adapter on a serial port.
pub(super) struct TextLine {
    port: Box<dyn SerialPort>,
    form: TextForm,
    waiting: Vec<u8>,
}

/// Lengths of CAN-FD frames by their code.
const LENGTHS: [usize; 16] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64];

/// Bit rates of the commands S0 to S8, bit/s.
const SLCAN_BIT_S: [f64; 9] = [1e4, 2e4, 5e4, 1e5, 1.25e5, 2.5e5, 5e5, 8e5, 1e6];
/// Bit rates of the commands Y2 and Y5 for the data phase, bit/s.
const SLCAN_DATA_BIT_S: [f64; 2] = [2e6, 5e6];

impl TextForm {
    /// Lines that open the bus. An fdcanusb keeps its bit rates itself.
    ///
    /// Errors: bit rates that the protocol has no code for.
    fn opening(self, rates: &BitRates) -> io::Result<String> {
        if self == Self::Fdcanusb {
            return Ok("\ncan on\n".to_owned());
        }
        let BitRates { nominal, data } = rates;
        let code = SLCAN_BIT_S.iter().position(|known| known == nominal);
        let code = code.zip(SLCAN_DATA_BIT_S.contains(data).then_some(data / 1e6));
        let (code, data) = code.ok_or_else(|| {
            io::Error::other(format!(
                "slcan has no code for bit_s {nominal} with data_bit_s {data}: of the first it has {SLCAN_BIT_S:?}, of the second {SLCAN_DATA_BIT_S:?}"
            ))
        })?;
        Ok(format!("C\rS{code}\rY{data}\rO\r"))
    }

    /// Errors: a frame without data for an fdcanusb, which takes its flags for data.
    fn line(self, frame: &Frame) -> io::Result<String> {
        if self == Self::Fdcanusb && !frame.remote && frame.bytes().is_empty() {
            let error = "an fdcanusb sends no frame without data, as the SYNC of CiA 402 is: use another adapter";
            return Err(io::Error::new(io::ErrorKind::Unsupported, error));
        }
        let hex = hex::encode_upper(frame.bytes());
        Ok(match self {
            Self::Slcan => {
                let kind = match (frame.fd, frame.remote) {
                    (true, _) => 'b',
                    (_, true) => 'r',
                    _ => 't',
                };
                let (kind, width) = match frame.extended {
                    true => (kind.to_ascii_uppercase(), 8),
                    false => (kind, 3),
                };
                let length = frame.bytes().len();
                let code = LENGTHS.iter().position(|known| *known >= length);
                let code = code.unwrap_or(LENGTHS.len() - 1);
                format!("{kind}{:0width$X}{code:X}{hex}\r", frame.id)
            }
            Self::Fdcanusb => {
                let flags = match (frame.fd, frame.remote) {
                    (true, _) => "BF",
                    (_, true) => "bfR",
                    _ => "bf",
                };
                // The adapter sends identifiers up to 7ff as standard ones otherwise.
                let short = frame.extended && frame.id <= Frame::STANDARD_MAX;
                let command = if short { "ext" } else { "send" };
                let data = if frame.remote { "00" } else { &hex };
                format!("can {command} {:x} {data} {flags}\n", frame.id)
            }
        })
    }

    /// Frame of a line; `None` for any other line.
    fn frame(self, line: &str) -> Option<Frame> {
        match self {
            Self::Slcan => slcan(line),
            Self::Fdcanusb => fdcanusb(line),
        }
    }
}

fn slcan(line: &str) -> Option<Frame> {
    if !line.is_ascii() {
        return None;
    }
    let kind = line.chars().next()?;
    let extended = kind.is_ascii_uppercase();
    let digits = if extended { 8 } else { 3 };
    let id = u32::from_str_radix(line.get(1..=digits)?, 16).ok()?;
    let code = usize::from_str_radix(line.get(digits + 1..digits + 2)?, 16).ok()?;
    let rest = line.get(digits + 2..)?;
    let fd = match kind.to_ascii_lowercase() {
        't' => false,
        'd' | 'b' => true,
        'r' if extended || id > Frame::STANDARD_MAX => return None,
        'r' => return Some(Frame::remote(id)),
        _ => return None,
    };
    let length = LENGTHS[code];
    if length > 8 && !fd {
        return None;
    }
    let mut frame = frame_of(id, extended, &hex::decode(rest.get(..2 * length)?).ok()?)?;
    frame.fd = fd;
    Some(frame)
}

fn fdcanusb(line: &str) -> Option<Frame> {
    let mut words = line.split_ascii_whitespace().peekable();
    if words.next()? != "rcv" {
        return None;
    }
    let id = u32::from_str_radix(words.next()?, 16).ok()?;
    // A frame without data has its flags, of one letter each, in the place of it.
    let data = words.next_if(|word| word.len() > 1).unwrap_or_default();
    let data = hex::decode(data).ok()?;
    let flags: Vec<&str> = words.collect();
    let is = |flag: &str| flags.contains(&flag);
    let mut frame = frame_of(id, is("E") || id > Frame::STANDARD_MAX, &data)?;
    frame.fd = is("F");
    (frame.fd || data.len() <= 8).then_some(frame)
}

impl TextLine {
    /// Opens an adapter on port `path`.
    ///
    /// Errors: the port's; bit rates that the adapter cannot be given.
    pub(super) fn open(path: &str, form: TextForm, rates: &BitRates) -> io::Result<Self> {
        let opening = form.opening(rates)?;
        let opened = serialport::new(path, 921_600).timeout(TIMEOUT).open();
        let mut port = opened.map_err(|error| io::Error::other(error.to_string()))?;
        port.write_all(opening.as_bytes())?;
        Ok(Self {
            port,
            form,
            waiting: Vec::new(),
        })
    }

    /// The first whole line of what waits.
    fn next_line(&mut self) -> Option<String> {
        let is_end = |byte: &u8| matches!(byte, b'\r' | b'\n' | 7);
        let end = self.waiting.iter().position(is_end)?;
        let line: Vec<u8> = self.waiting.drain(..=end).collect();
        Some(String::from_utf8_lossy(&line[..end]).into_owned())
    }
}

impl Line for TextLine {
    fn send(&mut self, frame: &Frame) -> io::Result<()> {
        self.port.write_all(self.form.line(frame)?.as_bytes())
    }

    fn receive(&mut self) -> io::Result<Option<Frame>> {
        let count = self.port.bytes_to_read()?;
        if count > 0 {
            let mut buffer = vec![0; count as usize];
            let count = self.port.read(&mut buffer)?;
            self.waiting.extend_from_slice(&buffer[..count]);
        }
        while let Some(line) = self.next_line() {
            if let Some(frame) = self.form.frame(&line) {
                return Ok(Some(frame));
            }
        }
        if self.waiting.len() > LINE_BYTES {
            // No line of an adapter is so long.
            self.waiting.clear();
        }
        Ok(None)
    }
}

impl Drop for TextLine {
    fn drop(&mut self) {
        if self.form == TextForm::Slcan {
            // The port may have gone.
            let _ = self.port.write_all(b"C\r");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_and_lines_convert_both_ways() {
        let moteus = Frame::extended(0x8001, &[1, 0, 10]).into_fd(0x50);
        let [two, one] = [
            Frame::standard(0x123, &[0xaa, 0xbb]),
            Frame::standard(1, &[2]),
        ];
        for (frame, line) in [
            (two, "t1232AABB\r"),
            (Frame::extended(0x123, &[0xaa]), "T000001231AA\r"),
            (Frame::remote(0x49), "r0490\r"),
            (moteus, "B00008001301000A\r"),
        ] {
            assert_eq!(
                TextForm::Slcan.line(&frame).expect("slcan has every frame"),
                line
            );
            assert_eq!(TextForm::Slcan.frame(line.trim_end()), Some(frame));
        }
        for (frame, line) in [
            (moteus, "can send 8001 01000A BF\n"),
            (one, "can send 1 02 bf\n"),
            (Frame::remote(0x49), "can send 49 00 bfR\n"),
            (Frame::extended(0x7f, &[3]), "can ext 7f 03 bf\n"),
        ] {
            let written = TextForm::Fdcanusb.line(&frame);
            assert_eq!(written.expect("it has data"), line);
        }
        let refused = TextForm::Fdcanusb.line(&Frame::standard(0x80, &[]));
        assert!(refused.is_err_and(|error| error.to_string().contains("without data")));
        let extended = Frame::extended(0x100, &[0x27, 0x01]).into_fd(0);
        for (line, frame) in [
            ("rcv 100 2701 E B F t123", extended),
            ("rcv 100  E b f", Frame::extended(0x100, &[])),
            ("rcv 100  e b f", Frame::standard(0x100, &[])),
        ] {
            assert_eq!(TextForm::Fdcanusb.frame(line), Some(frame), "{line}");
        }
    }

    #[test]
    fn other_lines_are_no_frames() {
        let slcan = "|z|Z|t|t12|t1239|t1239112233445566778899|tXYZ0|t12328|rFFF0|t8000";
        let fdcanusb = "OK|rcv|rcv zz 00|rcv 1 0g|rcv 1 000|ü";
        for line in slcan.split('|').chain(fdcanusb.split('|')) {
            assert_eq!(TextForm::Slcan.frame(line), None, "{line}");
            assert_eq!(TextForm::Fdcanusb.frame(line), None, "{line}");
        }
    }

    #[test]
    fn frames_pass_a_pseudo_terminal() {
        let slcan = ["t0018FFFFFFFFFFFFFFFC\r", "z\rt01182122334455667788\r"];
        let sent = "can send 1 FFFFFFFFFFFFFFFC bf\n";
        let fdcanusb = [sent, "OK\nrcv 11 2122334455667788 e b f\n"];
        for (form, [sent, given]) in [(TextForm::Slcan, slcan), (TextForm::Fdcanusb, fdcanusb)] {
            let rates = BitRates::default();
            let (mut adapter, path) = crate::board::serial::pseudo_terminal();
            let timeout = adapter.set_timeout(Duration::from_secs(2));
            timeout.expect("it has a timeout");
            let mut line = TextLine::open(&path, form, &rates).expect("it is free");
            let enable = Frame::standard(1, &[255, 255, 255, 255, 255, 255, 255, 252]);
            line.send(&enable).expect("it is there");
            let whole = form.opening(&rates).expect("it has codes") + sent;
            let mut taken = vec![0; whole.len()];
            adapter.read_exact(&mut taken).expect("it was sent");
            assert_eq!(String::from_utf8_lossy(&taken), whole);
            assert_eq!(line.receive().expect("it is there"), None);
            adapter.write_all(given.as_bytes()).expect("it is there");
            let reply = Frame::standard(0x11, &[0x21, 0x22, 0x33, 0x44, 0x55, 0x66, 0x77, 0x88]);
            let deadline = std::time::Instant::now() + Duration::from_secs(2);
            let mut received = None;
            while received.is_none() && std::time::Instant::now() < deadline {
                received = line.receive().expect("it is there");
            }
            assert_eq!(received, Some(reply));
        }
    }

    #[test]
    fn an_slcan_adapter_is_given_the_bit_rates_of_the_profile() {
        let opening = |nominal, data| TextForm::Slcan.opening(&BitRates { nominal, data });
        for (nominal, data, expected) in
            [(1e6, 5e6, "C\rS8\rY5\rO\r"), (5e5, 2e6, "C\rS6\rY2\rO\r")]
        {
            assert_eq!(opening(nominal, data).expect("it has codes"), expected);
        }
        for (nominal, data) in [(3e5, 5e6), (1e6, 8e6)] {
            assert!(opening(nominal, data).is_err(), "{nominal} {data}");
        }
    }
}
