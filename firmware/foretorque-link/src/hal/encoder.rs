use core::f32::consts::TAU;
use embedded_hal::spi::{Error as _, ErrorKind, SpiDevice};
use foretorque::math::nearest;

/// Counts of one turn: 14 bits.
const TURN: i32 = 1 << 14;
const VALUE: u16 = 0x3fff;
/// Bit 14 of an answer: the command before was invalid.
const ERROR_FLAG: u16 = 1 << 14;

/// Direction of counting.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// Counts grow with +q.
    Same,
    /// Counts fall with +q.
    Opposite,
}

/// Conversion of counts to the position of the joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EncoderConfig {
    /// Reading at q = 0, counts.
    pub zero_counts: u16,
    /// Direction of counting.
    pub direction: Direction,
    /// Turns of the encoder per turn of the joint: 1 on the link side, the gear ratio on the motor's shaft.
    pub ratio: f32,
    /// Largest plausible change from one reading to the next, counts; below half a turn, beyond which the direction is ambiguous.
    /// The turn stays known while as many of them as readings were missed, and one more, are below half a turn.
    pub largest_step: u16,
}

/// Registers of the chip (AS5047P data sheet v1-06, table 21).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Register {
    Errors = 0x0001,
    Diagnostics = 0x3ffc,
    /// With dynamic angle error compensation, which removes the latency of the chip.
    Angle = 0x3fff,
}

impl Register {
    /// Read command: bit 14 reads, bit 15 makes the parity even.
    const fn read(self) -> u16 {
        let command = self as u16 | 1 << 14;
        command | ((command.count_ones() as u16 & 1) << 15)
    }
}

/// Magnetic absolute encoder of the AS5047 class on an SPI device: mode 1, at most 10 MHz.
///
/// The chip answers a read command in the next frame. A reading is two frames: the first returns the diagnostics that the
/// reading before has requested and requests the angle; the second returns the angle and requests the diagnostics. The
/// position counts over turns, from a [`reference`](Self::reference) on.
///
/// ```text
/// q = direction · 2π / (16384 · ratio) · (counts over all turns − zero)
/// ```
///
/// A line without a chip gives an error: all ones carry the error flag, and all zeros are diagnostics without "ready". One
/// count is 0.383 mrad / ratio. The f32 is exact to a count within 1024 turns of the encoder.
///
/// ```
/// # use embedded_hal_mock::eh1::spi::{Mock, Transaction};
/// # let frame = |to: [u8; 2], from: [u8; 2]| [
/// #     Transaction::transaction_start(),
/// #     Transaction::transfer_in_place(to.to_vec(), from.to_vec()),
/// #     Transaction::transaction_end(),
/// # ];
/// # let mut frames = Vec::new();
/// # frames.extend(frame([0xff, 0xfc], [0, 0]));
/// # for _ in 0..2 {
/// #     frames.extend(frame([0xff, 0xff], [0x81, 0x00]));
/// #     frames.extend(frame([0xff, 0xfc], [0x90, 0x00]));
/// # }
/// # let spi = Mock::new(&frames);
/// use foretorque_link::hal::{AbsoluteEncoder, Direction, EncoderConfig, EncoderError};
/// let config = EncoderConfig { zero_counts: 0, direction: Direction::Same, ratio: 1.0, largest_step: 1000 };
/// let mut encoder = AbsoluteEncoder::new(spi, config)?;
/// assert_eq!(encoder.reference(1.6), Err(EncoderError::Pipeline));
/// encoder.reference(1.6)?;
/// let q = encoder.position()?;
/// assert!((q - core::f32::consts::FRAC_PI_2).abs() < 1e-6);
/// # encoder.release().done();
/// # Ok::<(), foretorque_link::hal::EncoderError>(())
/// ```
#[derive(Debug)]
pub struct AbsoluteEncoder<Spi> {
    pub(crate) spi: Spi,
    config: EncoderConfig,
    /// Position in counts over all turns, without the zero offset; `None` while the turn is unknown. Wraps after 131 072
    /// turns.
    position: Option<i32>,
    /// Readings missed since the last good one.
    missed: u32,
    /// Register whose value the next frame returns.
    requested: Option<Register>,
    rad_per_count: f32,
}

