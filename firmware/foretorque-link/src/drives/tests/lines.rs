//! Frames as lines of text.

use super::*;

#[test]
fn lines_of_text_come_back() {
    let command = Frame::extended(
        0x8001,
        &[
            0x01, 0, 0x0a, 0x07, 0x20, 0x88, 0x13, 0xa0, 0x0f, 0x7d, 0, 0x17, 1,
        ],
    );
    let line = text::write_line(&command.into_fd(0x50), text::Direction::Send);
    // The line of the Python client moteus 1.1.1.
    assert_eq!(
        &line[..],
        b"can send 8001 01000A07208813A00F7D001701505050 BF *18\n"
    );
    for frame in [
        command.into_fd(0x50),
        Frame::standard(0x100, &[1, 2]),
        Frame::extended(0x1fff_ffff, &[]),
        Frame::standard(0, &[7; 64]).into_fd(0),
    ] {
        for direction in [text::Direction::Send, text::Direction::Receive] {
            let line = text::write_line(&frame, direction);
            assert_eq!(text::read_line(&line), Some(frame));
            for place in 0..line.len() - 1 {
                let mut damaged = line.clone();
                damaged[place] ^= 1;
                let read = text::read_line(&damaged);
                // Without its `*` a line has no sum, but its frame is whole.
                assert!(read.is_none() || read == Some(frame), "{place}");
            }
        }
    }
    for bad in [
        "",
        "can",
        "can send",
        "can send g 00",
        "rcv 1 0",
        "rcv 1 000",
        "rcv 1 00 *00",
        "rcv 123456789 00",
        "OK",
    ] {
        assert_eq!(text::read_line(bad.as_bytes()), None, "{bad}");
    }
}
