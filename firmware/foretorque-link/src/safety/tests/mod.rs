mod page;

use super::*;
use foretorque::arm::ur5::{JOINTS as N, Ur5};
use foretorque::joint::{JointMeasurement, JointMotion};
use proptest::prelude::*;

type Change = fn(&mut JointSample<N>);

const NO_FAULT: SafetyReason = SafetyReason::None;

fn limits() -> SafetyLimits<N> {
    SafetyLimits::for_arm::<Ur5, _>(1000)
}

fn torque(value: f32) -> JointVector<N> {
    JointVector::<N>::repeat(value)
}

fn sample() -> JointSample<N> {
    JointSample {
        desired: JointMotion {
            q: torque(0.5),
            ..JointMotion::zero()
        },
        measured: Some(JointMeasurement {
            q: torque(0.5),
            tau: torque(0.0),
        }),
    }
}

fn changed(change: impl FnOnce(&mut JointSample<N>)) -> JointSample<N> {
    let mut sample = sample();
    change(&mut sample);
    sample
}

fn measured(sample: &mut JointSample<N>) -> &mut JointMeasurement<N> {
    sample.measured.as_mut().unwrap()
}

fn tick(safety: &mut Safety<N>, sample: Option<JointSample<N>>) -> JointVector<N> {
    safety.period();
    safety.admit(sample, 1, NO_FAULT);
    safety.release(&torque(5.0))
}

/// A period in which samples pace the board and none arrives.
fn silence(safety: &mut Safety<N>) {
    safety.period();
    safety.supervise();
    let held = *safety.output();
    safety.release(&held);
}

fn ticks(safety: &mut Safety<N>, count: u32, sample: Option<JointSample<N>>) {
    (0..count).for_each(|_| _ = tick(safety, sample));
}

fn new() -> Safety<N> {
    Safety::new(limits(), NO_FAULT)
}

fn ready() -> Safety<N> {
    let mut safety = new();
    for _ in 0..ARM_SAMPLES {
        assert_eq!(safety.clone().arm(), Err(SafetyReason::NoSample));
        assert_eq!(tick(&mut safety, Some(sample())), torque(0.0));
    }
    safety
}

fn armed() -> Safety<N> {
    let mut safety = ready();
    assert_eq!(safety.arm(), Ok(()));
    ticks(&mut safety, 5, Some(sample()));
    assert_eq!(*safety.output(), torque(5.0));
    safety
}

/// Ticks without a sample until the torque has ended, and the largest step on the way.
fn run_out(safety: &mut Safety<N>) -> (u32, f32) {
    let mut steepest = 0.0_f32;
    for ticks in 0..1000 {
        let before = *safety.output();
        if safety.at_rest() {
            return (ticks, steepest);
        }
        let after = tick(safety, None);
        steepest = steepest.max((after - before).abs().max());
    }
    panic!("the torque never ends");
}

#[test]
fn arming_takes_fresh_plausible_near_samples() {
    use SafetyReason::*;
    assert_eq!(ready().arm(), Ok(()));
    let refusals: [(Change, SafetyReason); 9] = [
        (|s| s.measured = Option::None, NoSample),
        (|s| measured(s).q[2] = f32::NAN, MeasuredNotFinite),
        (|s| measured(s).tau[2] = f32::NAN, MeasuredNotFinite),
        (|s| measured(s).q[2] = 7.0, PositionRange),
        (|s| measured(s).q[2] += 0.1, PositionJump),
        (|s| measured(s).tau[0] = 451.0, EffortRange),
        (|s| s.desired.qdd[5] = f32::INFINITY, DesiredNotFinite),
        (|s| s.desired.q[5] = f32::NAN, DesiredNotFinite),
        (|s| s.desired.q[0] += 0.1, DesiredJump),
    ];
    for (change, reason) in refusals {
        let mut safety = ready();
        tick(&mut safety, Some(changed(change)));
        let before = safety;
        assert_eq!(safety.arm(), Err(reason));
        assert_eq!(safety, before, "a refusal changes nothing");
    }
    let mut hot = ready();
    hot.note_temperature(1, HOT_C);
    assert_eq!(hot.arm(), Err(MotorHot));
    let mut stale = ready();
    ticks(&mut stale, 51, Option::None);
    assert_eq!(stale.arm(), Err(NoSample));
    let mut far = ready();
    let sample = changed(|s| s.desired.q[0] += 0.3);
    ticks(&mut far, ARM_SAMPLES + 1, Some(sample));
    assert_eq!(far.arm(), Err(TooFar));
}

#[test]
fn a_sound_torque_passes_and_an_unsound_one_is_limited() {
    let mut safety = armed();
    for k in 0..1000 {
        // As fast as the tick's own slew limit allows, half the hard one.
        let wanted = limits().torque * (0.9 * (k as f32 * 0.05).sin());
        safety.period();
        safety.admit(Some(sample()), 1, NO_FAULT);
        let given = safety.release(&wanted);
        assert!(k < 20 || given == wanted, "tick {k}");
    }
    for absurd in [1e30, -1e30] {
        let before = *safety.output();
        safety.period();
        safety.admit(Some(sample()), 1, NO_FAULT);
        let given = safety.release(&torque(absurd));
        for joint in 0..N {
            let step = (given[joint] - before[joint]).abs();
            assert!(step <= 1.0001 * limits().slew_per_tick[joint]);
            assert!(given[joint].abs() <= limits().torque[joint]);
        }
    }
}

