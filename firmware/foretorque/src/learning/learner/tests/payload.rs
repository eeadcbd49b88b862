use super::*;
use crate::dynamics::rnea;
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
