//! The serial link: USART2, one byte an interrupt in each direction.

use core::sync::atomic::{AtomicU32, Ordering};

use heapless::spsc::{Consumer, Producer};
use stm32f4xx_hal::pac::{Interrupt, USART2};

use crate::{board, counter};

/// Bytes received and not yet read: more than the longest frame, so that an upload survives a busy tick.
pub(crate) const RECEIVE_RING: usize = 1024;
/// Bytes waiting to be sent.
pub(crate) const TRANSMIT_RING: usize = 1024;

/// What the receive interrupt saw. Written there only; everybody may read.
#[derive(Debug)]
pub(crate) struct ReceiveCounters {
    /// Bytes moved into the ring.
    pub(crate) bytes: AtomicU32,
    /// Bytes lost because the ring was full.
    pub(crate) lost: AtomicU32,
    /// Overruns of the receive register: the interrupt came too late.
    pub(crate) overruns: AtomicU32,
    /// Counts spent on received bytes, from the first to the last instruction of the handler.
    pub(crate) counts: AtomicU32,
    /// Most counts spent on one byte.
    pub(crate) counts_max: AtomicU32,
}

/// Counters of the link.
pub(crate) static RECEIVED: ReceiveCounters = ReceiveCounters {
    bytes: AtomicU32::new(0),
    lost: AtomicU32::new(0),
    overruns: AtomicU32::new(0),
    counts: AtomicU32::new(0),
    counts_max: AtomicU32::new(0),
};

/// The interrupt's end of the link.
pub(crate) struct Wire {
    usart: USART2,
    received: Producer<'static, u8>,
    waiting: Consumer<'static, u8>,
}

impl Wire {
    /// Sets the port up for 8 data bits, no parity, one stop bit. Receiving starts at once.
    pub(crate) fn start(
        usart: USART2,
        apb1_hz: u32,
        received: Producer<'static, u8>,
        waiting: Consumer<'static, u8>,
    ) -> Self {
        // Eight-fold oversampling: USARTDIV = f / (8 · baud), mantissa in bits 4.., three bits of fraction
        // (RM0090 30.3.4).
        let eighths = (apb1_hz + board::LINK_BAUD / 2) / board::LINK_BAUD;
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

    /// One interrupt: takes the received byte, fills the transmit register. True when the byte ended a frame.
    ///
    /// Cost: at 2 Mbaud it may come every 5 µs, 840 cycles; its counts are in [`RECEIVED`].
    #[inline(always)]
    pub(crate) fn interrupt(&mut self) -> bool {
        let start = counter::now();
        let status = self.usart.sr().read();
        let mut delimiter = false;
        if status.rxne().bit_is_set() || status.ore().bit_is_set() {
            // Reading status and then data also clears the error flags (RM0090 30.6.1).
            let byte = self.usart.dr().read().bits() as u8;
            if status.ore().bit_is_set() {
                add(&RECEIVED.overruns, 1);
            }
            match self.received.enqueue(byte) {
                Ok(()) => add(&RECEIVED.bytes, 1),
                Err(_) => add(&RECEIVED.lost, 1),
            }
            delimiter = byte == 0;
            let spent = counter::now().wrapping_sub(start);
            add(&RECEIVED.counts, spent);
            if spent > RECEIVED.counts_max.load(Ordering::Relaxed) {
                RECEIVED.counts_max.store(spent, Ordering::Relaxed);
            }
        }
        self.transmit();
        delimiter
    }

    /// Moves waiting bytes into the transmit register while it is free: one on silicon, all in the emulator.
    fn transmit(&mut self) {
        while self.usart.sr().read().txe().bit_is_set() {
            match self.waiting.dequeue() {
                // SAFETY: the data register takes any byte.
                Some(byte) => self
                    .usart
                    .dr()
                    .write(|w| unsafe { w.bits(u16::from(byte)) }),
                None => {
                    self.usart.cr1().modify(|_, w| w.txeie().disabled());
                    return;
                }
            };
        }
        self.usart.cr1().modify(|_, w| w.txeie().enabled());
    }
}

/// Queues a reply and wakes the interrupt, which does the sending. Returns the number of bytes that found no room.
pub(crate) fn send(waiting: &mut Producer<'static, u8>, bytes: &[u8]) -> usize {
    let room = waiting.capacity() - waiting.len();
    if bytes.len() > room {
        // Half a frame is worth nothing to the other side.
        return bytes.len();
    }
    for &byte in bytes {
        if waiting.enqueue(byte).is_err() {
            break;
        }
    }
    // The emulator raises no interrupt for a free transmit register: pend it by hand, on silicon a nudge too many.
    rtic::pend(Interrupt::USART2);
    0
}

/// Adds without a lock: there is one writer.
#[inline(always)]
fn add(counter: &AtomicU32, amount: u32) {
    counter.store(
        counter.load(Ordering::Relaxed).wrapping_add(amount),
        Ordering::Relaxed,
    );
}
