use super::codec::encode_as;
use super::*;
use crate::edge::bank::BankError;
use crate::edge::safety::{SafetyReason, SafetyState, SafetyStatus};
use crate::edge::store::StoreError;
use crate::edge::store::StoreHealth;
use crate::edge::telemetry::{Cost, Statistics};
use crate::excitation::{AbortReason, Cue, ExcitationError, Stage};
use proptest::prelude::*;
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

fn floats<const K: usize>() -> impl Strategy<Value = [f32; K]> {
    // Every bit pattern, so NaN, infinities and denormals too.
    prop::array::uniform::<_, K>(any::<u32>().prop_map(f32::from_bits))
}

fn bytes(most: usize) -> impl Strategy<Value = Vec<u8>> {
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

fn host_message() -> impl Strategy<Value = HostMessage<N>> {
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
        prop::sample::select(std::vec![Cue::Status, Cue::Start, Cue::Stop, Cue::Release])
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

fn stage() -> impl Strategy<Value = Stage> {
    prop_oneof![
        Just(Stage::Empty),
        Just(Stage::Playing),
        any::<u8>().prop_map(|j| Stage::Refused(ExcitationError::CertificateBroken(j))),
        any::<u8>().prop_map(|j| Stage::Aborted(AbortReason::Tracking(j))),
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
            lessons_lost: c,
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

fn board_message() -> impl Strategy<Value = BoardMessage<N>> {
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
        stage().prop_map(BoardMessage::Excitation),
        (stage(), sample(), floats(), floats()).prop_map(|(stage, motion, total, shares)| {
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
                stage,
                q: motion.desired_q,
                qd: motion.desired_qd,
                qdd: motion.desired_qdd,
            })
        }),
    ]
}

proptest! {
    #[test]
    fn every_host_message_comes_back(sequence: u16, message in host_message()) {
        assert_comes_back(sequence, &message);
    }

    #[test]
    fn every_board_message_comes_back(sequence: u16, message in board_message()) {
        assert_comes_back(sequence, &message);
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
        // The delimiter of the damaged frame may be gone: then it swallows the one behind it, and no more.
        damaged.extend(wire(8, &HostMessage::<N>::Statistics));
        damaged.extend(wire(9, &HostMessage::<N>::Hello));
        let (good, _) = hear::<HostMessage<N>>(&damaged);
        prop_assert_eq!(good.iter().any(|(sequence, _)| *sequence == 7), unharmed);
        prop_assert!(good.iter().all(|(sequence, _)| [7, 8, 9].contains(sequence)));
        prop_assert_eq!(good.last(), Some(&(9, HostMessage::Hello)));
    }

    #[test]
    fn a_frame_cut_short_is_lost_and_the_next_one_but_one_is_not(
        message in host_message(),
        cut in any::<prop::sample::Index>(),
    ) {
        let frame = wire(7, &message);
        let mut line = frame[..cut.index(frame.len())].to_vec();
        line.extend(wire(8, &HostMessage::<N>::Statistics));
        line.extend(wire(9, &HostMessage::<N>::Hello));
        let (good, _) = hear::<HostMessage<N>>(&line);
        prop_assert!(good.iter().all(|(sequence, _)| *sequence != 7));
        prop_assert_eq!(good.last(), Some(&(9, HostMessage::Hello)));
    }

    #[test]
    fn garbage_between_frames_costs_no_more_than_the_frame_it_touches(
        garbage in bytes(600),
        message in host_message(),
    ) {
        let mut line = garbage;
        line.extend(wire(1, &HostMessage::<N>::Hello));
        line.extend(wire(2, &message));
        let (good, _) = hear::<HostMessage<N>>(&line);
        let last = good.last().map(|(sequence, again)| (*sequence, wire(2, again)));
        prop_assert_eq!(last, Some((2, wire(2, &message))));
        prop_assert!(good.len() <= 2);
    }

    #[test]
    fn a_frame_sent_twice_is_heard_twice_with_the_same_number(message in host_message()) {
        let frame = wire(3, &message);
        let (good, bad) = hear::<HostMessage<N>>(&[frame.clone(), frame].concat());
        prop_assert_eq!(good.iter().map(|(sequence, _)| *sequence).collect::<Vec<_>>(), [3, 3]);
        prop_assert!(bad.is_empty());
    }

    #[test]
    fn a_foreign_version_is_named(ahead in 1..=255u8, message in host_message()) {
        // Any but its own, older ones too.
        let version = PROTOCOL_VERSION.wrapping_add(ahead);
        let mut room = [0; MAX_FRAME];
        let frame = encode_as(version, 1, &message, &mut room).unwrap();
        let (good, bad) = hear::<HostMessage<N>>(frame);
        prop_assert!(good.is_empty());
        prop_assert_eq!(bad, [DecodeError::ForeignVersion(version)]);
    }
}

#[test]
fn a_sample_of_six_joints_is_none_of_seven() {
    let six = SampleFrame::<6>::new(&crate::joint::JointSample {
        desired: crate::joint::JointMotion::zero(),
        measured: None,
    });
    let (good, bad) = hear::<HostMessage<7>>(&wire(1, &HostMessage::Sample(six)));
    assert!(good.is_empty());
    assert_eq!(bad, [DecodeError::Unknown]);
}

#[test]
fn a_frame_longer_than_any_message_is_refused_and_the_next_one_heard() {
    let mut line = [1; 3 * MAX_FRAME].to_vec();
    line.push(0);
    line.extend(wire(4, &HostMessage::<N>::Hello));
    let (good, bad) = hear::<HostMessage<N>>(&line);
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

/// The largest of every message of the host and of the board, with the name that the protocol page gives it.
fn sizes<const J: usize>() -> [Vec<(&'static str, usize)>; 2] {
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
            HostMessage::Sample(SampleFrame::new(&crate::joint::JointSample {
                desired: crate::joint::JointMotion::zero(),
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
        host("Excitation", HostMessage::Excitation(Cue::Start)),
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
            BoardMessage::Excitation(Stage::Aborted(AbortReason::Tracking(1)))
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
                stage: Stage::Aborted(AbortReason::Tracking(1)),
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
    for joints in [6, 7] {
        for bytes in [
            size::sample(joints),
            size::torque(joints),
            size::full_torque(joints),
        ] {
            assert!(size::headroom_permille(bytes, 1000, 2_000_000) >= 300);
        }
    }
    assert_eq!(size::headroom_permille(96, 1000, 2_000_000), 520);
}

#[test]
fn every_message_of_eight_joints_fits_a_frame() {
    for (name, bytes) in sizes::<8>().into_iter().flatten() {
        assert!(bytes <= MAX_FRAME, "{name}: {bytes}");
    }
}

/// The line of the protocol page that begins with these cells.
fn row<'a>(page: &'a str, cells: &str) -> &'a str {
    let row = page.lines().find(|line| line.starts_with(cells));
    row.unwrap_or_else(|| panic!("docs/protocol.md has no row `{cells}`"))
}

#[test]
fn the_protocol_page_states_the_sizes_of_the_types() {
    let page = include_str!("../../../../docs/protocol.md");
    let directions = ["→", "←"].into_iter().zip(sizes::<6>()).zip(sizes::<7>());
    for ((direction, six), seven) in directions {
        for (tag, ((name, six), (_, seven))) in six.iter().zip(&seven).enumerate() {
            let line = row(page, &std::format!("| {direction} | {tag} | `{name}` |"));
            let ends = std::format!("| {six} | {seven} |");
            assert!(
                line.ends_with(&ends),
                "{line}\nends with {ends} in the types"
            );
        }
    }
    let permille = |bytes| size::headroom_permille(bytes, 1000, 2_000_000);
    for (name, bytes) in [
        ("request, 6 joints", size::sample(6)),
        ("request, 7 joints", size::sample(7)),
        ("reply, 6 joints", size::torque(6)),
        ("reply, 7 joints", size::torque(7)),
        ("full reply, 6 joints", size::full_torque(6)),
        ("full reply, 7 joints", size::full_torque(7)),
        ("reply with motion, 6 joints", size::excited(6)),
        ("reply with motion, 7 joints", size::excited(7)),
    ] {
        let headroom = permille(bytes);
        let wanted = std::format!(
            "| {name} | {bytes} | {}.{} % |",
            headroom / 10,
            headroom % 10
        );
        assert_eq!(row(page, &std::format!("| {name} |")), wanted);
    }
    let heading = page.find("| receive interrupt |").unwrap();
    for (name, joints) in [("request, 6 joints", 6), ("request, 7 joints", 7)] {
        let share = size::receive_permille(size::sample(joints), 1000);
        let wanted = std::format!(
            "| {name} | ≤ {} | {} | {}.{} % |",
            size::RECEIVE_INSTRUCTIONS,
            size::RECEIVE_INSTRUCTIONS + size::RECEIVE_OVERHEAD,
            share / 10,
            share % 10
        );
        assert_eq!(row(&page[heading..], &std::format!("| {name} |")), wanted);
    }
    for (name, joints) in [("six", 6), ("seven", 7)] {
        let bytes = size::sample(joints) + size::full_torque(joints);
        let share = size::receive_permille(bytes, 1000);
        let sums = std::format!(
            "({} + {}) × {}",
            size::sample(joints),
            size::full_torque(joints),
            size::RECEIVE_INSTRUCTIONS + size::RECEIVE_OVERHEAD
        );
        let told = std::format!("{}.{} %", share / 10, share % 10);
        assert!(
            page.contains(&sums) && page.contains(&told),
            "{name}: {sums}, {told}"
        );
    }
    let heading = page.find("| bit | field |").unwrap();
    for field in Field::ALL {
        let line = row(&page[heading..], &std::format!("| {} | ", field as u8));
        let ends = std::format!("| {} |", field.bytes(6));
        assert!(line.ends_with(&ends), "{line}: {ends}");
    }
    for (name, resolution, range) in [
        ("position", Position::RESOLUTION, Position::MAX),
        ("velocity", Velocity::RESOLUTION, Velocity::MAX),
        ("acceleration", Acceleration::RESOLUTION, Acceleration::MAX),
        ("effort", Effort::RESOLUTION, Effort::MAX),
    ] {
        let exponent = (1.0 / resolution).log2() as u32;
        let wanted = std::format!("| {name} | 2^-{exponent} | ±{} |", range.round());
        assert!(
            row(page, &std::format!("| {name} |")).starts_with(&wanted),
            "{wanted}"
        );
    }
    assert!(page.contains(&std::format!("protocol version {PROTOCOL_VERSION}")));
}
