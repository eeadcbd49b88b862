//! Learning and payload on the host: a simulated UR5, 15 % heavier than its model and with friction, follows its desired
//! motion exactly. After 20 s it picks up 2 kg, and the learner estimates the mass while the arm moves.
//!
//! `cargo run --release -p foretorque --example payload`

use foretorque::arm::ur5::{self, Ur5};
use foretorque::arm::{Arm as _, LinkInertia, base_parameters};
use foretorque::dynamics::{BaseParameters, rnea};
use foretorque::feedforward::{FeedForwardConfig, Torque};
use foretorque::joint::{JointMeasurement, JointMotion, JointSample, JointVector};
use foretorque::learning::ConfigError;

/// Joints of the arm.
const N: usize = ur5::JOINTS;
/// Period of a tick, s.
const PERIOD_S: f32 = 1e-3;

/// Board and arm, tick by tick.
struct Cell {
    feedforward: ur5::FeedForward,
    learner: ur5::Learner,
    exchange: ur5::Exchange,
    body: BaseParameters<{ ur5::PARAMETERS }>,
    noise: u32,
    tick: u32,
}

impl Cell {
    /// A learning board whose arm is 15 % heavier than its model, and has friction.
    fn new() -> Result<Self, ConfigError> {
        let set = ur5::ParameterSet::nominal::<Ur5>(1);
        let mut feedforward =
            ur5::FeedForward::new(FeedForwardConfig::for_arm::<Ur5, _>(PERIOD_S), set)?;
        feedforward.set_learning(true);
        Ok(Self {
            feedforward,
            learner: ur5::Learner::new(ur5::LearnerConfig::for_arm::<Ur5>(PERIOD_S), set)?,
            exchange: ur5::Exchange::new(),
            body: BaseParameters::from(Ur5::NOMINAL) * 1.15,
            noise: 1,
            tick: 0,
        })
    }

    /// Puts a body of `mass`, kg, into the hand, 5 cm beyond the flange.
    fn pick_up(&mut self, mass: f32) {
        let mut links = [LinkInertia::NONE; N];
        links[N - 1].mass = mass;
        links[N - 1].com.z = 0.05;
        self.body += base_parameters::<Ur5, N, _>(&links, &[0.0; N]);
    }

    /// One tick. Returns the torque of the board, and the torque that the arm needed, N × N·m.
    fn step(&mut self) -> (Torque<N>, JointVector<N>) {
        let desired = motion(self.tick as f32 * PERIOD_S);
        let limits = Ur5::LIMITS.map(|joint| joint.torque);
        let rigid = rnea::<Ur5, N, _>(&self.body, &desired);
        let needed = JointVector::from_fn(|j, _| {
            let speed = desired.qd[j];
            rigid[j] + limits[j] * (0.04 * (speed / 0.01).tanh() + 0.02 * speed)
        });
        // Noise of the torque sensors: ±1 % of the limit.
        let tau = JointVector::from_fn(|j, _| {
            self.noise = self
                .noise
                .wrapping_mul(1_664_525)
                .wrapping_add(1_013_904_223);
            let uniform = (self.noise >> 8) as f32 / (1 << 23) as f32 - 1.0;
            needed[j] + 0.01 * limits[j] * uniform
        });
        let measured = Some(JointMeasurement { q: desired.q, tau });

        self.feedforward.adopt(&mut self.exchange);
        let torque = self.feedforward.step(&JointSample { desired, measured });
        let sample = self.feedforward.learning_sample(measured);
        self.learner.learn(&sample, &mut self.exchange);
        self.tick += 1;
        (torque, needed)
    }

    /// Root mean square of the torque error over `ticks`, in per cent of the joints' torque limits.
    fn error_percent(&mut self, ticks: u32) -> f32 {
        let mut squares = 0.0;
        for _ in 0..ticks {
            let (torque, needed) = self.step();
            for (joint, limits) in Ur5::LIMITS.iter().enumerate() {
                squares += ((torque.total[joint] - needed[joint]) / limits.torque).powi(2);
            }
        }
        100.0 * (squares / (ticks * N as u32) as f32).sqrt()
    }

    /// Estimated mass of the payload, kg; 0 without one.
    fn mass(&self) -> f32 {
        self.feedforward.state().report.quality.payload.mass
    }
}

/// Desired motion at time `t`, s: two sines a joint, rad.
fn motion(t: f32) -> JointMotion<N> {
    let mut motion = JointMotion::zero();
    for joint in 0..N {
        let slow = 0.9 + 0.13 * joint as f32;
        for (omega, amplitude) in [(slow, 0.6), (2.3 * slow, 0.25)] {
            let (sine, cosine) = (omega * t).sin_cos();
            motion.q[joint] += amplitude * sine;
            motion.qd[joint] += amplitude * omega * cosine;
            motion.qdd[joint] -= amplitude * omega * omega * sine;
        }
    }
    motion
}

fn main() -> Result<(), ConfigError> {
    let mut cell = Cell::new()?;
    for second in 1..=20 {
        let error = cell.error_percent(1000);
        println!("{second:2} s, empty hand: {error:5.2} % of the torque limits");
    }
    cell.pick_up(2.0);
    for second in 21..=25 {
        let error = cell.error_percent(1000);
        println!(
            "{second:2} s, with 2 kg:  {error:5.2} %, estimated {:.2} kg",
            cell.mass()
        );
    }
    let mass = cell.mass();
    assert!((mass - 2.0).abs() < 0.2, "{mass} kg instead of 2 kg");
    Ok(())
}
