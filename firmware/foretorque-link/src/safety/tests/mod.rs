mod faults;
mod page;

use super::*;
use foretorque::arm::ur5::{JOINTS as N, Ur5};
use foretorque::feedforward::{ParameterSet, evaluate};
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
fn a_sound_torque_passes() {
    let mut safety = armed();
    for k in 0..1000 {
        // As fast as the tick's own slew limit allows, half the hard one.
        let wanted = limits().torque * (0.9 * (k as f32 * 0.05).sin());
        safety.period();
        safety.admit(Some(sample()), 1, NO_FAULT);
        let given = safety.release(&wanted);
        assert!(k < 20 || given == wanted, "tick {k}");
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
fn silence_keeps_the_reason_against_arming() {
    let mut safety = ready();
    tick(&mut safety, Some(changed(|s| measured(s).q[1] = -6.5)));
    silence(&mut safety);
    assert_eq!(safety.arm(), Err(SafetyReason::PositionRange));
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

/// At 95 °C a quarter of the torque limit is left, less than the gravity of the shoulder.
#[test]
fn a_brake_closes_before_a_warm_motor_lets_go_and_is_waited_for_at_full_torque() {
    let set = ParameterSet::nominal::<Ur5>(1);
    let state = FeedForwardState::new(set);
    let shoulder = state.gravity::<Ur5>(&torque(0.0))[1].abs();
    let mut stretched = sample();
    stretched.desired.q.fill(0.0);
    measured(&mut stretched).q.fill(0.0);
    let wanted = evaluate::<Ur5, N, 40>(&set, &stretched.desired);
    for (close_us, celsius) in [
        (0, 95),
        (0, HOT_C),
        (100_000, 90),
        (100_000, 95),
        (100_000, HOT_C),
    ] {
        let mut safety = Safety::new(limits().with_brake(close_us, 1000), NO_FAULT);
        let tick = |safety: &mut Safety<N>| {
            safety.period();
            safety.admit(Some(stretched), 1, NO_FAULT);
            let wanted = safety.with_brakes::<Ur5, 40>(&wanted, &state);
            safety.release(&wanted)[1].abs()
        };
        (0..3).for_each(|_| _ = tick(&mut safety));
        safety.arm().unwrap();
        (0..100).for_each(|_| _ = tick(&mut safety));
        safety.note_temperature(1, celsius);
        let mut held = 0;
        while safety.enabled() && held < 200 && tick(&mut safety) >= 0.999 * shoulder {
            held += 1;
        }
        let brake = close_us > 0;
        let expected = match celsius {
            90 => 200,
            _ if brake => safety.limits().brake_ticks,
            _ => 0,
        };
        assert_eq!(held, expected, "{close_us} {celsius}");
        let hot = brake && celsius > 90 || celsius == HOT_C;
        let latched = if hot {
            SafetyReason::MotorHot
        } else {
            NO_FAULT
        };
        assert_eq!(safety.latched(), latched, "{close_us} {celsius}");
    }
}

/// An armed board with brakes of 20 ms, and parameters with a payload in the torque.
fn braked() -> (Safety<N>, FeedForwardState<N, 40>) {
    let mut safety = armed();
    safety.limits = limits().with_brake(20_000, 1000);
    let mut state = FeedForwardState::new(ParameterSet::nominal::<Ur5>(1));
    state.payload = state.active.rigid * 0.1;
    (safety, state)
}

/// Torque of a tick that has had no sample for too long.
fn withdrawn(state: &FeedForwardState<N, 40>) -> Torque<N> {
    let mut torque = evaluate::<Ur5, N, 40>(&state.active, &sample().desired);
    torque.flags = Flags::STALE_SAMPLE | Flags::WITHDRAWN;
    torque
}

/// A period of a timer without a sample.
fn unsampled(safety: &mut Safety<N>, state: &FeedForwardState<N, 40>) -> JointVector<N> {
    safety.period();
    safety.supervise();
    let wanted = safety.with_brakes::<Ur5, 40>(&withdrawn(state), state);
    safety.release(&wanted)
}

#[test]
fn the_torque_of_an_earlier_brake_does_not_flow_after_a_stop() {
    let (mut safety, state) = braked();
    safety.disarm();
    while !safety.at_rest() {
        unsampled(&mut safety, &state);
    }
    ticks(&mut safety, ARM_SAMPLES, Some(sample()));
    safety.arm().unwrap();
    ticks(&mut safety, 5, Some(sample()));
    safety.torque_off(SafetyReason::Stopped);
    safety.clear().unwrap();
    ticks(&mut safety, ARM_SAMPLES, Some(sample()));
    safety.arm().unwrap();
    for _ in 0..30 {
        assert_eq!(unsampled(&mut safety, &state), torque(0.0));
    }
}

#[test]
fn a_torque_that_ends_between_two_ticks_is_kept_until_gravity_is_known() {
    let (mut safety, state) = braked();
    let before = *safety.output();
    safety.disarm();
    safety.period();
    assert_eq!(safety.release(&before), before);
    (0..15).for_each(|_| _ = unsampled(&mut safety, &state));
    let gravity = state.gravity::<Ur5>(&torque(0.5));
    let plain = FeedForwardState::new(state.active).gravity::<Ur5>(&torque(0.5));
    assert!((gravity - plain * 1.1).amax() < 1e-3, "with the payload");
    assert!((safety.output() - gravity).amax() < 1e-3);
}

#[test]
fn gravity_is_that_of_the_last_plausible_position() {
    let (mut safety, state) = braked();
    let failing = [0.5, 2.0].map(|q| changed(|s| measured(s).q[1] = q));
    for k in 0.. {
        tick(&mut safety, Some(failing[k % 2]));
        if safety.status().state == SafetyState::RampDown {
            break;
        }
    }
    assert_eq!(safety.latched(), SafetyReason::PositionJump);
    (0..15).for_each(|_| _ = unsampled(&mut safety, &state));
    let gravity = state.gravity::<Ur5>(&torque(0.5));
    assert!((safety.output() - gravity).amax() < 1e-3);
}

#[test]
fn a_cold_motor_that_gravity_overloads_is_not_hot() {
    let (mut safety, state) = braked();
    safety.limits.torque[1] = 1.0;
    (0..15).for_each(|_| _ = unsampled(&mut safety, &state));
    assert_eq!(safety.latched(), SafetyReason::None);
}

/// The shortest brake closes within one period.
#[test]
fn m8_a_torque_that_is_withdrawn_becomes_that_of_gravity_for_every_brake_and_without_one_stays() {
    let state = FeedForwardState::new(ParameterSet::nominal::<Ur5>(1));
    let gravity = state.gravity::<Ur5>(&torque(0.5));
    let mut stale = withdrawn(&state);
    stale.total = torque(1.0);
    for (close_us, periods, wanted) in [(0, 0, torque(1.0)), (1, 1, gravity), (1000, 2, gravity)] {
        let mut safety = armed();
        safety.limits = limits().with_brake(close_us, 1000);
        assert_eq!(safety.limits.brake_ticks, periods);
        let held = Flags::STALE_SAMPLE;
        for (flags, wanted) in [(held | Flags::WITHDRAWN, wanted), (held, torque(1.0))] {
            stale.flags = flags;
            assert_eq!(safety.with_brakes::<Ur5, 40>(&stale, &state), wanted);
        }
    }
}
