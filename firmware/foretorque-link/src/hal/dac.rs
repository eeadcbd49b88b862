use super::output::{OutputError, TorqueOutput, bounded};
use embedded_hal::spi::{Error as _, SpiDevice};

/// A converter whose frame is known here. SPI mode 0, most significant bit first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DacModel {
    /// 12 bits, 16-bit frames (Microchip DS21897, register 5-1): channel A, unbuffered reference, gain 1, active.
    Mcp4921,
    /// 16 bits, 24-bit frames (Texas Instruments SLAS430, table 1): written to and put out on channel A.
    Dac8552A,
    /// Channel B of the DAC8552.
    Dac8552B,
}

impl DacModel {
    /// Codes from mid-scale, which is no torque, to the end of the range that both signs reach.
    const fn half(self) -> u16 {
        match self {
            Self::Mcp4921 => 2047,
            Self::Dac8552A | Self::Dac8552B => 32_767,
        }
    }

    /// The frame of `code`, and how many of its bytes are sent.
    const fn frame(self, code: u16) -> ([u8; 3], usize) {
        let [high, low] = code.to_be_bytes();
        match self {
            Self::Mcp4921 => ([0x30 | (high & 0x0f), low, 0], 2),
            Self::Dac8552A => ([0x10, high, low], 3),
            Self::Dac8552B => ([0x24, high, low], 3),
        }
    }
}

/// The analogue command input of a servo drive, behind a converter whose mid-scale is no torque.
///
/// Code = mid-scale + round(level · half-scale): with a reference of V_ref, the output is V_ref / 2 · (1 + level), which
/// the analogue stage of the board brings to the drive's ±10 V (or whatever it takes). One least significant bit is 1/2047
/// of the largest current with 12 bits, 1/32767 with 16.
///
/// ```
/// # use embedded_hal_mock::eh1::spi::{Mock, Transaction};
/// # let spi = Mock::new(&[Transaction::transaction_start(), Transaction::write_vec(vec![0x38, 0x00]), Transaction::transaction_end()]);
/// use foretorque_link::hal::{DacModel, SpiDac, TorqueOutput};
/// let mut output = SpiDac::new(spi, DacModel::Mcp4921);
/// output.command(0.0)?;
/// # output.release().done();
/// # Ok::<(), foretorque_link::hal::OutputError>(())
/// ```
#[derive(Debug)]
pub struct SpiDac<Spi> {
    spi: Spi,
    model: DacModel,
}

impl<Spi: SpiDevice> SpiDac<Spi> {
    /// Takes the device and sends nothing.
    pub const fn new(spi: Spi, model: DacModel) -> Self {
        Self { spi, model }
    }

    /// Gives the device back, as it is.
    pub fn release(self) -> Spi {
        self.spi
    }
}

impl<Spi: SpiDevice> TorqueOutput for SpiDac<Spi> {
    fn command(&mut self, level: f32) -> Result<(), OutputError> {
        let half = i32::from(self.model.half());
        let swing = bounded(level) * half as f32;
        // Away from zero by a half, then cut: the nearest integer, and the same for both signs.
        let swing = if swing < 0.0 {
            (swing - 0.5) as i32
        } else {
            (swing + 0.5) as i32
        };
        let code = (half + 1 + swing.min(half).max(-half)) as u16;
        let (bytes, count) = self.model.frame(code);
        let sent = self.spi.write(bytes.get(..count).unwrap_or_default());
        sent.map_err(|error| OutputError::Bus(error.kind()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use embedded_hal::spi::{ErrorKind, ErrorType, Operation};
    use embedded_hal_mock::eh1::spi::{Mock, Transaction};

    #[test]
    fn every_model_gets_its_own_frame() {
        use DacModel::{Dac8552A, Dac8552B, Mcp4921};
        for (model, level, frame) in [
            (Mcp4921, 0.0, vec![0x38, 0x00]),
            (Mcp4921, 1.0, vec![0x3f, 0xff]),
            (Mcp4921, -1.0, vec![0x30, 0x01]),
            (Mcp4921, 9.0, vec![0x3f, 0xff]),
            (Mcp4921, f32::NEG_INFINITY, vec![0x30, 0x01]),
            (Mcp4921, f32::NAN, vec![0x38, 0x00]),
            (Mcp4921, 1.0 / 2047.0, vec![0x38, 0x01]),
            (Mcp4921, -0.6 / 2047.0, vec![0x37, 0xff]),
            (Dac8552A, 0.0, vec![0x10, 0x80, 0x00]),
            (Dac8552A, -0.5, vec![0x10, 0x40, 0x00]),
            (Dac8552B, 1.0, vec![0x24, 0xff, 0xff]),
        ] {
            let mut output = SpiDac::new(
                Mock::new(&[
                    Transaction::transaction_start(),
                    Transaction::write_vec(frame),
                    Transaction::transaction_end(),
                ]),
                model,
            );
            output.command(level).unwrap();
            output.release().done();
        }
    }

    /// A bus that is gone. The mock of the crate cannot fail.
    struct Gone;

    impl ErrorType for Gone {
        type Error = ErrorKind;
    }

    impl SpiDevice for Gone {
        fn transaction(&mut self, _: &mut [Operation<'_, u8>]) -> Result<(), ErrorKind> {
            Err(ErrorKind::ModeFault)
        }
    }

    #[test]
    fn a_bus_that_is_gone_is_reported() {
        let mut output = SpiDac::new(Gone, DacModel::Dac8552A);
        assert_eq!(
            output.command(0.1),
            Err(OutputError::Bus(ErrorKind::ModeFault))
        );
    }
}
