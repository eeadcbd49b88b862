use core::f32::consts::TAU;
use core::fmt;
use embedded_hal::spi::{Error as _, ErrorKind, SpiDevice};

/// Counts of one turn: 14 bits.
const TURN: i32 = 1 << 14;
const VALUE: u16 = 0x3fff;
/// Bit 14 of an answer: the command before was not understood.
const ERROR_FLAG: u16 = 1 << 14;

/// Which way the encoder counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// Counts grow with +q.
    Same,
    /// Counts fall with +q.
    Opposite,
}

/// How counts become the joint's position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EncoderConfig {
    /// Reading at q = 0, counts.
    pub zero_counts: u16,
    /// Which way it counts.
    pub direction: Direction,
    /// Turns of the encoder per turn of the joint: 1 on the link side, the gear ratio on the motor's shaft.
    pub ratio: f32,
    /// Largest change between two readings that is believed, counts; below half a turn, beyond which the way round cannot
    /// be told.
    pub largest_step: u16,
}

/// What went wrong with a reading.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EncoderError {
    /// The configuration cannot work: a ratio that is not positive, a step of half a turn or more.
    Configuration,
    /// The bus.
    Bus(ErrorKind),
    /// Parity of the answer: a bit was flipped on the line, or nobody is there.
    Parity,
    /// The chip flags an error of the frame before; its error register is read, and so cleared, next.
    Flagged,
    /// What the chip says was wrong: framing (bit 0), command (bit 1), parity (bit 2). The next reading is a position.
    Refused(u8),
    /// The first frame after a start, and the one after a bus error, bring the answer to nobody's question.
    Pipeline,
    /// The chip has not finished its start-up.
    NotReady,
    /// The magnet is too weak, or too far away.
    MagnetWeak,
    /// The magnet is too strong, or too near.
    MagnetStrong,
    /// The angle could not be computed: CORDIC overflow.
    Overflow,
    /// The reading moved farther than the joint can: it is not believed, and the count of turns is lost.
    Jump,
    /// The turn is not known: [`reference`](AbsoluteEncoder::reference) first.
    NoReference,
}

impl fmt::Display for EncoderError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Configuration => f.write_str("encoder configuration cannot work"),
            Self::Bus(kind) => write!(f, "encoder bus: {kind}"),
            Self::Parity => f.write_str("encoder answer with a wrong parity"),
            Self::Flagged => f.write_str("encoder flags an error"),
            Self::Refused(bits) => write!(f, "encoder refused a frame ({bits:#05b})"),
            Self::Pipeline => f.write_str("encoder has not been asked yet"),
            Self::NotReady => f.write_str("encoder is not ready"),
            Self::MagnetWeak => f.write_str("encoder magnet too weak"),
            Self::MagnetStrong => f.write_str("encoder magnet too strong"),
            Self::Overflow => f.write_str("encoder angle overflow"),
            Self::Jump => f.write_str("encoder reading jumped"),
            Self::NoReference => f.write_str("encoder turn not known"),
        }
    }
}

impl core::error::Error for EncoderError {}

/// What an encoder carries from reading to reading.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EncoderState {
    /// Position in counts over all turns since the reference, zero offset taken out; `None` while the turn is not known.
    /// Wraps after 131 072 turns.
    pub position: Option<i32>,
    /// Readings that failed since the last good one. Saturates.
    pub failed: u16,
    /// What the next frame brings the answer to.
    asked: Option<Register>,
}

/// Registers of the chip that are read here (AS5047P data sheet v1-06, table 21).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Register {
    Errors = 0x0001,
    Diagnostics = 0x3ffc,
    /// With the dynamic angle error compensation, which takes the latency of the chip out.
    Angle = 0x3fff,
}

impl Register {
    /// The 16 bits that ask for it: bit 14 reads, bit 15 makes the number of ones even.
    const fn read(self) -> u16 {
        let command = self as u16 | 1 << 14;
        command | ((command.count_ones() as u16 & 1) << 15)
    }
}

