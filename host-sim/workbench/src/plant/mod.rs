//! The simulated arm: rigid body, rotors, friction, sensors, events and faults. f64, seeded, repeatable to the
//! last bit.

mod effects;
mod friction;
#[cfg(test)]
mod tests;

pub use effects::{PlantEffects, ReportFaults};

use crate::dynamics::{Joints, ReferenceModel, State};
use crate::robot::{Link, Robot};
use effects::{DriveErrors, ReportQueue};
use friction::{DriveFriction, Gear, solved};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

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

/// A body that the hand holds for a while.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Payload {
    /// The body, in the frame of the last link.
    pub body: Link,
    /// Pick-up time, s.
    pub from_s: f64,
    /// Release time, s.
    pub to_s: f64,
}

/// An external torque on the joints, for example a contact or a collision.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Push<const N: usize> {
    /// Torque on every joint while it lasts, N·m; positive accelerates +q.
    pub torque: Joints<N>,
    /// Start, s.
    pub from_s: f64,
    /// End, s.
    pub to_s: f64,
}

/// Time in which a push rises, and falls again, s.
const RISE_S: f64 = 0.01;

/// All events of one run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Events<const N: usize> {
    /// Payloads; the first one whose interval contains the time counts.
    pub payloads: Vec<Payload>,
    /// Pushes; they add up.
    pub pushes: Vec<Push<N>>,
}

impl<const N: usize> Events<N> {
    /// Index of the payload in the hand at `t_s`.
    fn payload_at(&self, t_s: f64) -> Option<usize> {
        // Half a nanosecond of slack: the sum of many steps is not exactly the time they make.
        let now = t_s + 5e-10;
        let held = |payload: &Payload| (payload.from_s..payload.to_s).contains(&now);
        self.payloads.iter().position(held)
    }

    /// Torque from outside at `t_s`, N·m.
    fn push_at(&self, t_s: f64) -> Joints<N> {
        let mut torque = Joints::zeros();
        for push in &self.pushes {
            let inside = (t_s - push.from_s).min(push.to_s - t_s);
            torque += push.torque * (inside / RISE_S).clamp(0.0, 1.0);
        }
        torque
    }
}

impl Payload {
    /// A cube of `mass_kg` and of steel's third in density (2600 kg/m³), its centre at `com_m` in the last link's frame.
    pub fn cube(mass_kg: f64, com_m: [f64; 3], from_s: f64, to_s: f64) -> Self {
        let side = (mass_kg / 2600.0).cbrt();
        let moment = mass_kg * side * side / 6.0;
        Self {
            body: Link {
                mass: mass_kg,
                com: com_m.into(),
                inertia_com: nalgebra::Matrix3::identity() * moment,
            },
            from_s,
            to_s,
        }
    }
}

