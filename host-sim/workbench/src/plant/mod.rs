//! The simulated arm: rigid body, rotors, friction, sensors, events and faults. f64, seeded, repeatable to the
//! last bit.

mod events;
mod faults;
mod friction;

pub use events::{Events, Payload, Push};
pub use faults::ReportFaults;

use crate::dynamics::{Joints, ReferenceModel, State};
use crate::robot::Robot;
use friction::FrictionModel;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use std::f64::consts::TAU;

/// Plant properties that are not in the robot's description.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlantConfig {
    /// Steps of the integrator in one second, Hz.
    pub step_rate_hz: f64,
    /// Standard deviation of the white torque noise, as a share of each joint's torque limit.
    pub torque_noise: f64,
    /// Relative growth of viscous friction, 1/s.
    pub viscous_drift: f64,
    /// Coulomb friction that grows with the load: share of the torque against gravity and velocity products.
    pub load_friction: f64,
    /// Ratio of delivered to commanded torque: error of the torque constants.
    pub drive_gain: f64,
}

impl Default for PlantConfig {
    /// 8 kHz, 1 % noise, viscous friction +30 % in ten minutes, no friction under load, right torque constants.
    fn default() -> Self {
        Self {
            step_rate_hz: 8000.0,
            torque_noise: 0.01,
            viscous_drift: 0.3 / 600.0,
            load_friction: 0.0,
            drive_gain: 1.0,
        }
    }
}

/// Sensor values of the arm at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measurement<const N: usize> {
    /// Encoder positions, rad.
    pub q: Joints<N>,
    /// Torque of the drives over the last period, with noise, N·m.
    pub tau: Joints<N>,
}

/// An arm that moves under joint torques.
#[derive(Clone, Debug)]
pub struct Plant<const N: usize> {
    /// The arm with its payload.
    model: ReferenceModel<N>,
    /// The arm without payload.
    unloaded: ReferenceModel<N>,
    events: Events<N>,
    carried: Option<usize>,
    friction: FrictionModel<N>,
    torque_limit: Joints<N>,
    /// Encoder counts a radian.
    counts: Joints<N>,
    config: PlantConfig,
    random: ChaCha8Rng,
    faults: ReportFaults,
    fault_random: ChaCha8Rng,
    reported: Option<Measurement<N>>,
    q: Joints<N>,
    qd: Joints<N>,
    tau: Joints<N>,
    t_s: f64,
}

impl<const N: usize> Plant<N> {
    /// An arm at rest in q = 0; `None` when the robot has not `N` joints.
    pub fn new(robot: &Robot, config: PlantConfig, seed: u64) -> Option<Self> {
        let zero = Joints::zeros();
        let unloaded = ReferenceModel::new(robot)?;
        // A stream of its own: an arm whose reports are damaged has the same noise as one whose are not.
        let mut fault_random = ChaCha8Rng::seed_from_u64(seed);
        fault_random.set_stream(1);
        Some(Self {
            model: unloaded.clone(),
            unloaded,
            events: Events::default(),
            carried: None,
            friction: FrictionModel::new(robot, config.viscous_drift, config.load_friction)?,
            torque_limit: Joints::from_iterator(robot.joints.iter().map(|j| j.limits.torque)),
            counts: Joints::from_iterator(
                robot
                    .joints
                    .iter()
                    .map(|j| f64::from(j.drive.encoder_bits).exp2() / TAU),
            ),
            config,
            random: ChaCha8Rng::seed_from_u64(seed),
            faults: ReportFaults::default(),
            fault_random,
            reported: None,
            q: zero,
            qd: zero,
            tau: zero,
            t_s: 0.0,
        })
    }

    /// This arm with `events`. Their times are those of [`t_s`](Self::t_s).
    pub fn with_events(mut self, events: Events<N>) -> Self {
        self.events = events;
        self.pick_or_release();
        self
    }

    /// This arm with `faults` in its reports.
    pub fn with_faults(mut self, faults: ReportFaults) -> Self {
        self.faults = faults;
        self
    }

    /// Puts the arm down at rest at `q`, rad. Its clock, and with it the warm-up, runs on.
    pub fn place(&mut self, q: &Joints<N>) {
        self.q = *q;
        self.qd = Joints::zeros();
        self.tau = self.model.gravity_torques(q);
    }

    /// True positions, rad.
    pub fn q(&self) -> &Joints<N> {
        &self.q
    }

    /// True velocities, rad/s.
    pub fn qd(&self) -> &Joints<N> {
        &self.qd
    }

    /// Age of the arm, s.
    pub fn t_s(&self) -> f64 {
        self.t_s
    }

