//! Are copying and filling memory right? For every alignment and every length up to three rounds of their loops.

use core::hint::black_box;
use core::ptr;

/// Bytes of a room, and where in it the moved ones begin.
const ROOM: usize = 80;
const START: usize = 8;
const LONGEST: usize = 52;
/// What is there before.
const BEFORE: u8 = 0xA5;
const FILL: u8 = 0x3C;

/// Every byte that should was written, and no other.
pub(crate) fn hold() -> bool {
    let mut source = [0u8; ROOM];
    for (k, byte) in (0..).zip(&mut source) {
        *byte = k;
    }
    (0..=LONGEST).all(|length| {
        (0..4).all(|to| (0..4).all(|from| copies(&source, from, to, length)) && fills(to, length))
    })
}

fn copies(source: &[u8; ROOM], from: usize, to: usize, length: usize) -> bool {
    let mut room = [BEFORE; ROOM];
    // SAFETY: START + 3 + LONGEST is below ROOM on both sides, and the two are different arrays.
    unsafe {
        let to = room.as_mut_ptr().add(START + to);
        ptr::copy_nonoverlapping(source.as_ptr().add(from), to, black_box(length));
    }
    written(&room, to, length, |k| source.get(from + k).copied())
}

fn fills(to: usize, length: usize) -> bool {
    [FILL, 0].into_iter().all(|byte| {
        let mut room = [BEFORE; ROOM];
        let byte = black_box(byte);
        // SAFETY: START + 3 + LONGEST is below ROOM.
        unsafe { ptr::write_bytes(room.as_mut_ptr().add(START + to), byte, black_box(length)) };
        written(&room, to, length, |_| Some(byte))
    })
}

fn written(room: &[u8; ROOM], to: usize, length: usize, of: impl Fn(usize) -> Option<u8>) -> bool {
    let begin = START + to;
    black_box(room).iter().enumerate().all(|(k, &byte)| {
        match k.checked_sub(begin).filter(|&k| k < length) {
            Some(k) => of(k) == Some(byte),
            None => byte == BEFORE,
        }
    })
}
