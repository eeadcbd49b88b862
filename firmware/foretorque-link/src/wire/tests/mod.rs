//! Messages over the link, whole and damaged.

mod page;
mod sizes;

use super::*;
use crate::wire::codec::encode_as;
use core::fmt::Debug;
use foretorque::joint::{JointMeasurement, JointMotion, JointSample, JointVector};
use proptest::prelude::*;
use proptest::sample::select;
use serde::Serialize;
use serde::de::DeserializeOwned;
use sizes::longest;
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

#[test]
fn an_effort_at_the_end_of_its_range_leaves_the_sample_without_measurement() {
    let frame = SampleFrame::new(&JointSample {
        desired: JointMotion::zero(),
        measured: Some(JointMeasurement {
            q: JointVector::<N>::repeat(0.5),
            tau: JointVector::repeat(1.0),
        }),
    });
    for (effort, measured) in [
        (Effort::MAX - Effort::RESOLUTION, true),
        (Effort::MAX, false),
        (600.0, false),
        (-600.0, false),
    ] {
        let mut frame = frame;
        frame.effort[4] = Effort::encode(effort);
        let sample = frame.sample(&[0.0; N]);
        let tau = sample.measured.map(|measured| measured.tau[4]);
        assert_eq!(tau, measured.then_some(effort), "{effort}");
        assert_eq!(
            frame
                .with_current(&JointVector::repeat(effort))
                .sample(&[2.0; N])
                .measured
                .is_some(),
            measured
        );
    }
}

/// Compares bits, so that NaN counts as equal to itself.
fn assert_survives<M: Serialize + DeserializeOwned>(sequence: u16, message: &M) {
    let frame = wire(sequence, message);
    assert!(frame.len() <= MAX_FRAME);
    let delimiter = frame.iter().position(|&byte| byte == 0);
    assert_eq!(delimiter, Some(frame.len() - 1));
    let (good, bad) = receive::<M>(&frame);
    assert!(bad.is_empty());
    let [(number, again)] = good.as_slice() else {
        panic!("one frame in, {} out", good.len());
    };
    assert_eq!(*number, sequence);
    assert_eq!(wire(sequence, again), frame);
}

/// A message with any values in it, NaN, infinities and denormals too: one of `examples` with other bytes behind the tag,
/// wherever they still are a message.
fn like<M>(examples: impl Into<Vec<M>>) -> impl Strategy<Value = M>
where
    M: Serialize + DeserializeOwned + Clone + Debug + 'static,
{
    // Small ones are likelier to be a tag or a length.
    let byte = prop_oneof![any::<u8>(), 0..16u8];
    let others = prop::collection::vec(byte, MAX_PAYLOAD);
    (select(examples.into()), others).prop_map(|(example, others)| {
        let mut buffer = [0; MAX_PAYLOAD];
        let content = postcard::to_slice(&example, &mut buffer).unwrap();
        for place in 1..content.len() {
            let old = core::mem::replace(&mut content[place], others[place]);
            if postcard::take_from_bytes::<M>(content).is_err() {
                content[place] = old;
            }
        }
        postcard::take_from_bytes(content).unwrap().0
    })
}

fn host_message() -> impl Strategy<Value = HostMessage<N>> {
    like(longest().0)
}

fn board_message() -> impl Strategy<Value = BoardMessage<N>> {
    like(longest().1)
}

proptest! {
    #[test]
    fn every_host_message_survives(sequence: u16, message in host_message()) {
        assert_survives(sequence, &message);
    }

    #[test]
    fn every_board_message_survives(sequence: u16, message in board_message()) {
        assert_survives(sequence, &message);
    }

    #[test]
    fn up_to_three_flipped_bits_are_found(
        message in host_message(),
        flips in prop::collection::vec((any::<prop::sample::Index>(), 0..8u32), 1..=3),
    ) {
        let frame = wire(7, &message);
        let mut damaged = frame.clone();
        for (place, bit) in flips {
            let place = place.index(frame.len());
            damaged[place] ^= 1 << bit;
        }
        let unharmed = damaged == frame;
        // The delimiter of the damaged frame may be lost: then the next frame is lost too, and no more.
        damaged.extend(wire(8, &HostMessage::<N>::Statistics));
        damaged.extend(wire(9, &HostMessage::<N>::Hello));
        let (good, _) = receive::<HostMessage<N>>(&damaged);
        prop_assert_eq!(good.iter().any(|(sequence, _)| *sequence == 7), unharmed);
        prop_assert!(good.iter().all(|(sequence, _)| [7, 8, 9].contains(sequence)));
        prop_assert_eq!(good.last(), Some(&(9, HostMessage::Hello)));
    }

    #[test]
    fn a_foreign_version_is_named(ahead in 1..=255u8, message in host_message()) {
        // Any but its own, older ones too.
        let version = PROTOCOL_VERSION.wrapping_add(ahead);
        let mut buffer = [0; MAX_FRAME];
        let frame = encode_as(version, 1, &message, &mut buffer).unwrap();
        let (good, bad) = receive::<HostMessage<N>>(frame);
        prop_assert!(good.is_empty());
        prop_assert_eq!(bad, [DecodeError::ForeignVersion(version)]);
    }
}

#[test]
fn a_sample_of_six_joints_is_none_of_seven() {
    let six = SampleFrame::<6>::new(&foretorque::joint::JointSample {
        desired: foretorque::joint::JointMotion::zero(),
        measured: None,
    });
    let (good, bad) = receive::<HostMessage<7>>(&wire(1, &HostMessage::Sample(six)));
    assert!(good.is_empty());
    assert_eq!(bad, [DecodeError::Unknown]);
}

#[test]
fn an_overlong_frame_is_refused_and_the_next_one_received() {
    let mut line = [1; 3 * MAX_FRAME].to_vec();
    line.push(0);
    line.extend(wire(4, &HostMessage::<N>::Hello));
    let (good, bad) = receive::<HostMessage<N>>(&line);
    assert_eq!(bad, [DecodeError::Framing]);
    assert_eq!(good, [(4, HostMessage::Hello)]);
}

#[test]
fn lost_bytes_are_those_of_refused_frames() {
    let mut frame = wire(4, &HostMessage::<N>::Hello);
    frame[2] ^= 4;
    let mut decoder = Decoder::new();
    for byte in [&[0, 0][..], &frame, &wire(5, &HostMessage::<N>::Hello)].concat() {
        let _ = decoder.push(byte);
    }
    assert_eq!(decoder.bytes_lost() as usize, frame.len());
}