    /// Moves the arm for `period_s` under constant torques (N·m, cut off at the drives' limits).
    ///
    /// Each step solves `(M + h F) qdd = tau − V − G − f` with F the slope of the friction over the velocity and h the
    /// step, then `qd += h qdd`, `q += h qd`: friction enters implicitly, so the steep Coulomb sign stays stable.
    /// First order: the error is proportional to the step; at 8 kHz the arm is within a milliradian of a step 16 times
    /// finer after one second of open loop (the test holds it to that). A payload is there, or not, from the first step
    /// that begins in its time; it comes and goes at the speed of the hand.
    pub fn advance(&mut self, tau: &Joints<N>, period_s: f64) {
        self.tau = tau.zip_map(&self.torque_limit, |tau, limit| tau.clamp(-limit, limit));
        let steps = (period_s * self.config.step_rate_hz).round().max(1.0);
        let h = period_s / steps;
        for _ in 0..steps as usize {
            self.pick_or_release();
            let (mut mass, bias) = self.model.mass_matrix_and_bias(&self.q, &self.qd);
            let (friction, slope) = self
                .friction
                .torque_and_slope(&self.q, &self.qd, &bias, self.t_s);
            for j in 0..N {
                mass[(j, j)] += h * slope[j];
            }
            let made = self.tau * self.config.drive_gain;
            let force = made + self.events.push_at(self.t_s) - bias - friction;
            // The mass matrix of a physical arm is positive definite; rotor inertias keep it well so.
            let qdd = mass.cholesky().map_or(Joints::zeros(), |m| m.solve(&force));
            self.qd += qdd * h;
            self.q += self.qd * h;
            self.t_s += h;
        }
    }

    /// Reads the sensors: encoder counts, and the torque of the last period with its noise.
    pub fn measure(&mut self) -> Measurement<N> {
        let noise = self.config.torque_noise;
        let random = &mut self.random;
        Measurement {
            q: self
                .q
                .zip_map(&self.counts, |q, counts| (q * counts).round() / counts),
            tau: self.tau.zip_map(&self.torque_limit, |tau, limit| {
                tau + noise * limit * random.sample::<f64, _>(StandardNormal)
            }),
        }
    }

    /// Report of a measurement beyond the drives: damaged, delayed, or lost.
    ///
    /// * `measured` result of [`measure`](Self::measure)
    pub fn report(&mut self, measured: &Measurement<N>) -> Option<Measurement<N>> {
        let fresh = self
            .faults
            .damaged(measured, &self.torque_limit, &mut self.fault_random);
        let before = self.reported.replace(fresh);
        self.faults.delivered(fresh, before, &mut self.fault_random)
    }

    /// Torque that the drives need for this motion, free of noise, at the arm's present age and payload, N·m.
    pub fn true_torque(&self, motion: &State<N>) -> Joints<N> {
        let bias = self.model.bias(&motion.q, &motion.qd);
        let (friction, _) = self
            .friction
            .torque_and_slope(&motion.q, &motion.qd, &bias, self.t_s);
        (self.model.inverse_dynamics(motion) + friction) / self.config.drive_gain
    }

    /// Payload that the arm carries now.
    pub fn carried(&self) -> Option<&Payload> {
        self.carried.and_then(|k| self.events.payloads.get(k))
    }

