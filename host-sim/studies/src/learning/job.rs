//! The runs of one arm: board, plant and scenario in closed loop, and the figures of each.

use super::world::{Event, Motion, PLAIN, Scenario, Source, Start, TORQUE_LOOP_GAIN, WorldArm};
use super::{Figures, LearningConfig, PERIOD_S, ScenarioReport};
use crate::{StudyError, bank_of, unsupported};
use foretorque::arm::Arm;
use foretorque::feedforward::{ParameterSet, evaluate};
use foretorque::learning::rated_payload;
use foretorque_link::bank::ParameterBank;
use foretorque_workbench::closed_loop::{PdConfig, motion_f32};
use foretorque_workbench::dynamics::{Joints, ReferenceModel, State};
use foretorque_workbench::metrics::{MOVING_RAD_S, root_mean};
use foretorque_workbench::plant::{Events, Payload, Plant, PlantConfig, PlantEffects, Push};
use foretorque_workbench::robot::Robot;
use foretorque_workbench::trajectory::via::ViaPath;
use foretorque_workbench::trajectory::{Trajectory, VALIDATION_PEAK_RAD_S};
use nalgebra::Vector3;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

const BANDWIDTH_HZ: f64 = 6.0;
const UNSEEN_POINTS: usize = 250;
/// Time of the look at which learning is compared with batch identification, s.
const EARLY_S: f64 = 30.0;
/// Joints below this share of their torque limit count as having it.
const LEAST_TORQUE: f64 = 0.02;

/// An arm of one seed.
pub(super) struct Bench<const N: usize> {
    seed: u64,
    described: Robot,
    truth: Robot,
    bare: Robot,
    /// PD control of a motor drive, and of one with a torque loop.
    pub(super) pd: [PdConfig<N>; 2],
    unseen: Vec<State<N>>,
    pub(super) scale: Joints<N>,
}

impl<const N: usize> Bench<N> {
    pub(super) fn new(arm: &WorldArm, seed: u64) -> Result<Self, StudyError> {
        let described = arm.described.clone();
        let (mut rotors, _) = described.with_assumed_rotors();
        let pd = |robot: &Robot| {
            let model = ReferenceModel::<N>::new(robot).ok_or_else(|| unsupported(N))?;
            Ok::<_, StudyError>(PdConfig::tuned(&model, BANDWIDTH_HZ, PERIOD_S))
        };
        let motor = pd(&rotors)?;
        for joint in &mut rotors.joints {
            joint.drive.rotor_inertia /= 1.0 + TORQUE_LOOP_GAIN;
        }
        let validation = Trajectory::<N>::validation(&described, seed.wrapping_add(2));
        let length_s = validation.duration_s();
        let points = 0..UNSEEN_POINTS;
        let unseen = points.map(|k| validation.at(length_s * k as f64 / UNSEEN_POINTS as f64));
        let mut bench = Self {
            seed,
            truth: WorldArm::truth(&described, seed),
            bare: WorldArm::bare(&described, arm.guessed_rotors),
            pd: [motor, pd(&rotors)?],
            unseen: unseen.collect(),
            scale: Joints::zeros(),
            described,
        };
        let limits = bench.truth.each(|joint| joint.limits.torque);
        let limits = Joints::<N>::from(limits.ok_or_else(|| unsupported(N))?);
        let needed = bench.needed(&bench.plant(&PLAIN, Source::Current)?);
        let squares = needed.iter().fold(Joints::zeros(), |sum: Joints<N>, tau| {
            sum + tau.component_mul(tau) / UNSEEN_POINTS as f64
        });
        bench.scale = squares.map(f64::sqrt).sup(&(limits * LEAST_TORQUE));
        Ok(bench)
    }

    /// The true arm; errors of its drives belong to the seed, so that all scenarios have the same.
    fn plant(&self, scenario: &Scenario, source: Source) -> Result<Plant<N>, StudyError> {
        Plant::new(&self.truth, scenario.plant(source), self.seed).ok_or_else(|| unsupported(N))
    }

    /// Torques that `plant` needs along the unseen path.
    pub(super) fn needed(&self, plant: &Plant<N>) -> Vec<Joints<N>> {
        let motions = self.unseen.iter();
        motions.map(|state| plant.true_torque(state)).collect()
    }

    /// Error of a set on the unseen path, in units of the joints' scale.
    pub(super) fn unseen_error<A: Arm<N, P>, const P: usize>(
        &self,
        set: &ParameterSet<N, P>,
        needed: &[Joints<N>],
    ) -> f64 {
        let squares = self.unseen.iter().zip(needed).flat_map(|(state, needed)| {
            let torque: Joints<N> = evaluate::<A, N, P>(set, &motion_f32(state)).total.cast();
            let moving = (0..N).filter(|&j| state.qd[j].abs() > MOVING_RAD_S);
            moving.map(move |j| ((torque[j] - needed[j]) / self.scale[j]).powi(2))
        });
        root_mean(squares)
    }

