//! The scenarios, as data: what the arm does, what happens to it, what the board starts from.

use super::world::{N, World};
use foretorque_workbench::dynamics::Joints;
use foretorque_workbench::plant::{Events, Payload, PlantConfig, Push, ReportFaults};
use foretorque_workbench::trajectory::Trajectory;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// What the board believes when a scenario begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Start {
    /// The wrong prior: inertias 20 % and friction 40 % off.
    Wrong,
    /// Identified by least squares on 40 s of another path.
    Identified,
    /// The same without the Stribeck columns: what the networks are there for.
    PlainFriction,
}

/// What the arm does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Motion {
    /// Its task, all the time.
    Task,
    /// Its task for so long, s; then it stands still.
    TaskThenStill(f64),
    /// One joint of its task, from 0, for so long, s, while the others stand still; then all.
    OneJointFirst(usize, f64),
}

/// What happens to the arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Happening {
    /// Nothing.
    Nothing,
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
    pub(super) start: Start,
    pub(super) motion: Motion,
    pub(super) happening: Happening,
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
/// Where the payloads hang, in the frame of the last link, m: 5 cm beyond the flange and aside.
pub(super) const PAYLOAD_COM_M: [f64; 3] = [0.02, -0.01, 0.0823 + 0.05];

/// The plant for acceptance: 8 kHz, 1 % noise, viscous friction +30 % in ten minutes.
const PLANT: PlantConfig = PlantConfig {
    step_rate_hz: 8000.0,
    torque_noise: 0.01,
    viscous_drift: 0.3 / 600.0,
    load_friction: 0.0,
    drive_gain: 1.0,
};
const NO_FAULTS: ReportFaults = ReportFaults {
    torque_gain: 1.0,
    outliers: 0.0,
    outlier_size: 0.2,
    glitches: 0.0,
    not_a_number: 0.0,
    lost: 0.0,
    late: 0.0,
};

/// A minute of the task by an identified board to which nothing happens.
const PLAIN: Scenario = Scenario {
    name: "task",
    shows: "nothing goes wrong",
    start: Start::Identified,
    motion: Motion::Task,
    happening: Happening::Nothing,
    seconds: 60.0,
    quick_s: 22.0,
    plant: PLANT,
    viscous: 1.0,
    faults: NO_FAULTS,
    against_pd: false,
    without_network: false,
};

/// The arm as it was identified, without drift, against PD control alone.
const TRACKING: Scenario = Scenario {
    name: "tracking-identified",
    shows: "tracking error, identified; second half",
    plant: PlantConfig {
        viscous_drift: 0.0,
        ..PLANT
    },
    against_pd: true,
    ..PLAIN
};

const fn payload(name: &'static str, shows: &'static str, mass_kg: f64, times: usize) -> Scenario {
    Scenario {
        name,
        shows,
        happening: Happening::Payloads(mass_kg, times),
        seconds: FIRST_EVENT_S + (PAYLOAD_CYCLE_S + 1.0) * times as f64,
        quick_s: FIRST_EVENT_S + PAYLOAD_CYCLE_S + 1.0,
        ..PLAIN
    }
}

const fn damaged(name: &'static str, shows: &'static str, faults: ReportFaults) -> Scenario {
    Scenario {
        name,
        shows,
        faults,
        ..PLAIN
    }
}

