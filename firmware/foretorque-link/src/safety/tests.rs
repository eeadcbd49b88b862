use super::*;
use foretorque::arm::ur5::{JOINTS as N, Ur5};
use foretorque::joint::{JointMeasurement, JointMotion};
use proptest::prelude::*;

type Change = fn(&mut JointSample<N>);

fn limits() -> SafetyLimits<N> {
    SafetyLimits::for_arm::<Ur5, _>(1e-3)
}

fn sample() -> JointSample<N> {
    JointSample {
        desired: JointMotion {
            q: JointVector::<N>::repeat(0.5),
            ..JointMotion::zero()
        },
        measured: Some(JointMeasurement {
            q: JointVector::<N>::repeat(0.5),
            tau: JointVector::<N>::zeros(),
        }),
    }
}

fn measured(sample: &mut JointSample<N>) -> &mut JointMeasurement<N> {
    sample.measured.as_mut().unwrap()
}

fn tick(safety: &mut Safety<N>, sample: Option<JointSample<N>>) -> JointVector<N> {
    safety.admit(sample, 1, SafetyReason::None);
    safety.release(&JointVector::<N>::repeat(5.0))
}

fn ready() -> Safety<N> {
    let mut safety = Safety::new(limits(), SafetyReason::None);
    for _ in 0..ARM_SAMPLES {
        assert_eq!(tick(&mut safety, Some(sample())), JointVector::<N>::zeros());
    }
    safety
}

fn armed() -> Safety<N> {
    let mut safety = ready();
    assert_eq!(safety.arm(), Ok(()));
    for _ in 0..5 {
        tick(&mut safety, Some(sample()));
    }
    assert_eq!(*safety.output(), JointVector::<N>::repeat(5.0));
    safety
}

/// Ticks until the torque has ended, with nothing heard; the largest step on the way.
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
fn a_new_board_is_disarmed_and_lets_no_torque_through() {
    let mut safety = Safety::new(limits(), SafetyReason::None);
    assert_eq!(safety.status(), SafetyStatus::default());
    for _ in 0..100 {
        assert_eq!(tick(&mut safety, Some(sample())), JointVector::<N>::zeros());
    }
    assert!(!safety.enabled());
}

#[test]
fn arming_takes_fresh_plausible_near_samples() {
    assert_eq!(ready().arm(), Ok(()));
    let refused = |change: Change, reason| {
        let mut safety = ready();
        let mut changed = sample();
        change(&mut changed);
        tick(&mut safety, Some(changed));
        let before = safety;
        assert_eq!(safety.arm(), Err(reason));
        assert_eq!(safety, before, "a refusal changes nothing");
    };
    refused(|s| s.measured = None, SafetyReason::NoSample);
    refused(
        |s| measured(s).q[2] = f32::NAN,
        SafetyReason::MeasuredNotFinite,
    );
    refused(|s| measured(s).q[2] = 7.0, SafetyReason::PositionRange);
    refused(|s| measured(s).q[2] += 0.1, SafetyReason::PositionJump);
    refused(|s| measured(s).tau[0] = 451.0, SafetyReason::EffortRange);
    refused(
        |s| s.desired.qdd[5] = f32::INFINITY,
        SafetyReason::DesiredNotFinite,
    );
    refused(|s| s.desired.q[0] += 0.1, SafetyReason::DesiredJump);
    let mut stale = ready();
    for _ in 0..=50 {
        tick(&mut stale, None);
    }
    assert_eq!(stale.arm(), Err(SafetyReason::NoSample));
    let mut far = ready();
    let mut sample = sample();
    sample.desired.q[0] += 0.3;
    for _ in 0..=ARM_SAMPLES {
        tick(&mut far, Some(sample));
    }
    assert_eq!(far.arm(), Err(SafetyReason::TooFar));
}

#[test]
fn a_sound_torque_passes_bit_for_bit_and_an_unsound_one_within_the_hard_limits() {
    let mut safety = armed();
    for k in 0..1000 {
        // As fast as the tick's own slew limit allows, half the hard one.
        let wanted = limits().torque * (0.9 * (k as f32 * 0.05).sin());
        safety.admit(Some(sample()), 1, SafetyReason::None);
        let given = safety.release(&wanted);
        assert!(k < 20 || given == wanted, "tick {k}");
    }
    for absurd in [1e30, -1e30] {
        let before = *safety.output();
        safety.admit(Some(sample()), 1, SafetyReason::None);
        let given = safety.release(&JointVector::<N>::repeat(absurd));
        for joint in 0..N {
            let step = (given[joint] - before[joint]).abs();
            assert!(step <= 1.0001 * limits().slew_per_tick[joint]);
            assert!(given[joint].abs() <= limits().torque[joint]);
        }
    }
}

