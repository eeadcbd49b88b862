use super::*;
use crate::arm::ur5::Ur5;
use crate::dynamics::{BaseParameters, DISSIPATION_BOUNDS, FrictionColumn, rnea};
use crate::joint::{JointMeasurement, JointMotion, JointVector};
use crate::learning::Request;
use crate::learning::conditioning::MAX_BRIDGED;
use crate::learning::parameters::dot;
use crate::learning::payload::{NO_PAYLOAD, payload_base};
use crate::learning::supervisor::payload_test::PayloadDecision;
use crate::limits::Flags;
use crate::sines;

const N: usize = 6;
const P: usize = 40;

fn prior() -> ParameterSet<N, P> {
    ParameterSet::nominal::<Ur5>(1)
}

/// Learner without alarms: no model explains the torques of these tests.
fn learner() -> Learner<Ur5, N, P> {
    let mut config = LearnerConfig::for_arm::<Ur5>(1e-3);
    config.supervisor.detector.threshold = 1e9;
    Learner::new(config, prior()).unwrap()
}

fn measured(tick: u32, speed: f32, tau: f32) -> JointMeasurement<N> {
    let t = tick as f32 * 1e-3;
    JointMeasurement {
        q: JointVector::from_fn(|j, _| (speed * t + j as f32).sin()),
        tau: JointVector::from_element(tau),
    }
}

fn sample_of(tick: u32, measured: Option<JointMeasurement<N>>, enabled: bool) -> LearningSample<N> {
    LearningSample {
        tick,
        generation: 0,
        requests: 0,
        measured,
        enabled,
        flags: Flags::NONE,
    }
}

/// Sample of a moving arm with a torque of 20 N·m on every joint.
fn moving(tick: u32) -> LearningSample<N> {
    sample_of(tick, Some(measured(tick, 2.0, 20.0)), true)
}

fn learn_ticks(learner: &mut Learner<Ur5, N, P>, ticks: core::ops::Range<u32>, enabled: bool) {
    for tick in ticks {
        let sample = moving(tick);
        learner.study(&LearningSample { enabled, ..sample });
    }
}

/// A decision with this reason is in the log.
fn has_decided(learner: &Learner<Ur5, N, P>, reason: Reason) -> bool {
    let mut decisions = learner.state.report.decisions.since(0);
    decisions.any(|decision| decision.reason == reason)
}

#[test]
fn with_learning_off_only_the_window_fills() {
    let mut learner = learner();
    learn_ticks(&mut learner, 0..100, false);
    assert_eq!(learner.state.active, prior());
    assert_eq!(learner.state.statistics, LearnerStatistics::default());
    let before = learner.state.estimate;
    learn_ticks(&mut learner, 100..101, true);
    assert_eq!(learner.state.statistics.accepted, 1);
    assert_ne!(learner.state.estimate, before);
}

#[test]
fn missing_and_not_finite_measurements_are_bridged() {
    let mut bad_torque = measured(60, 2.0, 20.0);
    bad_torque.tau[0] = f32::NAN;
    let mut bad_position = measured(60, 2.0, 20.0);
    bad_position.q[5] = f32::INFINITY;
    let learn_around = |gap: core::ops::Range<u32>, bad| {
        let mut learner = learner();
        learn_ticks(&mut learner, 0..gap.start, true);
        let full = learner.state.statistics.incomplete;
        gap.clone()
            .for_each(|tick| learner.study(&sample_of(tick, bad, true)));
        learn_ticks(&mut learner, gap.end..200, true);
        assert_eq!(learner.state.statistics.incomplete, full, "{gap:?}");
        learner
    };
    let bridged = learn_around(70..70 + MAX_BRIDGED as u32, None);
    for bad in [Some(bad_torque), Some(bad_position)] {
        let learner = learn_around(70..70 + MAX_BRIDGED as u32, bad);
        assert!(learner.state == bridged.state);
    }
    let whole = learn_around(70..70, None).state.estimate;
    let [bridged, whole] = [bridged.state.estimate, whole].map(|it| it.parameters().rigid);
    for (bridged, whole) in bridged.iter().zip(whole) {
        assert!((bridged - whole).abs() < 0.01 * (1.0 + whole.abs()));
    }
}