/// A magnetic absolute encoder of the AS5047 class on an SPI bus of its own chip select: mode 1, at most 10 MHz.
///
/// The chip answers a question in the next frame, so one frame a tick both brings the position asked for in the tick
/// before and asks for the next. The position counts on over turns, starting from a [`reference`](Self::reference).
///
/// ```text
/// q = direction · 2π / (16384 · ratio) · (counts over all turns − zero)
/// ```
///
/// Pull the chip's data line up: without a chip it then reads all ones, which is flagged, while all zeros are a position.
/// One count is 0.383 mrad / ratio. The f32 is exact to a count within 1024 turns of the encoder.
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
/// # frames.extend(frame([0xff, 0xff], [0x01, 0x80]));
/// # frames.extend(frame([0xff, 0xff], [0x90, 0x00]));
/// # frames.extend(frame([0xff, 0xff], [0x90, 0x00]));
/// # let spi = Mock::new(&frames);
/// use foretorque::edge::hal::{AbsoluteEncoder, Direction, EncoderConfig};
/// let config = EncoderConfig { zero_counts: 0, direction: Direction::Same, ratio: 1.0, largest_step: 1000 };
/// let mut encoder = AbsoluteEncoder::new(spi, config)?;
/// encoder.start()?;
/// encoder.reference(1.6)?;
/// let q = encoder.position()?;
/// assert!((q - core::f32::consts::FRAC_PI_2).abs() < 1e-6);
/// # encoder.release().done();
/// # Ok::<(), foretorque::edge::hal::EncoderError>(())
/// ```
#[derive(Debug)]
pub struct AbsoluteEncoder<Spi> {
    spi: Spi,
    config: EncoderConfig,
    state: EncoderState,
    rad_per_count: f32,
}