#[test]
fn silence_ends_the_torque_by_a_ramp_and_samples_alone_never_bring_it_back() {
    let mut safety = armed();
    let (ticks, steepest) = run_out(&mut safety);
    assert!((51..60).contains(&ticks), "{ticks}");
    assert!(steepest <= limits().slew_per_tick.max());
    let timed_out = SafetyStatus {
        state: SafetyState::Disarmed,
        reason: SafetyReason::CommandTimeout,
    };
    assert_eq!(safety.status(), timed_out);
    for _ in 0..100 {
        assert_eq!(tick(&mut safety, Some(sample())), JointVector::<N>::zeros());
    }
    assert_eq!(safety.arm(), Ok(()), "a time-out is no fault");
}

#[test]
fn a_gap_shorter_than_the_time_out_ends_nothing() {
    let mut safety = armed();
    for _ in 0..50 {
        assert_eq!(tick(&mut safety, None), JointVector::<N>::repeat(5.0));
    }
    assert_eq!(
        tick(&mut safety, Some(sample())),
        JointVector::<N>::repeat(5.0)
    );
    assert_eq!(safety.status().state, SafetyState::Armed);
}

#[test]
fn a_stop_is_immediate_from_any_state_and_latches() {
    for mut safety in [Safety::new(limits(), SafetyReason::None), ready(), armed()] {
        safety.torque_off(SafetyReason::Stopped);
        assert!(!safety.enabled());
        assert_eq!(tick(&mut safety, Some(sample())), JointVector::<N>::zeros());
        assert_eq!(safety.status().reason, SafetyReason::Stopped);
        for _ in 0..10 {
            tick(&mut safety, Some(sample()));
        }
        assert_eq!(safety.arm(), Err(SafetyReason::Stopped));
        assert_eq!(safety.clear(), Ok(()));
        assert_eq!(safety.status(), SafetyStatus::default());
        assert_eq!(safety.arm(), Ok(()), "only after it was cleared");
    }
}

#[test]
fn disarming_ramps_and_the_board_cannot_be_armed_on_the_way() {
    let mut safety = armed();
    safety.release(&JointVector::<N>::repeat(14.0));
    safety.disarm();
    assert_eq!(safety.status().state, SafetyState::RampDown);
    assert!(safety.enabled());
    assert_eq!(safety.arm(), Err(SafetyReason::StillRamping));
    let (ticks, _) = run_out(&mut safety);
    assert!(ticks > 1, "{ticks}");
    assert_eq!(safety.status().reason, SafetyReason::Disarmed);
}

#[test]
fn one_implausible_sample_is_survived_and_lasting_ones_latch_their_reason() {
    let cases: [(Change, SafetyReason); 4] = [
        (
            |s| measured(s).q[1] = f32::NAN,
            SafetyReason::MeasuredNotFinite,
        ),
        (|s| measured(s).q[1] = -6.5, SafetyReason::PositionRange),
        (|s| measured(s).tau[5] = 90.0, SafetyReason::EffortRange),
        (
            |s| s.desired.qd[3] = f32::NAN,
            SafetyReason::DesiredNotFinite,
        ),
    ];
    for (change, reason) in cases {
        let mut bad = sample();
        change(&mut bad);
        let mut safety = armed();
        tick(&mut safety, Some(bad));
        let told = safety.status();
        assert_eq!(told.state, SafetyState::Armed);
        assert!(told.reason == reason || told.reason == SafetyReason::PositionRange);
        for _ in 0..10 {
            tick(&mut safety, Some(sample()));
        }
        assert_eq!(safety.status().state, SafetyState::Armed);
        for _ in 0..60 {
            tick(&mut safety, Some(bad));
        }
        let (_, _) = run_out(&mut safety);
        let latched = SafetyStatus {
            state: SafetyState::Fault,
            reason,
        };
        assert_eq!(safety.status(), latched);
        for _ in 0..10 {
            tick(&mut safety, Some(sample()));
        }
        assert_eq!(safety.arm(), Err(reason));
    }
}

#[test]
fn an_implausible_measurement_is_not_learnt_from() {
    let mut safety = armed();
    let mut bad = sample();
    measured(&mut bad).q[0] += 0.2;
    let admitted = safety.admit(Some(bad), 1, SafetyReason::None).unwrap();
    assert_eq!((admitted.desired, admitted.measured), (bad.desired, None));
    let mut jump = sample();
    jump.desired.q[0] += 0.2;
    assert_eq!(safety.admit(Some(jump), 1, SafetyReason::None), None);
}

#[test]
fn a_step_after_lost_samples_is_no_jump() {
    let mut safety = armed();
    let mut later = sample();
    measured(&mut later).q[0] += 0.1;
    later.desired.q[0] += 0.1;
    assert_eq!(
        safety.admit(Some(later), 30, SafetyReason::None),
        Some(later)
    );
    assert_eq!(safety.status().reason, SafetyReason::None);
}

