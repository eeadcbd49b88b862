//! The serial link: USART2, one byte an interrupt in each direction.

use crate::{chip, counter};
use core::hint::assert_unchecked;
use core::sync::atomic::{AtomicU32, Ordering};
use foretorque_link::telemetry::Cost;
use heapless::spsc::{Consumer, Producer, Queue};
use stm32f4xx_hal::pac::{Interrupt, USART2};

/// Bytes received and not yet read: more than the longest frame, so that an upload survives a busy tick.
pub const RECEIVE_RING: usize = 1024;
/// Bytes waiting to be sent.
pub const TRANSMIT_RING: usize = 1024;

/// Counters of the receive interrupt. Written there only; every task may read them.
#[derive(Debug)]
pub struct ReceiveCounters {
    /// Bytes moved into the ring.
    pub bytes: AtomicU32,
    /// Bytes lost because the ring was full.
    pub lost: AtomicU32,
    /// Overruns of the receive register: the interrupt came too late.
    pub overruns: AtomicU32,
    /// Counts spent on the last `counted` bytes or so: both are halved before they would wrap.
    pub counts: AtomicU32,
    /// Bytes that `counts` is about.
    pub counted: AtomicU32,
    /// Most counts spent on one byte.
    pub counts_max: AtomicU32,
}

/// Counters of the link.
pub static RECEIVED: ReceiveCounters = ReceiveCounters {
    bytes: AtomicU32::new(0),
    lost: AtomicU32::new(0),
    overruns: AtomicU32::new(0),
    counts: AtomicU32::new(0),
    counted: AtomicU32::new(0),
    counts_max: AtomicU32::new(0),
};

/// The interrupt's end of the link.
pub struct Wire {
    usart: USART2,
    received: Sender<RECEIVE_RING>,
    waiting: Receiver<TRANSMIT_RING>,
}

impl Wire {
    /// Sets the port up for 8 data bits, no parity, one stop bit. Receiving starts at once.
    pub fn start(
        usart: USART2,
        apb1_hz: u32,
        received: Sender<RECEIVE_RING>,
        waiting: Receiver<TRANSMIT_RING>,
    ) -> Self {
        // Eight-fold oversampling: USARTDIV = f / (8 · baud), mantissa in bits 4.., three bits of fraction
        // (RM0090 30.3.4).
        let eighths = (apb1_hz + chip::LINK_BAUD / 2) / chip::LINK_BAUD;
        // SAFETY: bit 3 must stay clear with eight-fold oversampling, and does.
        usart
            .brr()
            .write(|w| unsafe { w.bits((((eighths >> 3) << 4) | (eighths & 7)) as u16) });
        usart.cr1().write(|w| {
            w.over8()
                .oversample8()
                .ue()
                .enabled()
                .te()
                .enabled()
                .re()
                .enabled()
                .rxneie()
                .enabled()
        });
        Self {
            usart,
            received,
            waiting,
        }
    }

    /// One interrupt: takes the received byte, fills the transmit register. True when the byte ended a frame, or the last
    /// reply has left: frames may have waited for its space.
    ///
    /// Cost: at 2 Mbaud it may come every 5 µs, 840 cycles; its counts are in [`RECEIVED`].
    #[inline(always)]
    pub fn interrupt(&mut self) -> bool {
        let start = counter::now();
        let status = self.usart.sr().read();
        let mut delimiter = false;
        let mut received = false;
        if status.rxne().bit_is_set() {
            // Reading status and then data also clears the error flags (RM0090 30.6.1).
            let byte = self.usart.dr().read().bits() as u8;
            if status.ore().bit_is_set() {
                add(&RECEIVED.overruns, 1);
            }
            let taken = self.received.put(byte);
            let ReceiveCounters { bytes, lost, .. } = &RECEIVED;
            add(if taken { bytes } else { lost }, 1);
            delimiter = byte == 0;
            if delimiter {
                ENDED_AT.store(start, Ordering::Relaxed);
            }
            received = true;
        } else if status.ore().bit_is_set() {
            // The byte there is the one before, and was taken.
            self.usart.dr().read();
            add(&RECEIVED.overruns, 1);
        }
        let sending = self.usart.cr1().read().txeie().bit_is_set();
        let sent = self.transmit();
        // A byte that finds some to send shares its interrupt with them, and measures nothing of receiving.
        if received && !sent {
            note_cost(counter::now().wrapping_sub(start));
        }
        delimiter || sending && !sent
    }

