use super::*;
use crate::arm::ur5::Ur5;
use crate::edge::bank::BankError;
use crate::edge::wire::NackReason;
use crate::edge::wire::{CHUNK, CRC, Chunk, encode, encode_as};
use crate::feedforward::Torque;
use crate::joint::{JointMeasurement, JointSample, JointVector};
use crate::learning::{Learner, LearnerConfig};
use crate::limits::Flags;
use proptest::prelude::*;
use std::boxed::Box;
use std::vec::Vec;

const N: usize = 6;
const P: usize = 40;

/// A session with its desk and learner, as one board has them.
struct Board {
    session: Box<Session<Ur5, N, P>>,
    desk: Box<Desk<N, P>>,
    learner: Box<Learner<Ur5, N, P>>,
    sequence: u16,
}

impl Board {
    fn new() -> Self {
        let mut description = BoardDescription::plain(NoClock);
        description.capabilities = Capabilities::LEARNING | Capabilities::TIMER;
        let session = Session::new(description).unwrap();
        let set = session.feed_forward.state().active;
        Self {
            session: Box::new(session),
            desk: Box::default(),
            learner: Box::new(Learner::new(LearnerConfig::for_arm::<Ur5>(1e-3), set).unwrap()),
            sequence: 0,
        }
    }

    fn hear(&mut self, bytes: &[u8]) -> Vec<(u16, BoardMessage<N>)> {
        let mut out = FrameBuffer::new();
        self.session.receive(bytes, &mut self.desk, &mut out);
        heard(out.as_bytes())
    }

    fn ask(&mut self, message: HostMessage<N>) -> BoardMessage<N> {
        self.sequence += 1;
        let answers = self.hear(&frame(self.sequence, &message));
        let [(sequence, answer)] = answers.as_slice() else {
            panic!("{} answers", answers.len());
        };
        assert_eq!(*sequence, self.sequence);
        answer.clone()
    }

    fn timer(&mut self) -> Vec<(u16, BoardMessage<N>)> {
        let mut out = FrameBuffer::new();
        self.session.timer_tick(&mut self.desk, &mut out);
        heard(out.as_bytes())
    }

    fn learn(&mut self) {
        self.desk.work(&mut self.learner, &NoClock);
    }

    fn read(&mut self) -> Vec<u8> {
        let mut bank = Vec::new();
        loop {
            let offset = bank.len() as u16;
            match self.ask(HostMessage::BankRead { offset }) {
                BoardMessage::BankChunk { bytes, length, .. } => {
                    bank.extend(bytes);
                    if bank.len() == usize::from(length) {
                        return bank;
                    }
                }
                other => panic!("{other:?}"),
            }
        }
    }

    fn write(&mut self, bank: &[u8]) {
        for (place, piece) in bank.chunks(CHUNK).enumerate() {
            let bytes: Chunk = piece.iter().copied().collect();
            let offset = (place * CHUNK) as u16;
            let answer = self.ask(HostMessage::BankWrite { offset, bytes });
            assert_eq!(answer, BoardMessage::Ack);
        }
    }

    fn commit(&mut self, bank: &[u8]) -> BoardMessage<N> {
        self.ask(HostMessage::BankCommit {
            length: bank.len() as u16,
            crc: CRC.checksum(bank),
        })
    }
}

fn frame(sequence: u16, message: &HostMessage<N>) -> Vec<u8> {
    encode(sequence, message, &mut [0; 300]).unwrap().to_vec()
}

fn heard(bytes: &[u8]) -> Vec<(u16, BoardMessage<N>)> {
    let mut decoder = Decoder::new();
    let mut messages = Vec::new();
    for &byte in bytes {
        if let Some(frame) = decoder.push(byte) {
            let frame = frame.unwrap();
            messages.push((frame.sequence, frame.message().unwrap()));
        }
    }
    messages
}

fn sample(k: u32) -> JointSample<N> {
    let t = k as f32 * 1e-2;
    JointSample {
        desired: JointMotion {
            q: JointVector::from_fn(|j, _| (t + j as f32).sin()),
            qd: JointVector::from_fn(|j, _| (t + j as f32).cos()),
            qdd: JointVector::from_fn(|j, _| -(t + j as f32).sin()),
        },
        measured: Some(JointMeasurement {
            q: JointVector::from_fn(|j, _| (t + j as f32).sin()),
            tau: JointVector::<N>::repeat(2.0),
        }),
    }
}

