//! How many bytes of the line every message takes.

use super::*;
use crate::bank::BankError;
use crate::excitation::{AbortReason, ExcitationCommand, ExcitationState};
use crate::safety::{SafetyReason, SafetyState, SafetyStatus};
use crate::store::StoreError;
use crate::telemetry::Statistics;

/// The largest of every message of the host and of the board, with the name that the protocol page gives it.
pub(super) fn sizes<const J: usize>() -> [Vec<(&'static str, usize)>; 2] {
    let chunk: Chunk = [0xA5; CHUNK].into_iter().collect();
    let name: Name = "abcdefghijklmnopqrstuvwx".parse().unwrap();
    let ones = [f32::from_bits(0x0101_0101); J];
    let evaluated = EvaluatedFrame {
        flags: 0x0101,
        total: ones,
        rigid: ones,
        friction: ones,
        network: ones,
    };
    let safety = SafetyStatus {
        state: SafetyState::Armed,
        reason: SafetyReason::Disarmed,
    };
    let host = |name, message: HostMessage<J>| (name, wire(0x0101, &message).len());
    let board = |name, message: BoardMessage<J>| (name, wire(0x0101, &message).len());
    let from_host = std::vec![
        host("Hello", HostMessage::Hello),
        host(
            "Sample",
            HostMessage::Sample(SampleFrame::new(&foretorque::joint::JointSample {
                desired: foretorque::joint::JointMotion::zero(),
                measured: None,
            }))
        ),
        host(
            "Evaluate",
            HostMessage::Evaluate(MotionFrame {
                q: ones,
                qd: ones,
                qdd: ones
            })
        ),
        host(
            "Configure",
            HostMessage::Configure(Configuration::default())
        ),
        host("Learning", HostMessage::Learning { on: true }),
        host(
            "BankWrite",
            HostMessage::BankWrite {
                offset: 1,
                bytes: chunk.clone()
            }
        ),
        host(
            "BankCommit",
            HostMessage::BankCommit {
                length: 1,
                crc: 1,
                mac: Some([1; MAC_BYTES])
            }
        ),
        host(
            "BankRead",
            HostMessage::BankRead {
                source: BankSource::Stored,
                offset: 1
            }
        ),
        host("Statistics", HostMessage::Statistics),
        host("Reset", HostMessage::Reset),
        host("Arm", HostMessage::Arm),
        host("Disarm", HostMessage::Disarm),
        host("Stop", HostMessage::Stop),
        host("ClearFault", HostMessage::ClearFault),
        host("Request", HostMessage::Request { code: 1 }),
        host("Save", HostMessage::Save),
        host("Restore", HostMessage::Restore),
        host(
            "Telemetry",
            HostMessage::Telemetry {
                fields: 1,
                every: 1
            }
        ),
        host("Challenge", HostMessage::Challenge),
        host("Reboot", HostMessage::Reboot),
        host(
            "ExcitationLoad",
            HostMessage::ExcitationLoad {
                length: 1,
                crc: 1,
                mac: Some([1; MAC_BYTES])
            }
        ),
        host(
            "Excitation",
            HostMessage::Excitation(ExcitationCommand::Start)
        ),
    ];
    let from_board = std::vec![
        board(
            "Hello",
            BoardMessage::Hello(BoardHello {
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
            })
        ),
        board(
            "Torque",
            BoardMessage::Torque(TorqueFrame {
                tick: 1,
                flags: 1,
                safety,
                total: ones,
                shares: [1.0; 3],
            })
        ),
        board(
            "FullTorque",
            BoardMessage::FullTorque(FullTorqueFrame {
                tick: 1,
                safety,
                torque: evaluated
            })
        ),
        board("Evaluated", BoardMessage::Evaluated(evaluated)),
        board("Ack", BoardMessage::Ack),
        board(
            "Nack",
            BoardMessage::Nack(NackReason::Store(StoreError::Bank(BankError::WrongArm {
                found: u32::MAX
            })))
        ),
        board(
            "BankChunk",
            BoardMessage::BankChunk {
                offset: 1,
                length: 1,
                bytes: chunk
            }
        ),
        board(
            "Statistics",
            BoardMessage::Statistics(Statistics::default())
        ),
        board(
            "Telemetry",
            BoardMessage::Telemetry(TelemetryFrame {
                tick: 1,
                fields: 1,
                bytes: [1; TELEMETRY_BYTES].into_iter().collect(),
            })
        ),
        board(
            "Challenge",
            BoardMessage::Challenge {
                nonce: [1; MAC_BYTES]
            }
        ),
        board(
            "Excitation",
            BoardMessage::Excitation(ExcitationState::Aborted(AbortReason::Tracking(1)))
        ),
        board(
            "Excited",
            BoardMessage::Excited(ExcitedFrame {
                torque: TorqueFrame {
                    tick: 1,
                    flags: 1,
                    safety,
                    total: ones,
                    shares: [1.0; 3],
                },
                state: ExcitationState::Aborted(AbortReason::Tracking(1)),
                q: [Position::encode(1.0); J],
                qd: [Velocity::encode(1.0); J],
                qdd: [Acceleration::encode(1.0); J],
            })
        ),
    ];
    [from_host, from_board]
}

#[test]
fn cyclic_frames_have_the_sizes_that_the_link_is_planned_for() {
    fn cyclic<const J: usize>() -> [usize; 4] {
        let of = |wanted| {
            sizes::<J>()
                .into_iter()
                .flatten()
                .find(|(name, _)| *name == wanted)
                .unwrap()
                .1
        };
        [of("Sample"), of("Torque"), of("FullTorque"), of("Excited")]
    }
    assert_eq!(
        cyclic::<6>(),
        [
            size::sample(6),
            size::torque(6),
            size::full_torque(6),
            size::excited(6)
        ]
    );
    assert_eq!(
        cyclic::<7>(),
        [
            size::sample(7),
            size::torque(7),
            size::full_torque(7),
            size::excited(7)
        ]
    );
    assert!(size::sample(6) <= 96 && size::torque(6) <= 64);
    assert_eq!(size::headroom_permille(96, 1000, 200_000), 520);
}

#[test]
fn every_message_of_eight_joints_fits_a_frame() {
    for (name, bytes) in sizes::<8>().into_iter().flatten() {
        assert!(bytes <= MAX_FRAME, "{name}: {bytes}");
    }
}