#[test]
fn silence_ramps_down_and_samples_alone_never_arm_again() {
    let mut safety = armed();
    let (count, steepest) = run_out(&mut safety);
    assert!((51..60).contains(&count), "{count}");
    assert!(steepest <= limits().slew_per_tick.max());
    let timed_out = SafetyStatus {
        state: SafetyState::Disarmed,
        reason: SafetyReason::CommandTimeout,
    };
    assert_eq!(safety.status(), timed_out);
    for _ in 0..100 {
        assert_eq!(tick(&mut safety, Some(sample())), torque(0.0));
    }
    assert_eq!(safety.arm(), Ok(()), "a time-out is no fault");
}

#[test]
fn silence_ages_a_disarmed_board_and_keeps_its_reasons() {
    let mut safety = ready();
    (1..limits().timeout_ticks).for_each(|_| silence(&mut safety));
    let mut in_time = safety;
    assert_eq!(in_time.arm(), Ok(()));
    silence(&mut safety);
    assert_eq!(safety.arm(), Err(SafetyReason::NoSample));
    let mut implausible = ready();
    tick(&mut implausible, Some(changed(|s| measured(s).q[1] = -6.5)));
    silence(&mut implausible);
    assert_eq!(implausible.arm(), Err(SafetyReason::PositionRange));
}

#[test]
fn a_board_just_armed_waits_for_a_sample() {
    let mut safety = ready();
    assert_eq!(safety.arm(), Ok(()));
    for _ in 0..10 {
        assert_eq!(tick(&mut safety, None), torque(0.0));
        silence(&mut safety);
        assert_eq!(*safety.output(), torque(0.0));
        assert_eq!(safety.status().state, SafetyState::Armed);
    }
    let given = tick(&mut safety, Some(sample()));
    assert!(given.iter().all(|&torque| torque > 1.0));
    // Once torque flows, one sample far from the measured position does not end it.
    let far = changed(|s| s.desired.q[0] += 0.3);
    safety.admit(Some(far), 100, NO_FAULT);
    assert_eq!(safety.status().state, SafetyState::Armed);
}

/// `page.rs` compares the times at 1 ms, and the other limits.
#[test]
fn the_times_of_the_page_are_kept_at_every_period() {
    for (period_us, timeout, measurement, temperature) in [
        (100, 501, 1001, 100_001),
        (250, 201, 401, 40_001),
        (1000, 51, 101, 10_001),
        (1500, 34, 67, 6667),
        (4000, 13, 26, 2501),
        (20_000, 3, 6, 501),
    ] {
        let limits = SafetyLimits::<N>::for_arm::<Ur5, _>(period_us);
        let ticks = (limits.timeout_ticks, limits.measurement_ticks);
        assert_eq!(ticks, (timeout, measurement), "{period_us} µs");
        assert_eq!(limits.temperature_ticks, temperature, "{period_us} µs");
    }
}

#[test]
fn the_first_fault_is_the_latched_one_and_what_does_not_flow_needs_no_brake() {
    let mut disarmed = ready();
    disarmed.limits = limits().with_brake(149_500, 1000);
    disarmed.trip(SafetyReason::MotorHot);
    disarmed.trip(SafetyReason::Drive);
    assert!(!disarmed.enabled());
    assert_eq!(disarmed.latched(), SafetyReason::MotorHot);
}

/// The shortest brake closes within one period.
#[test]
fn m8_a_torque_that_is_withdrawn_becomes_that_of_gravity_for_every_brake_and_without_one_stays() {
    let set = ParameterSet::nominal::<Ur5>(1);
    let mut withdrawn = foretorque::feedforward::evaluate::<Ur5, N, 40>(&set, &sample().desired);
    withdrawn.flags = Flags::STALE_SAMPLE | Flags::WITHDRAWN;
    withdrawn.total = torque(1.0);
    let gravity = gravity::<Ur5, N, 40>(&set, &torque(0.5));
    for (close_us, periods, wanted) in [(0, 0, torque(1.0)), (1, 1, gravity), (1000, 2, gravity)] {
        let mut safety = armed();
        safety.limits = limits().with_brake(close_us, 1000);
        assert_eq!(safety.limits.brake_ticks, periods);
        assert_eq!(safety.with_brakes::<Ur5, 40>(&withdrawn, &set), wanted);
        withdrawn.flags = Flags::STALE_SAMPLE;
        assert_eq!(safety.with_brakes::<Ur5, 40>(&withdrawn, &set), torque(1.0));
        withdrawn.flags = Flags::STALE_SAMPLE | Flags::WITHDRAWN;
    }
}

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