fn sample_message(k: u32) -> HostMessage<N> {
    HostMessage::Sample(SampleFrame::new(&sample(k)))
}

fn uploaded() -> Vec<u8> {
    let mut bank = ParameterBank::nominal::<Ur5, N, P>();
    bank.columns[0].value += 1.0;
    bank.drive_gains_nm_a.fill(10.0);
    let mut room = [0; ParameterBank::MAX_BYTES];
    bank.encode(&mut room).unwrap().to_vec()
}

#[test]
fn an_upload_takes_effect_whole_for_tick_fallback_and_learner() {
    let mut board = Board::new();
    let bank = uploaded();
    board.write(&bank);
    let before = board.session.feed_forward.state().active;
    assert_eq!(board.commit(&bank), BoardMessage::Ack);
    let state = *board.session.feed_forward.state();
    assert_ne!(state.active, before);
    assert_eq!(state.committed, state.active);
    board.ask(sample_message(0));
    board.learn();
    assert_eq!(board.learner.state().prior, state.active);
    assert_eq!(board.session.gains, [10.0; N]);
    assert_eq!(board.read(), bank);
}

#[test]
fn an_upload_that_breaks_off_changes_nothing_and_can_begin_anew() {
    let mut board = Board::new();
    let (before, bank) = (board.read(), uploaded());
    board.write(&bank[..3 * CHUNK]);
    assert_eq!(
        board.commit(&bank),
        BoardMessage::Nack(NackReason::Checksum)
    );
    assert_eq!(board.read(), before);
    board.write(&bank[..5 * CHUNK]);
    board.write(&bank);
    assert_eq!(board.commit(&bank), BoardMessage::Ack);
    assert_eq!(board.read(), bank);
}

#[test]
fn a_missing_piece_is_named_and_a_repeated_one_harmless() {
    let mut board = Board::new();
    let bank = uploaded();
    board.write(&bank[..2 * CHUNK]);
    let piece = |place: usize| HostMessage::BankWrite {
        offset: (place * CHUNK) as u16,
        bytes: bank[place * CHUNK..][..CHUNK].iter().copied().collect(),
    };
    let gap = NackReason::Gap { expected: 128 };
    assert_eq!(board.ask(piece(3)), BoardMessage::Nack(gap));
    assert_eq!(board.ask(piece(1)), BoardMessage::Ack);
    assert_eq!(board.ask(piece(2)), BoardMessage::Ack);
}

#[test]
fn a_damaged_or_endless_bank_is_refused() {
    let mut board = Board::new();
    let before = board.read();
    let mut bank = uploaded();
    bank[40] ^= 1;
    board.write(&bank);
    let refused = BoardMessage::Nack(NackReason::Bank(BankError::Checksum));
    assert_eq!(board.commit(&bank), refused);
    let full = [1; ParameterBank::MAX_BYTES / CHUNK * CHUNK];
    board.write(&full);
    let bytes: Chunk = [1; CHUNK].into_iter().collect();
    let beyond = HostMessage::BankWrite {
        offset: full.len() as u16,
        bytes,
    };
    assert_eq!(board.ask(beyond), BoardMessage::Nack(NackReason::TooLong));
    assert_eq!(board.read(), before);
}

#[test]
fn currents_count_by_the_drive_gain_once_it_is_known() {
    let frame = SampleFrame::new(&sample(0)).with_current(&JointVector::<N>::repeat(0.5));
    assert_eq!(frame.sample(&[0.0; N]).measured, None);
    let measured = frame.sample(&[10.0; N]).measured.unwrap();
    assert_eq!(measured.tau, JointVector::<N>::repeat(5.0));
}

#[test]
fn the_timer_runs_the_newest_sample_once_and_then_none() {
    let mut board = Board::new();
    let timer = HostMessage::Configure(Configuration {
        pacing: Pacing::SysTick,
        ..Configuration::default()
    });
    assert_eq!(board.ask(timer), BoardMessage::Ack);
    assert!(board.hear(&frame(2, &sample_message(0))).is_empty());
    assert!(board.hear(&frame(3, &sample_message(1))).is_empty());
    let flags = |answers: Vec<(u16, BoardMessage<N>)>| match answers.as_slice() {
        [(sequence, BoardMessage::Torque(torque))] => (*sequence, torque.tick, Flags(torque.flags)),
        other => panic!("{other:?}"),
    };
    let (sequence, tick, first) = flags(board.timer());
    assert_eq!((sequence, tick), (3, 0));
    assert!(!first.contains(Flags::NO_MEASUREMENT));
    let (sequence, tick, second) = flags(board.timer());
    assert_eq!((sequence, tick), (3, 1));
    assert!(second.contains(Flags::NO_MEASUREMENT));
    let statistics = board.session.statistics(&board.desk);
    assert_eq!((statistics.overtaken, statistics.stale_ticks), (1, 1));
}