/// Under these flags the measured torque is not what the model is asked for.
#[test]
fn flagged_ticks_freeze_learning_for_a_window() {
    for (flag, reason) in [
        (Flags::SATURATED, Reason::FrozenSaturated),
        (Flags::NOT_FINITE, Reason::FrozenNotFinite),
    ] {
        let mut learner = learner();
        learn_ticks(&mut learner, 0..90, true);
        let before = (learner.state.estimate, learner.state.active);
        let window = learner.config.filter_ticks();
        let sample = moving(90);
        learner.study(&LearningSample {
            flags: flag,
            ..sample
        });
        learn_ticks(&mut learner, 91..90 + window, true);
        assert!((learner.state.estimate, learner.state.active) == before);
        let decided = |learner: &Learner<Ur5, N, P>| learner.state.report.decisions.newest();
        assert_eq!(decided(&learner).unwrap().reason, reason);
        learn_ticks(&mut learner, 90 + window..92 + window, true);
        assert_eq!(decided(&learner).unwrap().reason, Reason::Resumed);
        assert!(learner.state.estimate != before.0);
    }
}

#[test]
fn few_lost_samples_are_missing_measurements_and_many_a_gap() {
    let lost = MAX_BRIDGED as u32;
    for (lost, incomplete) in [(1, 0), (lost, 0), (lost + 1, 30)] {
        let mut learner = learner();
        learn_ticks(&mut learner, 0..60, true);
        let before = learner.state.statistics;
        learn_ticks(&mut learner, 60 + lost..90 + lost, true);
        let after = learner.state.statistics;
        assert_eq!(after.accepted, before.accepted + 30 - incomplete, "{lost}");
        assert_eq!(after.incomplete, before.incomplete + incomplete, "{lost}");
    }
}

/// Shares of the joints after a step towards 0, from 1, with `changes` of the torque of some.
fn shares_after(changes: &[(usize, TorqueChanges)], moves_set: bool) -> [f32; N] {
    let mut learner = learner();
    learner.state.supervisor.learnt.share.joint = [1.0; N];
    learner.state.round_changes = [Some(TorqueChanges::default()); N];
    for &(joint, change) in changes {
        learner.state.round_changes[joint] = Some(change);
    }
    learner.follow(moves_set);
    learner.state.supervisor.learnt.share.joint
}

/// The share of a joint whose torque hardly changes goes all the way while that of another takes a bounded step.
#[test]
fn no_joint_stops_the_share_of_another() {
    let most = learner().config.torque_step;
    for (moves_set, part) in [(false, 1.0), (true, 0.5)] {
        let changes = [(0, 0.4 * most), (5, 30.0 * most)].map(|(joint, torque)| {
            let (learnt, estimate) = (torque, torque);
            (joint, TorqueChanges { learnt, estimate })
        });
        let share = shares_after(&changes, moves_set);
        assert_eq!(share[0], 0.0);
        let left = 1.0 - part / 30.0;
        assert!((share[5] - left).abs() < 1e-6, "{moves_set} {share:?}");
    }
    // The set may take all of the step, or by rounding a little more.
    for part in 1..1000 {
        let (learnt, estimate) = (0.0, 1.37e-3 * part as f32);
        let share = shares_after(&[(1, TorqueChanges { learnt, estimate })], true);
        assert_eq!(share, [0.0; N], "{part}");
    }
}

#[test]
fn the_prediction_variance_follows_the_motion_while_the_estimate_pauses() {
    let mut learner = learner();
    learn_ticks(&mut learner, 0..600, true);
    learner.state.supervisor.carries_payload = true;
    let before = learner.state.innovation_variance;
    learn_ticks(&mut learner, 600..660, true);
    for (before, now) in before.iter().zip(learner.state.innovation_variance) {
        assert!((before - now).abs() > 1e-3 * before, "{before} {now}");
    }
}

