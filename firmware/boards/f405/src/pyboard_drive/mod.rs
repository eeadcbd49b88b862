//! The third board: a pyboard v1.1 that drives its own joint, with a servo drive or inverter that takes its torque command
//! as pulse width and direction, and an AS5047 class encoder.
//!
//! Card and chip are those of [`Pyboard`]; here is what this board has besides. **Scale, signs and zero are
//! an example: they belong to one joint and its drive, and docs/board.md describes how to find them.** Sources: as there, and the
//! data sheets AS5047P v1-06 and DS8626, table 9 (alternate functions).

mod peripherals;

use core::cell::Cell;

use cortex_m::interrupt::{self, Mutex};
use foretorque::joint::JointSample;
use foretorque_link::drive::{JointEncoder, JointStage, TurnReference};
use foretorque_link::hal::{
    AbsoluteEncoder, Direction, EncoderConfig, EncoderError, MotorStage, PwmWithDirection,
    StageError, TorqueScale,
};
use foretorque_link::safety::SafetyReason;
use foretorque_link::session::LocalSensor;
use stm32f4xx_hal::gpio::{PinState, Speed};
use stm32f4xx_hal::pac::{SPI1, TIM1};
use stm32f4xx_hal::prelude::*;
use stm32f4xx_hal::rcc::Rcc;

use crate::arm::{BoardSession, JOINTS};
use crate::board::{Board, Drive, Pin, Ports, start_link};
use crate::clock::Clocks;
use crate::pyboard::Pyboard;
use peripherals::{DirectionPin, EncoderDevice, FaultInput, Pulse, StageEnable};

/// The joint that this board drives, from 0: the shoulder lift.
const JOINT: usize = 1;
const _: () = assert!(JOINT < JOINTS);

/// From torque to pulse width. The gain is also that of the bank if currents are measured.
const SCALE: TorqueScale = TorqueScale {
    gain_nm_per_a: 12.5,
    // At a duty of 1: what the drive is set to take for its largest current command.
    full_scale_a: 16.0,
    limit_nm: 150.0,
};
const _: () = assert!(SCALE.usable());

/// Timer of the pulse width, channel 1N on PB13 (Y6), alternate function 1: the one timer whose break input the card has
/// on a pin, so that a fault of the stage ends the pulses without the processor.
type PulseTimer = TIM1;
/// Counts of a period, and so of a full duty: 20 kHz from 168 MHz, above hearing; one count is 1/8400 of the full scale.
/// From the bare oscillator of 16 MHz it is 1.9 kHz.
const PULSE_TOP: u16 = 8400;
/// Direction of the torque: PB9 (Y4), high for +.
const DIRECTION: Pin = Pin::B(9);
/// Fault of the stage, active low: PB12 (Y5), which is also the break input of the timer, alternate function 1.
const FAULT: Pin = Pin::B(12);

/// Bus of the encoder: clock PA5 (X6), from the chip PA6 (X7), to the chip PA7 (X8), alternate function 5.
type EncoderBus = SPI1;
/// Chip select of the encoder: PA4 (X5), active low.
const SELECT: Pin = Pin::A(4);
/// Division of APB2 for the clock of the bus, 2^(n + 1): 84 MHz / 16 = 5.25 MHz; 10 MHz are allowed.
const ENCODER_DIVIDER: u8 = 3;
/// Cycles from select to clock, clock to select, and between frames: at least 350 ns (AS5047P, SPI timing), 59 at 168 MHz.
const SELECT_CYCLES: u32 = 64;
/// Reads of the ready flag before a byte is given up. A byte takes 256 cycles, a read at least three.
const ENCODER_POLLS: u32 = 200;

/// Zero, sign and ratio of the encoder: on the link, counting with +q. 160 counts from a reading to the next are 0.061 rad, more
/// than the joint can move in 19 ms; 51 of them are below half a turn, so at 1 kHz readings may fail for 50 ms.
const ENCODER: EncoderConfig = EncoderConfig {
    zero_counts: 0,
    direction: Direction::Same,
    ratio: 1.0,
    largest_step: 160,
};
/// One turn of the encoder is one of the joint: at start it is taken to be within ± π.
const TURN: TurnReference = TurnReference::Near(0.0);

/// The board.
pub struct PyboardDrive;

impl Board for PyboardDrive {
    const NAME: &'static str = "pyboard-v1.1 with drive";
    const CRYSTAL_HZ: u32 = Pyboard::CRYSTAL_HZ;
    const ENABLE: Pin = Pyboard::ENABLE;
    const BRAKE: Option<Pin> = Pyboard::BRAKE;
    const OWN_JOINT: Option<usize> = Some(JOINT);