#[test]
fn the_timer_does_nothing_where_the_link_paces() {
    let mut board = Board::new();
    assert!(board.timer().is_empty());
    assert_eq!(board.session.statistics(&board.desk).ticks, 0);
}

#[test]
fn every_constant_follows_the_period() {
    let mut board = Board::new();
    let slow = HostMessage::Configure(Configuration {
        period_us: 4000,
        ..Configuration::default()
    });
    assert_eq!(board.ask(slow), BoardMessage::Ack);
    let bank = ParameterBank::nominal::<Ur5, N, P>();
    let wanted = bank.feed_forward_config::<Ur5, N, P>(4e-3).unwrap();
    assert_eq!(*board.session.feed_forward.config(), wanted);
    // The learner starts over too: a round is closed and published from its new tick 0.
    for k in 0..6 {
        board.ask(sample_message(k));
        board.learn();
    }
    assert_eq!(board.learner.state().statistics.published, 1);
}

#[test]
fn learnt_sets_do_not_depend_on_how_late_the_learner_is_within_its_time() {
    let run = |delay: u32| -> Vec<BoardMessage<N>> {
        let mut board = Board::new();
        board.ask(HostMessage::Learning { on: true });
        (0..400)
            .map(|k| {
                let answer = board.ask(sample_message(k));
                // The last tick of a round, N - 1, is due N / 2 ticks later.
                if k % (delay + 1) == delay {
                    board.learn();
                }
                answer
            })
            .collect()
    };
    let prompt = run(0);
    assert_eq!(run(2), prompt);
    let flags = prompt.iter().filter_map(|answer| match answer {
        BoardMessage::Torque(torque) => Some(Flags(torque.flags)),
        _ => None,
    });
    let adopted = flags
        .filter(|flags| flags.contains(Flags::SET_ADOPTED))
        .count();
    assert!(adopted > 60, "{adopted}");
}

#[test]
fn a_set_learnt_before_a_restart_never_meets_the_ticks_after_it() {
    let mut board = Board::new();
    board.ask(HostMessage::Learning { on: true });
    for k in 0..5 {
        board.ask(sample_message(k));
        board.learn();
    }
    board.ask(sample_message(5));
    let lesson = board.desk.begin(&mut board.learner).unwrap();
    board.learner.study(&lesson);
    // The tick interrupts the learner here, at the end of a round.
    board.ask(HostMessage::Learning { on: false });
    assert_eq!(board.ask(HostMessage::Reset), BoardMessage::Ack);
    board.desk.finish(&mut board.learner, 0);
    assert_eq!(board.desk.exchange.published, None);
}

#[test]
fn a_host_of_another_version_is_told_who_is_here() {
    let mut board = Board::new();
    let mut room = [0; 300];
    let foreign = encode_as(9, 77, &HostMessage::<N>::Hello, &mut room).unwrap();
    let answers = board.hear(foreign);
    assert!(matches!(answers.as_slice(), [(0, BoardMessage::Hello(_))]));
    assert_eq!(board.session.statistics(&board.desk).foreign_version, 1);
}

#[test]
fn answers_that_find_no_room_are_counted_and_the_rest_is_whole() {
    let mut board = Board::new();
    let flood: Vec<u8> = (1..=40)
        .flat_map(|k| frame(k, &HostMessage::Statistics))
        .collect();
    let answers = board.hear(&flood);
    let lost = board.session.statistics(&board.desk).replies_lost;
    assert_eq!(answers.len() + lost as usize, 40);
    assert!(lost > 0);
}

