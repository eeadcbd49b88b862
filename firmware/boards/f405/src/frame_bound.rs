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
