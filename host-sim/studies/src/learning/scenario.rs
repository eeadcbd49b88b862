//! The scenarios as a table: motion, disturbances, starting parameters.

use super::setup::{N, Setup};
use foretorque_workbench::dynamics::Joints;
use foretorque_workbench::plant::{Events, Payload, PlantConfig, PlantEffects, Push, ReportFaults};
use foretorque_workbench::trajectory::Trajectory;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Parameters of the board when a scenario begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Start {
    /// The wrong prior: inertias 20 % and friction 40 % off.
    Wrong,
    /// Identified by least squares on 40 s of another path.
    Identified,
    /// Identified without the Stribeck columns.
    PlainFriction,
}

/// Motion of the arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Motion {
    /// Its task, all the time.
    Task,
    /// Its task for so long, s; then it stands still.
    TaskThenStill(f64),
    /// One joint of its task, from 0, for so long, s, while the others stand still; then all.
    OneJointFirst(usize, f64),
}

/// Disturbances of the arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Event {
    /// No disturbance.
    None,
    /// A body of this mass, kg, is picked up and let go so many times.
    Payloads(f64, usize),
    /// So many collisions.
    Collisions(usize),
}

/// One scenario.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Scenario {
    pub(super) name: &'static str,
    pub(super) shows: &'static str,
    /// Number in the table: the stream of its random numbers.
    pub(super) stream: u64,
    pub(super) start: Start,
    pub(super) motion: Motion,
    pub(super) event: Event,
    /// Length, s, and length of the short form that the tests run.
    pub(super) seconds: f64,
    pub(super) quick_s: f64,
    pub(super) plant: PlantConfig,
    /// Factor on the viscous friction, against the arm that was identified.
    pub(super) viscous: f64,
    pub(super) faults: ReportFaults,
    /// PD control alone is run too, to divide its tracking error by.
    pub(super) against_pd: bool,
    /// A board whose networks are not trained is run too.
    pub(super) without_network: bool,
}

/// The first event is at this time, s: the board has settled by then.
const FIRST_EVENT_S: f64 = 12.0;
/// Shortest time from one pick to the next, s; half of it the payload is held.
const PAYLOAD_CYCLE_S: f64 = 9.0;
/// Shortest time from one collision to the next, s.
const COLLISION_CYCLE_S: f64 = 5.0;
/// Centre of mass of the payloads in the frame of the last link, m: 5 cm beyond the flange and aside.
pub(super) const PAYLOAD_COM_M: [f64; 3] = [0.02, -0.01, 0.0823 + 0.05];

/// A minute of the task by an identified board, without disturbance; the plant for acceptance: 8 kHz, 1 % noise, viscous
/// friction +30 % in ten minutes.
const PLAIN: Scenario = Scenario {
    name: "",
    shows: "",
    stream: 0,
    start: Start::Identified,
    motion: Motion::Task,
    event: Event::None,
    seconds: 60.0,
    quick_s: 22.0,
    plant: PlantConfig {
        step_rate_hz: 8000.0,
        torque_noise: 0.01,
        viscous_drift: 0.3 / 600.0,
        load_friction: 0.0,
        drive_gain: 1.0,
        effects: PlantEffects::NONE,
    },
    viscous: 1.0,
    faults: ReportFaults {
        torque_gain: 1.0,
        outliers: 0.0,
        outlier_size: 0.2,
        glitches: 0.0,
        not_a_number: 0.0,
        lost: 0.0,
        late: 0.0,
    },
    against_pd: false,
    without_network: false,
};

/// Name, description, difference from the plain scenario.
type Row = (&'static str, &'static str, fn(&mut Scenario));

/// All scenarios.
const SCENARIOS: &[Row] = &[
    ("convergence", "from the wrong prior", |s| {
        s.start = Start::Wrong
    }),
    ("task", "nothing goes wrong", |_| ()),
    ("standstill", "15 s of task, then 61 s of standstill", |s| {
        s.motion = Motion::TaskThenStill(15.0);
        s.seconds = 77.0;
    }),
    (
        "viscous-drift",
        "viscous friction +30 % in ten minutes",
        |s| s.seconds = 600.0,
    ),
    ("payload-0.5kg", "picked up and let go", |s| {
        s.payloads(0.5, 6)
    }),
    ("payload-1kg", "picked up and let go", |s| {
        s.payloads(1.0, 6)
    }),
    ("payload-2kg", "picked up and let go", |s| {
        s.payloads(2.0, 6)
    }),
    ("payload-3kg", "picked up and let go at 20 instants", |s| {
        s.payloads(3.0, 20)
    }),
    ("payload-5kg", "picked up and let go", |s| {
        s.payloads(5.0, 6)
    }),
    (
        "collisions",
        "100 pushes of 10–35 % of the torque limit, 0.1–2.5 s",
        |s| {
            s.event = Event::Collisions(100);
            s.seconds = FIRST_EVENT_S + (COLLISION_CYCLE_S + 1.0) * 100.0;
            s.quick_s = FIRST_EVENT_S + 4.0 * (COLLISION_CYCLE_S + 1.0);
        },
    ),
    (
        "outliers",
        "1 % of the torques off by 20 % of the limit",
        |s| s.faults.outliers = 0.01,
    ),
    ("noise-x10", "torque noise of 10 % of the limit", |s| {
        s.plant.torque_noise = 0.1
    }),
    ("wrong-sign", "reported torque with the wrong sign", |s| {
        s.faults.torque_gain = -1.0
    }),
    (
        "sensor-gain-plus-20",
        "reported torque 20 % too large",
        |s| s.faults.torque_gain = 1.2,
    ),
    (
        "sensor-gain-minus-20",
        "reported torque 20 % too small",
        |s| s.faults.torque_gain = 0.8,
    ),
    (
        "drive-gain-plus-20",
        "torque constants 20 % above the model's",
        |s| s.plant.drive_gain = 1.2,
    ),
    (
        "drive-gain-minus-20",
        "torque constants 20 % below the model's",
        |s| s.plant.drive_gain = 0.8,
    ),
    (
        "glitches",
        "0.1 % of the positions with a flipped encoder bit",
        |s| s.faults.glitches = 0.001,
    ),
    ("lost-and-late", "5 % of the samples lost, 5 % late", |s| {
        (s.faults.lost, s.faults.late) = (0.05, 0.05);
    }),
    (
        "not-a-number",
        "1 % of the samples with a number that is none",
        |s| {
            s.faults.not_a_number = 0.01;
        },
    ),
    (
        "one-joint",
        "40 s in which only the shoulder lift moves, then all joints",
        |s| {
            s.motion = Motion::OneJointFirst(1, 40.0);
            s.seconds = 70.0;
        },
    ),
    (
        "network",
        "a friction model without Stribeck columns, and the networks beside it",
        |s| {
            s.start = Start::PlainFriction;
            s.without_network = true;
        },
    ),
    (
        "tracking-identified",
        "tracking error, identified; second half",
        Scenario::tracking,
    ),
    (
        "tracking-wrong-prior",
        "tracking error, from the wrong prior; second half",
        |s| {
            s.tracking();
            s.start = Start::Wrong;
        },
    ),
    (
        "tracking-warm",
        "tracking error after viscous friction +30 %; second half",
        |s| {
            s.tracking();
            s.viscous = 1.3;
        },
    ),
];

