//! Messages over the link, whole and damaged, and their bytes.

mod page;

use super::*;
use crate::bank::BankError;
use crate::excitation::{AbortReason, ExcitationState};
use crate::store::StoreError;
use crate::wire::codec::encode_as;
use core::fmt::Debug;
use foretorque::joint::{JointMeasurement, JointMotion, JointSample, JointVector};
use proptest::prelude::*;
use proptest::sample::select;
use serde::Serialize;
use serde::de::DeserializeOwned;

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
fn a_value_at_the_end_of_its_range_or_a_current_without_a_gain_is_no_measurement() {
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
        let frame = frame.with_current(&JointVector::repeat(effort));
        let tau = |gain: f32| frame.sample(&[gain; N]).measured.map(|it| it.tau);
        let doubled = JointVector::repeat(2.0 * effort);
        assert_eq!(tau(2.0), measured.then_some(doubled));
        assert_eq!(tau(0.0), None);
    }
    // A position beyond the range is sent as the end of it.
    for (q, measured) in [(Position::MAX - Position::RESOLUTION, true), (9.0, false)] {
        let mut frame = frame;
        frame.q[2] = Position::encode(q);
        assert_eq!(frame.sample(&[0.0; N]).measured.is_some(), measured, "{q}");
        frame.q[2] = Position::encode(-q);
        assert_eq!(frame.sample(&[0.0; N]).measured.is_some(), measured, "{q}");
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
fn like<M>(examples: Vec<M>) -> impl Strategy<Value = M>
where
    M: Serialize + DeserializeOwned + Clone + Debug + 'static,
{
    // Small ones are likelier to be a tag or a length.
    let byte = prop_oneof![any::<u8>(), 0..16u8];
    let others = prop::collection::vec(byte, MAX_PAYLOAD);
    (select(examples), others).prop_map(|(example, others)| {
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

proptest! {
    #[test]
    fn every_host_message_survives(sequence: u16, message in host_message()) {
        assert_survives(sequence, &message);
    }

    #[test]
    fn every_board_message_survives(sequence: u16, message in like(longest::<N>().1)) {
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
    let (from_host, _) = longest::<6>();
    let (good, bad) = receive::<HostMessage<7>>(&wire(1, &from_host[1]));
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

/// Name of a variant.
fn named(variant: &impl Debug) -> String {
    let text = format!("{variant:?}");
    let name = text.split(|letter: char| !letter.is_alphabetic()).next();
    name.unwrap().to_string()
}

/// Name and longest frame of every message of host and board, in the order of their tags. No byte of the header is zero.
fn frames<const J: usize>() -> [Vec<(String, Vec<u8>)>; 2] {
    fn framed<M: Serialize + Debug>(messages: &[M]) -> Vec<(String, Vec<u8>)> {
        let messages = messages.iter();
        let framed = messages.map(|message| (named(message), wire(0x0101, message)));
        framed.collect()
    }
    let (from_host, from_board) = longest::<J>();
    [framed(&from_host), framed(&from_board)]
}

/// Every message of one direction, in the order of their tags, with the bytes 01 and 00 in turn behind the tag.
fn filled<M: DeserializeOwned>() -> Vec<M> {
    let read = |tag| {
        let mut bytes = [[0, 1]; MAX_PAYLOAD / 2].concat();
        bytes[0] = tag;
        postcard::take_from_bytes(&bytes).map(|(message, _)| message)
    };
    (0..).map_while(|tag| read(tag).ok()).collect()
}

/// Every message of host and board at its longest, in the order of their tags.
fn longest<const J: usize>() -> (Vec<HostMessage<J>>, Vec<BoardMessage<J>>) {
    let chunk: Chunk = [0xA5; CHUNK].into_iter().collect();
    let name: Name = "abcdefghijklmnopqrstuvwx".parse().unwrap();
    let refused = BankError::WrongArm { found: u32::MAX };
    let aborted = ExcitationState::Aborted(AbortReason::Tracking(1));
    let (mut from_host, mut from_board) = (filled(), filled());
    for message in &mut from_host {
        if let HostMessage::BankWrite { bytes, .. } = message {
            bytes.clone_from(&chunk);
        }
    }
    for message in &mut from_board {
        match message {
            BoardMessage::Hello(hello) => {
                (hello.arm, hello.firmware) = (name.clone(), name.clone())
            }
            BoardMessage::Nack(reason) => *reason = NackReason::Store(StoreError::Bank(refused)),
            BoardMessage::BankChunk { bytes, .. } => bytes.clone_from(&chunk),
            BoardMessage::Telemetry(frame) => {
                frame.bytes = [1; TELEMETRY_BYTES].into_iter().collect();
            }
            BoardMessage::Excitation(state) => *state = aborted,
            BoardMessage::Excited(frame) => frame.state = aborted,
            _ => {}
        }
    }
    (from_host, from_board)
}

fn assert_sizes<const J: usize>() {
    let all = frames::<J>().concat();
    for (name, bytes) in [
        ("Sample", size::sample(J)),
        ("Torque", size::torque(J)),
        ("FullTorque", size::full_torque(J)),
        ("Excited", size::excited(J)),
    ] {
        let is = |(known, frame): &(String, Vec<u8>)| known == name && frame.len() == bytes;
        assert!(all.iter().any(is), "{name}: {bytes}");
    }
}

/// That every frame fits is a part of making it.
#[test]
fn cyclic_frames_have_their_planned_sizes_and_those_of_eight_joints_fit() {
    assert_sizes::<6>();
    assert_sizes::<7>();
    assert_sizes::<8>();
    assert_eq!(size::headroom_permille(96, 1000, 200_000), 520);
}
