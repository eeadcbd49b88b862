use core::f32::consts::TAU;
use embedded_hal::spi::{Error as _, ErrorKind, SpiDevice};

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
    /// Largest plausible change between two readings, counts; below half a turn, beyond which the direction is ambiguous.
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
    spi: Spi,
    config: EncoderConfig,
    /// Position in counts over all turns, without the zero offset; `None` while the turn is unknown. Wraps after 131 072
    /// turns.
    position: Option<i32>,
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
        let ratio_usable = config.ratio > 0.0 && config.ratio.is_finite();
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
        let half = if turns < 0.0 { -0.5 } else { 0.5 };
        let position = within + TURN * (turns + half) as i32;
        self.position = Some(position);
        Ok(self.rad(position))
    }

    /// Position of the joint, rad.
    ///
    /// Errors: those of a reading; `NoReference`; `Jump`, after which the turn is unknown. Others keep the count of turns,
    /// which continues if the joint has moved less than `largest_step` at the next good reading.
    pub fn position(&mut self) -> Result<f32, EncoderError> {
        let within = self.read()?;
        let last = self.position.ok_or(EncoderError::NoReference)?;
        // The shorter direction, from −half a turn to half a turn.
        let apart = within.wrapping_sub(last).wrapping_add(TURN / 2);
        let step = (apart & (TURN - 1)) - TURN / 2;
        if step.abs() > i32::from(self.config.largest_step) {
            self.position = None;
            return Err(EncoderError::Jump);
        }
        let position = last.wrapping_add(step);
        self.position = Some(position);
        Ok(self.rad(position))
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
pub(crate) mod tests {
    use super::*;
    use embedded_hal::spi::{ErrorType, Operation};

    const CONFIG: EncoderConfig = EncoderConfig {
        zero_counts: 0,
        direction: Direction::Same,
        ratio: 1.0,
        largest_step: 2000,
    };

    /// An encoder that has started, at `angle` counts with the joint near `q`.
    fn encoder(config: EncoderConfig, angle: u16, q: f32) -> AbsoluteEncoder<Chip> {
        let mut encoder = AbsoluteEncoder::new(Chip::new(angle), config).unwrap();
        assert_eq!(encoder.reference(q), Err(EncoderError::Pipeline));
        encoder.reference(q).unwrap();
        encoder
    }

    fn moved(encoder: &mut AbsoluteEncoder<Chip>, angle: u16) -> Result<f32, EncoderError> {
        encoder.spi.angle = angle;
        encoder.position()
    }

    const COUNT: f32 = TAU / 16_384.0;

    #[test]
    fn commands_have_even_parity() {
        let commands = [Register::Angle, Register::Diagnostics, Register::Errors];
        assert_eq!(commands.map(Register::read), [0xffff, 0xfffc, 0x4001]);
    }

    #[test]
    fn counts_become_radians_by_zero_direction_and_ratio() {
        for (zero, direction, ratio, angle, near, q) in [
            (0, Direction::Same, 1.0, 4096, 1.5, 4096.0 * COUNT),
            (4096, Direction::Same, 1.0, 4096, 0.1, 0.0),
            (4096, Direction::Same, 1.0, 0, -1.0, -4096.0 * COUNT),
            (4096, Direction::Opposite, 1.0, 0, 1.0, 4096.0 * COUNT),
            (0, Direction::Same, 100.0, 0, 0.5, 8.0 * TAU / 100.0),
            (0, Direction::Opposite, 100.0, 0, -0.5, -8.0 * TAU / 100.0),
        ] {
            let config = EncoderConfig {
                zero_counts: zero,
                direction,
                ratio,
                ..CONFIG
            };
            let seen = encoder(config, angle, near).position().unwrap();
            assert!((seen - q).abs() < 1e-6, "{config:?}: {seen} for {q}");
        }
    }

    #[test]
    fn the_count_continues_over_turns_in_both_directions() {
        let mut encoder = encoder(CONFIG, 16_000, 6.0);
        for (angle, counts) in [
            (16_383, 16_383.0),
            (100, 16_484.0),
            (1900, 18_284.0),
            (100, 16_484.0),
            (15_000, 15_000.0),
        ] {
            let q = moved(&mut encoder, angle).unwrap();
            assert!((q - counts * COUNT).abs() < 3e-6, "{angle}: {q}");
        }
        for _ in 0..9 {
            for angle in [13_500, 12_000, 10_500, 9000, 7500, 6000, 4500, 3000, 1500] {
                moved(&mut encoder, angle).unwrap();
            }
            moved(&mut encoder, 0).unwrap();
            moved(&mut encoder, 15_000).unwrap();
        }
        assert_eq!(encoder.position, Some(15_000 - 9 * TURN));
    }

    #[test]
    fn diagnostics_are_reported_in_the_next_reading() {
        for (diagnostics, error) in [
            (0, EncoderError::NotReady),
            (0x300, EncoderError::Overflow),
            (0x500, EncoderError::MagnetStrong),
            (0x900, EncoderError::MagnetWeak),
        ] {
            let mut encoder = encoder(CONFIG, 100, 0.0);
            encoder.spi.diagnostics = diagnostics;
            assert!(encoder.position().is_ok());
            assert_eq!(encoder.position(), Err(error));
            encoder.spi.diagnostics = 1 << 8;
            assert_eq!(encoder.position(), Err(error));
            assert_eq!(encoder.position(), Ok(100.0 * COUNT));
        }
    }

    #[test]
    fn every_flipped_bit_of_an_answer_is_detected() {
        for (frame, bit) in (0..32).map(|k| (k / 16, k % 16)) {
            let mut encoder = encoder(CONFIG, 1234, 0.5);
            encoder.spi.flips = (frame, 0, 1 << bit);
            assert_eq!(encoder.position(), Err(EncoderError::Parity), "bit {bit}");
            assert_eq!(encoder.position(), Ok(1234.0 * COUNT));
        }
    }

    #[test]
    fn every_flipped_bit_of_a_command_is_flagged_once() {
        for (frame, bit) in (0..32).map(|k| (k / 16, k % 16)) {
            let mut encoder = encoder(CONFIG, 1234, 0.5);
            encoder.spi.flips = (frame, 1 << bit, 0);
            if frame == 1 {
                assert_eq!(encoder.position(), Ok(1234.0 * COUNT));
            }
            assert_eq!(encoder.position(), Err(EncoderError::Flagged), "bit {bit}");
            match encoder.position() {
                Err(EncoderError::Refused(bits)) => assert_ne!(bits & 4, 0, "bit {bit}"),
                other => panic!("bit {bit}: {other:?}"),
            }
            assert_eq!(encoder.position(), Ok(1234.0 * COUNT));
        }
    }

    #[test]
    fn a_bus_error_invalidates_one_answer_and_keeps_the_turn() {
        let mut encoder = encoder(CONFIG, 100, TAU);
        encoder.spi.gone = true;
        let overrun = Err(EncoderError::Bus(ErrorKind::Overrun));
        assert_eq!([encoder.position(), encoder.position()], [overrun; 2]);
        encoder.spi.gone = false;
        assert_eq!(encoder.position(), Err(EncoderError::Pipeline));
        let q = encoder.position().unwrap();
        assert!((q - 16_484.0 * COUNT).abs() < 1e-6, "{q}");
    }

    #[test]
    fn a_line_without_a_chip_gives_no_position() {
        for (level, error) in [
            (0x0000, EncoderError::NotReady),
            (0xffff, EncoderError::Flagged),
        ] {
            // At the position of the level, where no jump shows the error.
            let mut encoder = encoder(CONFIG, level & VALUE, 0.0);
            encoder.spi.level = Some(level);
            assert_eq!(encoder.position(), Err(error));
            for _ in 0..9 {
                assert!(encoder.position().is_err(), "{level:#x}");
            }
            encoder.spi.level = None;
            let back = (0..4).find_map(|_| encoder.position().ok());
            assert!(back.is_some(), "{level:#x}");
        }
    }

    #[test]
    fn a_jump_is_dropped_and_needs_a_new_reference() {
        let mut encoder = encoder(CONFIG, 100, 0.0);
        assert_eq!(moved(&mut encoder, 2101), Err(EncoderError::Jump));
        assert_eq!(encoder.position(), Err(EncoderError::NoReference));
        let q = encoder.reference(0.8).unwrap();
        assert!((q - 2101.0 * COUNT).abs() < 1e-6);
        assert!(encoder.position().is_ok());
    }

    #[test]
    fn a_reference_that_is_not_finite_is_refused() {
        let mut encoder = encoder(CONFIG, 100, 0.0);
        for q in [f32::NAN, f32::INFINITY, 1e30] {
            assert_eq!(encoder.reference(q), Err(EncoderError::NoReference));
        }
        assert_eq!(encoder.position, None);
    }

    #[test]
    fn an_invalid_configuration_is_refused() {
        let cases = [
            (0, 0.0, 100),
            (0, f32::NAN, 100),
            (0, -1.0, 100),
            (0, 1.0, 0),
            (0, 1.0, 8192),
            (16_384, 1.0, 100),
        ];
        for (zero_counts, ratio, largest_step) in cases {
            let config = EncoderConfig {
                zero_counts,
                ratio,
                largest_step,
                ..CONFIG
            };
            let refused = AbsoluteEncoder::new(Chip::new(0), config).map(drop);
            assert_eq!(refused, Err(EncoderError::Configuration), "{config:?}");
        }
    }

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
}
