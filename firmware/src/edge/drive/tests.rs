use super::*;
use crate::arm::ur5::{JOINTS as N, PARAMETERS as P, Ur5};
use crate::edge::hal::{
    AbsoluteEncoder, Chip, Direction, EncoderConfig, EncoderError, OutputError, TorqueScale,
};
use crate::edge::safety::SafetyState;
use crate::edge::session::{BoardDescription, Desk, NoClock};
use crate::edge::wire::{
    BoardMessage, Capabilities, Configuration, Decoder, FrameBuffer, HostMessage, NackReason,
    Pacing, SampleFrame, TorqueFrame,
};
use crate::joint::{JointMeasurement, JointMotion, JointSample, JointVector};
use crate::limits::Flags;
use core::convert::Infallible;
use embedded_hal::digital::ErrorType;
use embedded_hal::spi::{ErrorKind, Operation, SpiDevice};
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
    desk: Desk<N, P>,
    stage: JointStage<Hands, Hands, Hands>,
    encoder: JointEncoder<Bus>,
    chip: Rc<RefCell<Chip>>,
    bench: Rc<RefCell<Bench>>,
    sequence: u16,
}

impl Board {
    fn new(turn: Turn) -> Self {
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
            desk: Desk::new(),
            stage: JointStage::new(stage, JOINT),
            encoder: JointEncoder::new(encoder, JOINT, turn),
            chip,
            bench: hands.0,
            sequence: 0,
        }
    }

    /// What the firmware does when a frame has come.
    fn ask(&mut self, message: HostMessage<N>) -> BoardMessage<N> {
        self.sequence += 1;
        let (mut frame, mut out) = (FrameBuffer::new(), FrameBuffer::new());
        frame.push(self.sequence, &message).unwrap();
        self.stage.watch(&mut self.session);
        let (desk, own) = (&mut self.desk, &mut self.encoder);
        self.session
            .receive_with(frame.as_bytes(), desk, &mut out, own);
        self.stage.follow(&mut self.session);
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

    fn armed(turn: Turn) -> Self {
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

#[test]
fn the_stage_gets_the_joints_own_torque_at_its_scale_while_the_board_is_armed() {
    let mut board = Board::armed(Turn::Near(0.0));
    for k in 0..200 {
        let mut sample = still(0.0);
        sample.desired.qd[JOINT] = (k as f32 * 0.05).sin() * 0.2;
        sample.desired.qdd[JOINT] = (k as f32 * 0.05).cos() * 4.0;
        let torque = board.sample(&sample).total[JOINT];
        assert!((board.level() - torque / FULL_SCALE_NM).abs() < 1e-6, "{k}");
        assert!(torque.abs() > 1.0, "{torque}");
    }
    assert_eq!(board.ask(HostMessage::Disarm), BoardMessage::Ack);
    let mut ramp = 0;
    while board.sample(&still(0.0)).safety.state == SafetyState::RampDown {
        assert!(board.bench.borrow().enabled, "the torque is not zero yet");
        ramp += 1;
    }
    assert!(ramp > 1, "it ramps");
    assert!(!board.bench.borrow().enabled);
    assert_eq!(board.level(), 0.0);
}

#[test]
fn one_command_goes_out_in_a_tick_and_none_between_ticks() {
    let mut board = Board::armed(Turn::Near(0.0));
    let before = board.bench.borrow().levels.len();
    for k in 1..=10 {
        let mut sample = still(0.0);
        sample.desired.qdd[JOINT] = k as f32 * 0.1;
        board.sample(&sample);
        board.ask(HostMessage::Statistics);
        assert_eq!(board.bench.borrow().levels.len(), before + k);
    }
}

#[test]
fn a_stop_switches_the_stage_off_before_it_is_answered() {
    let mut board = Board::armed(Turn::Near(0.0));
    assert_eq!(board.ask(HostMessage::Stop), BoardMessage::Ack);
    assert!(!board.bench.borrow().enabled);
    assert_eq!(board.level(), 0.0);
}

#[test]
fn silence_brings_the_stage_to_rest() {
    let mut board = Board::armed(Turn::Near(0.0));
    let mut out = FrameBuffer::new();
    for _ in 0..100 {
        board
            .session
            .timer_tick_with(&mut board.desk, &mut out, &mut board.encoder);
        board.stage.follow(&mut board.session);
    }
    assert!(!board.bench.borrow().enabled);
    assert_eq!(board.level(), 0.0);
    assert_eq!(board.session.safety().reason, SafetyReason::CommandTimeout);
}

#[test]
fn a_stage_with_a_fault_is_off_at_once_and_the_host_is_told_in_the_same_tick() {
    let mut board = Board::armed(Turn::Near(0.0));
    board.bench.borrow_mut().fault = true;
    let reply = board.sample(&still(0.0));
    assert!(!board.bench.borrow().enabled);
    assert_eq!(board.level(), 0.0);
    assert_eq!(reply.total, [0.0; N]);
    assert_eq!(reply.safety.state, SafetyState::Fault);
    assert_eq!(reply.safety.reason, SafetyReason::Drive);
    assert_eq!(board.stage.trouble(), Some(StageError::Fault));
    // Clearing what is still there lasts until the next tick.
    assert_eq!(board.ask(HostMessage::ClearFault), BoardMessage::Ack);
    assert_eq!(board.refusal(), SafetyReason::Drive);
    board.bench.borrow_mut().fault = false;
    assert_eq!(board.refusal(), SafetyReason::Drive, "it is latched");
    assert_eq!(board.ask(HostMessage::ClearFault), BoardMessage::Ack);
    assert_eq!(board.ask(HostMessage::Arm), BoardMessage::Ack);
    assert!(board.bench.borrow().enabled);
}

#[test]
fn a_fault_at_boot_refuses_to_arm() {
    let mut board = Board::new(Turn::Near(0.0));
    board.bench.borrow_mut().fault = true;
    for _ in 0..5 {
        let safety = board.sample(&still(0.0)).safety;
        assert_eq!(safety.reason, SafetyReason::Drive);
    }
    assert_eq!(board.refusal(), SafetyReason::Drive);
    assert!(!board.bench.borrow().enabled);
}

#[test]
fn a_command_that_does_not_get_out_switches_off_and_latches() {
    let mut board = Board::armed(Turn::Near(0.0));
    board.bench.borrow_mut().output_gone = true;
    let mut sample = still(0.0);
    sample.desired.qdd[JOINT] = 1.0;
    board.sample(&sample);
    assert!(!board.bench.borrow().enabled);
    let after = board.sample(&still(0.0));
    assert_eq!(after.total, [0.0; N]);
    assert_eq!(after.safety.reason, SafetyReason::Stage);
    assert_eq!(board.refusal(), SafetyReason::Stage);
}

#[test]
fn the_encoder_and_not_the_sample_says_where_the_joint_is() {
    let mut board = Board::new(Turn::Near(0.0));
    // The host believes the joint half a radian away; the encoder is right.
    for _ in 0..5 {
        board.sample(&still(0.5));
    }
    assert_eq!(board.ask(HostMessage::Arm), BoardMessage::Ack);
    let mut board = Board::new(Turn::Near(0.0));
    board.chip.borrow_mut().angle = 1304;
    for _ in 0..5 {
        board.sample(&still(0.0));
    }
    assert!(far(&mut board), "the encoder is half a radian away");
}

#[test]
fn a_reading_that_fails_drops_the_measurement_and_the_tick_goes_on() {
    let mut board = Board::armed(Turn::Near(0.0));
    let torque = board.sample(&still(0.0)).total;
    board.chip.borrow_mut().flips = (0, 0, 1);
    let reply = board.sample(&still(0.0));
    assert_eq!(reply.safety.state, SafetyState::Armed);
    assert_eq!(reply.safety.reason, SafetyReason::Encoder);
    assert!(Flags(reply.flags).contains(Flags::NO_MEASUREMENT));
    assert_eq!(reply.total, torque);
    assert_eq!(board.encoder.trouble(), Some(EncoderError::Parity));
    let reply = board.sample(&still(0.0));
    assert_eq!(reply.safety.reason, SafetyReason::None);
    assert!(!Flags(reply.flags).contains(Flags::NO_MEASUREMENT));
    assert_eq!(board.encoder.trouble(), None);
}

#[test]
fn an_encoder_that_is_gone_ends_the_torque_within_the_time_out_and_latches() {
    for (level, error) in [
        (0x0000, EncoderError::NotReady),
        (0xffff, EncoderError::Refused(7)),
    ] {
        let mut board = Board::armed(Turn::Near(0.0));
        board.chip.borrow_mut().level = Some(level);
        let mut ticks = 0;
        while board.sample(&still(0.0)).safety.state == SafetyState::Armed {
            ticks += 1;
        }
        assert!((49..=52).contains(&ticks), "{ticks}");
        for _ in 0..20 {
            board.sample(&still(0.0));
        }
        assert!(!board.bench.borrow().enabled);
        let safety = board.session.safety();
        assert_eq!(
            (safety.state, safety.reason),
            (SafetyState::Fault, SafetyReason::Encoder)
        );
        let told = (0..4).any(|_| {
            board.sample(&still(0.0));
            board.encoder.trouble() == Some(error)
        });
        assert!(told, "{level:#x}");
    }
}

#[test]
fn a_board_without_its_encoder_is_not_armed() {
    for level in [0x0000, 0xffff] {
        let mut board = Board::new(Turn::Near(0.0));
        board.chip.borrow_mut().level = Some(level);
        for _ in 0..20 {
            let safety = board.sample(&still(0.0)).safety;
            assert_eq!(safety.reason, SafetyReason::Encoder);
        }
        assert_eq!(board.refusal(), SafetyReason::Encoder);
    }
}

#[test]
fn a_lost_turn_is_found_again_at_rest_only() {
    let mut board = Board::armed(Turn::Near(0.0));
    board.chip.borrow_mut().angle = 1500;
    board.sample(&still(0.0));
    assert_eq!(board.encoder.trouble(), Some(EncoderError::Jump));
    board.chip.borrow_mut().angle = 0;
    while board.session.torque_enabled() {
        board.sample(&still(0.0));
        assert_eq!(board.encoder.trouble(), Some(EncoderError::NoReference));
    }
    board.sample(&still(0.0));
    assert_eq!(board.encoder.trouble(), None);
    assert_eq!(board.ask(HostMessage::ClearFault), BoardMessage::Ack);
    for _ in 0..5 {
        board.sample(&still(0.0));
    }
    assert_eq!(board.ask(HostMessage::Arm), BoardMessage::Ack);
}

#[test]
fn behind_a_gear_the_host_says_in_which_turn_the_encoder_stands() {
    let mut board = Board::new(Turn::OfSample);
    let mut silent = still(0.0);
    silent.measured = None;
    for _ in 0..5 {
        let safety = board.sample(&silent).safety;
        assert_eq!(safety.reason, SafetyReason::Encoder);
    }
    assert_eq!(board.encoder.trouble(), Some(EncoderError::NoReference));
    for _ in 0..5 {
        board.sample(&still(0.1));
    }
    assert_eq!(board.encoder.trouble(), None);
    assert_eq!(board.ask(HostMessage::Arm), BoardMessage::Ack);
}

#[test]
fn the_timers_tick_reads_the_encoder_too() {
    let mut board = Board::armed(Turn::Near(0.0));
    let configuration = Configuration {
        pacing: Pacing::SysTick,
        ..Configuration::default()
    };
    let mut description = BoardDescription::plain(NoClock);
    description.capabilities = description.capabilities | Capabilities::TIMER;
    board.session = Session::new(description).unwrap();
    board.sequence = 0;
    assert_eq!(
        board.ask(HostMessage::Configure(configuration)),
        BoardMessage::Ack
    );
    let before = board.chip.borrow().frames;
    let mut out = FrameBuffer::new();
    for _ in 0..10 {
        board
            .session
            .timer_tick_with(&mut board.desk, &mut out, &mut board.encoder);
        out.clear();
    }
    assert_eq!(board.chip.borrow().frames, before + 20);
}
