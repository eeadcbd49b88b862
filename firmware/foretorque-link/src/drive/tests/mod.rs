//! A board with stage and encoder in the hands of the test; the tests are in the rooms below.

mod encoder;
mod stage;

use super::*;
use crate::hal::{
    AbsoluteEncoder, Chip, Direction, EncoderConfig, EncoderError, OutputError, TorqueScale,
};
use crate::safety::SafetyState;
use crate::session::{BoardDescription, Mailboxes, NoClock};
use crate::wire::{
    BoardMessage, Capabilities, Configuration, Decoder, FrameBuffer, HostMessage, NackReason,
    Pacing, SampleFrame, TorqueFrame,
};
use core::convert::Infallible;
use embedded_hal::digital::ErrorType;
use embedded_hal::spi::{ErrorKind, Operation, SpiDevice};
use foretorque::arm::ur5::{JOINTS as N, PARAMETERS as P, Ur5};
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

/// The hardware around the board, in the hands of the test.
#[derive(Default)]
struct Bench {
    enabled: bool,
    fault: bool,
    levels: Vec<f32>,
    output_gone: bool,
}

#[derive(Clone, Default)]
struct Hands(Rc<RefCell<Bench>>);

impl ErrorType for Hands {
    type Error = Infallible;
}

impl OutputPin for Hands {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.0.borrow_mut().enabled = false;
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        self.0.borrow_mut().enabled = true;
        Ok(())
    }
}

impl InputPin for Hands {
    fn is_high(&mut self) -> Result<bool, Infallible> {
        Ok(!self.0.borrow().fault)
    }

    fn is_low(&mut self) -> Result<bool, Infallible> {
        Ok(self.0.borrow().fault)
    }
}

impl TorqueOutput for Hands {
    fn command(&mut self, level: f32) -> Result<(), OutputError> {
        let mut bench = self.0.borrow_mut();
        if bench.output_gone {
            return Err(OutputError::Bus(ErrorKind::Other));
        }
        bench.levels.push(level);
        Ok(())
    }
}

/// The chip on its bus, and in the hands of the test.
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

/// A board with a stage and an encoder, as its firmware runs it.
struct Board {
    session: Session<Ur5, N, P>,
    mailboxes: Mailboxes<N, P>,
    stage: JointStage<Hands, Hands, Hands>,
    encoder: JointEncoder<Bus>,
    chip: Rc<RefCell<Chip>>,
    bench: Rc<RefCell<Bench>>,
    sequence: u16,
}

impl Board {
    fn new(turn: TurnReference) -> Self {
        let (hands, chip) = (Hands::default(), Rc::new(RefCell::new(Chip::new(0))));
        let stage = MotorStage::new(hands.clone(), hands.clone(), hands.clone(), SCALE).unwrap();
        let config = EncoderConfig {
            zero_counts: 0,
            direction: Direction::Same,
            ratio: 1.0,
            largest_step: 1000,
        };
        let encoder = AbsoluteEncoder::new(Bus(chip.clone()), config).unwrap();
        Self {
            session: Session::new(BoardDescription::plain(NoClock)).unwrap(),
            mailboxes: Mailboxes::new(),
            stage: JointStage::new(stage, JOINT),
            encoder: JointEncoder::new(encoder, JOINT, turn),
            chip,
            bench: hands.0,
            sequence: 0,
        }
    }

    /// Act on a received frame as the firmware does.
    fn ask(&mut self, message: HostMessage<N>) -> BoardMessage<N> {
        self.sequence += 1;
        let (mut frame, mut out) = (FrameBuffer::new(), FrameBuffer::new());
        frame.push(self.sequence, &message).unwrap();
        self.stage.check(&mut self.session);
        let (mailboxes, sensor) = (&mut self.mailboxes, &mut self.encoder);
        self.session
            .receive(frame.as_bytes(), mailboxes, &mut out, sensor);
        self.stage.apply(&mut self.session);
        let mut decoder = Decoder::new();
        let heard = out.as_bytes().iter().find_map(|&byte| {
            let frame = decoder.push(byte)?;
            Some(frame.unwrap().message().unwrap())
        });
        heard.unwrap()
    }

    fn sample(&mut self, sample: &JointSample<N>) -> TorqueFrame<N> {
        match self.ask(HostMessage::Sample(SampleFrame::new(sample))) {
            BoardMessage::Torque(torque) => torque,
            other => panic!("{other:?}"),
        }
    }

    fn armed(turn: TurnReference) -> Self {
        let mut board = Self::new(turn);
        for _ in 0..5 {
            assert_eq!(board.sample(&still(0.0)).total, [0.0; N]);
        }
        assert_eq!(board.ask(HostMessage::Arm), BoardMessage::Ack);
        for _ in 0..40 {
            board.sample(&still(0.0));
        }
        assert!(board.bench.borrow().enabled);
        board
    }

    fn refusal(&mut self) -> SafetyReason {
        match self.ask(HostMessage::Arm) {
            BoardMessage::Nack(NackReason::Unsafe(reason)) => reason,
            other => panic!("{other:?}"),
        }
    }

    fn level(&self) -> f32 {
        *self.bench.borrow().levels.last().unwrap()
    }
}

/// The arm stretched out at rest, as the host knows it: its own figure for the joint is `told`, rad.
fn still(told: f32) -> JointSample<N> {
    let mut q = JointVector::zeros();
    q[JOINT] = told;
    JointSample {
        desired: JointMotion::zero(),
        measured: Some(JointMeasurement {
            q,
            tau: JointVector::zeros(),
        }),
    }
}

/// The position the tick had, as the telemetry would say: judged by what the safety compares it with.
fn far(board: &mut Board) -> bool {
    board.refusal() == SafetyReason::TooFar
}
