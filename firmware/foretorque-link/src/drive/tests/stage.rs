//! Inputs of the motor stage, and the states in which it is off.

use super::*;

#[test]
fn the_stage_gets_the_joints_own_torque_at_its_scale_while_the_board_is_armed() {
    let mut board = Board::armed(TurnReference::Near(0.0));
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
    let mut board = Board::armed(TurnReference::Near(0.0));
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
    let mut board = Board::armed(TurnReference::Near(0.0));
    assert_eq!(board.ask(HostMessage::Stop), BoardMessage::Ack);
    assert!(!board.bench.borrow().enabled);
    assert_eq!(board.level(), 0.0);
}

#[test]
fn silence_brings_the_stage_to_rest() {
    let mut board = Board::armed(TurnReference::Near(0.0));
    let mut out = FrameBuffer::new();
    for _ in 0..100 {
        board
            .session
            .timer_tick(&mut board.mailboxes, &mut out, &mut board.encoder);
        board.stage.apply(&mut board.session);
    }
    assert!(!board.bench.borrow().enabled);
    assert_eq!(board.level(), 0.0);
    assert_eq!(board.session.safety().reason, SafetyReason::CommandTimeout);
}

#[test]
fn a_stage_with_a_fault_is_off_at_once_and_the_host_is_told_in_the_same_tick() {
    let mut board = Board::armed(TurnReference::Near(0.0));
    board.bench.borrow_mut().fault = true;
    let reply = board.sample(&still(0.0));
    assert!(!board.bench.borrow().enabled);
    assert_eq!(board.level(), 0.0);
    assert_eq!(reply.total, [0.0; N]);
    assert_eq!(reply.safety.state, SafetyState::Fault);
    assert_eq!(reply.safety.reason, SafetyReason::Drive);
    assert_eq!(board.stage.last_error(), Some(StageError::Fault));
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
    let mut board = Board::new(TurnReference::Near(0.0));
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
    let mut board = Board::armed(TurnReference::Near(0.0));
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
