//! One tick, and the learning step after it.
//!
//! `cargo run -p foretorque --example tick`

use foretorque::arm::ur5::{Exchange, FeedForward, Learner, LearnerConfig, ParameterSet, Ur5};
use foretorque::feedforward::FeedForwardConfig;
use foretorque::joint::{JointMeasurement, JointMotion, JointSample};
use foretorque::learning::ConfigError;

const PERIOD_S: f32 = 1e-3;

fn main() -> Result<(), ConfigError> {
    let set = ParameterSet::nominal::<Ur5>(1);
    let mut feedforward = FeedForward::new(FeedForwardConfig::for_arm::<Ur5, _>(PERIOD_S), set)?;
    let mut learner = Learner::new(LearnerConfig::for_arm::<Ur5>(PERIOD_S), set)?;
    let mut exchange = Exchange::new();
    feedforward.set_learning(true);

    // From the drives: position, rad, and torque on the link side, N·m, of every joint.
    let measured = Some(JointMeasurement::zero());
    // From the trajectory: position, velocity and acceleration at the end of the period.
    let desired = JointMotion::zero();

    feedforward.adopt(&mut exchange);
    let torque = feedforward.step(&JointSample { desired, measured });
    // To the drives: `torque.total`. The rest of the period is for learning.
    learner.learn(&feedforward.learning_sample(measured), &mut exchange);

    for joint in 0..6 {
        println!(
            "joint {}: rigid body {:7.2} N·m, friction {:5.2} N·m, network {:5.2} N·m, total {:6.2} N·m",
            joint + 1,
            torque.shares.rigid[joint],
            torque.shares.friction[joint],
            torque.shares.network[joint],
            torque.total[joint],
        );
    }
    println!("The total of the first ticks is smaller: it grows by the slew limit.");
    Ok(())
}
