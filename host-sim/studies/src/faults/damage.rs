//! Damage to frames on a bad line.

use rand::seq::SliceRandom;
use rand::{Rng, RngCore};
use rand_chacha::ChaCha8Rng;

/// This frame is hit, so that there is damage in a campaign however short.
const EARLY: u32 = 20;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Damage {
    /// One to eight bits of the frame are turned.
    Flips,
    /// The frame ends early, with or without its delimiter.
    Truncation,
    /// The frame comes two or three times.
    Duplication,
    /// The frame comes after up to eight later ones.
    Reordering,
    /// Up to 4 KiB of chance come before the frame, or old frames all over again.
    Flood,
    /// Every byte is another one with a probability of 0.01 %.
    Noise,
    /// Bursts of up to 64 bytes of chance, 1 % of all bytes.
    Bursts,
    /// Up to 200 frames are lost in a row.
    Silence,
}

/// All of them, with their names in a report.
pub(super) const DAMAGES: [(Damage, &str); 8] = [
    (Damage::Flips, "bit flips"),
    (Damage::Truncation, "truncated frames"),
    (Damage::Duplication, "duplicated frames"),
    (Damage::Reordering, "reordered frames"),
    (Damage::Flood, "floods"),
    (Damage::Noise, "0.01 % random byte errors"),
    (Damage::Bursts, "1 % byte errors in bursts"),
    (Damage::Silence, "silence"),
];

impl Damage {
    /// One frame in how many is hit, where the damage is to frames and not to bytes.
    const fn seldom(self) -> u32 {
        match self {
            Self::Flood => 40,
            Self::Silence => 400,
            _ => 4,
        }
    }
}

pub(super) struct BadLine {
    damage: Damage,
    random: ChaCha8Rng,
    /// Frames kept back, with the number of frames that come before them.
    kept: Vec<(u32, Vec<u8>)>,
    /// Frames carried last, for floods of old frames.
    old: Vec<Vec<u8>>,
    /// Frames still to be lost, or bytes still to be spoilt.
    left: u32,
    /// Frames that came in.
    frames: u32,
    pub(super) injected: u64,
}

impl BadLine {
    pub(super) fn new(damage: Damage, random: ChaCha8Rng) -> Self {
        Self {
            damage,
            random,
            kept: Vec::new(),
            old: Vec::new(),
            left: 0,
            frames: 0,
            injected: 0,
        }
    }

    /// Bytes that leave the line when `frame` enters it.
    pub(super) fn carry(&mut self, frame: &[u8]) -> Vec<u8> {
        match self.damage {
            Damage::Noise => return self.noise(frame),
            Damage::Bursts => return self.bursts(frame),
            Damage::Silence if self.left > 0 => {
                self.left -= 1;
                return Vec::new();
            }
            _ => {}
        }
        let mut line = Vec::new();
        self.frames += 1;
        if self.frames == EARLY || self.random.random_ratio(1, self.damage.seldom()) {
            self.injected += 1;
            self.hit(frame, &mut line);
        } else {
            line.extend(frame);
        }
        for (before, _) in &mut self.kept {
            *before -= 1;
        }
        for (_, late) in self.kept.extract_if(.., |(before, _)| *before == 0) {
            line.extend(late);
        }
        if self.damage == Damage::Flood {
            self.old.push(frame.to_vec());
            if self.old.len() > 12 {
                self.old.remove(0);
            }
        }
        line
    }

    fn hit(&mut self, frame: &[u8], line: &mut Vec<u8>) {
        let random = &mut self.random;
        match self.damage {
            Damage::Flips => {
                let mut corrupted = frame.to_vec();
                let mut bits: Vec<usize> = (0..8 * frame.len()).collect();
                bits.shuffle(random);
                for bit in bits.into_iter().take(random.random_range(1..=8)) {
                    corrupted[bit / 8] ^= 1 << (bit % 8);
                }
                line.extend(corrupted);
            }
            Damage::Truncation => {
                let whole = random.random_range(0..frame.len() - 1);
                line.extend(&frame[..whole]);
                if random.random() {
                    line.push(0);
                }
            }
            Damage::Duplication => line.extend(frame.repeat(random.random_range(2..=3))),
            // One more than the frames between, because this call counts.
            Damage::Reordering => self.kept.push((random.random_range(2..=9), frame.to_vec())),
            Damage::Flood => {
                if random.random() {
                    let mut chance = vec![0; random.random_range(256..=4096)];
                    random.fill_bytes(&mut chance);
                    line.extend(chance);
                    line.push(0);
                } else {
                    let copies = random.random_range(1..=8);
                    line.extend(self.old.concat().repeat(copies));
                }
                line.extend(frame);
            }
            Damage::Silence => self.left = random.random_range(1..=200) - 1,
            Damage::Noise | Damage::Bursts => {}
        }
    }

    fn noise(&mut self, frame: &[u8]) -> Vec<u8> {
        let mut corrupted = frame.to_vec();
        self.frames += 1;
        for (place, byte) in corrupted.iter_mut().enumerate() {
            let sure = (self.frames, place) == (EARLY, 0);
            if sure || self.random.random_ratio(1, 10_000) {
                *byte ^= self.random.random_range(1..=255u8);
                self.injected += 1;
            }
        }
        corrupted
    }

    fn bursts(&mut self, frame: &[u8]) -> Vec<u8> {
        let mut corrupted = frame.to_vec();
        for byte in &mut corrupted {
            // 32 bytes in the mean, one burst in 3200 bytes: 1 %.
            if self.left == 0 && self.random.random_ratio(1, 3200) {
                self.left = self.random.random_range(1..=64);
            }
            if self.left > 0 {
                self.left -= 1;
                *byte ^= self.random.random_range(1..=255u8);
                self.injected += 1;
            }
        }
        corrupted
    }
}