impl<Spi: SpiDevice> AbsoluteEncoder<Spi> {
    /// Takes the device and says nothing to it.
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
            state: EncoderState::default(),
            rad_per_count: sign * TAU / (TURN as f32 * config.ratio),
        })
    }

    /// Asks the chip how it is: start-up finished, magnet in range. Two frames; the next reading has been asked for.
    ///
    /// Errors: `NotReady`, `MagnetWeak`, `MagnetStrong`, `Overflow`; those of a frame.
    pub fn start(&mut self) -> Result<(), EncoderError> {
        const READY: u16 = 1 << 8;
        const OVERFLOW: u16 = 1 << 9;
        const STRONG: u16 = 1 << 10;
        const WEAK: u16 = 1 << 11;
        // The answer to whatever was asked before, by whomever.
        self.exchange(Register::Diagnostics)?;
        let seen = self.value(Register::Angle)?;
        for (bit, bad_when, error) in [
            (READY, 0, EncoderError::NotReady),
            (OVERFLOW, OVERFLOW, EncoderError::Overflow),
            (STRONG, STRONG, EncoderError::MagnetStrong),
            (WEAK, WEAK, EncoderError::MagnetWeak),
        ] {
            if seen & bit == bad_when {
                return Err(error);
            }
        }
        Ok(())
    }

    /// Takes the turn in which the joint is nearest to `q`, rad: how a single-turn encoder behind a gear learns where it
    /// is. One frame.
    ///
    /// Errors: those of a frame; `NoReference` where `q` is no position. The turn is then not known.
    pub fn reference(&mut self, q: f32) -> Result<f32, EncoderError> {
        self.state.position = None;
        let within = self.read()?;
        let wanted = q / self.rad_per_count;
        let turns = (wanted - within as f32) / TURN as f32;
        // Half of what an i32 counts.
        if turns.is_nan() || turns.abs() > 65_536.0 {
            return Err(EncoderError::NoReference);
        }
        let half = if turns < 0.0 { -0.5 } else { 0.5 };
        let position = within + TURN * (turns + half) as i32;
        self.state.position = Some(position);
        Ok(self.rad(position))
    }

    /// The joint's position, rad, as asked for by the frame before. One frame; two when the chip flags an error.
    ///
    /// Errors: those of a frame; `NoReference`; `Jump`, after which the turn is not known. Others leave the count of turns
    /// as it was: it goes on if the joint has moved less than `largest_step` when the next reading is good.
    pub fn position(&mut self) -> Result<f32, EncoderError> {
        let within = self.read()?;
        let last = self.state.position.ok_or(EncoderError::NoReference)?;
        // The shortest way round, from −half a turn to half a turn.
        let apart = within.wrapping_sub(last).wrapping_add(TURN / 2);
        let step = (apart & (TURN - 1)) - TURN / 2;
        if step.abs() > i32::from(self.config.largest_step) {
            self.state.position = None;
            return Err(EncoderError::Jump);
        }
        let position = last.wrapping_add(step);
        self.state.position = Some(position);
        Ok(self.rad(position))
    }

    /// What is carried from reading to reading.
    pub const fn state(&self) -> &EncoderState {
        &self.state
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
        let reading = self.value_of_angle();
        self.state.failed = match reading {
            Ok(_) => 0,
            Err(_) => self.state.failed.saturating_add(1),
        };
        let counts = i32::from(reading?) - i32::from(self.config.zero_counts);
        Ok(counts & (TURN - 1))
    }

    fn value_of_angle(&mut self) -> Result<u16, EncoderError> {
        match self.state.asked {
            Some(Register::Angle) => self.value(Register::Angle),
            Some(Register::Errors) => {
                let errors = self.value(Register::Angle)?;
                Err(EncoderError::Refused(errors as u8 & 7))
            }
            _ => {
                self.exchange(Register::Angle)?;
                Err(EncoderError::Pipeline)
            }
        }
    }

    /// The value that was asked for by the frame before, while `next` is asked for.
    fn value(&mut self, next: Register) -> Result<u16, EncoderError> {
        // The error register's own answer still carries the flag that reading it clears.
        let clearing = self.state.asked == Some(Register::Errors);
        let answer = self.exchange(next)?;
        if answer.count_ones() & 1 != 0 {
            return Err(EncoderError::Parity);
        }
        if answer & ERROR_FLAG != 0 && !clearing {
            // Asked at once, in a frame of its own: the position that this frame asked for is thrown away.
            self.exchange(Register::Errors)?;
            return Err(EncoderError::Flagged);
        }
        Ok(answer & VALUE)
    }

    /// One frame of 16 bits each way.
    fn exchange(&mut self, question: Register) -> Result<u16, EncoderError> {
        let mut frame = question.read().to_be_bytes();
        // Whether the chip heard a frame that failed is not known: then the next answer is nobody's.
        self.state.asked = None;
        let sent = self.spi.transfer_in_place(&mut frame);
        sent.map_err(|error| EncoderError::Bus(error.kind()))?;
        self.state.asked = Some(question);
        Ok(u16::from_be_bytes(frame))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use embedded_hal::spi::{ErrorType, Operation};

    /// The chip: answers in the next frame, with parity, and flags what it does not understand.
    #[derive(Default)]
    struct Chip {
        angle: u16,
        diagnostics: u16,
        errors: u16,
        pending: u16,
        frames: usize,
        /// Bits flipped on the way to the chip, and on the way back, in the next frame.
        flips: (u16, u16),
        gone: bool,
    }

    impl Chip {
        fn new(angle: u16) -> Self {
            Self {
                angle,
                diagnostics: 1 << 8,
                ..Self::default()
            }
        }

        fn hear(&mut self, command: u16) {
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
            let (to, from) = core::mem::take(&mut self.flips);
            let command = u16::from_be_bytes([bytes[0], bytes[1]]) ^ to;
            bytes.copy_from_slice(&(self.pending ^ from).to_be_bytes());
            self.hear(command);
            Ok(())
        }
    }

    const CONFIG: EncoderConfig = EncoderConfig {
        zero_counts: 0,
        direction: Direction::Same,
        ratio: 1.0,
        largest_step: 2000,
    };

    /// An encoder that has started, at `angle` counts with the joint near `q`.
    fn encoder(config: EncoderConfig, angle: u16, q: f32) -> AbsoluteEncoder<Chip> {
        let mut encoder = AbsoluteEncoder::new(Chip::new(angle), config).unwrap();
        encoder.start().unwrap();
        encoder.reference(q).unwrap();
        encoder
    }

    /// Moves the chip and reads twice, because the first answer is of before.
    fn moved(encoder: &mut AbsoluteEncoder<Chip>, angle: u16) -> Result<f32, EncoderError> {
        encoder.spi.angle = angle;
        encoder.position()?;
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
    fn the_count_goes_on_over_turns_in_both_directions() {
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
        assert_eq!(encoder.state().position, Some(15_000 - 9 * TURN));
    }

    #[test]
    fn one_frame_a_reading() {
        let mut encoder = encoder(CONFIG, 10, 0.0);
        let before = encoder.spi.frames;
        for _ in 0..5 {
            encoder.position().unwrap();
        }
        assert_eq!(encoder.spi.frames, before + 5);
    }

    #[test]
    fn the_chips_own_troubles_are_told_at_the_start() {
        for (diagnostics, error) in [
            (0, EncoderError::NotReady),
            (0x300, EncoderError::Overflow),
            (0x500, EncoderError::MagnetStrong),
            (0x900, EncoderError::MagnetWeak),
        ] {
            let mut chip = Chip::new(0);
            chip.diagnostics = diagnostics;
            let mut encoder = AbsoluteEncoder::new(chip, CONFIG).unwrap();
            assert_eq!(encoder.start(), Err(error));
        }
    }

    #[test]
    fn a_flipped_bit_of_an_answer_is_seen_whichever_it_is() {
        for bit in 0..16 {
            let mut encoder = encoder(CONFIG, 1234, 0.5);
            encoder.spi.flips = (0, 1 << bit);
            assert_eq!(encoder.position(), Err(EncoderError::Parity), "bit {bit}");
            assert_eq!(encoder.state().failed, 1);
            assert_eq!(encoder.position(), Ok(1234.0 * COUNT));
            assert_eq!(encoder.state().failed, 0);
        }
    }

    #[test]
    fn a_flipped_bit_of_a_command_is_flagged_explained_and_over() {
        for bit in 0..16 {
            let mut encoder = encoder(CONFIG, 1234, 0.5);
            encoder.spi.flips = (1 << bit, 0);
            assert_eq!(encoder.position(), Ok(1234.0 * COUNT));
            assert_eq!(encoder.position(), Err(EncoderError::Flagged), "bit {bit}");
            let told = encoder.position();
            assert!(
                matches!(told, Err(EncoderError::Refused(bits)) if bits & 4 != 0),
                "bit {bit}: {told:?}"
            );
            assert_eq!(encoder.position(), Ok(1234.0 * COUNT));
        }
    }

    #[test]
    fn after_a_bus_error_the_next_answer_is_nobodys_and_the_turn_is_kept() {
        let mut encoder = encoder(CONFIG, 100, TAU);
        encoder.spi.gone = true;
        let overrun = Err(EncoderError::Bus(ErrorKind::Overrun));
        assert_eq!([encoder.position(), encoder.position()], [overrun; 2]);
        encoder.spi.gone = false;
        assert_eq!(encoder.position(), Err(EncoderError::Pipeline));
        assert_eq!(encoder.state().failed, 3);
        let q = encoder.position().unwrap();
        assert!((q - 16_484.0 * COUNT).abs() < 1e-6, "{q}");
    }

    #[test]
    fn nobody_on_the_line_is_not_a_position() {
        for level in [0x0000, 0xffff] {
            let mut encoder = encoder(CONFIG, 100, 0.0);
            // A line that is always low or always high, whatever the chip would have said.
            encoder.spi.flips = (0, encoder.spi.pending ^ level);
            let seen = encoder.position();
            match level {
                0xffff => assert_eq!(seen, Err(EncoderError::Flagged)),
                // All zeros have even parity: only the size of the step can tell, and a short one cannot.
                _ => assert_eq!(seen, Ok(0.0)),
            }
        }
    }

    #[test]
    fn a_jump_is_not_believed_and_asks_for_a_new_reference() {
        let mut encoder = encoder(CONFIG, 100, 0.0);
        assert_eq!(moved(&mut encoder, 2101), Err(EncoderError::Jump));
        assert_eq!(encoder.position(), Err(EncoderError::NoReference));
        let q = encoder.reference(0.8).unwrap();
        assert!((q - 2101.0 * COUNT).abs() < 1e-6);
        assert!(encoder.position().is_ok());
    }

    #[test]
    fn a_reference_that_is_no_position_is_refused() {
        let mut encoder = encoder(CONFIG, 100, 0.0);
        for q in [f32::NAN, f32::INFINITY, 1e30] {
            assert_eq!(encoder.reference(q), Err(EncoderError::NoReference));
        }
        assert_eq!(encoder.state().position, None);
    }

    #[test]
    fn a_configuration_that_cannot_work_is_refused() {
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
}