    /// Moves waiting bytes into the transmit register while it is free: one on silicon, all in the emulator. True when
    /// there was one.
    #[inline(always)]
    fn transmit(&mut self) -> bool {
        let mut sent = false;
        while self.usart.sr().read().txe().bit_is_set() {
            match self.waiting.take() {
                // SAFETY: the data register takes any byte.
                Some(byte) => self
                    .usart
                    .dr()
                    .write(|w| unsafe { w.bits(u16::from(byte)) }),
                None => {
                    self.usart.cr1().modify(|_, w| w.txeie().disabled());
                    return sent;
                }
            };
            sent = true;
        }
        self.usart.cr1().modify(|_, w| w.txeie().enabled());
        true
    }
}

/// Queues frames and wakes the interrupt, which does the sending. False where they do not fit; then none is sent,
/// because half a frame is worth nothing to the other side.
#[inline(always)]
pub fn send(waiting: &mut Sender<TRANSMIT_RING>, bytes: &[u8]) -> bool {
    if bytes.len() > waiting.free() {
        return false;
    }
    let queued = bytes.iter().all(|&byte| waiting.put(byte));
    // The emulator raises no interrupt for a free transmit register: pend it by hand, on silicon a nudge too many.
    rtic::pend(Interrupt::USART2);
    queued
}

/// Cost of receiving one byte, in counts, without [`chip::RECEIVE_OVERHEAD`].
pub fn receive_cost() -> Cost {
    let counted = RECEIVED.counted.load(Ordering::Relaxed).max(1);
    Cost {
        mean: RECEIVED.counts.load(Ordering::Relaxed) / counted,
        max: RECEIVED.counts_max.load(Ordering::Relaxed),
    }
}

/// End of the last frame, on the board's counter.
static ENDED_AT: AtomicU32 = AtomicU32::new(0);

/// Counts since the last frame ended.
pub fn since_frame() -> u32 {
    counter::now().wrapping_sub(ENDED_AT.load(Ordering::Relaxed))
}

/// Bytes lost by the ring and overruns of the register, together. Wraps.
pub fn losses() -> u32 {
    let lost = RECEIVED.lost.load(Ordering::Relaxed);
    lost.wrapping_add(RECEIVED.overruns.load(Ordering::Relaxed))
}

/// Adds without a lock: there is one writer.
#[inline(always)]
pub(crate) fn add(counter: &AtomicU32, amount: u32) {
    let sum = counter.load(Ordering::Relaxed).wrapping_add(amount);
    counter.store(sum, Ordering::Relaxed);
}

/// Takes the cost of one byte; its own is not in it.
#[inline(always)]
fn note_cost(spent: u32) {
    let half = RECEIVED.counts.load(Ordering::Relaxed) >> 31;
    let counts = (RECEIVED.counts.load(Ordering::Relaxed) >> half) + spent;
    let counted = (RECEIVED.counted.load(Ordering::Relaxed) >> half) + 1;
    RECEIVED.counts.store(counts, Ordering::Relaxed);
    RECEIVED.counted.store(counted, Ordering::Relaxed);
    if spent > RECEIVED.counts_max.load(Ordering::Relaxed) {
        RECEIVED.counts_max.store(spent, Ordering::Relaxed);
    }
}

/// The end where they go in.
pub struct Sender<const N: usize, T: 'static = u8>(Producer<'static, T>);

/// The end where they come out.
pub struct Receiver<const N: usize, T: 'static = u8>(Consumer<'static, T>);

/// The two ends of `queue`.
pub fn split<const N: usize, T>(queue: &'static mut Queue<T, N>) -> (Sender<N, T>, Receiver<N, T>) {
    let (sender, receiver) = queue.split();
    (Sender(sender), Receiver(receiver))
}

impl<const N: usize, T> Sender<N, T> {
    /// Puts one in; false if the queue is full.
    #[inline(always)]
    pub fn put(&mut self, item: T) -> bool {
        // SAFETY: the only constructor takes a queue of this length.
        unsafe { assert_unchecked(self.0.capacity() == N - 1) };
        self.0.enqueue(item).is_ok()
    }

    /// Number that can be put in.
    #[inline(always)]
    pub fn free(&self) -> usize {
        // SAFETY: as above.
        unsafe { assert_unchecked(self.0.capacity() == N - 1) };
        self.0.capacity() - self.0.len()
    }
}

impl<const N: usize, T> Receiver<N, T> {
    /// Takes the oldest one out.
    #[inline(always)]
    pub fn take(&mut self) -> Option<T> {
        // SAFETY: as above.
        unsafe { assert_unchecked(self.0.capacity() == N - 1) };
        self.0.dequeue()
    }
}
