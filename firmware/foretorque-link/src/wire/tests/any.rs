//! Any message there is, with any numbers in it.

use super::*;
use crate::bank::BankError;
use crate::excitation::{AbortReason, ExcitationCommand, ExcitationError, ExcitationState};
use crate::safety::{SafetyReason, SafetyState, SafetyStatus};
use crate::store::{StoreError, StoreHealth};
use crate::telemetry::{Cost, Statistics};
use proptest::prelude::*;

fn floats<const K: usize>() -> impl Strategy<Value = [f32; K]> {
    // Every bit pattern, so NaN, infinities and denormals too.
    prop::array::uniform::<_, K>(any::<u32>().prop_map(f32::from_bits))
}

pub(super) fn bytes(most: usize) -> impl Strategy<Value = Vec<u8>> {
    prop::collection::vec(any::<u8>(), 0..=most)
}

fn chunk() -> impl Strategy<Value = Chunk> {
    bytes(CHUNK).prop_map(|bytes| bytes.into_iter().collect())
}

fn name() -> impl Strategy<Value = Name> {
    "[ -~]{0,24}".prop_map(|text| text.parse().unwrap())
}

fn configuration() -> impl Strategy<Value = Configuration> {
    let pacing = prop_oneof![Just(Pacing::Link), Just(Pacing::SysTick)];
    let reply = prop_oneof![Just(ReplyMode::Decimated), Just(ReplyMode::Full)];
    (any::<u32>(), pacing, reply).prop_map(|(period_us, pacing, reply)| Configuration {
        period_us,
        pacing,
        reply,
    })
}

fn sample() -> impl Strategy<Value = SampleFrame<N>> {
    (
        any::<u8>(),
        any::<i8>(),
        floats::<6>(),
        floats::<6>(),
        floats::<6>(),
        floats::<6>(),
    )
        .prop_map(|(flags, temperature_c, a, b, c, d)| SampleFrame {
            flags: SampleFlags(flags),
            temperature_c,
            desired_q: a.map(Position::encode),
            desired_qd: b.map(Velocity::encode),
            desired_qdd: c.map(Acceleration::encode),
            q: d.map(Position::encode),
            effort: a.map(Effort::encode),
        })
}

pub(super) fn host_message() -> impl Strategy<Value = HostMessage<N>> {
    prop_oneof![
        Just(HostMessage::Hello),
        sample().prop_map(HostMessage::Sample),
        (floats(), floats(), floats())
            .prop_map(|(q, qd, qdd)| HostMessage::Evaluate(MotionFrame { q, qd, qdd })),
        configuration().prop_map(HostMessage::Configure),
        any::<bool>().prop_map(|on| HostMessage::Learning { on }),
        (any::<u16>(), chunk())
            .prop_map(|(offset, bytes)| HostMessage::BankWrite { offset, bytes }),
        (any::<u16>(), any::<u32>(), any::<Option<[u8; MAC_BYTES]>>())
            .prop_map(|(length, crc, mac)| HostMessage::BankCommit { length, crc, mac }),
        (bank_source(), any::<u16>())
            .prop_map(|(source, offset)| HostMessage::BankRead { source, offset }),
        Just(HostMessage::Statistics),
        Just(HostMessage::Reset),
        commands(),
    ]
}

fn bank_source() -> impl Strategy<Value = BankSource> {
    prop_oneof![
        Just(BankSource::Live),
        Just(BankSource::Committed),
        Just(BankSource::Stored),
    ]
}

fn commands() -> impl Strategy<Value = HostMessage<N>> {
    prop_oneof![
        Just(HostMessage::Arm),
        Just(HostMessage::Disarm),
        Just(HostMessage::Stop),
        Just(HostMessage::ClearFault),
        any::<u8>().prop_map(|code| HostMessage::Request { code }),
        Just(HostMessage::Save),
        Just(HostMessage::Restore),
        (any::<u16>(), any::<u16>())
            .prop_map(|(fields, every)| HostMessage::Telemetry { fields, every }),
        Just(HostMessage::Challenge),
        Just(HostMessage::Reboot),
        (any::<u16>(), any::<u32>(), any::<Option<[u8; MAC_BYTES]>>())
            .prop_map(|(length, crc, mac)| HostMessage::ExcitationLoad { length, crc, mac }),
        prop::sample::select(std::vec![
            ExcitationCommand::Status,
            ExcitationCommand::Start,
            ExcitationCommand::Stop,
            ExcitationCommand::Release
        ])
        .prop_map(HostMessage::Excitation),
    ]
}

fn safety() -> impl Strategy<Value = SafetyStatus> {
    let state = prop_oneof![
        Just(SafetyState::Disarmed),
        Just(SafetyState::Armed),
        Just(SafetyState::RampDown),
        Just(SafetyState::Fault),
    ];
    let reason = (0..SafetyReason::ALL.len()).prop_map(|code| SafetyReason::ALL[code]);
    (state, reason).prop_map(|(state, reason)| SafetyStatus { state, reason })
}

fn telemetry() -> impl Strategy<Value = TelemetryFrame> {
    (any::<u32>(), any::<u16>(), bytes(TELEMETRY_BYTES)).prop_map(|(tick, fields, bytes)| {
        TelemetryFrame {
            tick,
            fields,
            bytes: bytes.into_iter().collect(),
        }
    })
}

