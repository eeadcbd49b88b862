use super::*;
use crate::wire::size::{self, LinkCapacity};
use crate::wire::{Field, MAX_FRAME, TelemetryFrame, encode_as};

#[test]
fn a_host_of_another_version_receives_the_hello() {
    let mut board = Board::new();
    let mut buffer = [0; 300];
    let foreign = encode_as(9, 77, &HostMessage::<N>::Hello, &mut buffer).unwrap();
    let replies = board.receive(foreign);
    assert!(matches!(replies.as_slice(), [(0, BoardMessage::Hello(_))]));
    assert_eq!(board.statistics().foreign_version, 1);
}

#[test]
fn replies_beyond_the_buffer_are_counted_and_the_rest_is_whole() {
    let mut board = Board::new();
    let flood: Vec<u8> = (1..=40)
        .flat_map(|k| frame(k, &HostMessage::Statistics))
        .collect();
    let replies = board.receive(&flood);
    let lost = board.statistics().replies_lost;
    assert_eq!(replies.len() + lost as usize, 40);
    assert!(lost > 0);
}

const ALL: u16 = (1 << Field::ALL.len()) - 1;

/// A serial line of 2 Mbaud.
const LINE: LinkCapacity = LinkCapacity::stream(200_000);

fn connected(link: LinkCapacity) -> Board {
    Board::with(|board| board.link = link)
}

/// Telemetry of `ticks` ticks, and the most bytes in one of them.
fn streamed(
    link: LinkCapacity,
    fields: u16,
    every: u16,
    ticks: u32,
) -> (Vec<TelemetryFrame>, usize) {
    let mut board = connected(link);
    board.acknowledged(HostMessage::Telemetry { fields, every });
    let (mut frames, mut most) = (Vec::new(), 0);
    for k in 0..ticks {
        let mut bytes = 0;
        for (sequence, message) in board.send(&sample_message(k)) {
            bytes += encode(sequence, &message, &mut [0; 300]).unwrap().len();
            if let BoardMessage::Telemetry(frame) = message {
                assert_eq!(sequence, 0, "unasked");
                frames.push(frame);
            }
        }
        most = most.max(bytes);
    }
    assert_eq!(board.statistics().records_lost, 0);
    (frames, most)
}

fn refused(link: LinkCapacity, fields: u16, every: u16) -> u16 {
    match connected(link).request(HostMessage::Telemetry { fields, every }) {
        BoardMessage::Nack(NackReason::Bandwidth { every }) => every,
        other => panic!("{other:?}"),
    }
}

#[test]
fn every_field_of_a_record_arrives_with_its_tick() {
    for link in [LINE, LinkCapacity::UNLIMITED] {
        let (frames, _) = streamed(link, ALL, 10, 200);
        for tick in (0..200).step_by(10) {
            let of_tick = frames.iter().filter(|frame| frame.tick == tick);
            let fields: Vec<Field> = of_tick
                .flat_map(|frame| frame.fields(N).map(|(field, _)| field))
                .collect();
            assert_eq!(fields, Field::ALL, "tick {tick}");
        }
        assert!(frames.iter().all(|frame| frame.tick.is_multiple_of(10)));
        let size = |frame: &TelemetryFrame| size::telemetry(frame.bytes.len());
        assert!(frames.iter().all(|frame| size(frame) <= MAX_FRAME));
    }
}

#[test]
fn telemetry_never_exceeds_what_the_link_has_left() {
    for every in [10, 50] {
        let (frames, most) = streamed(LINE, ALL, every, 100);
        assert!(!frames.is_empty());
        // 200 bytes a period, less the reserve.
        assert!(most <= 140, "{most}");
    }
    let (_, most) = streamed(LINE, Field::Total.bit(), 1, 100);
    assert_eq!(most, size::torque(N) + size::telemetry(4 * N));
}

#[test]
fn too_much_is_refused_with_the_smallest_interval() {
    let every = refused(LINE, ALL, 1);
    assert!((2..=10).contains(&every), "{every}");
    streamed(LINE, ALL, every, 10);
    assert_eq!(refused(LINE, ALL, every - 1), every);
    // Replies alone fill this line.
    let slow = LinkCapacity::stream(50_000);
    assert_eq!(refused(slow, Field::Total.bit(), 1000), 0);
}

#[test]
fn fields_equal_the_values_of_the_replies() {
    let fields = Field::State.bit() | Field::Total.bit() | Field::MeasuredPosition.bit();
    let mut board = Board::new();
    board.arm();
    board.acknowledged(HostMessage::Telemetry { fields, every: 1 });
    for k in 0..20 {
        let replies = board.send(&sample_message(k));
        let [(_, reply), (0, BoardMessage::Telemetry(telemetry))] = replies.as_slice() else {
            panic!("{replies:?}");
        };
        let torque = torque(reply);
        assert_eq!(telemetry.tick, torque.tick);
        let [low, high] = torque.flags.to_le_bytes();
        let safety = torque.safety;
        let measured = SampleFrame::new(&sample(k)).sample(&[0.0; N]).measured;
        let measured: [f32; N] = measured.unwrap().q.into();
        let expected = [
            &[low, high, safety.state as u8, safety.reason.code()][..],
            &torque.total.map(f32::to_le_bytes).concat(),
            &measured.map(f32::to_le_bytes).concat(),
        ];
        let parts: Vec<_> = telemetry.fields(N).map(|(_, bytes)| bytes).collect();
        assert_eq!(parts, expected);
    }
    let none = HostMessage::Telemetry {
        fields: 0,
        every: 0,
    };
    board.acknowledged(none.clone());
    assert_eq!(board.send(&sample_message(0)).len(), 1);
    // No fields always fit, and so do bits without a field.
    let mut slow = connected(LinkCapacity::stream(50_000));
    slow.acknowledged(none);
    let (fields, every) = (!ALL, 0);
    slow.acknowledged(HostMessage::Telemetry { fields, every });
}

/// A record without space is counted once.
#[test]
fn records_that_are_not_sent_whole_are_counted() {
    let mut board = Board::new();
    let every = 1;
    board.acknowledged(HostMessage::Telemetry { fields: ALL, every });
    let frame = board.numbered(&sample_message(0));
    board.output(|session, mailboxes, out| {
        while out.push(0, &ACK).is_ok() {}
        session.receive(&frame, mailboxes, out, &mut NoLocalSensor);
    });
    let statistics = board.statistics();
    assert_eq!((statistics.records_lost, statistics.replies_lost), (1, 1));
    assert_eq!(board.send(&sample_message(1)).len(), 3);
}