impl<Spi: SpiDevice> AbsoluteEncoder<Spi> {
    /// Takes the device without access to it.
    ///
    /// Errors: [`EncoderError::Configuration`].
    pub fn new(spi: Spi, config: EncoderConfig) -> Result<Self, EncoderError> {
        let step = i32::from(config.largest_step);
        let ratio_usable = config.ratio > 0.0 && config.ratio <= f32::MAX;
        if !ratio_usable || step == 0 || step >= TURN / 2 || i32::from(config.zero_counts) >= TURN {
            return Err(EncoderError::Configuration);
        }
        let sign = match config.direction {
            Direction::Same => 1.0,
            Direction::Opposite => -1.0,
        };
        Ok(Self {
            spi,
            config,
            position: None,
            missed: 0,
            requested: None,
            rad_per_count: sign * TAU / (TURN as f32 * config.ratio),
        })
    }

    /// Sets the turn in which the joint is nearest to `q`, rad, for a single-turn encoder behind a gear.
    ///
    /// Errors: those of a reading; `NoReference` where `q` is not a position. The turn is then unknown.
    pub fn reference(&mut self, q: f32) -> Result<f32, EncoderError> {
        self.position = None;
        let within = self.read()?;
        let wanted = q / self.rad_per_count;
        let turns = (wanted - within as f32) / TURN as f32;
        // Half of the range of i32.
        if turns.is_nan() || turns.abs() > 65_536.0 {
            return Err(EncoderError::NoReference);
        }
        let position = within + TURN * nearest(turns);
        self.position = Some(position);
        self.missed = 0;
        Ok(self.rad(position))
    }

    /// Position of the joint, rad.
    ///
    /// Errors: those of a reading; `NoReference`; `Jump`, after which the turn is unknown. Others count as a
    /// [missed](Self::miss) reading.
    pub fn position(&mut self) -> Result<f32, EncoderError> {
        let within = self.read().inspect_err(|_| self.miss(1))?;
        let last = self.position.ok_or(EncoderError::NoReference)?;
        // The shorter direction, from −half a turn to half a turn.
        let apart = within.wrapping_sub(last).wrapping_add(TURN / 2);
        let step = (apart & (TURN - 1)) - TURN / 2;
        if step.unsigned_abs() > self.reach() {
            self.position = None;
            return Err(EncoderError::Jump);
        }
        let position = last.wrapping_add(step);
        self.position = Some(position);
        self.missed = 0;
        Ok(self.rad(position))
    }

    /// Takes readings that were left out. The count of turns continues if the joint has moved by at most `largest_step` in each;
    /// the turn is unknown once that is half a turn.
    pub fn miss(&mut self, readings: u32) {
        self.missed = self.missed.saturating_add(readings);
        if self.reach() >= TURN as u32 / 2 {
            self.position = None;
        }
    }

    /// Largest plausible change since the last good reading, counts.
    fn reach(&self) -> u32 {
        let readings = self.missed.saturating_add(1);
        readings.saturating_mul(self.config.largest_step.into())
    }

    /// The turn is known.
    pub const fn has_turn(&self) -> bool {
        self.position.is_some()
    }

    /// Gives the device back, as it is.
    pub fn release(self) -> Spi {
        self.spi
    }

    fn rad(&self, position: i32) -> f32 {
        position as f32 * self.rad_per_count
    }

    /// Counts since the zero, within one turn: 0 to 16 383.
    fn read(&mut self) -> Result<i32, EncoderError> {
        let counts = i32::from(self.angle()?) - i32::from(self.config.zero_counts);
        Ok(counts & (TURN - 1))
    }