fn evaluated() -> impl Strategy<Value = EvaluatedFrame<N>> {
    (any::<u16>(), floats(), floats(), floats(), floats()).prop_map(
        |(flags, total, rigid, friction, network)| EvaluatedFrame {
            flags,
            total,
            rigid,
            friction,
            network,
        },
    )
}

fn nack() -> impl Strategy<Value = NackReason> {
    prop_oneof![
        Just(NackReason::LearningOn),
        Just(NackReason::NotCapable),
        Just(NackReason::Period),
        any::<u16>().prop_map(|expected| NackReason::Gap { expected }),
        Just(NackReason::TooLong),
        Just(NackReason::Checksum),
        any::<u32>().prop_map(|found| NackReason::Bank(BankError::WrongArm { found })),
        any::<u16>().prop_map(|place| NackReason::Bank(BankError::Weight(place))),
        Just(NackReason::Armed),
        safety().prop_map(|status| NackReason::Unsafe(status.reason)),
        Just(NackReason::Busy),
        Just(NackReason::Key),
        any::<u32>().prop_map(|found| NackReason::Store(StoreError::WrongArm { found })),
        any::<u16>()
            .prop_map(|place| { NackReason::Store(StoreError::Bank(BankError::Weight(place))) }),
        any::<u16>().prop_map(|every| NackReason::Bandwidth { every }),
        any::<u8>().prop_map(|j| NackReason::Excitation(ExcitationError::NotAtRest(j))),
    ]
}

fn state() -> impl Strategy<Value = ExcitationState> {
    prop_oneof![
        Just(ExcitationState::Empty),
        Just(ExcitationState::Playing),
        any::<u8>().prop_map(|j| ExcitationState::Refused(ExcitationError::CertificateBroken(j))),
        any::<u8>().prop_map(|j| ExcitationState::Aborted(AbortReason::Tracking(j))),
    ]
}

fn statistics() -> impl Strategy<Value = Statistics> {
    (prop::array::uniform4(any::<u32>()), any::<i8>()).prop_map(|([a, b, c, d], hottest_c)| {
        Statistics {
            frames: a,
            crc_errors: b,
            framing_errors: c,
            foreign_version: d,
            unknown: a,
            missed: b,
            repeated: c,
            bytes_lost: d,
            overtaken: a,
            stale_ticks: b,
            overruns: c,
            replies_lost: d,
            ticks: a,
            late_sets: b,
            learning_samples_lost: c,
            tick_cost: Cost { mean: d, max: a },
            learn_cost: Cost { mean: b, max: c },
            receive_cost: Cost { mean: c, max: d },
            hottest_c,
            reply_latency: Cost { mean: a, max: c },
            implausible: b,
            watchdog_feeds: c,
            records_lost: d,
            store: StoreHealth::Failing,
        }
    })
}

fn hello() -> impl Strategy<Value = BoardHello> {
    let words = (
        any::<u32>(),
        any::<u32>(),
        any::<u8>(),
        any::<u8>(),
        any::<u16>(),
    );
    (words, name(), name(), configuration(), safety()).prop_map(
        |(
            (arm_hash, counter_hz, joints, base_columns, capabilities),
            arm,
            firmware,
            configuration,
            safety,
        )| {
            BoardHello {
                arm_hash,
                arm,
                joints,
                base_columns,
                firmware,
                capabilities: Capabilities(capabilities),
                counter: CounterKind::Instructions,
                counter_hz,
                configuration,
                reset_reason: ResetReason::Fault,
                safety,
                boot_counts: counter_hz.rotate_left(7),
            }
        },
    )
}

pub(super) fn board_message() -> impl Strategy<Value = BoardMessage<N>> {
    prop_oneof![
        hello().prop_map(BoardMessage::Hello),
        (any::<u32>(), any::<u16>(), safety(), floats(), floats()).prop_map(
            |(tick, flags, safety, total, shares)| {
                BoardMessage::Torque(TorqueFrame {
                    tick,
                    flags,
                    safety,
                    total,
                    shares,
                })
            }
        ),
        (any::<u32>(), safety(), evaluated()).prop_map(|(tick, safety, torque)| {
            BoardMessage::FullTorque(FullTorqueFrame {
                tick,
                safety,
                torque,
            })
        }),
        evaluated().prop_map(BoardMessage::Evaluated),
        Just(BoardMessage::Ack),
        nack().prop_map(BoardMessage::Nack),
        (any::<u16>(), any::<u16>(), chunk()).prop_map(|(offset, length, bytes)| {
            BoardMessage::BankChunk {
                offset,
                length,
                bytes,
            }
        }),
        statistics().prop_map(BoardMessage::Statistics),
        telemetry().prop_map(BoardMessage::Telemetry),
        any::<[u8; MAC_BYTES]>().prop_map(|nonce| BoardMessage::Challenge { nonce }),
        state().prop_map(BoardMessage::Excitation),
        (state(), sample(), floats(), floats()).prop_map(|(state, motion, total, shares)| {
            BoardMessage::Excited(ExcitedFrame {
                torque: TorqueFrame {
                    tick: 7,
                    flags: 3,
                    safety: SafetyStatus {
                        state: SafetyState::Armed,
                        reason: SafetyReason::Disarmed,
                    },
                    total,
                    shares,
                },
                state,
                q: motion.desired_q,
                qd: motion.desired_qd,
                qdd: motion.desired_qdd,
            })
        }),
    ]
}
