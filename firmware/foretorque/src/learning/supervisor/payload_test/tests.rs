use super::*;
use crate::arm::ur5::{LearnerConfig, Ur5};
use crate::learning::payload::NO_PAYLOAD;

fn config() -> SupervisorConfig {
    LearnerConfig::for_arm::<Ur5>(1e-3).supervisor
}

fn is_refused_for_residual(decision: PayloadDecision) -> bool {
    matches!(decision, PayloadDecision::Refuse(Reason::Residual, _))
}

pub(in crate::learning::supervisor) fn of_mass(mass: f32) -> Payload {
    [mass, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
}

/// Adds one row for each parameter and two more for the mass, on the joints in turn. The torque has `carried` in it, the arm
/// holds `actual`.
///
/// * `height` of the column in its row, N·m a unit
/// * `noise` of the torque of each row, N·m
/// * `deviations` standard deviations of a measurement and of a block, N·m
pub(in crate::learning::supervisor) fn add_block<const JOINTS: usize>(
    test: &mut PayloadHypothesisTest<JOINTS>,
    [carried, actual]: [&Payload; 2],
    height: f32,
    mut noise: impl FnMut(usize) -> f32,
    deviations: [f32; 2],
) {
    for k in 0..PAYLOAD_PARAMETERS + 2 {
        let mut row = NO_PAYLOAD;
        row[k % PAYLOAD_PARAMETERS] = height;
        let tau = payload_torque(actual, &row) + noise(k);
        let torques = [tau, tau - payload_torque(carried, &row)];
        test.add_row(k % JOINTS, carried, &row, torques, deviations);
    }
}

/// Decision after blocks with `carried` in the torque where the arm has `actual`, on `JOINTS` joints, for rows of the noise and
/// of the deviation `inflated`, N·m: with their number, and the standard deviation of the mass then, kg.
fn decided<const JOINTS: usize>(
    carried: &Payload,
    actual: &Payload,
    (noise, inflated): (f32, f32),
) -> (u32, PayloadDecision, f32) {
    let config = config();
    let mut test = PayloadHypothesisTest::<JOINTS>::new(&config, carried);
    for block in 1.. {
        let noise = |k: usize| [noise, -noise][(block as usize + k) % 2];
        add_block(&mut test, [carried, actual], 10.0, noise, [0.1, inflated]);
        let carries = *carried != NO_PAYLOAD;
        if let Some(decision) = test.decide(&config, carries, false, 0.0) {
            return (block, decision, test.filter.mass_sigma());
        }
    }
    unreachable!("the test has a time-out");
}

#[test]
fn every_disturbance_has_its_decision() {
    let config = config();
    let of = |mass: f32, [x, y, z]: [f32; 3]| [mass, mass * x, mass * y, mass * z, 0.0, 0.0, 0.0];
    let two = of(2.0, [0.05; 3]);
    let (far, light) = (
        1.02 * config.max_com_distance,
        0.9 * config.min_payload_mass,
    );
    let heavy = of(1.01 * config.max_payload_mass, [0.0; 3]);
    // A first moment without mass explains much that an empty hand does not.
    let mut pulled = NO_PAYLOAD;
    pulled[1] = 1.5;
    let implausible = |mass: f32| PayloadDecision::Refuse(Reason::Implausible, mass);
    let five = config.decision_blocks;
    let (warm, late) = (five, config.timeout_blocks);
    for (carried, actual, blocks, wanted) in [
        (NO_PAYLOAD, two, warm, PayloadDecision::Promote),
        (two, NO_PAYLOAD, five, PayloadDecision::Release),
        (NO_PAYLOAD, NO_PAYLOAD, five, PayloadDecision::Transient),
        (two, two, five, PayloadDecision::Transient),
        // Heavier by a little: another payload, not an empty hand.
        (two, of(3.0, [0.05; 3]), warm, PayloadDecision::Promote),
        (two, of(0.9, [0.05; 3]), warm, PayloadDecision::Promote),
        // Nearly all of it is gone, and what remains is a body or none.
        (
            two,
            of(1.2 * config.min_payload_mass, [0.0; 3]),
            five,
            PayloadDecision::Release,
        ),
        (two, pulled, five, PayloadDecision::Release),
        (NO_PAYLOAD, of(2.0, [far, 0.0, 0.0]), late, implausible(2.0)),
        (NO_PAYLOAD, of(2.0, [0.0, far, 0.0]), late, implausible(2.0)),
        (NO_PAYLOAD, of(2.0, [0.0, 0.0, far]), late, implausible(2.0)),
        (NO_PAYLOAD, of(light, [0.0; 3]), late, implausible(light)),
        (NO_PAYLOAD, heavy, late, implausible(heavy[0])),
    ] {
        let (block, decision, _) = decided::<2>(&carried, &actual, (0.03, 0.1));
        let near = match (decision, wanted) {
            (PayloadDecision::Refuse(a, x), PayloadDecision::Refuse(b, y)) => {
                a == b && (x - y).abs() < 0.02 * y
            }
            (decision, wanted) => decision == wanted,
        };
        assert!(near, "{carried:?} {actual:?}: {decision:?}");
        assert!(
            (blocks..=blocks + 3).contains(&block),
            "{actual:?}: {block}"
        );
    }
    // An empty hand under noise that no payload explains, and a payload that is hardly felt.
    let (_, released, _) = decided::<2>(&two, &NO_PAYLOAD, (2.0, 0.1));
    assert_eq!(released, PayloadDecision::Release);
    let tiny = of(0.005, [0.0; 3]);
    let (_, over, _) = decided::<2>(&tiny, &tiny, (0.03, 0.1));
    assert_eq!(over, PayloadDecision::Transient);
    // A disturbance that a payload explains in part.
    let (block, decision, _) = decided::<2>(&NO_PAYLOAD, &two, (3.0, 0.1));
    assert!(is_refused_for_residual(decision), "{decision:?}");
    assert_eq!(block, late);
    // Evidence comes before a mass that is certain enough.
    let (block, decision, sigma) = decided::<2>(&NO_PAYLOAD, &two, (0.03, 20.0));
    assert_eq!(decision, PayloadDecision::Promote);
    let enough = 0.1 * two[0];
    assert!(enough > config.max_mass_sigma && (0.9 * enough..enough).contains(&sigma));
    assert!(block > 20, "{block}: {sigma} kg");
    // For a light body the limit by the rated payload is wider than a tenth of its mass.
    let light = of(1.0, [0.05; 3]);
    let (_, _, sigma) = decided::<2>(&NO_PAYLOAD, &light, (0.03, 20.0));
    assert!((0.1..config.max_mass_sigma).contains(&sigma), "{sigma} kg");
}

#[test]
fn a_body_that_one_joint_alone_shows_is_none() {
    let body = of_mass(2.0);
    let (_, of_two, _) = decided::<2>(&NO_PAYLOAD, &body, (0.03, 0.1));
    assert_eq!(of_two, PayloadDecision::Promote);
    let (_, of_one, _) = decided::<1>(&NO_PAYLOAD, &body, (0.03, 0.1));
    assert!(is_refused_for_residual(of_one), "{of_one:?}");
}

/// An error of the description that the estimate learns as well is no body.
#[test]
fn a_body_has_to_excel_the_estimate_that_goes_on_learning() {
    let config = config();
    let body = of_mass(2.0);
    let mut row = NO_PAYLOAD;
    row[0] = 10.0;
    for (left, promoted) in [(20.0, true), (2.0, true), (0.01, false)] {
        let mut test = PayloadHypothesisTest::<2>::new(&config, &NO_PAYLOAD);
        let decision = (0..config.timeout_blocks).find_map(|_| {
            for k in 0..PAYLOAD_PARAMETERS + 2 {
                let tau = payload_torque(&body, &row);
                test.add_row(k % 2, &NO_PAYLOAD, &row, [tau, left], [0.1; 2]);
            }
            let decision = test.decide(&config, false, false, 0.0);
            decision.filter(|decision| decision.is_change())
        });
        assert_eq!(decision.is_some(), promoted, "{left} N·m");
    }
}

#[test]
fn a_window_lasts_while_its_evidence_grows_fast_enough() {
    let config = config();
    let mut row = NO_PAYLOAD;
    row[0] = 10.0;
    // Squares of the rival, in variances: twice the pace, and half of it.
    let pace = config.payload_evidence / config.timeout_blocks as f32;
    for (square, last) in [(2.0 * pace, config.payload_update_blocks), (0.5 * pace, 1)] {
        let mut test = PayloadHypothesisTest::<2>::new(&config, &NO_PAYLOAD);
        let over = (1..).find(|_| {
            // A body that one joint alone shows is never promoted.
            let torques = [2.0, crate::math::sqrt(square)];
            test.add_row(0, &NO_PAYLOAD, &row, torques, [1.0; 2]);
            _ = test.decide(&config, false, false, 0.0);
            test.is_over(&config)
        });
        assert_eq!(over, Some(last), "{square}");
    }
}

/// Background test with the payload `actual` by block where `carried` is in the torque: decisions with their blocks until the
/// payload changes, and the mass of the last hypothesis, kg; `blocks` blocks, with torques of `height` times the noise of one
/// standard deviation.
fn background(
    carried: &Payload,
    actual: impl Fn(u32) -> Payload,
    (height, blocks): (f32, u32),
) -> (std::vec::Vec<(u32, PayloadDecision)>, f32) {
    let config = config();
    let mut test = PayloadHypothesisTest::<2>::new(&config, carried);
    let mut random = 1u64;
    let mut decisions = std::vec::Vec::new();
    for block in 1..blocks {
        // Uniform, of the variance of a measurement.
        let noise = |_| {
            random = random
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            0.1 * 3.0f32.sqrt() * ((random >> 40) as f32 / (1 << 23) as f32 - 1.0)
        };
        let actual = actual(block);
        add_block(&mut test, [carried, &actual], height, noise, [0.1; 2]);
        let decision = test.decide(&config, *carried != NO_PAYLOAD, false, 1.0);
        decisions.extend(decision.map(|decision| (block, decision)));
        if decision.is_some_and(PayloadDecision::is_change) {
            break;
        }
        if test.is_over(&config) {
            test.next_window(&config, carried);
        }
    }
    (decisions, test.filter.payload()[0])
}

/// The change of the payload in such a test.
fn found(carried: &Payload, actual: &Payload, how: (f32, u32)) -> Option<(u32, PayloadDecision)> {
    let (decisions, _) = background(carried, |_| *actual, how);
    let is_change = |(_, decision): &(u32, PayloadDecision)| decision.is_change();
    decisions.into_iter().find(is_change)
}

#[test]
fn a_payload_below_the_noise_is_found_in_the_background_and_noise_is_none() {
    let light = of_mass(0.3);
    assert_eq!(found(&NO_PAYLOAD, &NO_PAYLOAD, (0.3, 150)), None);
    assert_eq!(found(&light, &light, (0.3, 150)), None);
    for (carried, actual, wanted) in [
        (NO_PAYLOAD, light, PayloadDecision::Promote),
        (light, NO_PAYLOAD, PayloadDecision::Release),
    ] {
        let (block, decision) = found(&carried, &actual, (0.3, 150)).expect("a change");
        assert!(decision == wanted && block > 20, "{block}: {decision:?}");
    }
}

#[test]
fn a_release_is_found_though_no_window_alone_shows_it() {
    let light = of_mass(0.3);
    let window = config().timeout_blocks;
    let (block, decision) = found(&light, &NO_PAYLOAD, (0.08, 3000)).expect("a change");
    assert!(decision == PayloadDecision::Release, "{decision:?}");
    assert!(block > window, "{block}");
    assert_eq!(found(&light, &light, (0.08, 3000)), None);
}

#[test]
fn a_payload_let_go_within_a_window_is_not_half_a_payload() {
    let body = of_mass(1.0);
    for height in [0.1, 0.2, 0.3] {
        for last in [40, 80, 120] {
            let actual = |block| if block > last { NO_PAYLOAD } else { body };
            let (decisions, _) = background(&body, actual, (height, 300));
            let (block, decision) = *decisions.last().expect("a change");
            assert_eq!(decision, PayloadDecision::Release, "{height} {block}");
            assert!(block > last, "{block}");
        }
    }
}

#[test]
fn what_a_body_explains_is_no_transient_though_it_is_quiet() {
    let light = of_mass(0.3);
    for (actual, transient) in [(NO_PAYLOAD, true), (light, false)] {
        let (decisions, _) = background(&NO_PAYLOAD, |_| actual, (1.0, 150));
        let is_over = |(_, decision): &&_| *decision == PayloadDecision::Transient;
        let over = decisions.iter().find(is_over);
        assert_eq!(over.is_some(), transient, "{decisions:?}");
        assert!(over.is_none_or(|(block, _)| *block < 10), "{decisions:?}");
    }
}

/// Windows without evidence are short: few rows from before a body is picked up delay it, or make it lighter.
#[test]
fn a_body_is_found_soon_and_nearly_whole_whenever_it_is_picked_up() {
    let body = of_mass(1.0);
    for (height, soon, whole) in [(0.05, 250, 0.95), (0.2, 50, 0.75)] {
        let mut sum = 0.0;
        let picks = (0..300).step_by(30);
        for first in picks.clone() {
            let actual = |block| if block < first { NO_PAYLOAD } else { body };
            let (decisions, mass) = background(&NO_PAYLOAD, actual, (height, first + soon));
            let last = decisions.last().map(|(_, decision)| *decision);
            assert_eq!(last, Some(PayloadDecision::Promote), "{height} {first}");
            sum += mass;
        }
        let mean = sum / picks.count() as f32;
        assert!(mean > whole, "{height}: {mean} kg");
    }
}

#[test]
fn a_joint_at_rest_shows_an_empty_hand_where_no_friction_and_no_brake_can_hide_it() {
    let config = config();
    let body = of_mass(1.0);
    // Payload of 10 N·m; residual without it and deviation, N·m; blocks between two such blocks.
    for (residual, deviation, every, released) in [
        (0.0, 1.0, 1, true),
        (1.0, 1.0, 1, true),
        (10.0, 1.0, 1, false),
        (5.0, 1.0, 1, false),
        // Friction of a quarter of its torque, or more.
        (0.0, 1.6, 1, false),
        // A brake carries the arm as well.
        (-40.0, 1.0, 1, false),
        // Not in consecutive blocks.
        (0.0, 1.0, config.decision_blocks - 1, false),
    ] {
        let mut test = PayloadHypothesisTest::<2>::new(&config, &body);
        let after = (0..1000).find(|block| {
            let residual = if block % every == 0 { residual } else { 10.0 };
            test.add_rest(10.0, residual, deviation * deviation);
            test.decide(&config, true, false, 1.0) == Some(PayloadDecision::Release)
        });
        let expected = released.then_some(config.decision_blocks - 1);
        assert_eq!(after, expected, "{residual} {deviation} {every}");
    }
}

#[test]
fn a_torque_at_rest_that_is_that_of_an_empty_hand_for_a_moment_is_forgotten_in_motion() {
    let config = config();
    let body = of_mass(1.0);
    let mut test = PayloadHypothesisTest::<2>::new(&config, &body);
    test.add_rest(100.0, 0.0, 1.0);
    assert_eq!(test.decide(&config, true, false, 1.0), None);
    assert!(test.may_be_empty());
    for k in 0..10 {
        test.add_row(k % 2, &body, &body, [1.0, 0.0], [0.2; 2]);
    }
    assert_eq!(test.decide(&config, true, false, 1.0), None);
    assert!(!test.may_be_empty());
}

#[test]
fn a_payload_costs_when_the_torques_want_less_than_half_of_it() {
    let of = |shares: &[f32]| {
        let mut benefit = PayloadBenefit::NONE;
        for share in shares {
            for row in 0..1000 {
                let payload = (0.05 * row as f32).sin();
                benefit.add_row(payload, share * payload);
                benefit.end_block(500);
            }
        }
        benefit
    };
    let after = |shares: &[f32]| of(shares).is_cost(500);
    assert!(!PayloadBenefit::NONE.is_cost(500) && !after(&[0.6]) && after(&[0.4]));
    // What was long ago does not count.
    assert!(after(&[1.0, 1.0, 0.2]) && !after(&[0.0, 0.0, 0.8]));
    // Nothing is forgotten at rest, and the first rows after it do not decide, neither do those after a promotion.
    for mut benefit in [of(&[0.9]), PayloadBenefit::NONE] {
        (0..3000).for_each(|_| benefit.end_block(500));
        benefit.add_row(0.1, -0.1);
        benefit.end_block(500);
        assert!(!benefit.is_cost(500), "{benefit:?}");
    }
    // Minutes in which only joints move that carry next to nothing of the body, with errors of the model that last.
    let mut benefit = of(&[0.9]);
    for row in 0..20_000 {
        benefit.add_row(0.05, 0.2 * (0.003 * row as f32).sin() - 0.2);
        benefit.end_block(500);
        assert!(!benefit.is_cost(500), "{row} {benefit:?}");
    }
}