#[test]
fn a_learner_of_one_joint_keeps_the_friction_of_the_others() {
    let mut learner = learner();
    learner.learn_only(1);
    learn_ticks(&mut learner, 0..600, true);
    let prior = LinearParameters::of(&prior());
    let estimate = learner.state.estimate.parameters();
    assert_ne!(estimate.rigid, prior.rigid);
    for joint in 0..N {
        let moved = estimate.friction[joint] != prior.friction[joint];
        assert_eq!(moved, joint == 1, "joint {joint}");
    }
    let statistics = learner.state.statistics;
    assert!(statistics.accepted > 0 && statistics.accepted <= 100);
}

#[test]
fn rows_of_slow_joints_are_skipped() {
    let mut learner = learner();
    for tick in 0..100 {
        learner.study(&sample_of(tick, Some(measured(tick, 0.04, 20.0)), true));
    }
    assert_eq!(learner.state.active, prior());
    assert_eq!(learner.state.statistics.gated, 39);
}

#[test]
fn impossible_positions_or_torques_are_rejected() {
    let mut learner = learner();
    for tick in 0..100 {
        let mut wild = measured(tick, 2.0, 20.0);
        wild.q[4] = tick as f32;
        learner.study(&sample_of(tick, Some(wild), true));
    }
    for tick in 100..200 {
        learner.study(&sample_of(tick, Some(measured(tick, 2.0, 1e30)), true));
    }
    assert_eq!(learner.state.active, prior());
    assert_eq!(learner.state.statistics.accepted, 0);
    assert!(learner.state.statistics.rejected > 30);
}

#[test]
fn one_encoder_glitch_affects_no_joint() {
    let (mut clean, mut glitched) = (learner(), learner());
    for tick in 0..200 {
        let good = measured(tick, 2.0, 20.0);
        let mut bad = good;
        if tick == 100 {
            bad.q[3] += 0.2;
        }
        clean.study(&sample_of(tick, Some(good), !(100..=130).contains(&tick)));
        glitched.study(&sample_of(tick, Some(bad), true));
    }
    // The glitch is a gap.
    assert_eq!(glitched.state.statistics.rejected, 0);
    let [glitched, clean] =
        [glitched, clean].map(|it| BaseParameters::from(it.state.estimate.parameters().rigid));
    let (apart, moved) = ((glitched - clean).amax(), (clean - prior().rigid).amax());
    assert!(apart < 0.2 * moved, "{apart} of {moved}");
}

#[test]
fn a_wrong_torque_sensor_leaves_parameters_within_bounds() {
    let mut learner = learner();
    learn_ticks(&mut learner, 0..60_000, true);
    let LearnerState {
        active, estimate, ..
    } = &learner.state;
    let prior = prior();
    assert!(active.is_finite());
    assert!(estimate.parameters().iter().all(|theta| theta.is_finite()));
    let mut moved = false;
    for (joint, friction) in active.friction.iter().enumerate() {
        let deviation = learner.config.sigma.friction[joint];
        for bound in &DISSIPATION_BOUNDS {
            let value = dot(bound, &friction.0);
            let least = -0.02 * dot(bound, &deviation);
            assert!(value >= least, "joint {joint}: {friction:?}");
        }
        moved |= estimate.parameters().friction[joint] != prior.friction[joint].0;
    }
    assert!(moved, "nothing was learnt");
}

#[test]
fn sets_are_published_only_when_a_round_closes() {
    let mut learner = learner();
    for tick in 0..60 {
        let mut exchange = Exchange::new();
        learner.learn(&moving(tick), &mut exchange);
        let published = exchange.published.map(|set| set.closed);
        assert_eq!(published, (tick % 6 == 5).then_some(tick));
    }
    assert_eq!(learner.state.statistics.published, 10);
}

