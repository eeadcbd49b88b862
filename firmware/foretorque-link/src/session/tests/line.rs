use super::*;
use crate::wire::encode_as;
use foretorque::feedforward::{FeedForwardScratch, step};
use proptest::prelude::*;

#[test]
fn a_host_of_another_version_is_told_who_is_here() {
    let mut board = Board::new();
    let mut room = [0; 300];
    let foreign = encode_as(9, 77, &HostMessage::<N>::Hello, &mut room).unwrap();
    let answers = board.hear(foreign);
    assert!(matches!(answers.as_slice(), [(0, BoardMessage::Hello(_))]));
    assert_eq!(
        board
            .session
            .statistics(&board.mailboxes.learner)
            .foreign_version,
        1
    );
}

#[test]
fn answers_that_find_no_room_are_counted_and_the_rest_is_whole() {
    let mut board = Board::new();
    let flood: Vec<u8> = (1..=40)
        .flat_map(|k| frame(k, &HostMessage::Statistics))
        .collect();
    let answers = board.hear(&flood);
    let lost = board
        .session
        .statistics(&board.mailboxes.learner)
        .replies_lost;
    assert_eq!(answers.len() + lost as usize, 40);
    assert!(lost > 0);
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
        harmed.arm();
        reference.arm();
        let mut harmful = 0;
        let mut accepted = 0;
        for (k, harm) in harms.iter().enumerate() {
            let sequence = harmed.sequence + k as u16 + 1;
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
                0 => HostMessage::BankRead { source: BankSource::Live, offset },
                1 => HostMessage::BankCommit { length: offset, crc, mac: None },
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
        let feed_forward = board.session.feed_forward();
        let (config, mut state) = (*feed_forward.config(), *feed_forward.state());
        let last = step::<Ur5, N, P>(&config, &mut state, &mut FeedForwardScratch::new(), &sample(0));
        prop_assert!(last.total.iter().all(|tau| tau.is_finite()));
    }
}
