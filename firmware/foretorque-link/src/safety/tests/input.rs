//! Plausibility, age and nearness of the samples.

use super::*;

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
            let context = std::format!("one in {one_in}, {periods} periods a sample");
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
                let sign = if (k / 150).is_multiple_of(2) {
                    1.0
                } else {
                    -1.0
                };
                let q = if of_measured {
                    &mut measured(&mut moving).q
                } else {
                    &mut moving.desired.q
                };
                q[0] += sign * step;
                safety.period();
                safety.admit(Some(moving), 1, NO_FAULT);
                let jump = matches!(
                    safety.status().reason,
                    SafetyReason::PositionJump | SafetyReason::DesiredJump
                );
                jumps += u32::from(jump);
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
    use SafetyReason::{FollowingError, MeasurementTimeout};
    let cases: [(Change, SafetyReason, u32, SafetyState); 3] = [
        (
            |s| s.measured = None,
            MeasurementTimeout,
            101,
            SafetyState::Disarmed,
        ),
        (
            |s| measured(s).q[2] += 0.21,
            FollowingError,
            51,
            SafetyState::Fault,
        ),
        (
            |s| measured(s).q[2] += 0.19,
            NO_FAULT,
            1000,
            SafetyState::Armed,
        ),
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
