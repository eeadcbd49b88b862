//! A board with motor stage and encoder under test.

mod encoder;
mod stage;

use super::*;
use crate::hal::{
    AbsoluteEncoder, Chip, Direction, EncoderConfig, EncoderError, OutputError, TorqueScale,
};
use crate::safety::SafetyState;
use crate::session::tests::{self as session, ACK, N, nack, torque};
use crate::session::{BoardDescription, NoClock};
use crate::wire::{
    BoardMessage, Capabilities, HostMessage, NackReason, Pacing, SampleFrame, TorqueFrame,
};
use core::convert::Infallible;
use embedded_hal::digital::ErrorType;
use embedded_hal::spi::{ErrorKind, Operation, SpiDevice};
use foretorque::joint::{JointMeasurement, JointMotion, JointSample, JointVector};
use foretorque::limits::Flags;
use std::cell::RefCell;
use std::rc::Rc;

/// The shoulder, which carries the arm.
const JOINT: usize = 1;
const SCALE: TorqueScale = TorqueScale {
    gain_nm_per_a: 12.5,
    full_scale_a: 16.0,
    limit_nm: 150.0,
};
const FULL_SCALE_NM: f32 = 200.0;

/// State of the motor stage's pins and output.
#[derive(Default)]
struct Bench {
    enabled: bool,
    fault: bool,
    levels: Vec<f32>,
    output_fails: bool,
}

/// Every pin and the output of the motor stage.
#[derive(Clone, Default)]
struct Pins(Rc<RefCell<Bench>>);

impl ErrorType for Pins {
    type Error = Infallible;
}

impl OutputPin for Pins {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.0.borrow_mut().enabled = false;
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        self.0.borrow_mut().enabled = true;
        Ok(())
    }
}

impl InputPin for Pins {
    fn is_high(&mut self) -> Result<bool, Infallible> {
        Ok(!self.0.borrow().fault)
    }

    fn is_low(&mut self) -> Result<bool, Infallible> {
        Ok(self.0.borrow().fault)
    }
}

impl TorqueOutput for Pins {
    fn command(&mut self, level: f32) -> Result<(), OutputError> {
        let mut bench = self.0.borrow_mut();
        if bench.output_fails {
            return Err(OutputError::Bus(ErrorKind::Other));
        }
        bench.levels.push(level);
        Ok(())
    }
}

/// The bus of a chip that the test holds too.
#[derive(Clone)]
struct Bus(Rc<RefCell<Chip>>);

impl embedded_hal::spi::ErrorType for Bus {
    type Error = ErrorKind;
}

impl SpiDevice for Bus {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), ErrorKind> {
        self.0.borrow_mut().transaction(operations)
    }
}

/// A board with a stage and an encoder, in the order of calls of its firmware.
struct Board {
    board: session::Board,
    stage: JointStage<Pins, Pins, Pins>,
    encoder: JointEncoder<Bus>,
    chip: Rc<RefCell<Chip>>,
    bench: Rc<RefCell<Bench>>,
}

impl Board {
    fn new(turn: TurnReference) -> Self {
        let mut description = BoardDescription::plain(NoClock);
        description.capabilities = description.capabilities | Capabilities::TIMER;
        let (pins, chip) = (Pins::default(), Rc::new(RefCell::new(Chip::new(0))));
        let stage = MotorStage::new(pins.clone(), pins.clone(), pins.clone(), SCALE).unwrap();
        let config = EncoderConfig {
            zero_counts: 0,
            direction: Direction::Same,
            ratio: 1.0,
            largest_step: 1000,
        };
        let encoder = AbsoluteEncoder::new(Bus(chip.clone()), config).unwrap();
        Self {
            board: session::Board::described(description),
            stage: JointStage::new(stage, JOINT),
            encoder: JointEncoder::new(encoder, JOINT, turn),
            chip,
            bench: pins.0,
        }
    }

    fn armed(turn: TurnReference) -> Self {
        let mut board = Self::new(turn);
        for _ in 0..5 {
            assert_eq!(board.sample(&still(0.0)).total, [0.0; N]);
        }
        assert_eq!(board.request(HostMessage::Arm), ACK);
        board.samples(40);
        assert!(board.enabled());
        board
    }

    fn request(&mut self, message: HostMessage<N>) -> BoardMessage<N> {
        self.stage.check(&mut self.board.session);
        let frame = self.board.numbered(&message);
        let sensor = &mut self.encoder;
        let mut replies = self.board.output(|session, mailboxes, out| {
            session.receive(&frame, mailboxes, out, sensor);
        });
        self.stage.apply(&mut self.board.session);
        replies.remove(0).1
    }

    /// One period of the timer.
    fn timer(&mut self) {
        let sensor = &mut self.encoder;
        self.board.output(|session, mailboxes, out| {
            session.timer_tick(mailboxes, out, sensor);
        });
        self.stage.apply(&mut self.board.session);
    }

    fn sample(&mut self, sample: &JointSample<N>) -> TorqueFrame<N> {
        torque(&self.request(HostMessage::Sample(SampleFrame::new(sample))))
    }

    /// Samples of the arm at rest.
    fn samples(&mut self, count: u32) {
        (0..count).for_each(|_| _ = self.sample(&still(0.0)));
    }

    #[track_caller]
    fn assert_refused(&mut self, reason: SafetyReason) {
        let refused = nack(NackReason::Unsafe(reason));
        assert_eq!(self.request(HostMessage::Arm), refused);
    }

    fn enabled(&self) -> bool {
        self.bench.borrow().enabled
    }

    fn level(&self) -> f32 {
        *self.bench.borrow().levels.last().unwrap()
    }
}

/// The stretched arm at rest; the host measures its joint at `host_q`, rad.
fn still(host_q: f32) -> JointSample<N> {
    let mut q = JointVector::zeros();
    q[JOINT] = host_q;
    JointSample {
        desired: JointMotion::zero(),
        measured: Some(JointMeasurement {
            q,
            tau: JointVector::zeros(),
        }),
    }
}
