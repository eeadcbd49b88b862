//! Any message, with any values in it: NaN, infinities and denormals too.

use super::*;
use crate::bank::BankError;
use crate::excitation::{AbortReason, ExcitationCommand, ExcitationError, ExcitationState};
use crate::safety::{SafetyReason, SafetyState, SafetyStatus};
use crate::store::StoreError;
use core::fmt::Debug;
use proptest::prelude::*;
use proptest::sample::select;
use std::vec;

pub(super) fn bytes(most: usize) -> impl Strategy<Value = Vec<u8>> {
    prop::collection::vec(any::<u8>(), 0..=most)
}

/// A message of this tag with `length` arbitrary bytes, of which `make_valid` restricts those of enumerations.
fn fixed<M: DeserializeOwned + Debug>(
    tag: u8,
    length: usize,
    make_valid: fn(&mut [u8]),
) -> impl Strategy<Value = M> {
    prop::collection::vec(any::<u8>(), length).prop_map(move |mut content| {
        make_valid(&mut content);
        content.insert(0, tag);
        postcard::from_bytes(&content).unwrap()
    })
}

fn chunk() -> impl Strategy<Value = Chunk> {
    bytes(CHUNK).prop_map(|bytes| bytes.into_iter().collect())
}

fn name() -> impl Strategy<Value = Name> {
    "[ -~]{0,24}".prop_map(|text| text.parse().unwrap())
}

fn configuration() -> impl Strategy<Value = Configuration> {
    let pacing = select(vec![Pacing::Link, Pacing::SysTick]);
    let reply = select(vec![ReplyMode::Decimated, ReplyMode::Full]);
    let numbers = (any::<u32>(), any::<u16>());
    (numbers, pacing, reply).prop_map(|((period_us, brake_close_ms), pacing, reply)| {
        Configuration {
            period_us,
            pacing,
            reply,
            brake_close_ms,
        }
    })
}

pub(super) fn host_message() -> impl Strategy<Value = HostMessage<N>> {
    use HostMessage as M;
    let upload = || (any::<u16>(), any::<u32>(), any::<Option<[u8; MAC_BYTES]>>());
    let sources = select(vec![
        BankSource::Live,
        BankSource::Committed,
        BankSource::Stored,
    ]);
    prop_oneof![
        select(vec![
            M::Hello,
            M::Learning { on: false },
            M::Learning { on: true },
            M::Statistics,
            M::Reset,
            M::Arm,
            M::Disarm,
            M::Stop,
            M::ClearFault,
            M::Save,
            M::Restore,
            M::Challenge,
            M::Reboot,
            M::Excitation(ExcitationCommand::Status),
            M::Excitation(ExcitationCommand::Start),
            M::Excitation(ExcitationCommand::Stop),
            M::Excitation(ExcitationCommand::Release),
        ]),
        fixed(1, 2 + 14 * N, |_| ()),
        fixed(2, 12 * N, |_| ()),
        configuration().prop_map(M::Configure),
        (any::<u16>(), chunk()).prop_map(|(offset, bytes)| M::BankWrite { offset, bytes }),
        upload().prop_map(|(length, crc, mac)| M::BankCommit { length, crc, mac }),
        (sources, any::<u16>()).prop_map(|(source, offset)| M::BankRead { source, offset }),
        fixed(14, 1, |_| ()),
        fixed(17, 4, |_| ()),
        fixed(22, 18, |_| ()),
        upload().prop_map(|(length, crc, mac)| M::ExcitationLoad { length, crc, mac }),
    ]
}

/// Makes state and reason at the front of `content` valid.
fn safety(content: &mut [u8]) {
    content[0] %= 4;
    content[1] %= SafetyReason::ALL.len() as u8;
}

