use super::*;
use crate::wire::{Field, TelemetryFrame, size};

const ALL: u16 = (1 << Field::ALL.len()) - 1;

/// Capacity of a serial line of 2 Mbaud, bytes a second.
const LINE: u32 = 200_000;

/// A board whose line has this capacity, and what it says in `ticks` ticks: telemetry, and the most bytes in one tick.
fn streamed(bytes_s: u32, fields: u16, every: u16, ticks: u32) -> (Vec<TelemetryFrame>, usize) {
    let mut board = Board::described(BoardDescription {
        link_bytes_s: bytes_s,
        ..BoardDescription::plain(NoClock)
    });
    let answer = board.ask(HostMessage::Telemetry { fields, every });
    assert_eq!(answer, BoardMessage::Ack);
    let (mut frames, mut most) = (Vec::new(), 0);
    for k in 0..ticks {
        let mut out = FrameBuffer::new();
        board.sequence += 1;
        let line = frame(board.sequence, &sample_message(k));
        board
            .session
            .receive(&line, &mut board.mailboxes, &mut out, &mut NoLocalSensor);
        most = most.max(out.as_bytes().len());
        for (sequence, message) in heard(out.as_bytes()) {
            if let BoardMessage::Telemetry(frame) = message {
                assert_eq!(sequence, 0, "unasked");
                frames.push(frame);
            }
        }
    }
    assert_eq!(
        board
            .session
            .statistics(&board.mailboxes.learner)
            .records_lost,
        0
    );
    (frames, most)
}

fn refused(bytes_s: u32, fields: u16, every: u16) -> u16 {
    let mut board = Board::described(BoardDescription {
        link_bytes_s: bytes_s,
        ..BoardDescription::plain(NoClock)
    });
    match board.ask(HostMessage::Telemetry { fields, every }) {
        BoardMessage::Nack(NackReason::Bandwidth { every }) => every,
        other => panic!("{other:?}"),
    }
}

#[test]
fn every_field_of_every_record_arrives_whole_and_in_its_own_tick() {
    let (frames, _) = streamed(LINE, ALL, 10, 200);
    for tick in (0..200).step_by(10) {
        let of_tick = frames.iter().filter(|frame| frame.tick == tick);
        let fields: Vec<Field> = of_tick
            .flat_map(|frame| frame.fields(N).map(|(field, _)| field))
            .collect();
        assert_eq!(fields, Field::ALL, "tick {tick}");
    }
    assert!(frames.iter().all(|frame| frame.tick.is_multiple_of(10)));
}

#[test]
fn telemetry_never_takes_more_than_the_line_has_left() {
    for every in [10, 50] {
        let (frames, most) = streamed(LINE, ALL, every, 100);
        assert!(!frames.is_empty());
        // 200 bytes a period, of which a reserve is never planned for.
        assert!(most <= 140, "{most}");
    }
    let (_, most) = streamed(LINE, Field::Total.bit(), 1, 100);
    assert_eq!(most, size::torque(N) + size::telemetry(4 * N));
}

#[test]
fn what_the_line_has_no_room_for_is_refused_with_what_it_has_room_for() {
    let every = refused(LINE, ALL, 1);
    assert!((2..=10).contains(&every), "{every}");
    streamed(LINE, ALL, every, 10);
    assert_eq!(refused(LINE, ALL, every - 1), every);
    assert_eq!(
        refused(50_000, Field::Total.bit(), 1000),
        0,
        "replies alone fill this line"
    );
}

#[test]
fn fields_say_what_the_replies_say() {
    let fields = Field::State.bit() | Field::Total.bit() | Field::MeasuredPosition.bit();
    let mut board = Board::new();
    board.arm();
    board.ask(HostMessage::Telemetry { fields, every: 1 });
    for k in 0..20 {
        board.sequence += 1;
        let answers = board.hear(&frame(board.sequence, &sample_message(k)));
        let [
            (_, BoardMessage::Torque(torque)),
            (0, BoardMessage::Telemetry(told)),
        ] = answers.as_slice()
        else {
            panic!("{answers:?}");
        };
        assert_eq!(told.tick, torque.tick);
        let parts: Vec<_> = told.fields(N).collect();
        let [(_, state), (_, total), (_, q)] = parts.as_slice() else {
            panic!("{parts:?}");
        };
        let [low, high] = torque.flags.to_le_bytes();
        let safety = torque.safety;
        assert_eq!(
            *state,
            [low, high, safety.state as u8, safety.reason.code()]
        );
        assert_eq!(*total, torque.total.map(f32::to_le_bytes).concat());
        let measured = SampleFrame::new(&sample(k)).sample(&[0.0; N]).measured;
        let measured: [f32; N] = measured.unwrap().q.into();
        assert_eq!(*q, measured.map(f32::to_le_bytes).concat());
    }
    board.ask(HostMessage::Telemetry {
        fields: 0,
        every: 1,
    });
    assert_eq!(
        board
            .hear(&frame(board.sequence + 1, &sample_message(0)))
            .len(),
        1
    );
}
