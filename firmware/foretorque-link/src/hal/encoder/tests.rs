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
        // At the position of the level, where no jump shows the error; the turn stays known for as long.
        let config = EncoderConfig {
            largest_step: 500,
            ..CONFIG
        };
        let mut encoder = encoder(config, level & VALUE, 0.0);
        encoder.spi.level = Some(level);
        assert_eq!(encoder.position(), Err(error));
        for _ in 0..3 {
            assert!(encoder.position().is_err(), "{level:#x}");
        }
        encoder.spi.level = None;
        let back = (0..4).find_map(|_| encoder.position().ok());
        assert!(back.is_some(), "{level:#x}");
    }
}

#[test]
fn the_turn_is_known_until_the_joint_may_be_half_a_turn_away() {
    let config = EncoderConfig {
        largest_step: 160,
        ..CONFIG
    };
    for (missed, moves, known) in [(49, 7800, true), (49, 8100, false), (51, 0, false)] {
        let mut encoder = encoder(config, 100, 0.0);
        encoder.miss(missed);
        let position = moved(&mut encoder, 100 + moves);
        assert_eq!(position.is_ok(), known, "{missed} {moves}: {position:?}");
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