fn nack() -> impl Strategy<Value = NackReason> {
    use NackReason as R;
    prop_oneof![
        select(vec![
            R::LearningOn,
            R::NotCapable,
            R::Period,
            R::TooLong,
            R::Checksum,
            R::Armed,
            R::Busy,
            R::Key,
        ]),
        any::<u16>().prop_map(|expected| R::Gap { expected }),
        any::<u32>().prop_map(|found| R::Bank(BankError::WrongArm { found })),
        any::<u16>().prop_map(|place| R::Bank(BankError::Weight(place))),
        select(SafetyReason::ALL.to_vec()).prop_map(R::Unsafe),
        any::<u32>().prop_map(|found| R::Store(StoreError::WrongArm { found })),
        any::<u16>().prop_map(|place| R::Store(StoreError::Bank(BankError::Weight(place)))),
        any::<u16>().prop_map(|every| R::Bandwidth { every }),
        any::<u8>().prop_map(|j| R::Excitation(ExcitationError::NotAtRest(j))),
    ]
}

fn excitation() -> impl Strategy<Value = ExcitationState> {
    prop_oneof![
        select(vec![ExcitationState::Empty, ExcitationState::Playing]),
        any::<u8>().prop_map(|j| ExcitationState::Refused(ExcitationError::CertificateBroken(j))),
        any::<u8>().prop_map(|j| ExcitationState::Aborted(AbortReason::Tracking(j))),
    ]
}

fn hello() -> impl Strategy<Value = BoardHello> {
    let numbers = (any::<[u32; 3]>(), any::<[u8; 2]>(), any::<u16>());
    let states = select(vec![SafetyState::Disarmed, SafetyState::Fault]);
    let safety = (states, select(SafetyReason::ALL.to_vec()));
    (numbers, name(), name(), configuration(), safety).prop_map(
        |(
            ([arm_hash, counter_hz, boot_counts], counts, bits),
            arm,
            firmware,
            c,
            (state, reason),
        )| {
            BoardHello {
                arm_hash,
                arm,
                joints: counts[0],
                base_columns: counts[1],
                firmware,
                capabilities: Capabilities(bits),
                counter: CounterKind::Instructions,
                counter_hz,
                configuration: c,
                reset_reason: ResetReason::Fault,
                safety: SafetyStatus { state, reason },
                boot_counts,
                chip: ChipStatus::VIRTUAL,
            }
        },
    )
}

pub(super) fn board_message() -> impl Strategy<Value = BoardMessage<N>> {
    use BoardMessage as M;
    /// Content of a torque with the shares of one joint.
    const TORQUE: usize = 8 + 4 * N + 12;
    prop_oneof![
        hello().prop_map(M::Hello),
        fixed(1, TORQUE, |content| safety(&mut content[6..])),
        fixed(2, 8 + 16 * N, |content| safety(&mut content[4..])),
        fixed(3, 2 + 16 * N, |_| ()),
        Just(M::Ack),
        nack().prop_map(M::Nack),
        (any::<[u16; 2]>(), chunk()).prop_map(|([offset, length], bytes)| M::BankChunk {
            offset,
            length,
            bytes,
        }),
        fixed(7, 106, |content| content[105] %= 5),
        (any::<u32>(), any::<u16>(), bytes(TELEMETRY_BYTES)).prop_map(|(tick, fields, bytes)| {
            let bytes = bytes.into_iter().collect();
            M::Telemetry(TelemetryFrame {
                tick,
                fields,
                bytes,
            })
        }),
        fixed(9, MAC_BYTES, |_| ()),
        excitation().prop_map(M::Excitation),
        fixed(11, TORQUE + 1 + 8 * N, |content| {
            safety(&mut content[6..]);
            content[TORQUE] = [0, 1, 2, 4, 5, 6, 7][usize::from(content[TORQUE] % 7)];
        }),
        // Aborted, for tracking.
        fixed(11, TORQUE + 3 + 8 * N, |content| {
            safety(&mut content[6..]);
            content[TORQUE..][..2].copy_from_slice(&[8, 3]);
        }),
    ]
}
