//! defmt into a ring that a debug probe reads (RTT); in the emulator the idle loop moves the ring to USART3.
//!
//! Messages come from start-up and from the idle loop only, so nothing has to be masked while one is written: a
//! message begun while another one is under way is dropped.

use core::sync::atomic::{AtomicBool, AtomicPtr, AtomicU8, AtomicU32, Ordering};

use stm32f4xx_hal::pac::USART3;

/// Bytes of the ring: some forty messages.
const SIZE: usize = 1024;

static RING: [AtomicU8; SIZE] = [const { AtomicU8::new(0) }; SIZE];
/// The name by which probe-rs recognises that the channel carries defmt.
static NAME: [u8; 6] = *b"defmt\0";

/// One channel of a SEGGER RTT control block, as debug probes expect it in memory.
#[repr(C)]
struct Channel {
    name: AtomicPtr<u8>,
    buffer: AtomicPtr<u8>,
    size: AtomicU32,
    /// Offset of the next byte written; the board's.
    write: AtomicU32,
    /// Offset of the next byte read; the probe's, or in the emulator the idle loop's.
    read: AtomicU32,
    /// 0: skip what does not fit.
    mode: AtomicU32,
}

/// The control block: a mark that probes search for, one channel up, none down.
#[repr(C)]
struct ControlBlock {
    mark: [u8; 16],
    channels_up: u32,
    channels_down: u32,
    up: Channel,
}

#[unsafe(export_name = "_SEGGER_RTT")]
static RTT: ControlBlock = ControlBlock {
    mark: *b"SEGGER RTT\0\0\0\0\0\0",
    channels_up: 1,
    channels_down: 0,
    up: Channel {
        name: AtomicPtr::new((&raw const NAME).cast::<u8>().cast_mut()),
        buffer: AtomicPtr::new((&raw const RING).cast::<u8>().cast_mut()),
        size: AtomicU32::new(SIZE as u32),
        write: AtomicU32::new(0),
        read: AtomicU32::new(0),
        mode: AtomicU32::new(0),
    },
};

/// Messages under way, one inside the other.
static DEPTH: AtomicU32 = AtomicU32::new(0);
/// Offset behind the last byte of the message under way.
static HEAD: AtomicU32 = AtomicU32::new(0);
/// The message under way does not fit.
static OVERFLOW: AtomicBool = AtomicBool::new(false);

#[defmt::global_logger]
struct Logger;

// SAFETY: interrupts nest strictly, so the inner of two messages always ends first; only the outermost (depth 1)
// touches the ring, and its bytes become visible with the one store of `release`.
unsafe impl defmt::Logger for Logger {
    fn acquire() {
        let depth = DEPTH.load(Ordering::Relaxed) + 1;
        DEPTH.store(depth, Ordering::Relaxed);
        if depth == 1 {
            HEAD.store(RTT.up.write.load(Ordering::Relaxed), Ordering::Relaxed);
            OVERFLOW.store(false, Ordering::Relaxed);
            with_encoder(|encoder| encoder.start_frame(put));
        }
    }

    unsafe fn flush() {}

    unsafe fn release() {
        let depth = DEPTH.load(Ordering::Relaxed);
        if depth == 1 {
            with_encoder(|encoder| encoder.end_frame(put));
            if !OVERFLOW.load(Ordering::Relaxed) {
                RTT.up
                    .write
                    .store(HEAD.load(Ordering::Relaxed), Ordering::Release);
            }
        }
        DEPTH.store(depth - 1, Ordering::Relaxed);
    }

    unsafe fn write(bytes: &[u8]) {
        if DEPTH.load(Ordering::Relaxed) == 1 {
            with_encoder(|encoder| encoder.write(bytes, put));
        }
    }
}

/// Lends the encoder of the outermost message.
fn with_encoder(work: impl FnOnce(&mut defmt::Encoder)) {
    static mut ENCODER: defmt::Encoder = defmt::Encoder::new();
    let encoder = &raw mut ENCODER;
    // SAFETY: called at depth 1 only, and `work` does not log, so this is the one reference.
    work(unsafe { &mut *encoder });
}

/// Appends encoded bytes to the message under way.
fn put(bytes: &[u8]) {
    for &byte in bytes {
        let head = HEAD.load(Ordering::Relaxed);
        let next = (head + 1) % SIZE as u32;
        if next == RTT.up.read.load(Ordering::Acquire) {
            OVERFLOW.store(true, Ordering::Relaxed);
            return;
        }
        if let Some(cell) = RING.get(head as usize) {
            cell.store(byte, Ordering::Relaxed);
        }
        HEAD.store(next, Ordering::Relaxed);
    }
}

/// The emulator's way out of the ring.
pub(crate) struct Drain(USART3);

impl Drain {
    /// Switches the log's port on.
    pub(crate) fn start(usart: USART3) -> Self {
        usart.cr1().write(|w| w.ue().enabled().te().enabled());
        Self(usart)
    }

    /// Sends what is in the ring. The emulator's port is always ready.
    pub(crate) fn empty(&self) {
        let write = RTT.up.write.load(Ordering::Acquire);
        let mut read = RTT.up.read.load(Ordering::Relaxed);
        while read != write {
            let byte = RING
                .get(read as usize)
                .map_or(0, |cell| cell.load(Ordering::Relaxed));
            // SAFETY: the data register takes any byte.
            self.0.dr().write(|w| unsafe { w.bits(u16::from(byte)) });
            read = (read + 1) % SIZE as u32;
        }
        RTT.up.read.store(read, Ordering::Release);
    }
}
