//! A board with motor stage and encoder under test.

use super::*;
use crate::hal::tests::{Bench, Pins};
use crate::hal::{AbsoluteEncoder, Chip, Direction, EncoderConfig, EncoderError, TorqueScale};
use crate::safety::SafetyState;
use crate::session::tests::{self as session, ACK, N, nack, torque};
use crate::wire::{BoardMessage, HostMessage, NackReason, Pacing, SampleFrame, TorqueFrame};
use foretorque::joint::{JointMeasurement, JointMotion, JointSample};
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

/// A board with a stage and an encoder, in the order of calls of its firmware.
struct Board {
    board: session::Board<JointEncoder<Chip>>,
    stage: JointStage<Pins, Pins, Pins>,
    bench: Rc<RefCell<Bench>>,
}

impl Board {
    fn new(turn: TurnReference) -> Self {
        let pins = Pins::default();
        let stage = MotorStage::new(pins.clone(), pins.clone(), pins.clone(), SCALE).unwrap();
        let config = EncoderConfig {
            zero_counts: 0,
            direction: Direction::Same,
            ratio: 1.0,
            largest_step: 160,
        };
        let encoder = AbsoluteEncoder::new(Chip::new(0), config).unwrap();
        Self {
            board: session::Board::measuring(JointEncoder::new(encoder, JOINT, turn)),
            stage: JointStage::new(stage, JOINT),
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
        let reply = self.board.request(message);
        self.stage.apply(&mut self.board.session);
        reply
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

    fn chip(&mut self) -> &mut Chip {
        &mut self.board.sensor.encoder.spi
    }

    fn read_error(&self) -> Option<EncoderError> {
        self.board.sensor.last_error()
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
    let mut measured = JointMeasurement::zero();
    measured.q[JOINT] = host_q;
    JointSample {
        desired: JointMotion::zero(),
        measured: Some(measured),
    }
}

const NEAR: TurnReference = TurnReference::Near(0.0);

#[test]
fn the_position_of_the_encoder_replaces_that_of_the_sample() {
    // The host measures half a radian, where only the encoder allows arming, then zero, where it does not.
    let mut board = Board::new(NEAR);
    (0..5).for_each(|_| _ = board.sample(&still(0.5)));
    assert_eq!(board.request(HostMessage::Arm), ACK);
    let mut board = Board::new(NEAR);
    board.chip().angle = 1304;
    board.samples(5);
    board.assert_refused(SafetyReason::TooFar);
}

#[test]
fn a_failed_reading_drops_the_measurement_only() {
    let mut board = Board::armed(NEAR);
    let torque = board.sample(&still(0.0)).total;
    board.chip().flips = (0, 0, 1);
    let reply = board.sample(&still(0.0));
    assert_eq!(reply.safety.state, SafetyState::Armed);
    assert_eq!(reply.safety.reason, SafetyReason::Encoder);
    assert!(Flags(reply.flags).contains(Flags::NO_MEASUREMENT));
    assert_eq!(reply.total, torque);
    assert_eq!(board.read_error(), Some(EncoderError::Parity));
    let reply = board.sample(&still(0.0));
    assert_eq!(reply.safety.reason, SafetyReason::None);
    assert!(!Flags(reply.flags).contains(Flags::NO_MEASUREMENT));
    assert_eq!(board.read_error(), None);
}

#[test]
fn readings_may_fail_for_fifty_milliseconds_while_the_joint_moves() {
    for failing in [15, 20, 40, 49] {
        let mut board = Board::armed(NEAR);
        board.chip().level = Some(0);
        for tick in 1..=failing {
            board.chip().angle = 8 * tick;
            board.sample(&still(0.0));
        }
        board.chip().level = None;
        // Two readings until the chip answers in order again.
        board.samples(4);
        let safety = board.board.session.safety();
        assert_eq!(safety.state, SafetyState::Armed, "{failing}: {safety}");
        assert_eq!(board.read_error(), None, "{failing}");
    }
}

#[test]
fn a_missing_encoder_ends_the_torque_and_latches() {
    for (level, error) in [
        (0x0000, EncoderError::NotReady),
        (0xffff, EncoderError::Refused(7)),
    ] {
        let mut board = Board::armed(NEAR);
        board.chip().level = Some(level);
        let mut ticks = 0;
        while board.sample(&still(0.0)).safety.state == SafetyState::Armed {
            ticks += 1;
        }
        assert!((49..=52).contains(&ticks), "{ticks}");
        board.samples(20);
        assert!(!board.enabled());
        let safety = board.board.session.safety();
        let latched = (SafetyState::Fault, SafetyReason::Encoder);
        assert_eq!((safety.state, safety.reason), latched);
        let reported = (0..4).any(|_| {
            board.sample(&still(0.0));
            board.read_error() == Some(error)
        });
        assert!(reported, "{level:#x}");
    }
}

#[test]
fn a_lost_turn_is_restored_at_rest_only() {
    let mut board = Board::armed(NEAR);
    board.chip().angle = 1500;
    board.sample(&still(0.0));
    assert_eq!(board.read_error(), Some(EncoderError::Jump));
    board.chip().angle = 0;
    while board.board.session.torque_enabled() {
        board.sample(&still(0.0));
        assert_eq!(board.read_error(), Some(EncoderError::NoReference));
    }
    board.sample(&still(0.0));
    assert_eq!(board.read_error(), None);
    assert_eq!(board.request(HostMessage::ClearFault), ACK);
    board.samples(5);
    assert_eq!(board.request(HostMessage::Arm), ACK);
}

#[test]
fn behind_a_gear_the_sample_gives_the_turn() {
    let mut board = Board::new(TurnReference::FromSample);
    let mut unmeasured = still(0.0);
    unmeasured.measured = None;
    for _ in 0..5 {
        let safety = board.sample(&unmeasured).safety;
        assert_eq!(safety.reason, SafetyReason::Encoder);
    }
    assert_eq!(board.read_error(), Some(EncoderError::NoReference));
    (0..5).for_each(|_| _ = board.sample(&still(0.1)));
    assert_eq!(board.read_error(), None);
    assert_eq!(board.request(HostMessage::Arm), ACK);
}

#[test]
fn a_tick_of_the_timer_reads_the_encoder_too() {
    let mut board = Board::new(NEAR);
    board.samples(5);
    board.board.pace(Pacing::SysTick);
    let before = board.chip().frames;
    (0..10).for_each(|_| _ = board.board.timer());
    assert_eq!(board.chip().frames, before + 20);
}

#[test]
fn turns_are_counted_without_samples_and_lost_where_nobody_counted() {
    let paced = |board: &mut Board, sample: &JointSample<N>| {
        board.board.timer();
        board.sample(sample);
    };
    let mut board = Board::new(TurnReference::FromSample);
    (0..5).for_each(|_| paced(&mut board, &still(0.0)));
    for k in 1..=256 {
        board.chip().angle = (64 * k) % 16_384;
        board.board.timer();
    }
    assert_eq!(board.chip().angle, 0, "a whole turn");
    (0..10).for_each(|_| paced(&mut board, &still(0.0)));
    assert_eq!(board.read_error(), None);
    board.assert_refused(SafetyReason::TooFar);
    // Readings that fail, and time in which nothing ran: the host gives the turn anew.
    let misses: [fn(&mut Board); 2] = [
        |board| {
            board.chip().level = Some(0);
            (0..60).for_each(|_| _ = board.board.timer());
            board.chip().level = None;
        },
        |board| {
            board.board.session.note_missed(60);
            board.board.timer();
        },
    ];
    for miss in misses {
        miss(&mut board);
        let mut unmeasured = still(0.0);
        unmeasured.measured = None;
        (0..3).for_each(|_| paced(&mut board, &unmeasured));
        assert_eq!(board.read_error(), Some(EncoderError::NoReference));
        (0..3).for_each(|_| paced(&mut board, &still(0.0)));
        assert_eq!(board.read_error(), None);
    }
}

#[test]
fn an_armed_stage_gets_the_torque_of_its_joint() {
    let mut board = Board::armed(NEAR);
    for k in 0..200 {
        let mut sample = still(0.0);
        sample.desired.qd[JOINT] = (k as f32 * 0.05).sin() * 0.2;
        sample.desired.qdd[JOINT] = (k as f32 * 0.05).cos() * 4.0;
        let torque = board.sample(&sample).total[JOINT];
        assert!((board.level() - torque / FULL_SCALE_NM).abs() < 1e-6, "{k}");
        assert!(torque.abs() > 1.0, "{torque}");
    }
    assert_eq!(board.request(HostMessage::Disarm), ACK);
    let mut ramp = 0;
    while board.sample(&still(0.0)).safety.state == SafetyState::RampDown {
        assert!(board.enabled(), "the torque is not zero yet");
        ramp += 1;
    }
    assert!(ramp > 1, "it ramps");
    assert_eq!((board.enabled(), board.level()), (false, 0.0));
}

#[test]
fn a_tick_sends_one_command_and_other_messages_none() {
    let mut board = Board::armed(NEAR);
    let before = board.bench.borrow().levels.len();
    for k in 1..=10 {
        let mut sample = still(0.0);
        sample.desired.qdd[JOINT] = k as f32 * 0.1;
        board.sample(&sample);
        board.request(HostMessage::Statistics);
        assert_eq!(board.bench.borrow().levels.len(), before + k);
    }
}

#[test]
fn a_stage_with_a_fault_is_off_and_reported_in_the_same_tick() {
    let mut board = Board::armed(NEAR);
    board.bench.borrow_mut().fault = true;
    let reply = board.sample(&still(0.0));
    assert_eq!((board.enabled(), board.level()), (false, 0.0));
    assert_eq!(reply.total, [0.0; N]);
    assert_eq!(reply.safety.state, SafetyState::Fault);
    assert_eq!(reply.safety.reason, SafetyReason::Drive);
    assert_eq!(board.stage.last_error(), Some(StageError::Fault));
    // A lasting fault latches again in the next tick.
    assert_eq!(board.request(HostMessage::ClearFault), ACK);
    board.assert_refused(SafetyReason::Drive);
    board.bench.borrow_mut().fault = false;
    board.assert_refused(SafetyReason::Drive);
    assert_eq!(board.request(HostMessage::ClearFault), ACK);
    assert_eq!(board.request(HostMessage::Arm), ACK);
    assert!(board.enabled());
}

#[test]
fn a_command_that_fails_switches_off_and_latches() {
    let mut board = Board::armed(NEAR);
    board.bench.borrow_mut().output_fails = true;
    let mut sample = still(0.0);
    sample.desired.qdd[JOINT] = 1.0;
    board.sample(&sample);
    assert!(!board.enabled());
    let after = board.sample(&still(0.0));
    assert_eq!(after.total, [0.0; N]);
    assert_eq!(after.safety.reason, SafetyReason::Stage);
    board.assert_refused(SafetyReason::Stage);
}
