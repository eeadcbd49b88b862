/// Seeded source of starting weights: xorshift, period 2³² − 1.  [Marsaglia 2003, shifts 13, 17, 5]
pub(super) struct RandomStart {
    state: u32,
}

impl RandomStart {
    /// Neighbouring seeds are spread by a multiplication first; the state must not be zero.
    pub(super) fn new(seed: u32) -> Self {
        let state = seed.wrapping_mul(0x9E37_79B1) ^ 0x85EB_CA6B;
        Self {
            state: if state == 0 { 1 } else { state },
        }
    }

    /// The next number, uniform in ±1.
    pub(super) fn symmetric(&mut self) -> f32 {
        self.state ^= self.state << 13;
        self.state ^= self.state >> 17;
        self.state ^= self.state << 5;
        // 24 bits are what an f32 holds exactly.
        (self.state >> 8) as f32 * (2.0 / 16_777_216.0) - 1.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_uniform_and_never_stick() {
        let mut start = RandomStart::new(0);
        let mut counts = [0; 10];
        for _ in 0..10_000 {
            let x = start.symmetric();
            assert!((-1.0..1.0).contains(&x));
            counts[((x + 1.0) * 5.0) as usize] += 1;
        }
        assert!(
            counts.iter().all(|&c| (850..1150).contains(&c)),
            "{counts:?}"
        );
    }
}