    /// One reading: two frames; one after a start, a bus error or a flagged error, and three when the chip flags one.
    fn angle(&mut self) -> Result<u16, EncoderError> {
        match self.requested {
            Some(Register::Diagnostics) => {
                let diagnostics = self.exchange(Register::Angle)?;
                let angle = self.exchange(Register::Diagnostics)?;
                let checked = sound(diagnostics).and_then(|seen| Ok((seen, sound(angle)?)));
                if checked == Err(EncoderError::Flagged) {
                    // Requested at once, in a frame of its own.
                    self.exchange(Register::Errors)?;
                }
                let (diagnostics, angle) = checked?;
                healthy(diagnostics)?;
                Ok(angle)
            }
            Some(Register::Errors) => {
                // This answer still carries the flag that reading it clears.
                let errors = even(self.exchange(Register::Diagnostics)?)?;
                Err(EncoderError::Refused(errors as u8 & 7))
            }
            _ => {
                self.exchange(Register::Diagnostics)?;
                Err(EncoderError::Pipeline)
            }
        }
    }

    /// One frame of 16 bits each way.
    fn exchange(&mut self, request: Register) -> Result<u16, EncoderError> {
        let mut frame = request.read().to_be_bytes();
        // The chip may not have received a frame that failed: then the next answer is not valid.
        self.requested = None;
        let sent = self.spi.transfer_in_place(&mut frame);
        sent.map_err(|error| EncoderError::Bus(error.kind()))?;
        self.requested = Some(request);
        Ok(u16::from_be_bytes(frame))
    }
}

/// The answer, if its parity holds.
fn even(answer: u16) -> Result<u16, EncoderError> {
    if answer.count_ones() & 1 == 0 {
        Ok(answer)
    } else {
        Err(EncoderError::Parity)
    }
}

/// The value of an answer whose parity holds and that flags no error.
fn sound(answer: u16) -> Result<u16, EncoderError> {
    match even(answer)? {
        flagged if flagged & ERROR_FLAG != 0 => Err(EncoderError::Flagged),
        sound => Ok(sound & VALUE),
    }
}

/// Start-up finished, magnet in range (AS5047P data sheet v1-06, register DIAAGC).
fn healthy(diagnostics: u16) -> Result<(), EncoderError> {
    const READY: u16 = 1 << 8;
    const OVERFLOW: u16 = 1 << 9;
    const STRONG: u16 = 1 << 10;
    const WEAK: u16 = 1 << 11;
    for (bit, bad_when, error) in [
        (READY, 0, EncoderError::NotReady),
        (OVERFLOW, OVERFLOW, EncoderError::Overflow),
        (STRONG, STRONG, EncoderError::MagnetStrong),
        (WEAK, WEAK, EncoderError::MagnetWeak),
    ] {
        if diagnostics & bit == bad_when {
            return Err(error);
        }
    }
    Ok(())
}

described_errors! {
    /// Error of a reading.
    pub enum EncoderError {
        /// (A ratio that is not positive, a step of half a turn or more.)
        Configuration = "encoder configuration is invalid";
        Bus(kind: ErrorKind) = "encoder bus", ": {kind}";
        /// (A bit flipped on the line, or no chip answers.)
        Parity = "encoder answer with a wrong parity";
        /// (In the frame before; the next reading reads and clears its error register.)
        Flagged = "encoder flags an error";
        /// (Its error register: framing, bit 0, command, bit 1, parity, bit 2. The next reading is a position.)
        Refused(bits: u8) = "encoder refused a frame", " ({bits:#05b})";
        /// (In the frame after a start or a bus error.)
        Pipeline = "encoder has no valid answer yet";
        /// (It has not finished its start-up, or is absent and its line low.)
        NotReady = "encoder is not ready";
        /// (Or too far away.)
        MagnetWeak = "encoder magnet too weak";
        /// (Or too near.)
        MagnetStrong = "encoder magnet too strong";
        /// (CORDIC overflow of the chip.)
        Overflow = "encoder angle overflow";
        /// (Farther than the joint can move: it is dropped, and the count of turns is lost.)
        Jump = "encoder reading jumped";
        /// ([`reference`](super::AbsoluteEncoder::reference) first.)
        NoReference = "encoder turn not known";
    }
}

#[cfg(test)]
pub(crate) mod tests;