#[test]
fn a_loaded_set_is_taken_with_its_first_sample() {
    let mut learner = learner();
    let mut loaded = ParameterSet::nominal::<Ur5>(9);
    loaded.friction[0][FrictionColumn::Coulomb] = 3.0;
    let mut exchange = Exchange::new();
    exchange.reload = Some((1, loaded, StartDeviations::PRIOR));
    for tick in 40..44 {
        let mut sample = sample_of(tick, None, true);
        sample.generation = u32::from(tick >= 42);
        learner.learn(&sample, &mut exchange);
        assert_eq!(learner.state.active == loaded, tick >= 42, "tick {tick}");
        assert_eq!(exchange.reload.is_none(), tick >= 42, "tick {tick}");
    }
}

#[test]
fn a_well_known_parameter_moves_less_than_an_unknown_one() {
    // Coulomb friction of the well-known joint and of another one, prior standard deviations.
    let moved = |part: u8| {
        let mut start = StartDeviations::PRIOR;
        start.friction[3].fill(part);
        start.rigid.fill(part);
        let config = LearnerConfig::for_arm::<Ur5>(1e-3);
        let mut learner = Learner::<Ur5, N, P>::EMPTY;
        learner.restart_with(config, &prior(), &start).unwrap();
        learn_ticks(&mut learner, 0..300, true);
        let friction = learner.state.estimate.parameters().friction;
        [3, 0].map(|joint| friction[joint][1].abs() / config.sigma.friction[joint][1])
    };
    let (known, unknown) = (moved(13), moved(255));
    assert!(known[0] < 0.2 * unknown[0], "{known:?} {unknown:?}");
    assert!(known[1] > 0.2 * unknown[1], "{known:?} {unknown:?}");
}

#[test]
fn an_invalid_configuration_is_refused() {
    let checked = |change: fn(&mut LearnerConfig<N, P>)| {
        let mut config = LearnerConfig::for_arm::<Ur5>(1e-3);
        change(&mut config);
        config.validate()
    };
    assert_eq!(checked(|_| ()), Ok(()));
    let not_positive = Err(ConfigError::NotPositive("sigma.rigid"));
    assert_eq!(checked(|it| it.sigma.rigid[7] = 0.0), not_positive);
    let out_of_range = Err(ConfigError::RateOutOfRange("hidden_rate"));
    assert_eq!(
        checked(|it| it.network.hidden_rate = f32::NAN),
        out_of_range
    );
    let too_large = Err(ConfigError::TooLarge("delay"));
    assert_eq!(
        [checked(|it| it.delay = 1), checked(|it| it.delay = 16)],
        [too_large; 2]
    );
    for period_s in [1.0, 1e-6] {
        let config = LearnerConfig::<N, P>::for_arm::<Ur5>(period_s);
        assert_eq!(config.validate(), Err(ConfigError::TooLarge("inv_period")));
    }
    let no_period = LearnerConfig::<N, P>::for_arm::<Ur5>(0.0);
    assert!(no_period.validate().is_err());
    let mut learner = learner();
    for period_s in [0.0, -1.0, f32::NAN, f32::INFINITY] {
        let restarted = learner.restart_for_arm(period_s, &prior(), &StartDeviations::PRIOR);
        assert_eq!(restarted, Err(ConfigError::TooLarge("period_s")));
    }
    assert!(
        learner.state.window
            == MeasurementWindow::new(learner.config.decimation, learner.config.delay)
    );
}

#[test]
fn a_network_that_costs_is_silenced_under_a_payload_too() {
    let mut learner = learner();
    learn_ticks(&mut learner, 0..90, true);
    let supervisor = &mut learner.state.supervisor;
    supervisor.carries_payload = true;
    // The payload is no longer updated.
    supervisor.blocks_carried = learner.config.supervisor.payload_update_blocks;
    supervisor.learnt.share.joint = [1.0; N];
    let estimate = learner.state.estimate;
    for network in &mut learner.state.active.network {
        network.output_bias[0] = -0.05;
    }
    learn_ticks(&mut learner, 90..6000, true);
    assert!(learner.state.estimate == estimate, "it pauses");
    assert!(has_decided(&learner, Reason::NetworkSilenced));
}

