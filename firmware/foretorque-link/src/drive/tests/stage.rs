//! Commands and enable of the motor stage.

use super::*;

fn armed() -> Board {
    Board::armed(TurnReference::Near(0.0))
}

#[track_caller]
fn assert_off(board: &Board) {
    assert!(!board.enabled());
    assert_eq!(board.level(), 0.0);
}

#[test]
fn an_armed_stage_gets_the_torque_of_its_joint() {
    let mut board = armed();
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
    assert_off(&board);
}

#[test]
fn a_tick_sends_one_command_and_other_messages_none() {
    let mut board = armed();
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
fn a_stop_switches_the_stage_off_before_its_reply() {
    let mut board = armed();
    assert_eq!(board.request(HostMessage::Stop), ACK);
    assert_off(&board);
}

#[test]
fn silence_brings_the_stage_to_rest() {
    let mut board = armed();
    (0..100).for_each(|_| board.timer());
    assert_off(&board);
    let reason = board.board.session.safety().reason;
    assert_eq!(reason, SafetyReason::CommandTimeout);
}

#[test]
fn a_stage_with_a_fault_is_off_and_reported_in_the_same_tick() {
    let mut board = armed();
    board.bench.borrow_mut().fault = true;
    let reply = board.sample(&still(0.0));
    assert_off(&board);
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
fn a_fault_at_boot_refuses_to_arm() {
    let mut board = Board::new(TurnReference::Near(0.0));
    board.bench.borrow_mut().fault = true;
    for _ in 0..5 {
        let safety = board.sample(&still(0.0)).safety;
        assert_eq!(safety.reason, SafetyReason::Drive);
    }
    board.assert_refused(SafetyReason::Drive);
    assert!(!board.enabled());
}

#[test]
fn a_command_that_fails_switches_off_and_latches() {
    let mut board = armed();
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