#[test]
fn jumps_that_come_back_too_often_latch() {
    let mut safety = armed();
    for k in 0..400 {
        let mut sample = sample();
        measured(&mut sample).q[0] += if k % 4 == 0 { 0.2 } else { 0.0 };
        tick(&mut safety, Some(sample));
    }
    assert_eq!(safety.latched(), SafetyReason::PositionJump);
}

#[test]
fn heat_tightens_the_limit_and_ends_the_torque() {
    let mut safety = armed();
    safety.note_temperature(3, 90);
    for _ in 0..30 {
        safety.admit(Some(sample()), 1, SafetyReason::None);
        safety.release(&JointVector::<N>::repeat(28.0));
    }
    assert_eq!(safety.output()[3], 14.0);
    assert_eq!(safety.output()[4], 28.0);
    assert_eq!(safety.status().reason, SafetyReason::MotorWarm);
    safety.note_temperature(3, 100);
    run_out(&mut safety);
    assert_eq!(safety.latched(), SafetyReason::MotorHot);
    assert_eq!(safety.clear(), Err(SafetyReason::MotorHot));
    safety.note_temperature(3, 96);
    assert_eq!(
        safety.clear(),
        Err(SafetyReason::MotorHot),
        "within the hysteresis"
    );
    safety.note_temperature(3, 70);
    assert_eq!(safety.clear(), Ok(()));
}

#[test]
fn a_fault_kept_over_the_reset_is_still_there_and_a_restart_of_the_tick_keeps_it_too() {
    let mut safety = Safety::new(limits(), SafetyReason::Restarted);
    for _ in 0..10 {
        tick(&mut safety, Some(sample()));
    }
    assert_eq!(safety.arm(), Err(SafetyReason::Restarted));
    safety.restart(limits());
    assert_eq!(safety.latched(), SafetyReason::Restarted);
    assert_eq!(safety.clear(), Ok(()));
    let mut armed = armed();
    armed.restart(limits());
    assert!(!armed.enabled(), "a restart does not arm");
}

#[test]
fn silence_between_samples_that_pace_ends_the_torque_too() {
    let mut safety = armed();
    let periods = (0..1000).take_while(|_| {
        safety.silence();
        safety.enabled()
    });
    assert!((50..60).contains(&periods.count()));
    assert_eq!(safety.status().reason, SafetyReason::CommandTimeout);
}

#[test]
fn silence_ages_a_disarmed_board_and_its_reasons_stay() {
    let mut safety = ready();
    for _ in 1..limits().timeout_ticks {
        safety.silence();
    }
    let mut in_time = safety;
    assert_eq!(in_time.arm(), Ok(()));
    safety.silence();
    assert_eq!(safety.arm(), Err(SafetyReason::NoSample));
    let mut wrong = ready();
    let mut bad = sample();
    measured(&mut bad).q[1] = -6.5;
    tick(&mut wrong, Some(bad));
    wrong.silence();
    assert_eq!(wrong.arm(), Err(SafetyReason::PositionRange));
}

#[test]
fn a_board_just_armed_waits_for_a_sample_however_large_the_torque_it_is_given() {
    let mut safety = ready();
    assert_eq!(safety.arm(), Ok(()));
    for _ in 0..10 {
        assert_eq!(tick(&mut safety, None), JointVector::<N>::zeros());
        safety.silence();
        assert_eq!(*safety.output(), JointVector::<N>::zeros());
        assert_eq!(safety.status().state, SafetyState::Armed);
    }
    let torque = tick(&mut safety, Some(sample()));
    assert!(torque.iter().all(|&torque| torque > 1.0));
    // A torque that flows stands what a board just armed does not.
    let mut far = sample();
    far.desired.q[0] += 0.3;
    safety.admit(Some(far), 100, SafetyReason::None);
    assert_eq!(safety.status().state, SafetyState::Armed);
}

proptest! {
    /// Whatever happens, in whatever order.
    #[test]
    fn the_torque_is_finite_bounded_slewed_and_zero_unless_the_host_armed(
        steps in prop::collection::vec((0..12u8, any::<u32>(), 0..N), 1..300),
    ) {
        let mut safety = Safety::<N>::new(limits(), SafetyReason::None);
        let mut allowed = false;
        for (kind, bits, joint) in steps {
            let value = f32::from_bits(bits);
            let mut heard = Some(sample());
            match kind {
                0 => allowed |= safety.arm().is_ok(),
                1 => safety.disarm(),
                2 => { safety.torque_off(SafetyReason::Stopped); allowed = false; }
                3 => { let _ = safety.clear(); }
                4 => safety.note_temperature(joint, bits as i8),
                5 => heard = None,
                6 => measured(heard.as_mut().unwrap()).q[joint] = value,
                7 => heard.as_mut().unwrap().desired.qd[joint] = value,
                8 => safety.silence(),
                9 => { safety.restart(limits()); allowed = false; }
                _ => {}
            }
            let before = *safety.output();
            safety.admit(heard, 1, SafetyReason::None);
            let given = safety.release(&JointVector::<N>::repeat(value));
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