/// All of them.
pub(super) const SCENARIOS: &[Scenario] = &[
    Scenario {
        name: "convergence",
        shows: "from the wrong prior",
        start: Start::Wrong,
        ..PLAIN
    },
    PLAIN,
    Scenario {
        name: "standstill",
        shows: "15 s of task, then 61 s of standstill",
        motion: Motion::TaskThenStill(15.0),
        seconds: 77.0,
        ..PLAIN
    },
    Scenario {
        name: "viscous-drift",
        shows: "viscous friction +30 % in ten minutes",
        seconds: 600.0,
        ..PLAIN
    },
    payload("payload-0.5kg", "picked up and let go", 0.5, 6),
    payload("payload-1kg", "picked up and let go", 1.0, 6),
    payload("payload-2kg", "picked up and let go", 2.0, 6),
    payload(
        "payload-3kg",
        "picked up and let go at 20 instants",
        3.0,
        20,
    ),
    payload("payload-5kg", "picked up and let go", 5.0, 6),
    Scenario {
        name: "collisions",
        shows: "100 pushes of 10–35 % of the torque limit, 0.1–2.5 s",
        happening: Happening::Collisions(100),
        seconds: FIRST_EVENT_S + (COLLISION_CYCLE_S + 1.0) * 100.0,
        quick_s: FIRST_EVENT_S + 4.0 * (COLLISION_CYCLE_S + 1.0),
        ..PLAIN
    },
    damaged(
        "outliers",
        "1 % of the torques off by 20 % of the limit",
        ReportFaults {
            outliers: 0.01,
            ..NO_FAULTS
        },
    ),
    Scenario {
        name: "noise-x10",
        shows: "torque noise of 10 % of the limit",
        plant: PlantConfig {
            torque_noise: 0.1,
            ..PLANT
        },
        ..PLAIN
    },
    damaged(
        "wrong-sign",
        "the torque is reported with the wrong sign",
        ReportFaults {
            torque_gain: -1.0,
            ..NO_FAULTS
        },
    ),
    damaged(
        "sensor-gain-plus-20",
        "reported torque 20 % too large",
        ReportFaults {
            torque_gain: 1.2,
            ..NO_FAULTS
        },
    ),
    damaged(
        "sensor-gain-minus-20",
        "reported torque 20 % too small",
        ReportFaults {
            torque_gain: 0.8,
            ..NO_FAULTS
        },
    ),
    Scenario {
        name: "drive-gain-plus-20",
        shows: "torque constants 20 % larger than believed",
        plant: PlantConfig {
            drive_gain: 1.2,
            ..PLANT
        },
        ..PLAIN
    },
    Scenario {
        name: "drive-gain-minus-20",
        shows: "torque constants 20 % smaller than believed",
        plant: PlantConfig {
            drive_gain: 0.8,
            ..PLANT
        },
        ..PLAIN
    },
    damaged(
        "glitches",
        "0.1 % of the positions with a flipped encoder bit",
        ReportFaults {
            glitches: 0.001,
            ..NO_FAULTS
        },
    ),
    damaged(
        "lost-and-late",
        "5 % of the samples lost, 5 % late",
        ReportFaults {
            lost: 0.05,
            late: 0.05,
            ..NO_FAULTS
        },
    ),
    damaged(
        "not-a-number",
        "1 % of the samples with a number that is none",
        ReportFaults {
            not_a_number: 0.01,
            ..NO_FAULTS
        },
    ),
    Scenario {
        name: "one-joint",
        shows: "40 s in which only the shoulder lift moves, then all joints",
        motion: Motion::OneJointFirst(1, 40.0),
        seconds: 70.0,
        ..PLAIN
    },
    Scenario {
        name: "network",
        shows: "a friction model without Stribeck columns, and the networks beside it",
        start: Start::PlainFriction,
        without_network: true,
        ..PLAIN
    },
    TRACKING,
    Scenario {
        name: "tracking-wrong-prior",
        shows: "tracking error, from the wrong prior; second half",
        start: Start::Wrong,
        ..TRACKING
    },
    Scenario {
        name: "tracking-warm",
        shows: "tracking error after viscous friction +30 %; second half",
        viscous: 1.3,
        ..TRACKING
    },
];

impl Scenario {
    /// Number in the list: the stream of its random numbers.
    fn stream(&self) -> u64 {
        let place = SCENARIOS.iter().position(|other| other.name == self.name);
        place.unwrap_or_default() as u64
    }

    /// Seed of the noise of the arm in this scenario.
    pub(super) fn noise_stream(&self) -> u64 {
        self.stream()
    }

    /// Length in ticks.
    pub(super) fn length_s(&self, quick: bool) -> f64 {
        if quick { self.quick_s } else { self.seconds }
    }

    /// What the arm is to do.
    pub(super) fn trajectory(&self, world: &World, quick: bool) -> Trajectory<N> {
        let seconds = self.length_s(quick);
        let moving_s = match self.motion {
            Motion::TaskThenStill(moving_s) => moving_s,
            Motion::Task | Motion::OneJointFirst(..) => seconds,
        };
        let task = world.task(moving_s, 1 + self.stream());
        match self.motion {
            Motion::OneJointFirst(joint, alone_s) => {
                Trajectory::Via(task.of_joint_until(joint, alone_s))
            }
            Motion::Task | Motion::TaskThenStill(_) => Trajectory::Via(task),
        }
    }

    /// What happens to the arm: seeded, the same for every board.
    pub(super) fn events(&self, world: &World, quick: bool) -> Events<N> {
        let mut random = ChaCha8Rng::seed_from_u64(world.seed);
        random.set_stream(self.stream());
        let mut events = Events::default();
        let end_s = self.length_s(quick);
        let mut from_s = FIRST_EVENT_S;
        match self.happening {
            Happening::Nothing => {}
            Happening::Payloads(mass_kg, times) => {
                while events.payloads.len() < times && from_s + PAYLOAD_CYCLE_S <= end_s {
                    let held_s = 0.5 * PAYLOAD_CYCLE_S + random.random_range(-0.5..0.5);
                    let to_s = from_s + held_s;
                    events
                        .payloads
                        .push(Payload::cube(mass_kg, PAYLOAD_COM_M, from_s, to_s));
                    from_s += PAYLOAD_CYCLE_S + random.random_range(0.0..1.0);
                }
            }
            Happening::Collisions(times) => {
                while events.pushes.len() < times && from_s + COLLISION_CYCLE_S <= end_s {
                    let to_s = from_s + random.random_range(0.1..2.5);
                    events.pushes.push(Push {
                        torque: blow(world, &mut random),
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

/// Torques of something that touches a random link: up to 10–35 % of the limit on the joints below it, just that on its
/// own.
fn blow(world: &World, random: &mut ChaCha8Rng) -> Joints<N> {
    let touched = random.random_range(0..N);
    let size = random.random_range(0.10..0.35);
    Joints::from_fn(|j, _| {
        let limit = world.described.joints[j].limits.torque;
        let share: f64 = random.random_range(-1.0..1.0);
        match j.cmp(&touched) {
            std::cmp::Ordering::Less => size * share * limit,
            std::cmp::Ordering::Equal => size * share.signum() * limit,
            std::cmp::Ordering::Greater => 0.0,
        }
    })
}
