//! M5: no burst of frames starves the tasks below the tick.

use foretorque_f405::frame_bound::{FRAMES_PER_MS, FrameBound};

/// Frames and bytes that one pass reads out of a burst.
fn pass(bound: &mut FrameBound, timer: bool, burst: &mut impl Iterator<Item = u8>) -> (u32, usize) {
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
        assert_eq!(
            pass(&mut bound, true, &mut burst),
            (0, 0),
            "before the first period"
        );
        for (period_us, milliseconds) in [(100, 1), (1000, 1), (1001, 2), (20_000, 20)] {
            bound.refill(period_us);
            let most = FRAMES_PER_MS * milliseconds;
            let read = pass(&mut bound, true, &mut burst);
            assert_eq!(read, (most, (most * length) as usize), "{period_us} µs");
            assert_eq!(
                pass(&mut bound, true, &mut burst),
                (0, 0),
                "until the next period"
            );
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
