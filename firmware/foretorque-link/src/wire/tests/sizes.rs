//! Bytes on the wire of every message.

use super::*;
use crate::bank::BankError;
use crate::excitation::{AbortReason, ExcitationCommand, ExcitationState};
use crate::safety::{SafetyReason, SafetyState, SafetyStatus};
use crate::store::StoreError;
use crate::telemetry::Statistics;
use core::fmt::Debug;
use std::string::{String, ToString as _};

/// Name of a message and its frame, with no zero byte in its header.
fn framed<M: Serialize + Debug>(message: M) -> (String, Vec<u8>) {
    (named(&message), wire(0x0101, &message))
}

/// Name of a variant.
pub(super) fn named(variant: &impl Debug) -> String {
    let text = std::format!("{variant:?}");
    let name = text.split(|letter: char| !letter.is_alphabetic()).next();
    name.unwrap().to_string()
}

/// Names and largest wire sizes of the messages of host and board, in the order of their tags.
pub(super) fn sizes<const J: usize>() -> [Vec<(String, usize)>; 2] {
    frames::<J>().map(|frames| {
        let sized = frames.into_iter().map(|(name, frame)| (name, frame.len()));
        sized.collect()
    })
}

/// The longest frame of every message of host and board, in the order of their tags.
pub(super) fn frames<const J: usize>() -> [Vec<(String, Vec<u8>)>; 2] {
    let (from_host, from_board) = longest::<J>();
    [
        from_host.into_iter().map(framed).collect(),
        from_board.into_iter().map(framed).collect(),
    ]
}

/// Every message of host and board at its longest, in the order of their tags.
pub(super) fn longest<const J: usize>() -> ([HostMessage<J>; 23], [BoardMessage<J>; 12]) {
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