    /// Updates the model to the payload at this time.
    fn pick_or_release(&mut self) {
        let carried = self.events.payload_at(self.t_s);
        if carried != self.carried {
            self.carried = carried;
            self.model = match self.carried() {
                Some(payload) => self.unloaded.with_payload(&payload.body),
                None => self.unloaded.clone(),
            };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Perturbation;
    use crate::trajectory::Trajectory;

    fn quiet(step_rate_hz: f64) -> PlantConfig {
        PlantConfig {
            step_rate_hz,
            torque_noise: 0.0,
            viscous_drift: 0.0,
            ..PlantConfig::default()
        }
    }

    fn truth() -> Robot {
        Robot::load("ur5")
            .expect("built in")
            .perturbed(1, &Perturbation::PLANT)
    }

    /// Plays the torques of the validation path, open loop, for one second.
    fn played(step_rate_hz: f64) -> Plant<6> {
        let robot = truth();
        let path = Trajectory::<6>::validation(&robot, 5);
        let mut plant = Plant::new(&robot, quiet(step_rate_hz), 1).expect("six joints");
        plant.place(&path.at(0.0).q);
        for k in 0..1000 {
            let tau = plant.true_torque(&path.at((f64::from(k) + 0.5) * 1e-3));
            plant.advance(&tau, 1e-3);
        }
        plant
    }

    #[test]
    fn the_true_torque_of_a_motion_makes_that_motion() {
        let robot = truth();
        let path = Trajectory::<6>::validation(&robot, 5);
        let plant = played(8000.0);
        let error = (plant.q() - path.at(1.0).q).amax();
        assert!(error < 5e-3, "{error} rad after one second of open loop");
    }

    #[test]
    fn a_step_at_8_khz_is_within_a_milliradian_of_a_finer_one() {
        let fine = played(128_000.0);
        let coarse = (played(8000.0).q() - fine.q()).amax();
        let halved = (played(16_000.0).q() - fine.q()).amax();
        assert!(coarse < 1e-3, "{coarse} rad after one second");
        // First order: 15/128 of the error is left out by comparing with 128 kHz, hence 7/15 instead of 1/2.
        assert!(
            (halved / coarse - 7.0 / 15.0).abs() < 0.1,
            "{}",
            halved / coarse
        );
    }

    #[test]
    fn energy_is_kept_without_friction_and_torque() {
        let mut robot = truth();
        for joint in &mut robot.joints {
            joint.friction.viscous = 0.0;
            joint.friction.coulomb = 0.0;
            joint.friction.cogging = 0.0;
        }
        let mut plant = Plant::<6>::new(&robot, quiet(64_000.0), 1).expect("six joints");
        plant.place(&Joints::repeat(0.4));
        let energy = |plant: &Plant<6>| plant.model.energy(&plant.q, &plant.qd);
        let start = energy(&plant);
        let kinetic = |plant: &Plant<6>| {
            (plant.qd.transpose() * plant.model.mass_matrix(&plant.q) * plant.qd)[0] / 2.0
        };
        for _ in 0..1000 {
            plant.advance(&Joints::zeros(), 1e-3);
        }
        assert!(
            kinetic(&plant) > 1.0,
            "the arm falls: {} J",
            kinetic(&plant)
        );
        let lost = (energy(&plant) - start).abs() / kinetic(&plant);
        assert!(lost < 5e-3, "{lost} of the kinetic energy");
    }

    #[test]
    fn friction_and_work_balance_the_energy() {
        let robot = truth();
        let mut plant = Plant::<6>::new(&robot, quiet(64_000.0), 1).expect("six joints");
        plant.place(&Joints::repeat(-0.6));
        let start = plant.model.energy(&plant.q, &plant.qd);
        let mut work = 0.0;
        for k in 0..1000 {
            let tau = Joints::from_fn(|j, _| 20.0 * (f64::from(k) * 6e-3 + j as f64).sin());
            let before = plant.qd;
            let (friction, _) =
                plant
                    .friction
                    .torque_and_slope(&plant.q, &before, &Joints::zeros(), 0.0);
            plant.advance(&tau, 1e-3);
            let (after, _) =
                plant
                    .friction
                    .torque_and_slope(&plant.q, &plant.qd, &Joints::zeros(), 0.0);
            let mean = (before + plant.qd) * 0.5;
            work += 1e-3 * mean.dot(&(tau - (friction + after) * 0.5));
        }
        let change = plant.model.energy(&plant.q, &plant.qd) - start;
        assert!(
            (change - work).abs() < 0.02 * change.abs().max(1.0),
            "{change} J, {work} J"
        );
    }

    #[test]
    fn sensors_round_to_counts_and_carry_one_percent_of_noise() {
        let robot = truth();
        let mut plant = Plant::<6>::new(&robot, PlantConfig::default(), 3).expect("six joints");
        plant.place(&Joints::repeat(0.123_456));
        let count = TAU / 131_072.0;
        let mut spread = Joints::<6>::zeros();
        for _ in 0..4000 {
            let seen = plant.measure();
            for j in 0..6 {
                let counts = seen.q[j] / count;
                assert!((counts - counts.round()).abs() < 1e-6);
                assert!((seen.q[j] - 0.123_456).abs() <= 0.5001 * count);
            }
            let error = seen.tau - plant.tau;
            spread += error.component_mul(&error) / 4000.0;
        }
        for (j, joint) in robot.joints.iter().enumerate() {
            let share = spread[j].sqrt() / joint.limits.torque;
            assert!((share - 0.01).abs() < 1e-3, "joint {j}: {share}");
        }
    }

    #[test]
    fn the_same_seed_repeats_every_bit() {
        let run = |seed| {
            let mut plant = Plant::<6>::new(&truth(), PlantConfig::default(), seed).expect("six");
            for _ in 0..50 {
                let tau = plant.measure().tau;
                plant.advance(&tau, 1e-3);
            }
            plant.q
        };
        assert_eq!(run(1), run(1));
        assert_ne!(run(1), run(2));
    }
}