/// Sensor values of the arm at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measurement<const N: usize> {
    /// Encoder positions, rad.
    pub q: Joints<N>,
    /// Commanded torque of the drives, or torque of a sensor behind the gear, over the last period, with noise, N·m.
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
    friction: DriveFriction<N>,
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
        let (effects, random) = (&config.effects, &mut stream(2));
        let drives = DriveErrors::new(effects, config.drive_gain, &torque_limit, random);
        let elastic = effects.twist_mrad > 0.0;
        Some(Self {
            model: unloaded.clone(),
            unloaded,
            events: Events::default(),
            carried: None,
            friction: DriveFriction::new(robot, &config)?,
            drives,
            gear: match elastic {
                true => Some(Gear::new(robot, effects, &torque_limit)?),
                false => None,
            },
            torque_limit,
            counts: Joints::from(robot.each(|joint| 1.0 / joint.drive.encoder_step())?),
            config,
            random: ChaCha8Rng::seed_from_u64(seed),
            faults: ReportFaults::NONE,
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
            let play = self.tau.map(|tau| gear.half_backlash.copysign(tau));
            gear.q = q - self.tau.component_div(&gear.stiffness) - play;
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
            let links = self.gear.as_ref().map(|gear| (gear.q, gear.qd));
            let (q, qd) = links.unwrap_or((self.q, self.qd));
            let (mass, bias) = self.model.mass_matrix_and_bias(&q, &qd);
            let (own, time) = (&mut self.friction, (self.t_s, h));
            let (friction, slope) = own.begin_step(&self.q, &self.qd, &bias, time);
            let made = self.drives.delivered(&self.tau, self.t_s);
            let push = self.events.push_at(self.t_s);
            let qdd = match &mut self.gear {
                Some(gear) => {
                    let (rotors, forces) = ((&self.q, &self.qd), (made, push - bias));
                    gear.step(rotors, mass, forces, (&friction, &slope), h)
                }
                None => solved(mass, &(slope * h), &(made + push - bias - friction)),
            };
            self.qd += qdd * h;
            self.q += self.qd * h;
            self.t_s += h;
            self.friction.advance(&self.qd, h);
            resisted = friction;
        }
        self.friction.warm(&resisted, &self.qd, period_s);
    }

    /// Reads the sensors: encoder counts, and the torque of the last period with its noise.
    pub fn measure(&mut self) -> Measurement<N> {
        let noise = self.config.torque_noise;
        let sensed = self.sensed();
        let random = &mut self.random;
        Measurement {
            q: (self.q).zip_map(&self.counts, |q, counts| (q * counts).round() / counts),
            tau: sensed.zip_map(&self.torque_limit, |tau, limit| {
                tau + noise * limit * random.sample::<f64, _>(StandardNormal)
            }),
        }
    }

    /// Report of a measurement beyond the drives: damaged, delayed, or lost.
    ///
    /// * `measured` result of [`measure`](Self::measure)
    pub fn report(&mut self, measured: &Measurement<N>) -> Option<Measurement<N>> {
        let (effects, sent) = (&self.config.effects, (self.t_s, *measured));
        let random = &mut self.queue_random;
        let arrived = self.queue.pass(effects, sent, &self.qd, random);
        let (faults, random) = (&self.faults, &mut self.fault_random);
        let fresh = faults.damaged(&arrived, &self.torque_limit, random);
        let before = self.reported.replace(fresh);
        faults.delivered(fresh, before, random)
    }

    /// Torque that the drives need for this motion, free of noise, at the arm's present age and payload, N·m: what a
    /// sensor of no noise would measure. Gears count as rigid, friction as sliding; of a torque loop's friction and rotors,
    /// the sensor measures none, and the commanded torque has the part that the loop leaves.
    pub fn true_torque(&self, motion: &State<N>) -> Joints<N> {
        let (q, qd) = (&motion.q, &motion.qd);
        let (_, bias) = self.model.mass_matrix_and_bias(q, qd);
        let (friction, _) = self.friction.torque_and_slope(q, qd, &bias, self.t_s);
        // Measured part of friction and rotors.
        let (part, rotor) = match &self.gear {
            Some(gear) if self.sensor().is_some() => (0.0, gear.rotor),
            Some(gear) => (gear.loop_factor, gear.rotor),
            None => (1.0, Joints::zeros()),
        };
        let needed = self.model.inverse_dynamics(motion);
        let needed = needed + friction * part - rotor.component_mul(&motion.qdd) * (1.0 - part);
        self.drives.asked(&needed, self.t_s)
    }

    /// Torque that the sensors would measure without noise, N·m.
    fn sensed(&self) -> Joints<N> {
        match self.sensor() {
            Some(gear) => self.drives.asked(&gear.torque, self.t_s),
            None => self.tau,
        }
    }

    /// Gears with the sensor of a torque loop, if its torque is the measured one.
    fn sensor(&self) -> Option<&Gear<N>> {
        let commanded = self.config.effects.reports_commanded_torque;
        let gear = self.gear.as_ref();
        gear.filter(|gear| gear.loop_factor < 1.0 && !commanded)
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
