//! The encoder's bus: SPI mode 1, eight bits, never waiting for ever.

use cortex_m::asm;
use embedded_hal::spi::{ErrorKind, ErrorType, Operation, SpiDevice};
use stm32f4xx_hal::pac::spi1::RegisterBlock;

use super::{ENCODER_DIVIDER, ENCODER_POLLS, EncoderBus, SELECT_CYCLES, pins};

/// Result of [`exchange`] without a byte: beyond every byte.
const NONE: u32 = 1 << 8;

pub(crate) struct EncoderDevice;

impl EncoderDevice {
    /// Sets the bus up. Its clock must run.
    pub(crate) fn start() -> Self {
        // Master, select by hand, mode 1: data change with the leading edge (RM0090 28.3.1).
        bus().cr1().write(|w| {
            w.mstr().master();
            w.ssm().enabled();
            w.ssi().slave_not_selected();
            w.cpol().idle_low();
            w.cpha().second_edge();
            w.br().set(ENCODER_DIVIDER);
            w.spe().enabled()
        });
        Self
    }
}

impl ErrorType for EncoderDevice {
    type Error = ErrorKind;
}

impl SpiDevice for EncoderDevice {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), ErrorKind> {
        // What a transfer that was given up has left.
        let _ = bus().dr().read();
        pins::select(true);
        asm::delay(SELECT_CYCLES);
        let done = operations.iter_mut().try_for_each(execute);
        asm::delay(SELECT_CYCLES);
        pins::select(false);
        asm::delay(SELECT_CYCLES);
        done
    }
}

/// One operation of a frame. Request and answer are one transfer.
fn execute(operation: &mut Operation<'_, u8>) -> Result<(), ErrorKind> {
    let Operation::TransferInPlace(bytes) = operation else {
        return Err(ErrorKind::Other);
    };
    for byte in bytes.iter_mut() {
        *byte = u8::try_from(exchange(u32::from(*byte))).map_err(|_| ErrorKind::Overrun)?;
    }
    Ok(())
}

/// One byte each way, at most [`ENCODER_POLLS`] reads of the flag; [`NONE`] when none came. Not inlined: the tests stand
/// in for the encoder here, because the emulator has none.
#[inline(never)]
extern "C" fn exchange(byte: u32) -> u32 {
    bus().dr8().write(|w| w.dr().set(byte as u8));
    let come = (0..ENCODER_POLLS).any(|_| bus().sr().read().rxne().bit_is_set());
    if come {
        u32::from(bus().dr8().read().dr().bits())
    } else {
        NONE
    }
}

fn bus() -> &'static RegisterBlock {
    // SAFETY: start-up and the tick's task alone use the bus, one after the other.
    unsafe { &*EncoderBus::ptr() }
}
