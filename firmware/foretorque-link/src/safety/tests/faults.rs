//! Stops, disarming, faults that latch; plausibility, age and nearness of the samples.

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

/// Implausibility counts samples, whatever the time between them.
#[test]
fn m2_one_implausible_sample_in_three_latches_with_and_without_a_timer() {
    for (one_in, latches) in [
        (1, 51),
        (2, 136),
        (3, 306),
        (4, 805),
        (5, u32::MAX),
        (6, u32::MAX),
    ] {
        // At two periods a sample, lasting ones end the torque by the age of the measurement.
        let most = if one_in == 1 { 1 } else { 2 };
        for periods in 0..=most {
            let mut safety = armed();
            let mut samples = 0_u32;
            while safety.latched() == NO_FAULT && samples < 4000 {
                let bad = samples.is_multiple_of(one_in);
                let sample = changed(|s| measured(s).tau[5] = if bad { 90.0 } else { 0.0 });
                (0..periods).for_each(|_| silence(&mut safety));
                safety.admit(Some(sample), 1, NO_FAULT);
                safety.release(&torque(5.0));
                samples += 1;
            }
            let context = format!("one in {one_in}, {periods} periods a sample");
            let far = samples.abs_diff(latches.min(4000));
            assert!(far <= 8, "{context}: {samples}");
        }
    }
}

/// The margin of a jump counts once, not in every sample.
#[test]
fn m10_a_speed_that_the_joint_cannot_have_is_a_jump() {
    // Speeds in rad/s; the data sheet gives 3.14, and 1.5 times as much is plausible.
    for (speed, plausible) in [
        (3.1, true),
        (4.6, true),
        (5.0, false),
        (10.0, false),
        (24.5, false),
    ] {
        for of_measured in [false, true] {
            let mut safety = armed();
            let step = speed * 1e-3;
            let mut moving = sample();
            let mut jumps = 0;
            for k in 0..600_u32 {
                // There and back, within the range.
                let step = if k / 150 % 2 == 0 { step } else { -step };
                match of_measured {
                    true => measured(&mut moving).q[0] += step,
                    false => moving.desired.q[0] += step,
                }
                safety.period();
                safety.admit(Some(moving), 1, NO_FAULT);
                let reason = safety.status().reason;
                let jump = [SafetyReason::PositionJump, SafetyReason::DesiredJump];
                jumps += u32::from(jump.contains(&reason));
            }
            assert_eq!(jumps == 0, plausible, "{speed} rad/s: {jumps} jumps");
            let fast = speed > 8.0;
            let latched = safety.latched();
            assert!(!fast || latched != NO_FAULT, "{speed} rad/s, {latched:?}");
        }
    }
}

/// No torque without measurements, or with the arm elsewhere.
#[test]
fn m10_an_armed_board_needs_measurements_near_the_desired_position() {
    use SafetyReason::{FollowingError as Far, MeasurementTimeout as Late};
    use SafetyState::{Armed, Disarmed, Fault};
    let cases: [(Change, SafetyReason, u32, SafetyState); 3] = [
        (|s| s.measured = None, Late, 101, Disarmed),
        (|s| measured(s).q[2] += 0.21, Far, 51, Fault),
        (|s| measured(s).q[2] += 0.19, NO_FAULT, 1000, Armed),
    ];
    for (change, reason, after, state) in cases {
        let mut safety = armed();
        // The arm leaves slowly.
        safety.admit(Some(changed(change)), 50, NO_FAULT);
        let changed = changed(change);
        let mut periods = 1_u32;
        while safety.status().state == SafetyState::Armed && periods < 1000 {
            tick(&mut safety, Some(changed));
            periods += 1;
        }
        assert!(periods.abs_diff(after) <= 1, "{reason:?} after {periods}");
        ticks(&mut safety, 20, Some(changed));
        assert_eq!(safety.status(), SafetyStatus { state, reason });
    }
}

proptest! {
    #[test]
    fn in_any_order_torque_is_limited_and_zero_unless_armed(
        steps in prop::collection::vec((0..12u8, any::<u32>(), 0..N), 1..300),
    ) {
        let mut safety = new();
        let mut allowed = false;
        for (kind, bits, joint) in steps {
            let value = f32::from_bits(bits);
            let mut received = Some(sample());
            match kind {
                0 => allowed |= safety.arm().is_ok(),
                1 => safety.disarm(),
                2 => { safety.torque_off(SafetyReason::Stopped); allowed = false; }
                3 => { let _ = safety.clear(); }
                4 => safety.note_temperature(joint, bits as i8),
                5 => received = None,
                6 => measured(received.as_mut().unwrap()).q[joint] = value,
                7 => received.as_mut().unwrap().desired.qd[joint] = value,
                8 => silence(&mut safety),
                9 => { safety.restart(limits()); allowed = false; }
                _ => {}
            }
            let before = *safety.output();
            safety.period();
            safety.admit(received, 1, NO_FAULT);
            // Any number of calls is one step.
            safety.release(&torque(-value));
            let given = safety.release(&torque(value));
            for joint in 0..N {
                prop_assert!(given[joint].is_finite());
                prop_assert!(given[joint].abs() <= limits().torque[joint]);
                let step = (given[joint] - before[joint]).abs();
                prop_assert!(step <= 1.0001 * limits().slew_per_tick[joint]);
                prop_assert!(allowed || given[joint] == 0.0);
                prop_assert!(safety.enabled() || given[joint] == 0.0);
            }
            allowed &= safety.enabled();
        }
    }
}