    /// All runs of this arm whose names begin with `only`.
    pub(super) fn scenarios<A: Arm<N, P>, const P: usize>(
        &self,
        config: &LearningConfig,
        only: &str,
        done: &dyn Fn(usize),
    ) -> Result<Vec<ScenarioReport>, StudyError> {
        let mut reports = Vec::new();
        let description = bank_of::<A, N, P>(&self.bare);
        let mut banks: Vec<(Source, ParameterBank)> = Vec::new();
        for scenario in Scenario::all(config.quick) {
            for (name, start, source) in scenario.runs(only) {
                let bank = match start {
                    Start::Description => description.clone(),
                    Start::Bank => match banks.iter().find(|(known, _)| *known == source) {
                        Some((_, bank)) => bank.clone(),
                        None => {
                            let bank = self.identified::<A, P>(&description, source)?;
                            banks.push((source, bank.clone()));
                            bank
                        }
                    },
                };
                let figures = self.figures::<A, P>(&scenario, source, &bank, config);
                let run = format!("{}/{name}, seed {}", self.described.name, self.seed);
                let figures = figures.map_err(|error| format!("{run}: {error}"))?;
                reports.push(ScenarioReport {
                    arm: self.described.name.clone(),
                    scenario: name,
                    seed: self.seed,
                    curve: figures.1,
                    figures: figures.0,
                });
                done(scenario.ticks(config.quick));
            }
        }
        Ok(reports)
    }

    /// The bank that batch identification makes of 40 s of a path of its own.
    fn identified<A: Arm<N, P>, const P: usize>(
        &self,
        start: &ParameterBank,
        source: Source,
    ) -> Result<ParameterBank, StudyError> {
        let path = PLAIN.trajectory::<N>(&self.described, self.seed.wrapping_add(900), false);
        let plant = self.plant(&PLAIN, source)?;
        let (ticks, frozen) = (PLAIN.ticks(false), Some((start, false)));
        let trace = self.run::<A, P>((plant, source), &path, frozen, ticks, 0.0)?;
        let start = start.set::<A, N, P>()?;
        Ok(trace.rows.fit::<A, P>(&start))
    }

    fn figures<A: Arm<N, P>, const P: usize>(
        &self,
        scenario: &Scenario,
        source: Source,
        bank: &ParameterBank,
        config: &LearningConfig,
    ) -> Result<(Figures, Vec<(f64, f64)>), StudyError> {
        let quick = config.quick;
        let path = scenario.trajectory::<N>(&self.described, self.seed, quick);
        let rated = f64::from(rated_payload::<A, N, P>());
        let events = scenario.events::<N>(&self.described, rated, self.seed, quick);
        let plant = self.plant(scenario, source)?.with_events(events);
        let plant = plant.with_faults(scenario.faults);
        let (ticks, learning) = (scenario.ticks(quick), Some((bank, true)));
        let learnt = self.run::<A, P>((plant.clone(), source), &path, learning, ticks, EARLY_S)?;
        let mut figures = Figures::new();
        let mut put = |name: &'static str, value: f64| figures.insert(name, value);
        let last = |t_s: f64| learnt.curve.iter().rfind(|(at, _)| *at <= t_s + 1e-9);
        let early = last(EARLY_S).map_or(f64::NAN, |(_, error)| *error);
        put("unseen_over_start_ratio", early);
        let windows = learnt.windows();
        if !windows.is_empty() {
            let worse = windows.iter().filter(|ratio| **ratio > 1.05).count();
            let percent = 100.0 * worse as f64 / windows.len() as f64;
            put("windows_above_1.05_percent", percent);
            let worst = windows.iter().copied().fold(0.0, f64::max);
            put("worst_window_ratio", worst);
        }
        let sum = |k: usize| learnt.seconds.iter().map(|s| s[k]).sum::<f64>();
        put("mean_over_start_ratio", (sum(0) / sum(1)).sqrt());
        put("tracking_learnt_mrad", learnt.tracking.mean_rms_mrad());
        put("armed_at_the_end_count", f64::from(u8::from(learnt.armed)));
        if scenario.event == Event::None {
            put("alarms_count", f64::from(learnt.alarms));
        }
        if let Event::Payloads(share) = scenario.event {
            let mass = share * rated;
            let found = learnt.weighed.iter();
            let errors = found.map(|found| 100.0 * (found / mass - 1.0).abs());
            // Where none was weighed, none was found.
            let worst = errors.reduce(f64::max).unwrap_or(100.0);
            put("payload_mass_error_worst_percent", worst);
        }
        if scenario.against_batch {
            let set = bank.set::<A, N, P>()?;
            let batch = learnt.rows.fit::<A, P>(&set);
            let batch = batch.set::<A, N, P>()?;
            let needed = self.needed(&plant);
            let batch = self.unseen_error::<A, P>(&batch, &needed)
                / self.unseen_error::<A, P>(&set, &needed);
            put("batch_over_start_ratio", batch);
            put("unseen_over_batch_ratio", early / batch);
        }
        if scenario.against_pd {
            let truth = self.truth_tracking(plant.clone(), source, &path, ticks)?;
            let alone = self.run::<A, P>((plant, source), &path, None, ticks, 0.0)?;
            let alone = alone.tracking.mean_rms_mrad();
            put("tracking_truth_over_pd_ratio", truth / alone);
            let learnt = learnt.tracking.mean_rms_mrad();
            put("tracking_over_pd_ratio", learnt / alone);
        }
        Ok((figures, learnt.curve))
    }
}

