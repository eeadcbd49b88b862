//! Text form of frames on a UART or USB port: `can send 8001 01000A… BF *18` to a drive, `rcv 100 2701… E B F` from it.
//!
//! Flags: `E` extended, `B` faster data phase, `F` CAN-FD. A line may end in `*` and its CRC-8 (polynomial 0x97, over
//! everything before the `*`); a drive that has seen one sum expects it always. Source: mjbots, fdcanusb and
//! docs/integration/uart.md.

use super::Frame;

/// Line of the text form, with its line feed.
pub type Line = heapless::Vec<u8, 176>;

/// Direction of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// From a host: `can send`.
    Send,
    /// From a drive or adapter: `rcv`.
    Receive,
}

/// A frame as a line with its sum. A remote frame, which the text form does not have, is sent as one without data.
pub fn write_line(frame: &Frame, direction: Direction) -> Line {
    let mut line = Line::new();
    let mut put = |bytes: &[u8]| {
        let fits = line.extend_from_slice(bytes);
        debug_assert!(fits.is_ok(), "longer than a line");
    };
    put(match direction {
        Direction::Send => b"can send ",
        Direction::Receive => b"rcv ",
    });
    let digits = frame.id.checked_ilog2().map_or(1, |bits| bits / 4 + 1);
    for place in (0..digits.max(4)).rev() {
        put(&[digit(frame.id >> (4 * place)).to_ascii_lowercase()]);
    }
    put(b" ");
    for &byte in frame.bytes() {
        put(&[digit((byte >> 4).into()), digit(byte.into())]);
    }
    put(match (direction, frame.extended, frame.fd) {
        // A sender's flags need no E where the identifier is beyond 7ff.
        (Direction::Send, true, true) if frame.id <= Frame::STANDARD_MAX => b" EBF ",
        (Direction::Send, true, false) if frame.id <= Frame::STANDARD_MAX => b" Ebf ",
        (Direction::Send, _, true) => b" BF ",
        (Direction::Send, _, false) => b" bf ",
        (Direction::Receive, true, true) => b" E B F ",
        (Direction::Receive, true, false) => b" E b f ",
        (Direction::Receive, false, true) => b" e B F ",
        (Direction::Receive, false, false) => b" e b f ",
    });
    let sum = crc8(&line);
    let end = [b'*', digit(sum >> 4), digit(sum), b'\n'];
    let fits = line.extend_from_slice(&end);
    debug_assert!(fits.is_ok(), "longer than a line");
    line
}

/// Frame of a line of either direction, without its line feed.
///
/// `None` for any other line, for a wrong sum and for data that is not whole bytes.
pub fn read_line(line: &[u8]) -> Option<Frame> {
    let line = line.trim_ascii();
    let line = match line {
        [content @ .., b'*', high, low] => {
            let sum = value(*high)? << 4 | value(*low)?;
            (crc8(content) == sum).then_some(content)?
        }
        _ => line,
    };
    // A frame without data has two spaces in a row.
    let mut words = line.split(|letter| *letter == b' ');
    match words.next()? {
        b"can" => (words.next()? == b"send").then_some(())?,
        b"rcv" => {}
        _ => return None,
    }
    let mut id = 0_u32;
    for &letter in words.next().filter(|word| matches!(word.len(), 1..=8))? {
        id = id << 4 | value(letter)?;
    }
    let (mut data, hex) = (
        heapless::Vec::<u8, { Frame::CAPACITY }>::new(),
        words.next().unwrap_or_default(),
    );
    for pair in hex.chunks(2) {
        let &[high, low] = pair else { return None };
        data.push((value(high)? << 4 | value(low)?) as u8).ok()?;
    }
    let (mut fd, mut extended) = (false, id > Frame::STANDARD_MAX);
    for flag in words.flatten() {
        match flag {
            b'F' => fd = true,
            b'E' => extended = true,
            b'e' | b'b' | b'B' | b'f' => {}
            _ => return None,
        }
    }
    if id > Frame::EXTENDED_MAX || data.len() > 8 && !fd {
        return None;
    }
    let frame = Frame::new(id, extended, &data);
    Some(if fd { frame.into_fd(0x50) } else { frame })
}

fn digit(value: u32) -> u8 {
    match (value & 15) as u8 {
        digit @ 0..=9 => b'0' + digit,
        digit => b'A' - 10 + digit,
    }
}

fn value(letter: u8) -> Option<u32> {
    char::from(letter).to_digit(16)
}

/// CRC-8 with the polynomial 0x97, most significant bit first, from 0.
fn crc8(bytes: &[u8]) -> u32 {
    let sum = bytes.iter().fold(0_u8, |sum, byte| {
        (0..8).fold(sum ^ byte, |sum, _| {
            sum << 1 ^ if sum & 0x80 != 0 { 0x97 } else { 0 }
        })
    });
    sum.into()
}
