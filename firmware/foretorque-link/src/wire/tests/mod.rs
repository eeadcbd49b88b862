//! Helpers of the tests of the wire.

mod any;
mod line;
mod page;
mod sizes;

use super::*;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::vec::Vec;

const N: usize = 6;

fn wire<M: Serialize>(sequence: u16, message: &M) -> Vec<u8> {
    let mut room = [0; MAX_FRAME];
    encode(sequence, message, &mut room).unwrap().to_vec()
}

/// Everything a receiver makes of `bytes`: what came whole, and what was refused.
fn hear<M: DeserializeOwned>(bytes: &[u8]) -> (Vec<(u16, M)>, Vec<DecodeError>) {
    let mut decoder = Decoder::new();
    let (mut good, mut bad) = (Vec::new(), Vec::new());
    for &byte in bytes {
        match decoder.push(byte) {
            None => {}
            Some(Err(error)) => bad.push(error),
            Some(Ok(frame)) => match frame.message() {
                Ok(message) => good.push((frame.sequence, message)),
                Err(error) => bad.push(error),
            },
        }
    }
    (good, bad)
}

/// Bits are compared, not numbers: NaN must come through as the NaN it is.
fn assert_comes_back<M: Serialize + DeserializeOwned>(sequence: u16, message: &M) {
    let frame = wire(sequence, message);
    assert!(frame.len() <= MAX_FRAME);
    assert_eq!(
        frame.iter().position(|&byte| byte == 0),
        Some(frame.len() - 1)
    );
    let (good, bad) = hear::<M>(&frame);
    assert!(bad.is_empty());
    let [(heard, again)] = good.as_slice() else {
        panic!("one frame in, {} out", good.len());
    };
    assert_eq!(*heard, sequence);
    assert_eq!(wire(sequence, again), frame);
}