/// Request at `tick` that takes effect with its sample, with the decision `reason`.
fn request_at(learner: &mut Learner<Ur5, N, P>, tick: u32, request: Request, reason: Reason) {
    let mut exchange = Exchange::new();
    exchange.post_request(1, request).unwrap();
    assert!(exchange.post_request(1, request).is_err());
    let mut sample = sample_of(tick, None, true);
    learner.collect(&sample, &mut exchange);
    assert!(exchange.request.is_some(), "taken before its sample");
    sample.requests = 1;
    learner.collect(&sample, &mut exchange);
    assert_eq!(exchange.request, None);
    let newest = learner.state.report.decisions.newest().unwrap();
    assert_eq!((newest.tick, newest.reason), (tick, reason));
}

#[test]
fn a_rollback_restores_the_snapshot_bit_for_bit() {
    let mut learner = learner();
    learn_ticks(&mut learner, 0..200, true);
    request_at(&mut learner, 200, Request::Rollback, Reason::RequestRefused);
    let before = learner.state.active;
    request_at(&mut learner, 201, Request::Snapshot, Reason::SnapshotTaken);
    learn_ticks(&mut learner, 201..1200, true);
    learner.state.active.friction[0].0[0] += 0.1;
    request_at(&mut learner, 1200, Request::Rollback, Reason::RolledBack);
    assert_eq!(learner.state.active, before);
}

#[test]
fn an_emergency_stop_ends_when_learning_is_switched_off() {
    let mut learner = learner();
    learn_ticks(&mut learner, 0..60, true);
    request_at(&mut learner, 60, Request::Stop, Reason::FrozenStopped);
    let before = (learner.state.estimate, learner.state.active);
    learn_ticks(&mut learner, 60..120, true);
    assert!((learner.state.estimate, learner.state.active) == before);
    learn_ticks(&mut learner, 120..121, false);
    learn_ticks(&mut learner, 121..130, true);
    assert!(learner.state.estimate != before.0);
}

#[test]
fn samples_of_another_load_are_not_used() {
    let mut learner = learner();
    learn_ticks(&mut learner, 0..60, true);
    let mut exchange = Exchange::new();
    learner.publish(&mut exchange);
    exchange.published = None;
    let before = (learner.state.estimate, learner.state.statistics);
    for tick in 60..120 {
        let foreign = LearningSample {
            generation: 1,
            ..moving(tick)
        };
        learner.learn(&foreign, &mut exchange);
        assert_eq!(exchange.published, None, "tick {tick}");
    }
    assert!((learner.state.estimate, learner.state.statistics) == before);
    // The window has filled meanwhile.
    learn_ticks(&mut learner, 120..121, true);
    assert!(learner.state.statistics.accepted > before.1.accepted);
}

#[test]
fn a_pending_commit_ends_with_a_new_load() {
    let mut learner = learner();
    let mut exchange = Exchange::new();
    learner.execute(0, Request::Commit);
    for tick in 0..6 {
        learner.learn(&sample_of(tick, None, true), &mut exchange);
    }
    assert!(exchange.published.is_some_and(|set| set.commit));
    // A load during a learning step, before the tick has adopted the set.
    exchange.reload = Some((1, ParameterSet::nominal::<Ur5>(9), StartDeviations::PRIOR));
    for tick in 6..12 {
        let mut sample = sample_of(tick, None, true);
        sample.generation = 1;
        learner.learn(&sample, &mut exchange);
    }
    let published = exchange.published.unwrap();
    assert_eq!((published.generation, published.commit), (1, false));
}

