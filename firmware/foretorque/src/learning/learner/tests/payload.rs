use super::*;
use crate::dynamics::{FrictionColumn, rnea};
use crate::joint::JointMotion;
use crate::learning::decision::Reason;
use crate::learning::payload::{NO_PAYLOAD, payload_base};

/// Time until a body of 1 kg in the torque is released, ticks, where the arm is the nominal one plus `felt` bodies and the
/// estimate plus `estimated`; `None` after 4 s.
fn released(felt: f32, estimated: f32) -> Option<u32> {
    let mut body = NO_PAYLOAD;
    (body[0], body[3]) = (1.0, 0.05);
    let base = payload_base::<Ur5, N, P>(&body);
    let mut learner = learner();
    let nominal = prior().rigid;
    let truth = nominal + base * felt;
    let mut estimate = *learner.state.estimate.parameters();
    estimate.rigid = (nominal + base * estimated).into();
    learner.state.estimate.move_to(&estimate);
    let supervisor = &mut learner.state.supervisor;
    supervisor.set_payload::<Ur5>(&body);
    supervisor.carries_payload = true;
    let mut released = None;
    for tick in 0..4000 {
        let angle = |j: usize| 2e-3 * tick as f32 + j as f32;
        let motion = JointMotion {
            q: JointVector::from_fn(|j, _| angle(j).sin()),
            qd: JointVector::from_fn(|j, _| 2.0 * angle(j).cos()),
            qdd: JointVector::from_fn(|j, _| -4.0 * angle(j).sin()),
        };
        let measured = JointMeasurement {
            q: motion.q,
            tau: rnea::<Ur5, N, P>(&truth, &motion),
        };
        learner.study(&sample_of(tick, Some(measured), true));
        if released.is_none() && !learner.state.supervisor.carries_payload {
            released = Some(tick);
        }
    }
    let decisions = &learner.state.report.decisions;
    let mut decisions = (0..decisions.count()).filter_map(|index| decisions.get(index));
    let recorded = decisions.any(|decision| decision.reason == Reason::Released);
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
    let mut body = NO_PAYLOAD;
    (body[0], body[3]) = (4.0, 0.2);
    let base = payload_base::<Ur5, N, P>(&body);
    let mut learner = learner();
    let mut estimate = *learner.state.estimate.parameters();
    for joint in &mut estimate.friction {
        joint[FrictionColumn::Coulomb as usize] = friction;
    }
    learner.state.estimate.move_to(&estimate);
    let supervisor = &mut learner.state.supervisor;
    supervisor.set_payload::<Ur5>(&body);
    supervisor.carries_payload = true;
    // It is not updated any more.
    supervisor.blocks_carried = learner.config.supervisor.payload_update_blocks;
    let nominal = prior().rigid;
    (0..4000).find(|&tick| {
        let felt = if put_down && tick >= 1000 { 0.0 } else { 1.0 };
        let mut motion = JointMotion::zero();
        motion.q = JointVector::from_fn(|j, _| 0.3 - 0.2 * j as f32);
        let mut tau = rnea::<Ur5, N, P>(&(nominal + base * felt), &motion);
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
