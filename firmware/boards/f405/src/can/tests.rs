//! The driver on a model of bxCAN: start, frames there and back, order, overrun, faults.

extern crate std;

use super::*;
use std::collections::VecDeque;
use std::vec::Vec;

/// bxCAN after RM0090: state machine, mailboxes in order of request, FIFO of three, filters.
#[derive(Default)]
struct Model {
    mcr: u32,
    btr: u32,
    filters: std::collections::BTreeMap<usize, u32>,
    mailboxes: [[u32; 4]; 3],
    /// Mailboxes in the order of their requests.
    pending: VecDeque<usize>,
    fifo: VecDeque<[u32; 4]>,
    overrun: bool,
    off: bool,
    /// INAK never comes, as in the emulator, or never goes, as on a dead bus.
    stuck: Option<u32>,
    polls: std::cell::Cell<u32>,
    second: bool,
}

impl Registers for Model {
    fn read(&self, offset: usize) -> u32 {
        match offset {
            offset::MSR => {
                self.polls.set(self.polls.get() + 1);
                self.stuck.unwrap_or(self.mcr & INRQ)
            }
            offset::TSR => (0..3)
                .filter(|mailbox| !self.pending.contains(mailbox))
                .fold(0, |bits, mailbox| bits | TME0 << mailbox),
            offset::RF0R => self.fifo.len() as u32 | if self.overrun { FOVR } else { 0 },
            offset::ESR if self.off => BOFF,
            offset::RI0R..=0x1bc => self
                .fifo
                .front()
                .map_or(0, |frame| frame[(offset - offset::RI0R) / 4]),
            _ => 0,
        }
    }

    fn write(&mut self, offset: usize, value: u32) {
        match offset {
            offset::MCR => self.mcr = value,
            // Only in initialisation.
            offset::BTR if self.mcr & INRQ != 0 => self.btr = value,
            offset::RF0R if value & RFOM != 0 => drop(self.fifo.pop_front()),
            offset::RF0R => self.overrun &= value & FOVR == 0,
            offset::TI0R..=0x1ac => {
                let place = (offset - offset::TI0R) / 4;
                let (mailbox, word) = (place / 4, place % 4);
                let waits = self.pending.contains(&mailbox);
                assert!(!waits, "a waiting mailbox is not written");
                self.mailboxes[mailbox][word] = value;
                if word == 0 && value & TXRQ != 0 {
                    // Without it the identifier decides the order.
                    assert_ne!(self.mcr & TXFP, 0);
                    self.pending.push_back(mailbox);
                }
            }
            offset::FMR..=0x37c => drop(self.filters.insert(offset, value)),
            _ => {}
        }
    }
}

impl Model {
    fn filter(&self, offset: usize) -> u32 {
        self.filters.get(&offset).copied().unwrap_or_default()
    }

    /// Takes a frame from the bus, through the filters of `can1`.
    fn hear(&mut self, [id, length, low, high]: [u32; 4], can1: &Self) {
        let bank = if self.second {
            can1.filter(offset::FMR) >> 8 & 0x3f
        } else {
            0
        };
        let open = can1.filter(offset::FMR) & FINIT == 0
            && can1.filter(offset::FA1R) >> bank & 1 == 1
            && can1.filter(offset::FS1R) >> bank & 1 == 1
            && can1.filter(offset::F0R1 + 8 * bank as usize + 4) == 0;
        if !open {
            return;
        }
        if self.fifo.len() == 3 {
            self.overrun = true;
            self.fifo[2] = [id, length, low, high];
        } else {
            self.fifo.push_back([id, length, low, high]);
        }
    }

    /// The next frame that goes to the bus.
    fn speak(&mut self) -> Option<[u32; 4]> {
        let [id, length, low, high] = self.mailboxes[self.pending.pop_front()?];
        Some([id & !TXRQ, length, low, high])
    }
}

const POLLS: u32 = 1000;

fn pair() -> (Bxcan<Model>, Bxcan<Model>) {
    let timing = timing(42_000_000, 1_000_000).unwrap();
    let mut first = Model::default();
    open_filters(&mut first);
    let second = Model {
        second: true,
        ..Model::default()
    };
    (
        Bxcan::start(first, timing, POLLS).unwrap(),
        Bxcan::start(second, timing, POLLS).unwrap(),
    )
}

