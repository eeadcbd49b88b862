//! Stops, disarming, and faults that latch.

use super::*;

#[test]
fn a_stop_is_immediate_from_any_state_and_latches() {
    for mut safety in [new(), ready(), armed()] {
        safety.torque_off(SafetyReason::Stopped);
        assert!(!safety.enabled());
        assert_eq!(tick(&mut safety, Some(sample())), torque(0.0));
        assert_eq!(safety.status().reason, SafetyReason::Stopped);
        ticks(&mut safety, 10, Some(sample()));
        assert_eq!(safety.arm(), Err(SafetyReason::Stopped));
        assert_eq!(safety.clear(), Ok(()));
        assert_eq!(safety.status(), SafetyStatus::default());
        assert_eq!(safety.arm(), Ok(()), "only after it was cleared");
    }
}

#[test]
fn disarming_ramps_and_refuses_to_arm_meanwhile() {
    let mut safety = armed();
    safety.release(&torque(14.0));
    safety.disarm();
    assert_eq!(safety.status().state, SafetyState::RampDown);
    assert!(safety.enabled());
    assert_eq!(safety.arm(), Err(SafetyReason::StillRamping));
    let (ticks, _) = run_out(&mut safety);
    assert!(ticks > 1, "{ticks}");
    assert_eq!(safety.status().reason, SafetyReason::Disarmed);
    // Where no torque flows it changes nothing.
    for mut safety in [new(), ready(), Safety::new(limits(), SafetyReason::Drive)] {
        let before = safety;
        safety.disarm();
        assert_eq!(safety, before);
    }
}

#[test]
fn one_implausible_sample_passes_and_lasting_ones_latch() {
    use SafetyReason::*;
    let cases: [(Change, SafetyReason); 4] = [
        (|s| measured(s).q[1] = f32::NAN, MeasuredNotFinite),
        (|s| measured(s).q[1] = -6.5, PositionRange),
        (|s| measured(s).tau[5] = 90.0, EffortRange),
        (|s| s.desired.qd[3] = f32::NAN, DesiredNotFinite),
    ];
    for (change, reason) in cases {
        let bad = changed(change);
        let mut safety = armed();
        tick(&mut safety, Some(bad));
        let status = safety.status();
        assert_eq!(status.state, SafetyState::Armed);
        assert!(status.reason == reason || status.reason == PositionRange);
        ticks(&mut safety, 10, Some(sample()));
        assert_eq!(safety.status().state, SafetyState::Armed);
        ticks(&mut safety, 60, Some(bad));
        run_out(&mut safety);
        let state = SafetyState::Fault;
        assert_eq!(safety.status(), SafetyStatus { state, reason });
        ticks(&mut safety, 10, Some(sample()));
        assert_eq!(safety.arm(), Err(reason));
    }
}

#[test]
fn an_implausible_measurement_is_not_learnt_from() {
    let mut safety = armed();
    let bad = changed(|s| measured(s).q[0] += 0.2);
    let admitted = safety.admit(Some(bad), 1, NO_FAULT).unwrap();
    assert_eq!((admitted.desired, admitted.measured), (bad.desired, None));
    let jump = changed(|s| s.desired.q[0] += 0.2);
    assert_eq!(safety.admit(Some(jump), 1, NO_FAULT), None);
}

#[test]
fn a_step_after_lost_samples_is_no_jump() {
    let mut safety = armed();
    let later = changed(|s| {
        measured(s).q[0] += 0.1;
        s.desired.q[0] += 0.1;
    });
    assert_eq!(safety.admit(Some(later), 30, NO_FAULT), Some(later));
    assert_eq!(safety.status().reason, NO_FAULT);
}

#[test]
fn heat_lowers_the_limit_and_ends_the_torque() {
    let mut safety = armed();
    safety.note_temperature(3, 90);
    for _ in 0..30 {
        safety.period();
        safety.admit(Some(sample()), 1, NO_FAULT);
        safety.release(&torque(28.0));
    }
    assert_eq!((safety.output()[3], safety.output()[4]), (14.0, 28.0));
    assert_eq!(safety.status().reason, SafetyReason::MotorWarm);
    safety.note_temperature(3, 100);
    run_out(&mut safety);
    let hot = SafetyReason::MotorHot;
    assert_eq!(safety.latched(), hot);
    // 96 °C is within the hysteresis.
    for (celsius, cleared) in [(100, Err(hot)), (96, Err(hot)), (70, Ok(()))] {
        safety.note_temperature(3, celsius);
        assert_eq!(safety.clear(), cleared, "{celsius} °C");
    }
}

#[test]
fn a_kept_fault_survives_a_restart_of_the_tick() {
    let mut safety = Safety::new(limits(), SafetyReason::Restarted);
    ticks(&mut safety, 10, Some(sample()));
    assert_eq!(safety.arm(), Err(SafetyReason::Restarted));
    safety.restart(limits());
    assert_eq!(safety.latched(), SafetyReason::Restarted);
    assert_eq!(safety.clear(), Ok(()));
    let mut armed = armed();
    armed.restart(limits());
    assert!(!armed.enabled(), "a restart does not arm");
}
