//! Messages over the link, whole and damaged, and their bytes.

mod page;

use super::*;
use crate::bank::BankError;
use crate::excitation::{AbortReason, ExcitationCommand, ExcitationState};
use crate::safety::{SafetyReason, SafetyState, SafetyStatus};
use crate::store::StoreError;
use crate::telemetry::Statistics;
use crate::wire::codec::encode_as;
use core::fmt::Debug;
use foretorque::joint::{JointMeasurement, JointMotion, JointSample, JointVector};
use proptest::prelude::*;
use proptest::sample::select;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::string::{String, ToString as _};
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

/// Name of a message and its frame, with no zero byte in its header.
fn framed<M: Serialize + Debug>(message: M) -> (String, Vec<u8>) {
    (named(&message), wire(0x0101, &message))
}

/// Name of a variant.
fn named(variant: &impl Debug) -> String {
    let text = std::format!("{variant:?}");
    let name = text.split(|letter: char| !letter.is_alphabetic()).next();
    name.unwrap().to_string()
}

/// Names and largest wire sizes of the messages of host and board, in the order of their tags.
fn sizes<const J: usize>() -> [Vec<(String, usize)>; 2] {
    frames::<J>().map(|frames| {
        let sized = frames.into_iter().map(|(name, frame)| (name, frame.len()));
        sized.collect()
    })
}

/// The longest frame of every message of host and board, in the order of their tags.
fn frames<const J: usize>() -> [Vec<(String, Vec<u8>)>; 2] {
    let (from_host, from_board) = longest::<J>();
    [
        from_host.into_iter().map(framed).collect(),
        from_board.into_iter().map(framed).collect(),
    ]
}

/// Every message of host and board at its longest, in the order of their tags.
fn longest<const J: usize>() -> ([HostMessage<J>; 23], [BoardMessage<J>; 12]) {
    let ones = [f32::from_bits(0x0101_0101); J];
    let chunk: Chunk = [0xA5; CHUNK].into_iter().collect();
    let name: Name = "abcdefghijklmnopqrstuvwx".parse().unwrap();
    let mac = Some([1; MAC_BYTES]);
    let (length, crc, offset, every) = (1, 1, 1, 1);
    let sample = SampleFrame::new(&foretorque::joint::JointSample {
        desired: foretorque::joint::JointMotion::zero(),
        measured: None,
    });
    let motion = MotionFrame {
        q: ones,
        qd: ones,
        qdd: ones,
    };
    let write = HostMessage::BankWrite {
        offset,
        bytes: chunk.clone(),
    };
    let read = HostMessage::BankRead {
        source: BankSource::Stored,
        offset,
    };
    let from_host: [HostMessage<J>; 23] = [
        HostMessage::Hello,
        HostMessage::Sample(sample),
        HostMessage::Evaluate(motion),
        HostMessage::Configure(Configuration::default()),
        HostMessage::Learning { on: true },
        write,
        HostMessage::BankCommit { length, crc, mac },
        read,
        HostMessage::Statistics,
        HostMessage::Reset,
        HostMessage::Arm,
        HostMessage::Disarm,
        HostMessage::Stop,
        HostMessage::ClearFault,
        HostMessage::Request { code: 1 },
        HostMessage::Save,
        HostMessage::Restore,
        HostMessage::Telemetry { fields: 1, every },
        HostMessage::Challenge,
        HostMessage::Reboot,
        HostMessage::ExcitationLoad { length, crc, mac },
        HostMessage::Excitation(ExcitationCommand::Start),
        HostMessage::Unlock {
            order: [1; 2],
            mac: [1; MAC_BYTES],
        },
    ];
    let safety = SafetyStatus {
        state: SafetyState::Armed,
        reason: SafetyReason::Disarmed,
    };
    let hello = BoardHello {
        arm_hash: 1,
        arm: name.clone(),
        joints: 1,
        base_columns: 1,
        firmware: name,
        capabilities: Capabilities::LEARNING,
        counter: CounterKind::Cycles,
        counter_hz: 1,
        configuration: Configuration::default(),
        reset_reason: ResetReason::Pin,
        safety,
        boot_counts: 1,
        chip: ChipStatus {
            brown_out: 1,
            read_out_protection: 1,
            image: ImageStatus::Sound,
            ..ChipStatus::VIRTUAL
        },
    };
    let torque = TorqueFrame {
        tick: 1,
        flags: 1,
        safety,
        total: ones,
        shares: [1.0; 3],
    };
    let evaluated = EvaluatedFrame {
        flags: 0x0101,
        total: ones,
        rigid: ones,
        friction: ones,
        network: ones,
    };
    let full = FullTorqueFrame {
        tick: 1,
        safety,
        torque: evaluated,
    };
    let refused = BankError::WrongArm { found: u32::MAX };
    let telemetry = TelemetryFrame {
        tick: 1,
        fields: 1,
        bytes: [1; TELEMETRY_BYTES].into_iter().collect(),
    };
    let aborted = ExcitationState::Aborted(AbortReason::Tracking(1));
    let excited = ExcitedFrame {
        torque,
        state: aborted,
        q: [Position::encode(1.0); J],
        qd: [Velocity::encode(1.0); J],
        qdd: [Acceleration::encode(1.0); J],
    };
    let chunk = BoardMessage::BankChunk {
        offset,
        length,
        bytes: chunk,
    };
    let nonce = [1; MAC_BYTES];
    let from_board: [BoardMessage<J>; 12] = [
        BoardMessage::Hello(hello),
        BoardMessage::Torque(torque),
        BoardMessage::FullTorque(full),
        BoardMessage::Evaluated(evaluated),
        BoardMessage::Ack,
        BoardMessage::Nack(NackReason::Store(StoreError::Bank(refused))),
        chunk,
        BoardMessage::Statistics(Statistics::default()),
        BoardMessage::Telemetry(telemetry),
        BoardMessage::Challenge { nonce },
        BoardMessage::Excitation(aborted),
        BoardMessage::Excited(excited),
    ];
    (from_host, from_board)
}

fn assert_cyclic_sizes<const J: usize>() {
    let all: Vec<_> = sizes::<J>().into_iter().flatten().collect();
    for (name, bytes) in [
        ("Sample", size::sample(J)),
        ("Torque", size::torque(J)),
        ("FullTorque", size::full_torque(J)),
        ("Excited", size::excited(J)),
    ] {
        assert!(all.contains(&(name.to_string(), bytes)), "{name}: {bytes}");
    }
}

#[test]
fn cyclic_frames_have_their_planned_sizes() {
    assert_cyclic_sizes::<6>();
    assert_cyclic_sizes::<7>();
    assert!(size::sample(6) <= 96 && size::torque(6) <= 64);
    assert_eq!(size::headroom_permille(96, 1000, 200_000), 520);
}

#[test]
fn every_message_of_eight_joints_fits_a_frame() {
    for (name, bytes) in sizes::<8>().into_iter().flatten() {
        assert!(bytes <= MAX_FRAME, "{name}: {bytes}");
    }
}
