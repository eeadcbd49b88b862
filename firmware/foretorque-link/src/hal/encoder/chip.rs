//! Model of the encoder chip for tests.

use super::{ERROR_FLAG, VALUE};
use embedded_hal::spi::{ErrorKind, ErrorType, Operation, SpiDevice};

/// The chip: answers in the next frame, with parity, and flags invalid commands.
#[derive(Default)]
pub(crate) struct Chip {
    pub(crate) angle: u16,
    pub(crate) diagnostics: u16,
    pub(crate) errors: u16,
    pub(crate) pending: u16,
    pub(crate) frames: usize,
    /// Bits flipped on the way to the chip, and on the way back, in the frame after this many.
    pub(crate) flips: (usize, u16, u16),
    /// Level of a line without a driver.
    pub(crate) level: Option<u16>,
    pub(crate) gone: bool,
}

impl Chip {
    pub(crate) fn new(angle: u16) -> Self {
        Self {
            angle,
            diagnostics: 1 << 8,
            ..Self::default()
        }
    }

    fn receive(&mut self, command: u16) {
        if command.count_ones() & 1 != 0 {
            self.errors |= 1 << 2;
        }
        let value = match command & VALUE {
            0x3fff => self.angle,
            0x3ffc => self.diagnostics,
            1 => core::mem::take(&mut self.errors),
            _ => {
                self.errors |= 1 << 1;
                0
            }
        };
        let flagged = value | if self.errors == 0 { 0 } else { ERROR_FLAG };
        self.pending = flagged | ((flagged.count_ones() as u16 & 1) << 15);
    }
}

impl ErrorType for Chip {
    type Error = ErrorKind;
}

impl SpiDevice for Chip {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), ErrorKind> {
        let [Operation::TransferInPlace(bytes)] = operations else {
            return Err(ErrorKind::Other);
        };
        if self.gone {
            return Err(ErrorKind::Overrun);
        }
        self.frames += 1;
        let (to, from) = match &mut self.flips {
            (0, ..) => {
                let (_, to, from) = core::mem::take(&mut self.flips);
                (to, from)
            }
            (frames, ..) => {
                *frames -= 1;
                (0, 0)
            }
        };
        let command = u16::from_be_bytes([bytes[0], bytes[1]]) ^ to;
        let answer = self.level.unwrap_or(self.pending ^ from);
        bytes.copy_from_slice(&answer.to_be_bytes());
        self.receive(command);
        Ok(())
    }
}