    type Drive = StageAndEncoder;

    /// Direction low, no pulses, encoder not selected, link as on the card.
    fn start_pins(ports: Ports, rcc: &mut Rcc) {
        rcc.apb2enr()
            .modify(|_, w| w.tim1en().enabled().spi1en().enabled());
        let a = ports.a.split(rcc);
        let b = ports.b.split(rcc);
        b.pb8.into_push_pull_output_in_state(PinState::Low);
        b.pb9.into_push_pull_output_in_state(PinState::Low);
        b.pb10.into_push_pull_output_in_state(PinState::Low);
        b.pb13.into_alternate::<1>();
        // A line that is not plugged in is a fault. The open drain of the drive has its pull-up, 4.7 kΩ, on the drive's side.
        b.pb12.into_alternate::<1>().internal_pull_down(true);
        a.pa4.into_push_pull_output_in_state(PinState::High);
        // A clock line with slower edges corrupts the last bit of what is received at 84 MHz of the bus (ES0182 2.12.4).
        a.pa5.into_alternate::<5>().speed(Speed::High);
        a.pa6.into_alternate::<5>().internal_pull_up(true);
        a.pa7.into_alternate::<5>().speed(Speed::Medium);
        start_link(a.pa2, a.pa3);
    }
}

/// Errors of stage and encoder, for the log, which the tick does not write.
#[derive(Clone, Copy, PartialEq)]
struct Faults {
    stage: Option<StageError>,
    encoder: Option<EncoderError>,
}

impl Faults {
    const NONE: Self = Self {
        stage: None,
        encoder: None,
    };
}

static SEEN: Mutex<Cell<Faults>> = Mutex::new(Cell::new(Faults::NONE));
static LOGGED: Mutex<Cell<Faults>> = Mutex::new(Cell::new(Faults::NONE));

/// Motor stage and encoder of the own joint.
pub struct StageAndEncoder {
    stage: JointStage<PwmWithDirection<Pulse, DirectionPin>, StageEnable, FaultInput>,
    encoder: JointEncoder<EncoderDevice>,
}

impl LocalSensor<JOINTS> for StageAndEncoder {
    #[inline(always)]
    fn measure(&mut self, sample: &mut Option<JointSample<JOINTS>>, at_rest: bool) -> SafetyReason {
        self.encoder.measure(sample, at_rest)
    }

    #[inline(always)]
    fn silence(&mut self) {
        LocalSensor::<JOINTS>::silence(&mut self.encoder);
    }

    #[inline(always)]
    fn miss(&mut self, periods: u32) {
        LocalSensor::<JOINTS>::miss(&mut self.encoder, periods);
    }
}

impl Drive for StageAndEncoder {
    #[inline(always)]
    fn start(_: &Clocks) -> Option<Self> {
        let output = PwmWithDirection::new(Pulse::start(), DirectionPin);
        let stage = MotorStage::new(output, StageEnable, FaultInput, SCALE);
        let encoder = AbsoluteEncoder::new(EncoderDevice::start(), ENCODER);
        let mut encoder = JointEncoder::new(encoder.ok()?, JOINT, TURN);
        // The first frame only requests a reading, so that the first tick has a position.
        let _ = LocalSensor::<JOINTS>::measure(&mut encoder, &mut None, true);
        Some(Self {
            stage: JointStage::new(stage.ok()?, JOINT),
            encoder,
        })
    }

    fn watch(&mut self, session: &mut BoardSession) {
        self.stage.check(session);
    }

    fn follow(&mut self, session: &mut BoardSession) {
        self.stage.apply(session);
        let seen = Faults {
            stage: self.stage.last_error(),
            encoder: self.encoder.last_error(),
        };
        interrupt::free(|token| SEEN.borrow(token).set(seen));
    }

    fn report() {
        let (seen, logged) = interrupt::free(|token| {
            let seen = SEEN.borrow(token).get();
            (seen, LOGGED.borrow(token).replace(seen))
        });
        if let Some(error) = seen.stage.filter(|_| seen.stage != logged.stage) {
            defmt::error!("stage: {=istr}", error.interned());
        }
        if let Some(error) = seen.encoder.filter(|_| seen.encoder != logged.encoder) {
            defmt::warn!("encoder: {=istr}", error.interned());
        }
    }
}