/// Learner with a body of `mass`, kg, in the torque, and the base parameters of the body.
fn carrying(mass: f32) -> (Learner<Ur5, N, P>, BaseParameters<P>) {
    let mut body = NO_PAYLOAD;
    (body[0], body[3]) = (mass, 0.05 * mass);
    let mut learner = learner();
    let supervisor = &mut learner.state.supervisor;
    supervisor.set_payload::<Ur5>(&body);
    supervisor.carries_payload = true;
    (learner, payload_base::<Ur5, N, P>(&body))
}

/// Time until a body of 1 kg in the torque is released, ticks, where the arm is the nominal one plus `actual` bodies and the
/// estimate plus `estimated`; `None` after 4 s.
fn released(actual: f32, estimated: f32) -> Option<u32> {
    let (mut learner, body) = carrying(1.0);
    let nominal = prior().rigid;
    let truth = nominal + body * actual;
    let mut estimate = *learner.state.estimate.parameters();
    estimate.rigid = (nominal + body * estimated).into();
    learner.state.estimate.move_to(&estimate);
    let released = (0..4000).find(|&tick| {
        let motion = sines(1e-3 * f64::from(tick), |j| [1.0, 2.0, j as f64]);
        let tau = rnea::<Ur5, N, P>(&truth, &motion);
        let measured = JointMeasurement { q: motion.q, tau };
        learner.study(&sample_of(tick, Some(measured), true));
        !learner.state.supervisor.carries_payload
    });
    let recorded = has_decided(&learner, Reason::Released);
    assert_eq!(recorded, released.is_some());
    released
}

#[test]
fn a_payload_that_makes_up_for_an_error_of_the_estimate_is_released() {
    assert_eq!(released(1.0, 0.0), None, "a body");
    // The torque is that of the loaded set, which has no such error.
    let ticks = released(0.0, -1.0).expect("it costs");
    assert!((1500..2000).contains(&ticks), "{ticks}");
}

/// Time until a body of 4 kg is released that is put down one second after the arm stands still, ticks; `None` after 3 s.
///
/// * `friction` that holds each joint, N·m      * `put_down` false if the body stays
fn released_at_rest(friction: f32, put_down: bool) -> Option<u32> {
    let (mut learner, body) = carrying(4.0);
    let mut estimate = *learner.state.estimate.parameters();
    for joint in &mut estimate.friction {
        joint[FrictionColumn::Coulomb as usize] = friction;
    }
    learner.state.estimate.move_to(&estimate);
    // It is not updated any more.
    learner.state.supervisor.blocks_carried = learner.config.supervisor.payload_update_blocks;
    let nominal = prior().rigid;
    (0..4000).find(|&tick| {
        let actual = if put_down && tick >= 1000 { 0.0 } else { 1.0 };
        let mut motion = JointMotion::zero();
        motion.q = JointVector::from_fn(|j, _| 0.3 - 0.2 * j as f32);
        let mut tau = rnea::<Ur5, N, P>(&(nominal + body * actual), &motion);
        // No sample is a copy of the one before.
        tau[0] += 1e-3 * (tick % 7) as f32;
        let measured = JointMeasurement { q: motion.q, tau };
        learner.study(&sample_of(tick, Some(measured), true));
        !learner.state.supervisor.carries_payload
    })
}

#[test]
fn a_body_put_down_at_rest_is_released_unless_friction_may_hide_it() {
    let ticks = released_at_rest(0.5, true).expect("the torques show it");
    assert!((1050..1200).contains(&ticks), "{ticks}");
    assert_eq!(released_at_rest(10.0, true), None, "friction");
    assert_eq!(released_at_rest(0.5, false), None, "a body");
}

fn relearn(learner: &mut Learner<Ur5, N, P>) {
    let state = &mut learner.state.supervisor.state;
    (state.phase, state.relearning_ticks) = (Phase::Relearning, 5000);
    learner.state.report.quality.phase = Phase::Relearning;
}