#[test]
fn a_sample_that_is_not_a_number_gives_a_finite_torque() {
    let mut board = Board::new();
    let mut broken = sample(0);
    broken.desired.q[2] = f32::NAN;
    let answer = board.ask(HostMessage::Sample(SampleFrame::new(&broken)));
    let BoardMessage::Torque(torque) = answer else {
        panic!("{answer:?}");
    };
    assert!(torque.total.iter().all(|tau| tau.is_finite()));
    assert!(Flags(torque.flags).contains(Flags::NOT_FINITE));
}

/// What happens to one frame on a bad line.
#[derive(Clone, Debug)]
enum Harm {
    Unharmed,
    Flip(prop::sample::Index, u32),
    Cut(prop::sample::Index),
    Twice,
    Garbage(Vec<u8>),
    Lost,
}

fn harm() -> impl Strategy<Value = Harm> {
    prop_oneof![
        4 => Just(Harm::Unharmed),
        1 => (any::<prop::sample::Index>(), 0..8u32).prop_map(|(place, bit)| Harm::Flip(place, bit)),
        1 => any::<prop::sample::Index>().prop_map(Harm::Cut),
        1 => Just(Harm::Twice),
        1 => prop::collection::vec(any::<u8>(), 1..300).prop_map(Harm::Garbage),
        1 => Just(Harm::Lost),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// A wrong torque is one that differs from that of a board which heard the accepted frames only.
    #[test]
    fn no_wrong_torque_leaves_a_bad_line(harms in prop::collection::vec(harm(), 1..60)) {
        let (mut harmed, mut reference) = (Board::new(), Board::new());
        let mut harmful = 0;
        let mut accepted = 0;
        for (k, harm) in harms.iter().enumerate() {
            let sequence = k as u16 + 1;
            let good = frame(sequence, &sample_message(k as u32));
            let line = match harm {
                Harm::Unharmed => good.clone(),
                Harm::Flip(place, bit) => {
                    let mut bad = good.clone();
                    bad[place.index(good.len())] ^= 1 << bit;
                    bad
                }
                Harm::Cut(place) => good[..place.index(good.len())].to_vec(),
                Harm::Twice => [good.clone(), good.clone()].concat(),
                Harm::Garbage(bytes) => [bytes.clone(), good.clone()].concat(),
                Harm::Lost => Vec::new(),
            };
            // Every frame that is not whole may take the one behind it along.
            harmful += match harm {
                Harm::Unharmed | Harm::Twice => 0,
                Harm::Lost | Harm::Garbage(_) => 1,
                Harm::Flip(..) | Harm::Cut(_) => 2,
            };
            for (answered, answer) in harmed.hear(&line) {
                prop_assert_eq!(answered, sequence);
                let wanted = reference.hear(&frame(sequence, &sample_message(k as u32)));
                prop_assert_eq!(&wanted, &[(answered, answer)]);
                accepted += 1;
            }
            harmed.learn();
            reference.learn();
        }
        prop_assert!(accepted + harmful >= harms.len(), "{} accepted", accepted);
        prop_assert!(accepted <= harms.len());
    }

    #[test]
    fn no_bytes_can_make_a_session_panic(
        bytes in prop::collection::vec(any::<u8>(), 0..2000),
        words in prop::collection::vec((any::<u8>(), any::<u16>(), any::<u32>()), 0..40),
    ) {
        let mut board = Board::new();
        board.hear(&bytes);
        for (kind, offset, crc) in words {
            board.sequence = board.sequence.wrapping_add(1);
            let message = match kind % 8 {
                0 => HostMessage::BankRead { offset },
                1 => HostMessage::BankCommit { length: offset, crc },
                2 => HostMessage::BankWrite { offset, bytes: [kind; 9].into_iter().collect() },
                3 => HostMessage::Configure(Configuration { period_us: crc, ..Configuration::default() }),
                4 => HostMessage::Learning { on: crc % 2 == 0 },
                5 => HostMessage::Reset,
                6 => HostMessage::Evaluate((&JointMotion {
                    q: JointVector::<N>::repeat(f32::from_bits(crc)),
                    qd: JointVector::<N>::repeat(f32::from_bits(!crc)),
                    qdd: JointVector::<N>::repeat(f32::from_bits(crc.rotate_left(9))),
                }).into()),
                _ => sample_message(crc),
            };
            board.hear(&frame(board.sequence, &message));
            board.learn();
        }
        let last: Torque<N> = board.session.feed_forward.step(&sample(0));
        prop_assert!(last.total.iter().all(|tau| tau.is_finite()));
    }
}
