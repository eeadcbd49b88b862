//! The simulated arm: rigid body, rotors, friction, sensors, events and faults. f64, seeded, repeatable to the
//! last bit.

mod effects;
mod events;
mod faults;
mod friction;

pub use effects::{EffectsError, PlantEffects};
pub use events::{Events, Payload, Push};
pub use faults::ReportFaults;

use crate::dynamics::{Joints, ReferenceModel, State};
use crate::robot::Robot;
use effects::{DriveErrors, ReportQueue};
use friction::{FrictionModel, FrictionState};
use nalgebra::SMatrix;
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
    /// Effects of real drives.
    pub effects: PlantEffects,
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
            effects: PlantEffects::default(),
        }
    }
}

/// Sensor values of the arm at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measurement<const N: usize> {
    /// Encoder positions, rad.
    pub q: Joints<N>,
    /// Torque of the drives, or of a sensor behind the gear, over the last period, with noise, N·m.
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
    friction_state: FrictionState<N>,
    drives: DriveErrors<N>,
    gear: Option<Gear<N>>,
    torque_limit: Joints<N>,
    /// Encoder counts a radian.
    counts: Joints<N>,
    config: PlantConfig,
    random: ChaCha8Rng,
    faults: ReportFaults,
    fault_random: ChaCha8Rng,
    reported: Option<Measurement<N>>,
    queue: ReportQueue<N>,
    queue_random: ChaCha8Rng,
    q: Joints<N>,
    qd: Joints<N>,
    tau: Joints<N>,
    t_s: f64,
}

/// Elastic gears between the rotors, where the encoders are, and the links.
#[derive(Clone, Debug)]
struct Gear<const N: usize> {
    stiffness: Joints<N>,
    damping: Joints<N>,
    rotor: Joints<N>,
    half_backlash: f64,
    /// Factor of the torque loop on rotor inertia and friction.
    loop_factor: f64,
    /// Positions, rad, and velocities, rad/s, of the links.
    q: Joints<N>,
    qd: Joints<N>,
    /// Torque of the gears on the links, N·m.
    torque: Joints<N>,
}