#[test]
fn relearning_raises_no_variance_at_rest() {
    let mut learner = learner();
    learn_ticks(&mut learner, 0..600, true);
    relearn(&mut learner);
    let covariance = |learner: &Learner<Ur5, N, P>| *learner.state.estimate.filter();
    let rest = |learner: &mut Learner<Ur5, N, P>, ticks: core::ops::Range<u32>| {
        for tick in ticks {
            // No sample is a copy of the one before.
            let mut at_rest = measured(599, 2.0, 20.0);
            at_rest.tau[0] += 1e-3 * (tick % 7) as f32;
            learner.study(&sample_of(tick, Some(at_rest), true));
        }
        covariance(learner)
    };
    // The window still has motion.
    let before = rest(&mut learner, 600..700);
    assert!(rest(&mut learner, 700..1900) == before);
    learn_ticks(&mut learner, 1900..2500, true);
    assert!(covariance(&learner) != before);
}

#[test]
fn friction_learnt_under_a_payload_leaves_the_evidence_of_before_little_weight() {
    let mut learner = learner();
    learn_ticks(&mut learner, 0..600, true);
    let pause = learner.config.supervisor.pause_blocks;
    for (blocks, fades) in [(pause - 1, false), (pause, true)] {
        let supervisor = &mut learner.state.supervisor;
        supervisor.keep_checkpoint();
        supervisor.carries_payload = true;
        supervisor.blocks_carried = blocks;
        let before = supervisor.before_payload.learnt.evidence;
        learner.end_payload_test(600, PayloadDecision::Promote);
        let supervisor = &learner.state.supervisor;
        assert_eq!(supervisor.blocks_carried, 0);
        assert_eq!(supervisor.before_payload.learnt.evidence != before, fades);
    }
}

#[test]
fn a_release_keeps_the_covariance_unless_most_of_it_is_of_the_payload() {
    for (rows_before, blocks, kept) in [(0, true, false), (0, false, true), (900, true, true)] {
        let mut learner = learner();
        learn_ticks(&mut learner, 0..600, true);
        let pause = learner.config.supervisor.pause_blocks;
        let supervisor = &mut learner.state.supervisor;
        supervisor.carries_payload = true;
        supervisor.rows_before = rows_before;
        supervisor.blocks_carried = if blocks { pause } else { pause - 1 };
        let before = *learner.state.estimate.filter();
        learner.end_payload_test(600, PayloadDecision::Release);
        let after = *learner.state.estimate.filter();
        assert_eq!(after == before, kept, "{rows_before} {blocks}");
        assert_eq!(learner.state.estimate.rows() > 0, kept);
        // Rows are used again when the prior covariance is back.
        learn_ticks(&mut learner, 600..1200, true);
        assert!(*learner.state.estimate.filter() != after);
    }
}

#[test]
fn a_rollback_returns_to_the_covariance_of_the_start() {
    let mut learner = learner();
    learn_ticks(&mut learner, 0..600, true);
    learner.execute(600, Request::Snapshot);
    learn_ticks(&mut learner, 600..1200, true);
    assert!(learner.state.estimate.rows() > 0);
    learner.execute(1200, Request::Rollback);
    assert_eq!(learner.state.estimate.rows(), 0);
    assert!(learner.state.estimate.parameters() == &learner.state.supervisor.learnt.set);
}

/// Samples of eight ticks: in some of its turns a joint has none.
#[test]
fn time_passes_where_a_joint_has_no_row_in_some_turns() {
    let mut learner = learner();
    learner.config.decimation = 8;
    learner.state.window = MeasurementWindow::new(8, 15);
    learn_ticks(&mut learner, 0..600, true);
    relearn(&mut learner);
    learn_ticks(&mut learner, 600..3600, true);
    let passed = 5000 - learner.state.supervisor.state.relearning_ticks;
    assert!((2980..=3020).contains(&passed), "{passed}");
}