/// First event and time from one to the next, s; a payload is held for half of it.
const FIRST_EVENT_S: f64 = 12.0;
const CYCLE_S: f64 = 10.0;
/// Distance of a payload's centre of mass from the flange, m: bolted on, or in a gripper.
const TOOL_REACH_M: std::ops::Range<f64> = 0.05..0.25;

impl Scenario {
    /// The plant, its mechanics apart.
    pub(super) fn plant(&self, source: Source) -> PlantConfig {
        let config = PlantConfig {
            step_rate_hz: 4000.0,
            torque_noise: self.torque_noise,
            viscous_drift: self.drift_min / 60.0,
            load_friction: 0.02,
            drive_gain: self.drive_gain,
            effects: PlantEffects::default(),
        };
        let elastic = PlantEffects {
            twist_mrad: 5.0,
            twist_damping: 0.1,
            presliding_mrad: 0.3,
            backlash_mrad: 0.05,
            warm_viscous_fall: 0.2,
            warm_up_s: 300.0,
            delay_ms: 1.0,
            delay_jitter_ms: self.delay_jitter_ms,
            sampling_jitter_ms: 0.02,
            ..PlantEffects::default()
        };
        let effects = match source {
            Source::Rigid => return config,
            Source::Current => PlantEffects {
                drive_gain_spread: 0.08,
                torque_offset: 0.01,
                torque_offset_drift: 0.003,
                ..elastic
            },
            Source::Link | Source::Commanded => PlantEffects {
                torque_loop_gain: TORQUE_LOOP_GAIN,
                reports_commanded_torque: source == Source::Commanded,
                torque_offset: 0.003,
                ..elastic
            },
        };
        PlantConfig { effects, ..config }
    }

    /// Motion of the arm, another one for each scenario.
    pub(super) fn trajectory<const N: usize>(
        &self,
        robot: &Robot,
        seed: u64,
        quick: bool,
    ) -> Trajectory<N> {
        let seconds = self.ticks(quick) as f64 * PERIOD_S;
        let mix = |sum: u64, byte: u8| sum.wrapping_mul(31).wrapping_add(u64::from(byte));
        let seed = self.name.bytes().fold(seed, mix);
        let random = |seconds| ViaPath::random(robot, seed, seconds, VALIDATION_PEAK_RAD_S);
        Trajectory::Via(match self.motion {
            Motion::Rich => random(seconds),
            Motion::Slow => random(seconds / 8.0).stretched(8.0),
            Motion::SlowThenRich => random(seconds).slow_until(8.0, 0.5 * seconds),
            Motion::ThenStill => random(15.0),
            Motion::OneJointFirst => random(seconds).of_joint_until(1, 0.5 * seconds),
        })
    }

    /// Disturbances; `rated` is the rated payload, kg.
    pub(super) fn events<const N: usize>(
        &self,
        robot: &Robot,
        rated: f64,
        seed: u64,
        quick: bool,
    ) -> Events<N> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut events = Events::default();
        let end_s = self.ticks(quick) as f64 * PERIOD_S;
        let mut from_s = FIRST_EVENT_S;
        while from_s + 0.6 * CYCLE_S <= end_s {
            match self.event {
                Event::None => break,
                Event::Payloads(share) => {
                    let to_s = from_s + 0.5 * CYCLE_S;
                    let tool = Vector3::new(0.02, -0.01, random.random_range(TOOL_REACH_M));
                    let com = robot.flange.point(&tool).into();
                    let payload = Payload::cube(share * rated, com, from_s, to_s);
                    events.payloads.push(payload);
                }
                Event::Pushes => events.pushes.push(push(robot, from_s, &mut random)),
            }
            from_s += CYCLE_S + random.random_range(0.0..1.0);
        }
        events
    }
}

/// A collision with a random link: up to 10–35 % of the limit on the joints below it, just that on its own.
fn push<const N: usize>(robot: &Robot, from_s: f64, random: &mut ChaCha8Rng) -> Push<N> {
    let (touched, size) = (random.random_range(0..N), random.random_range(0.10..0.35));
    let torque = Joints::from_fn(|j, _| {
        let limit = robot.joints[j].limits.torque;
        let share: f64 = random.random_range(-1.0..1.0);
        match j.cmp(&touched) {
            std::cmp::Ordering::Less => size * share * limit,
            std::cmp::Ordering::Equal => size * share.signum() * limit,
            std::cmp::Ordering::Greater => 0.0,
        }
    });
    Push {
        torque,
        from_s,
        to_s: from_s + random.random_range(0.1..2.5),
    }
}