#[test]
fn the_wait_of_the_start_is_bounded() {
    let stuck = |value| Model {
        stuck: Some(value),
        ..Model::default()
    };
    assert!(Bxcan::start(stuck(0), 0, POLLS).is_none());
    // A bus that is never idle is one that the controller has not joined.
    let outside = Bxcan::start(stuck(INAK), 0, POLLS).unwrap();
    assert!(outside.is_off());
    let (can, _) = pair();
    assert!(!can.is_off() && can.registers.polls.get() <= POLLS);
    // 42 MHz / 3 / (1 + 11 + 2).
    assert_eq!(can.registers.btr, 2 | 10 << 16 | 1 << 20);
}

#[test]
fn bit_rates_are_exact_or_refused() {
    for clock_hz in [16_000_000, 42_000_000] {
        for bit_s in [125_000, 250_000, 500_000, 1_000_000] {
            let btr = timing(clock_hz, bit_s).unwrap();
            let (divider, first, second) =
                ((btr & 0x3ff) + 1, (btr >> 16 & 15) + 1, (btr >> 20 & 7) + 1);
            assert_eq!(clock_hz, bit_s * divider * (1 + first + second));
            let sample = f64::from(1 + first) / f64::from(1 + first + second);
            let late = (0.8..=0.9).contains(&sample);
            assert!(late, "{clock_hz} {bit_s}: {sample}");
        }
    }
    assert_eq!(timing(42_000_000, 800_000), None);
    assert_eq!(timing(42_000_000, 0), None);
}

#[test]
fn frames_pass_unchanged_and_in_order() {
    let (mut near, mut far) = pair();
    let mut random = 1_u64;
    let mut next = || {
        random = random
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        random >> 24
    };
    let (mut sent, mut received) = (VecDeque::new(), 0);
    for _ in 0..100_000 {
        let (data, id) = (next().to_le_bytes(), next() as u32);
        let bytes = &data[..(next() % 9) as usize];
        let frame = match next() % 5 {
            0 => Frame::remote(id),
            1 | 2 => Frame::extended(id, bytes),
            _ => Frame::standard(id, bytes),
        };
        match near.send(&frame) {
            Ok(()) => sent.push_back(frame),
            Err(error) => assert_eq!((error, sent.len()), (CanError::Full, 3)),
        }
        if !next().is_multiple_of(3)
            && let Some(words) = near.registers.speak()
        {
            far.registers.hear(words, &near.registers);
            assert_eq!(far.receive(), sent.pop_front());
            received += 1;
        }
    }
    assert!(received > 50_000);
}

#[test]
fn faults_of_the_bus_are_seen() {
    let (mut near, mut far) = pair();
    let frames: Vec<Frame> = (0..5).map(|id| Frame::standard(id, &[id as u8])).collect();
    for frame in &frames {
        near.send(frame).unwrap();
        let words = near.registers.speak().unwrap();
        far.registers.hear(words, &near.registers);
    }
    // Three fit: the first two and the last.
    assert_eq!(far.receive(), Some(frames[0]));
    assert!(!far.registers.overrun, "the flag is cleared");
    let others = [Some(frames[1]), Some(frames[4]), None];
    assert_eq!([(); 3].map(|()| far.receive()), others);
    for frame in [Frame::standard(1, &[0; 12]), frames[0].into_fd(0)] {
        assert_eq!(near.send(&frame), Err(CanError::NotClassic));
    }
    assert!(!near.is_off());
    near.registers.off = true;
    assert!(near.is_off());
    // Nobody acknowledges: the mailboxes fill.
    for frame in &frames[..3] {
        near.send(frame).unwrap();
    }
    assert_eq!(near.send(&frames[3]), Err(CanError::Full));
    // A length beyond 8 means eight bytes.
    far.registers.hear([5 << 21, 15, 1, 2], &near.registers);
    let eight = Frame::standard(5, &[1, 0, 0, 0, 2, 0, 0, 0]);
    assert_eq!(far.receive(), Some(eight));
}