impl<const N: usize> Plant<N> {
    /// An arm at rest in q = 0; `None` when the robot has not `N` joints.
    pub fn new(robot: &Robot, config: PlantConfig, seed: u64) -> Option<Self> {
        let zero = Joints::zeros();
        let unloaded = ReferenceModel::new(robot)?;
        // Streams of their own: an arm whose reports are damaged has the same noise as one whose are not.
        let stream = |number| {
            let mut random = ChaCha8Rng::seed_from_u64(seed);
            random.set_stream(number);
            random
        };
        let torque_limit = Joints::from(robot.each(|j| j.limits.torque)?);
        let gear = config.effects;
        let drives = DriveErrors::new(&gear, config.drive_gain, &torque_limit, &mut stream(2));
        Some(Self {
            model: unloaded.clone(),
            unloaded,
            events: Events::default(),
            carried: None,
            friction: FrictionModel::new(robot, &config)?,
            friction_state: FrictionState::new(),
            drives,
            gear: (gear.twist_mrad > 0.0)
                .then(|| Gear::new(robot, &gear, &torque_limit))
                .flatten(),
            torque_limit,
            counts: Joints::from_iterator(
                robot
                    .joints
                    .iter()
                    .map(|j| f64::from(j.drive.encoder_bits).exp2() / TAU),
            ),
            config,
            random: ChaCha8Rng::seed_from_u64(seed),
            faults: ReportFaults::default(),
            fault_random: stream(1),
            reported: None,
            queue: ReportQueue::default(),
            queue_random: stream(3),
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
        if let Some(gear) = &mut self.gear {
            gear.torque = self.tau;
            gear.qd = Joints::zeros();
            gear.q = q - self.tau.component_div(&gear.stiffness);
        }
    }

    /// True positions at the encoders, rad: with elastic gears those of the rotors.
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
    /// that begins in its time; it comes and goes at the speed of the hand. Elastic gears: see `Gear::step`.
    pub fn advance(&mut self, tau: &Joints<N>, period_s: f64) {
        self.tau = tau.zip_map(&self.torque_limit, |tau, limit| tau.clamp(-limit, limit));
        let steps = (period_s * self.config.step_rate_hz).round().max(1.0);
        let h = period_s / steps;
        let mut resisted = Joints::zeros();
        for _ in 0..steps as usize {
            self.pick_or_release();
            let (q, qd) = self
                .gear
                .as_ref()
                .map_or((self.q, self.qd), |gear| (gear.q, gear.qd));
            let (mass, bias) = self.model.mass_matrix_and_bias(&q, &qd);
            let (friction, slope) = self.friction.begin_step(
                &self.q,
                &self.qd,
                &bias,
                &mut self.friction_state,
                (self.t_s, h),
            );
            let made = self.drives.delivered(&self.tau, self.t_s);
            let push = self.events.push_at(self.t_s);
            let qdd = match &mut self.gear {
                Some(gear) => gear.step(
                    (&self.q, &self.qd),
                    mass,
                    (made, push - bias),
                    (&friction, &slope),
                    h,
                ),
                None => solved(mass, &(slope * h), &(made + push - bias - friction)),
            };
            self.qd += qdd * h;
            self.q += self.qd * h;
            self.t_s += h;
            self.friction_state.advance(&self.qd, h);
            resisted = friction;
        }
        self.friction
            .warm(&mut self.friction_state, &resisted, &self.qd, period_s);
    }

    /// Reads the sensors: encoder counts, and the torque of the last period with its noise.
    pub fn measure(&mut self) -> Measurement<N> {
        let noise = self.config.torque_noise;
        let sensed = self.sensed();
        let random = &mut self.random;
        Measurement {
            q: self
                .q
                .zip_map(&self.counts, |q, counts| (q * counts).round() / counts),
            tau: sensed.zip_map(&self.torque_limit, |tau, limit| {
                tau + noise * limit * random.sample::<f64, _>(StandardNormal)
            }),
        }
    }

    /// Report of a measurement beyond the drives: damaged, delayed, or lost.
    ///
    /// * `measured` result of [`measure`](Self::measure)
    pub fn report(&mut self, measured: &Measurement<N>) -> Option<Measurement<N>> {
        let arrived = self.queue.pass(
            &self.config.effects,
            (self.t_s, *measured),
            &self.qd,
            &mut self.queue_random,
        );
        let fresh = self
            .faults
            .damaged(&arrived, &self.torque_limit, &mut self.fault_random);
        let before = self.reported.replace(fresh);
        self.faults.delivered(fresh, before, &mut self.fault_random)
    }

    /// Torque that the drives need for this motion, free of noise, at the arm's present age and payload, N·m: what a
    /// sensor of no noise would measure. Gears count as rigid, friction as sliding; a torque loop carries friction and rotors.
    pub fn true_torque(&self, motion: &State<N>) -> Joints<N> {
        let mut needed = self.model.inverse_dynamics(motion);
        match &self.gear {
            Some(gear) if gear.loop_factor < 1.0 => {
                needed -= gear.rotor.component_mul(&motion.qdd);
            }
            _ => {
                let (q, qd) = (&motion.q, &motion.qd);
                let bias = self.model.bias(q, qd);
                let state = &self.friction_state;
                needed += self
                    .friction
                    .torque_and_slope(q, qd, &bias, state, self.t_s)
                    .0;
            }
        }
        self.drives.asked(&needed, self.t_s)
    }

    /// Torque that the sensors would measure without noise, N·m.
    fn sensed(&self) -> Joints<N> {
        match &self.gear {
            Some(gear) if gear.loop_factor < 1.0 => self.drives.asked(&gear.torque, self.t_s),
            _ => self.tau,
        }
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

impl<const N: usize> Gear<N> {
    /// Gears of `robot`, untwisted in q = 0; `None` when it has not `N` joints.
    fn new(robot: &Robot, effects: &PlantEffects, torque_limit: &Joints<N>) -> Option<Self> {
        let rotor = Joints::from(robot.each(|joint| joint.drive.rotor_inertia)?);
        let stiffness: Joints<N> = torque_limit / (1e-3 * effects.twist_mrad);
        let critical = |k: f64, j: f64| 2.0 * effects.twist_damping * (k * j).sqrt();
        Some(Self {
            damping: stiffness.zip_map(&rotor, critical),
            stiffness,
            rotor,
            half_backlash: 0.5e-3 * effects.backlash_mrad,
            loop_factor: 1.0 / (1.0 + effects.torque_loop_gain),
            q: Joints::zeros(),
            qd: Joints::zeros(),
            torque: Joints::zeros(),
        })
    }

    /// Moves the links by a step of `h` s and returns the accelerations of the rotors, rad/s².
    ///
    /// Link and rotor accelerations a, b under the gear torque `s = K e + D ė` [Spong 1987, eqs. 2.10, 2.11], with
    /// `e = θ − q` outside the backlash. Spring, damper and friction act at the end of the step, so any stiffness is stable:
    ///
    /// ```text
    /// s = s0 + G (b − a),  s0 = K e + (h K + D) ė,  G = h (h K + D)
    /// M a = s + load,  (J + h F) b = made − f − s
    /// ```
    /// The rotor equation is diagonal and is eliminated: `(M + G − G²/A) a = s0 + load + G r / A`, `A = J + h F + G`,
    /// `r = made − f − s0`.
    ///
    /// * `rotors` positions θ, rad, and velocities, rad/s
    /// * `mass` mass matrix at the links' positions, rotors included
    /// * `made`, `load` torque of the drives; torque on the links without the gears', N·m
    /// * `friction` torque f and slope F
    fn step(
        &mut self,
        rotors: (&Joints<N>, &Joints<N>),
        mut mass: SMatrix<f64, N, N>,
        (made, load): (Joints<N>, Joints<N>),
        friction: (&Joints<N>, &Joints<N>),
        h: f64,
    ) -> Joints<N> {
        let (mut s0, mut g, mut a, mut r) = (load, load, load, load);
        for j in 0..N {
            let (twist, rate) = (rotors.0[j] - self.q[j], rotors.1[j] - self.qd[j]);
            let play = twist + h * rate;
            let contact = if play.abs() <= self.half_backlash && self.half_backlash > 0.0 {
                0.0
            } else {
                1.0
            };
            let (k, d) = (contact * self.stiffness[j], contact * self.damping[j]);
            s0[j] = k * (twist - self.half_backlash.copysign(play)) + (h * k + d) * rate;
            g[j] = h * (h * k + d);
            a[j] = (self.loop_factor * (self.rotor[j] + h * friction.1[j]) + g[j]).max(1e-9);
            r[j] = made[j] - self.loop_factor * friction.0[j] - s0[j];
            mass[(j, j)] -= self.rotor[j];
        }
        let coupled = g - g.component_mul(&g).component_div(&a);
        let link = solved(
            mass,
            &coupled,
            &(s0 + load + g.component_mul(&r).component_div(&a)),
        );
        let rotor = (r + g.component_mul(&link)).component_div(&a);
        self.torque = s0 + g.component_mul(&(rotor - link));
        self.qd += link * h;
        self.q += self.qd * h;
        rotor
    }
}

/// Solution of `(M + diag) a = force`.
fn solved<const N: usize>(
    mut mass: SMatrix<f64, N, N>,
    diagonal: &Joints<N>,
    force: &Joints<N>,
) -> Joints<N> {
    for j in 0..N {
        mass[(j, j)] += diagonal[j];
    }
    // The mass matrix of a physical arm is positive definite; rotor inertias keep it well so.
    mass.cholesky().map_or(Joints::zeros(), |m| m.solve(force))
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
        let resisted = |plant: &Plant<6>, qd: &Joints<6>| {
            let (state, zero) = (&plant.friction_state, Joints::zeros());
            plant
                .friction
                .torque_and_slope(&plant.q, qd, &zero, state, 0.0)
                .0
        };
        let mut work = 0.0;
        for k in 0..1000 {
            let tau = Joints::from_fn(|j, _| 20.0 * (f64::from(k) * 6e-3 + j as f64).sin());
            let before = plant.qd;
            let friction = resisted(&plant, &before);
            plant.advance(&tau, 1e-3);
            let after = resisted(&plant, &plant.qd);
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

    fn effects(effects: PlantEffects) -> Plant<6> {
        let config = PlantConfig {
            effects,
            ..quiet(8000.0)
        };
        Plant::new(&truth(), config, 1).expect("six joints")
    }

    #[test]
    fn stiff_gears_move_the_arm_as_rigid_ones_do_and_soft_ones_twist_by_the_load() {
        let twisted = |twist_mrad| {
            let elastic = PlantEffects {
                twist_mrad,
                twist_damping: 0.1,
                ..PlantEffects::default()
            };
            let mut plant = effects(elastic);
            plant.place(&Joints::repeat(0.4));
            let hold = plant.tau;
            for k in 0..500 {
                let wave = Joints::from_fn(|j, _| 10.0 * (f64::from(k) * 6e-3 + j as f64).sin());
                plant.advance(&(hold + wave), 1e-3);
            }
            plant
        };
        let (rigid, stiff, soft) = (twisted(0.0), twisted(1e-3), twisted(8.0));
        let apart = (rigid.q() - stiff.q()).amax();
        assert!(apart < 2e-4, "{apart}");
        let moved = (rigid.q() - soft.q()).amax();
        assert!(moved > 1e-4, "{moved}");
        let gear = soft.gear.as_ref().expect("elastic");
        let twist = (soft.q() - gear.q).component_mul(&gear.stiffness);
        // The damper carries the rest.
        assert!(
            (twist - gear.torque).amax() < 2.0,
            "{twist} {}",
            gear.torque
        );
        assert!(soft.q().iter().chain(soft.qd()).all(|x| x.is_finite()));
    }

    #[test]
    fn a_link_swings_on_its_gear_at_the_frequency_of_both_masses() {
        let mut robot = truth();
        robot.joints.truncate(1);
        let joint = &mut robot.joints[0];
        (joint.friction.viscous, joint.friction.coulomb) = (0.0, 0.0);
        joint.friction.cogging = 0.0;
        joint.link.inertia_com *= 100.0;
        let effects = PlantEffects {
            twist_mrad: 8.0,
            ..PlantEffects::default()
        };
        let config = PlantConfig {
            effects,
            ..quiet(32_000.0)
        };
        let mut plant = Plant::<1>::new(&robot, config, 1).expect("one joint");
        plant.qd[0] = 0.1;
        let (mut turns, mut before) = (Vec::new(), 0.0);
        for k in 0..1000 {
            plant.advance(&Joints::zeros(), 1e-3);
            let torque = plant.gear.as_ref().expect("elastic").torque[0];
            if before < 0.0 && torque >= 0.0 {
                turns.push(k);
            }
            before = torque;
        }
        let gear = plant.gear.as_ref().expect("elastic");
        let link = plant.model.mass_matrix(&gear.q)[(0, 0)] - gear.rotor[0];
        let expected = (gear.stiffness[0] * (1.0 / gear.rotor[0] + 1.0 / link)).sqrt() / TAU;
        let found = 1e3 * (turns.len() - 1) as f64 / f64::from(turns[turns.len() - 1] - turns[0]);
        assert!(
            (found / expected - 1.0).abs() < 0.01,
            "{found} {expected} Hz"
        );
    }

    #[test]
    fn a_torque_loop_measures_behind_the_gear_and_carries_friction_and_rotor() {
        let behind = PlantEffects {
            twist_mrad: 5.0,
            twist_damping: 0.3,
            torque_loop_gain: 9.0,
            backlash_mrad: 0.2,
            ..PlantEffects::default()
        };
        let mut plant = effects(behind);
        let motion = State {
            q: Joints::repeat(0.3),
            qd: Joints::repeat(1.0),
            qdd: Joints::repeat(2.0),
        };
        let model = ReferenceModel::<6>::new(&truth()).expect("six joints");
        let rotors = truth().each(|joint| 2.0 * joint.drive.rotor_inertia);
        let rotors = Joints::from(rotors.expect("six joints"));
        let links = model.inverse_dynamics(&motion) - rotors;
        assert!((plant.true_torque(&motion) - links).amax() < 1e-9);
        // At rest the sensor carries gravity, whatever the gear.
        plant.place(&Joints::repeat(0.3));
        let hold = plant.tau;
        for _ in 0..300 {
            plant.advance(&hold, 1e-3);
        }
        assert!(
            (plant.sensed() - hold).amax() < 0.1,
            "{}",
            plant.sensed() - hold
        );
    }

    #[test]
    fn errors_of_current_sensors_are_torque_that_the_arm_lacks() {
        let wrong = PlantEffects {
            torque_offset: 0.02,
            torque_offset_drift: 0.01,
            drive_gain_spread: 0.08,
            ..PlantEffects::default()
        };
        let (mut plant, right) = (effects(wrong), effects(PlantEffects::default()));
        let rest = State::rest(Joints::repeat(0.4));
        let error = plant.true_torque(&rest) - right.true_torque(&rest);
        assert!(error.amax() > 0.3, "{error}");
        // What the errors ask for holds the arm.
        plant.place(&rest.q);
        for _ in 0..200 {
            let hold = plant.true_torque(&rest);
            plant.advance(&hold, 1e-3);
        }
        assert!((plant.q() - rest.q).amax() < 1e-4);
    }

    #[test]
    fn reports_are_delayed_and_torque_lags_behind_the_position() {
        let late = PlantEffects {
            delay_ms: 3.0,
            torque_lag_ms: 5.0,
            ..PlantEffects::default()
        };
        let mut plant = effects(late);
        let mut sent = Vec::new();
        for k in 0..50 {
            plant.advance(&Joints::repeat(f64::from(k)), 1e-3);
            let measured = plant.measure();
            let report = plant.report(&measured).expect("none is lost");
            sent.push(measured);
            if k >= 8 {
                let k = k as usize;
                assert_eq!((report.q, report.tau), (sent[k - 3].q, sent[k - 8].tau));
            }
        }
        let jitter = PlantEffects {
            delay_jitter_ms: 4.0,
            sampling_jitter_ms: 0.5,
            ..PlantEffects::default()
        };
        let mut plant = effects(jitter);
        let (mut ages, mut newest) = ([0; 6], 0);
        let mut sent: Vec<Measurement<6>> = Vec::new();
        for k in 0..400 {
            plant.advance(&Joints::repeat(f64::from(k) * 0.1), 1e-3);
            sent.push(plant.measure());
            let report = plant.report(&sent[k as usize]).expect("none is lost");
            let place = sent.iter().rposition(|sent| sent.tau == report.tau);
            let place = place.expect("one that was sent");
            assert!(place >= newest, "reports never go back in time");
            newest = place;
            ages[k as usize - place] += 1;
        }
        assert!(ages[1] > 20 && ages[3] > 20 && ages[5] == 0, "{ages:?}");
    }

    #[test]
    fn a_file_of_effects_is_checked() {
        let file = std::env::temp_dir().join(format!("effects-{}.toml", std::process::id()));
        for (text, outcome) in [
            ("twist_mrad = 5\nbacklash_mrad = 0.2", ""),
            ("backlash_mrad = 0.2", "need twist_mrad"),
            ("delay_ms = -1", "not negative"),
            ("warm_viscous_fall = 0.3", "needs warm_up_s"),
            ("stiffness = 1", "unknown field"),
        ] {
            std::fs::write(&file, text).expect("is written");
            let message = PlantEffects::load(&file).err().map(|e| e.to_string());
            let message = message.unwrap_or_default();
            assert_eq!(message.is_empty(), outcome.is_empty(), "{message}");
            assert!(message.contains(outcome), "{message}");
        }
        std::fs::remove_file(&file).expect("is there");
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