impl Scenario {
    /// All scenarios.
    pub(super) fn all() -> impl Iterator<Item = Self> {
        (0..).zip(SCENARIOS).map(|(stream, (name, shows, change))| {
            let mut scenario = Self {
                name,
                shows,
                stream,
                ..PLAIN
            };
            change(&mut scenario);
            scenario
        })
    }

    /// A body of this mass, kg, is picked up and let go so many times.
    fn payloads(&mut self, mass_kg: f64, times: usize) {
        self.event = Event::Payloads(mass_kg, times);
        self.seconds = FIRST_EVENT_S + (PAYLOAD_CYCLE_S + 1.0) * times as f64;
    }

    /// No drift, and PD control alone beside.
    fn tracking(&mut self) {
        self.plant.viscous_drift = 0.0;
        self.against_pd = true;
    }

    /// Length in ticks.
    pub(super) fn length_s(&self, quick: bool) -> f64 {
        if quick { self.quick_s } else { self.seconds }
    }

    /// Trajectory of the arm.
    pub(super) fn trajectory(&self, setup: &Setup, quick: bool) -> Trajectory<N> {
        let seconds = self.length_s(quick);
        let moving_s = match self.motion {
            Motion::TaskThenStill(moving_s) => moving_s,
            Motion::Task | Motion::OneJointFirst(..) => seconds,
        };
        let task = setup.task(moving_s, 1 + self.stream);
        match self.motion {
            Motion::OneJointFirst(joint, alone_s) => {
                Trajectory::Via(task.of_joint_until(joint, alone_s))
            }
            Motion::Task | Motion::TaskThenStill(_) => Trajectory::Via(task),
        }
    }

    /// Disturbances of the arm: seeded, equal for every board.
    pub(super) fn events(&self, setup: &Setup, quick: bool) -> Events<N> {
        let mut random = ChaCha8Rng::seed_from_u64(setup.seed);
        random.set_stream(self.stream);
        let mut events = Events::default();
        let end_s = self.length_s(quick);
        let mut from_s = FIRST_EVENT_S;
        match self.event {
            Event::None => {}
            Event::Payloads(mass_kg, times) => {
                while events.payloads.len() < times && from_s + PAYLOAD_CYCLE_S <= end_s {
                    let held_s = 0.5 * PAYLOAD_CYCLE_S + random.random_range(-0.5..0.5);
                    let to_s = from_s + held_s;
                    events
                        .payloads
                        .push(Payload::cube(mass_kg, PAYLOAD_COM_M, from_s, to_s));
                    from_s += PAYLOAD_CYCLE_S + random.random_range(0.0..1.0);
                }
            }
            Event::Collisions(times) => {
                while events.pushes.len() < times && from_s + COLLISION_CYCLE_S <= end_s {
                    let to_s = from_s + random.random_range(0.1..2.5);
                    events.pushes.push(Push {
                        torque: collision_torque(setup, &mut random),
                        from_s,
                        to_s,
                    });
                    from_s += COLLISION_CYCLE_S + random.random_range(0.0..1.0);
                }
            }
        }
        events
    }
}

/// Torques of a collision with a random link: up to 10–35 % of the limit on the joints below it, just that on its
/// own.
fn collision_torque(setup: &Setup, random: &mut ChaCha8Rng) -> Joints<N> {
    let touched = random.random_range(0..N);
    let size = random.random_range(0.10..0.35);
    Joints::from_fn(|j, _| {
        let limit = setup.described.joints[j].limits.torque;
        let share: f64 = random.random_range(-1.0..1.0);
        match j.cmp(&touched) {
            std::cmp::Ordering::Less => size * share * limit,
            std::cmp::Ordering::Equal => size * share.signum() * limit,
            std::cmp::Ordering::Greater => 0.0,
        }
    })
}
