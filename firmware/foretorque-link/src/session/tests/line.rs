use super::*;
use crate::wire::encode_as;
use foretorque::feedforward::{FeedForwardScratch, step};
use proptest::prelude::*;

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

/// Damage to one frame on the link.
#[derive(Clone, Debug)]
enum Damage {
    None,
    Flip(prop::sample::Index, u32),
    Cut(prop::sample::Index),
    Twice,
    Garbage(Vec<u8>),
    Lost,
}

fn damage() -> impl Strategy<Value = Damage> {
    prop_oneof![
        4 => Just(Damage::None),
        1 => (any::<prop::sample::Index>(), 0..8u32).prop_map(|(place, bit)| Damage::Flip(place, bit)),
        1 => any::<prop::sample::Index>().prop_map(Damage::Cut),
        1 => Just(Damage::Twice),
        1 => prop::collection::vec(any::<u8>(), 1..300).prop_map(Damage::Garbage),
        1 => Just(Damage::Lost),
    ]
}

impl Damage {
    /// The bytes that arrive of a frame, and the frames that this can cost.
    fn apply(&self, good: &[u8]) -> (Vec<u8>, usize) {
        match self {
            Self::None => (good.to_vec(), 0),
            Self::Twice => ([good, good].concat(), 0),
            Self::Lost => (Vec::new(), 1),
            Self::Garbage(bytes) => ([bytes, good].concat(), 1),
            // A frame that is not whole may take the next one with it.
            Self::Cut(place) => (good[..place.index(good.len())].to_vec(), 2),
            Self::Flip(place, bit) => {
                let mut bad = good.to_vec();
                bad[place.index(good.len())] ^= 1 << bit;
                (bad, 2)
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// A wrong torque is one that differs from that of a board which received the accepted frames only.
    #[test]
    fn no_wrong_torque_leaves_a_bad_link(damages in prop::collection::vec(damage(), 1..60)) {
        let (mut damaged, mut reference) = (Board::new(), Board::new());
        damaged.arm();
        reference.arm();
        let (mut cost, mut accepted, mut sent) = (0, 0, Vec::new());
        let first = damaged.sequence + 1;
        for (k, damage) in damages.iter().enumerate() {
            sent.push(frame(first + k as u16, &sample_message(k as u32)));
            let (line, frames) = damage.apply(&sent[k]);
            cost += frames;
            for (number, reply) in damaged.receive(&line) {
                // A frame that lacks its delimiter is whole with the next one.
                let good = &sent[usize::from(number - first)];
                prop_assert_eq!(&reference.receive(good), &[(number, reply)]);
                accepted += 1;
            }
            damaged.learn();
            reference.learn();
        }
        prop_assert!(accepted + cost >= damages.len(), "{} accepted", accepted);
        prop_assert!(accepted <= damages.len());
    }

    #[test]
    fn no_bytes_can_make_a_session_panic(
        bytes in prop::collection::vec(any::<u8>(), 0..2000),
        words in prop::collection::vec((any::<u8>(), any::<u16>(), any::<u32>()), 0..40),
    ) {
        let mut board = Board::new();
        board.receive(&bytes);
        for (kind, offset, crc) in words {
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
            board.send(&message);
            board.learn();
        }
        let feed_forward = board.session.feed_forward();
        let (config, mut state) = (*feed_forward.config(), *feed_forward.state());
        let last = *step::<Ur5, N, P>(&config, &mut state, &mut FeedForwardScratch::new(), &sample(0));
        prop_assert!(last.total.iter().all(|tau| tau.is_finite()));
    }
}
