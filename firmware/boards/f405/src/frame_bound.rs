//! Bound on the frames that the tick's task reads in a period, so that no burst starves the tasks below.

/// Frames that are read in each started millisecond of a period: a sample and three commands, each at most a tenth of it.
pub const FRAMES_PER_MS: u32 = 4;

/// Frames that may still be read in this period.
#[derive(Clone, Copy, Debug, Default)]
pub struct FrameBound {
    left: u32,
}

impl FrameBound {
    /// A period of the timer begins.
    pub const fn refill(&mut self, period_us: u32) {
        self.left = FRAMES_PER_MS * period_us.div_ceil(1000);
    }

    /// Takes the bytes of at most one frame out of `received` into `frame`; their number, 0 where none may be read.
    ///
    /// * `timer` the timer runs. One that stands still refills nothing: then the host waits for each reply
    pub fn take(
        &mut self,
        timer: bool,
        frame: &mut [u8],
        mut received: impl FnMut() -> Option<u8>,
    ) -> usize {
        if timer && self.left == 0 {
            return 0;
        }
        let mut count = 0;
        for slot in frame {
            let Some(byte) = received() else {
                break;
            };
            *slot = byte;
            count += 1;
            if byte == 0 {
                self.left = self.left.saturating_sub(1);
                break;
            }
        }
        count
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Frames and bytes that one pass reads out of a burst.
    fn pass(
        bound: &mut FrameBound,
        timer: bool,
        burst: &mut impl Iterator<Item = u8>,
    ) -> (u32, usize) {
        let (mut frames, mut bytes) = (0, 0);
        let mut frame = [1; 16];
        loop {
            let count = bound.take(timer, &mut frame, || burst.next());
            if count == 0 {
                return (frames, bytes);
            }
            bytes += count;
            frames += u32::from(frame[..count].ends_with(&[0]));
        }
    }

    #[test]
    fn m5_a_period_reads_a_bounded_number_of_frames() {
        // Reads of 13 bytes, and delimiters alone, which cost the least line time.
        for length in [1, 13] {
            let mut burst = (1..).map(|k: u32| u8::from(!k.is_multiple_of(length)));
            let mut bound = FrameBound::default();
            let before = pass(&mut bound, true, &mut burst);
            assert_eq!(before, (0, 0), "before the first period");
            for (period_us, milliseconds) in [(100, 1), (1000, 1), (1001, 2), (20_000, 20)] {
                bound.refill(period_us);
                let most = FRAMES_PER_MS * milliseconds;
                let read = pass(&mut bound, true, &mut burst);
                assert_eq!(read, (most, (most * length) as usize), "{period_us} µs");
                let more = pass(&mut bound, true, &mut burst);
                assert_eq!(more, (0, 0), "until the next period");
            }
        }
    }

    #[test]
    fn without_a_timer_all_frames_are_read() {
        let mut bound = FrameBound::default();
        let mut burst = (1..=130).map(|k: u32| u8::from(!k.is_multiple_of(13)));
        assert_eq!(pass(&mut bound, false, &mut burst), (10, 130));
        assert_eq!(FRAMES_PER_MS, 4, "docs/protocol.md, Bursts");
    }
}
