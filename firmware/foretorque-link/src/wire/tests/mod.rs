//! Helpers of the tests of the wire format.

mod line;
mod page;
mod sizes;

use super::*;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::vec::Vec;

const N: usize = 6;

fn wire<M: Serialize>(sequence: u16, message: &M) -> Vec<u8> {
    let mut buffer = [0; MAX_FRAME];
    encode(sequence, message, &mut buffer).unwrap().to_vec()
}

/// The messages in `bytes`, and the errors of the frames that were refused.
fn receive<M: DeserializeOwned>(bytes: &[u8]) -> (Vec<(u16, M)>, Vec<DecodeError>) {
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

/// Compares bits, so that NaN counts as equal to itself.
fn assert_survives<M: Serialize + DeserializeOwned>(sequence: u16, message: &M) {
    let frame = wire(sequence, message);
    assert!(frame.len() <= MAX_FRAME);
    assert_eq!(
        frame.iter().position(|&byte| byte == 0),
        Some(frame.len() - 1)
    );
    let (good, bad) = receive::<M>(&frame);
    assert!(bad.is_empty());
    let [(number, again)] = good.as_slice() else {
        panic!("one frame in, {} out", good.len());
    };
    assert_eq!(*number, sequence);
    assert_eq!(wire(sequence, again), frame);
}
