//! Arms and scenarios as tables.

use super::PERIOD_S;
use crate::StudyError;
use foretorque_workbench::plant::ReportFaults;
use foretorque_workbench::robot::Robot;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// One arm: its description, and the kind of arm it stands for.
#[derive(Debug)]
pub(super) struct WorldArm {
    pub(super) described: Robot,
    pub(super) kind: &'static str,
    /// The rotors of the description are guesses, which a board has too.
    pub(super) guessed_rotors: bool,
}

macro_rules! arms {
    ($($name:literal, $file:literal, $kind:literal;)*) => {
        &[$(($name, include_str!(concat!("../../../robots/", $file)), $kind)),*]
    };
}

/// Name, description and kind of the arms that are built in.
pub(super) const ARMS: &[(&str, &str, &str)] = arms! {
    "ur5", "ur5.toml", "industrial, 6 joints, data sheet";
    "panda", "panda.urdf", "7 joints, URDF without rotors and friction";
    "iiwa", "iiwa.toml", "7 joints, LWR class, no rotors and friction";
    "gen3", "gen3.toml", "7 light joints, Gen3 class, no rotors and friction";
    "ur10e", "ur10e.toml", "industrial, 6 joints, data sheet, guessed rotors";
    "mit6", "mit6.toml", "6 low-ratio MIT actuators, little friction";
    "small5", "small5.toml", "5 hobby servos, much friction";
    "eight", "eight.toml", "8 joints, no rotors and friction";
};

/// Largest relative error of a rotor inertia that is described, and range of those that are not, rad/s²: the torque limit
/// over the inertia.
const ROTOR_ERROR: f64 = 0.25;
/// Friction of joints whose description has none: Coulomb, share of the torque limit; viscous, the same at the speed limit.
const COULOMB_SHARE: f64 = 0.04;
const VISCOUS_SHARE: f64 = 0.06;

impl WorldArm {
    /// All that are built in.
    pub(super) fn all() -> Result<Vec<Self>, StudyError> {
        let arms = ARMS.iter().map(|(name, text, kind)| {
            Ok(Self {
                described: Robot {
                    name: (*name).to_owned(),
                    ..Robot::parse(name, text)?
                },
                kind,
                guessed_rotors: *name == "ur10e",
            })
        });
        arms.collect()
    }

    /// The description without friction, and without rotors where `described` gives them for certain: what a URDF has.
    pub(super) fn bare(described: &Robot, guessed_rotors: bool) -> Robot {
        let mut bare = described.clone();
        for joint in &mut bare.joints {
            (joint.friction.viscous, joint.friction.coulomb) = (0.0, 0.0);
            if !guessed_rotors {
                joint.drive.rotor_inertia = 0.0;
            }
        }
        bare
    }

    /// The arm as it is; its masses differ from the description by up to 20 %.
    pub(super) fn truth(described: &Robot, seed: u64) -> Robot {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        random.set_stream(7);
        let (robot, _) = described.with_assumed_rotors();
        let mut truth = robot.perturbed(seed);
        for joint in &mut truth.joints {
            joint.drive.rotor_inertia *= 1.0 + ROTOR_ERROR * random.random_range(-1.0..1.0);
            let (limits, friction) = (joint.limits, &mut joint.friction);
            if friction.coulomb <= 0.0 {
                friction.coulomb = COULOMB_SHARE * limits.torque * random.random_range(0.7..1.3);
                friction.viscous = VISCOUS_SHARE * limits.torque / limits.velocity;
                (friction.stribeck_ratio, friction.stribeck_velocity) = (0.25, 0.1);
            }
        }
        truth
    }
}

/// Gain of the torque loop around a sensor behind the gear.
pub(super) const TORQUE_LOOP_GAIN: f64 = 9.0;

/// Parameters of the board when a scenario begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Start {
    /// The description without friction and rotors.
    Description,
    /// Identified by weighted least squares on 40 s of another path.
    Bank,
}

/// Origin of the measured torque.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Source {
    /// Motor current, with gain error and drifting offset.
    Current,
    /// A sensor behind the gear, inside a torque loop: friction and rotor are not measured.
    Link,
    /// Commanded torque of such drives.
    Commanded,
    /// Motor current of a rigid arm with exact sensors and 1 % noise.
    Rigid,
}

impl Source {
    /// True if the drives have a torque loop.
    pub(super) fn has_torque_loop(self) -> bool {
        matches!(self, Self::Link | Self::Commanded)
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Motion {
    /// Via points, as fast as the arm may.
    Rich,
    /// That shape, eight times slower.
    Slow,
    /// Slow for half of the time, then as fast as the arm may.
    SlowThenRich,
    /// Via points for 15 s, then standstill.
    ThenStill,
    /// The second joint alone for half of the time, then all.
    OneJointFirst,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Event {
    None,
    /// A body of this share of the rated payload, picked up and let go.
    Payloads(f64),
    /// Pushes of 10–35 % of the torque limit.
    Pushes,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Scenario {
    pub(super) name: &'static str,
    pub(super) shows: &'static str,
    pub(super) starts: &'static [(Start, Source)],
    pub(super) motion: Motion,
    pub(super) event: Event,
    /// Length, s, and that of the short form; 0 leaves the scenario out of it.
    pub(super) seconds: f64,
    pub(super) quick_s: f64,
    /// Growth of viscous friction in a minute, share.
    pub(super) drift_min: f64,
    pub(super) torque_noise: f64,
    pub(super) drive_gain: f64,
    /// Largest further delay of a report, ms; below a period it makes no difference.
    pub(super) delay_jitter_ms: f64,
    pub(super) faults: ReportFaults,
    /// PD control alone is run too.
    pub(super) against_pd: bool,
    /// Batch least squares on the rows of the run is the rival.
    pub(super) against_batch: bool,
}

const BANK: &[(Start, Source)] = &[(Start::Bank, Source::Current)];

/// The scenario in which nothing happens.
pub(super) const PLAIN: Scenario = Scenario {
    name: "",
    shows: "",
    starts: BANK,
    motion: Motion::Rich,
    event: Event::None,
    seconds: 40.0,
    quick_s: 0.0,
    drift_min: 0.0,
    torque_noise: 0.01,
    drive_gain: 1.0,
    delay_jitter_ms: 1.0,
    faults: ReportFaults::NONE,
    against_pd: false,
    against_batch: false,
};

/// Name, description, difference from the plain scenario.
type Row = (&'static str, &'static str, fn(&mut Scenario));

const SCENARIOS: &[Row] = &[
    ("path", "one rich path, nothing goes wrong", |s| {
        s.starts = &[
            (Start::Description, Source::Current),
            (Start::Description, Source::Link),
            (Start::Description, Source::Commanded),
            (Start::Bank, Source::Current),
            (Start::Bank, Source::Link),
            (Start::Bank, Source::Commanded),
        ];
        (s.seconds, s.quick_s) = (60.0, 30.0);
        (s.against_pd, s.against_batch) = (true, true);
    }),
    ("rigid", "a rigid arm with exact sensors", |s| {
        s.starts = &[(Start::Description, Source::Rigid)];
        (s.quick_s, s.against_pd) = (22.0, true);
    }),
    ("slow", "slow motion from a bank", |s| {
        (s.motion, s.against_batch) = (Motion::Slow, true);
        (s.seconds, s.quick_s) = (120.0, 40.0);
    }),
    ("later", "slow motion from a bank, then rich motion", |s| {
        s.motion = Motion::SlowThenRich;
        (s.seconds, s.quick_s) = (120.0, 60.0);
    }),
    ("jitter", "reports 1 to 4 ms old, by chance", |s| {
        s.starts = &[
            (Start::Description, Source::Current),
            (Start::Bank, Source::Current),
        ];
        (s.quick_s, s.delay_jitter_ms) = (40.0, 3.0);
    }),
    ("drift", "viscous friction grows by 30 % in a minute", |s| {
        (s.seconds, s.quick_s, s.drift_min) = (120.0, 60.0, 0.3);
    }),
    ("calm", "undisturbed for ten minutes", |s| {
        (s.seconds, s.quick_s) = (600.0, 60.0);
    }),
    (
        "payload",
        "10 % of the rated payload, picked up and let go",
        |s| {
            s.event = Event::Payloads(0.1);
            (s.seconds, s.quick_s) = (80.0, 28.0);
        },
    ),
    ("payload-rated", "60 % of the rated payload", |s| {
        s.event = Event::Payloads(0.6);
        s.seconds = 80.0;
    }),
    ("pushes", "collisions of 0.1 to 2.5 s", |s| {
        s.event = Event::Pushes;
        s.seconds = 120.0;
    }),
    ("standstill", "15 s of path, then standstill", |s| {
        s.motion = Motion::ThenStill
    }),
    ("one-joint", "the second joint alone, then all", |s| {
        s.motion = Motion::OneJointFirst;
        s.seconds = 60.0;
    }),
    (
        "outliers",
        "1 % of the torques off by 20 % of the limit",
        |s| s.faults.outliers = 0.01,
    ),
    ("noise-x5", "torque noise of 5 % of the limit", |s| {
        s.torque_noise = 0.05
    }),
    ("wrong-sign", "reported torque with the wrong sign", |s| {
        s.faults.torque_gain = -1.0
    }),
    ("sensor-gain", "reported torque 20 % too large", |s| {
        s.faults.torque_gain = 1.2
    }),
    (
        "drive-gain",
        "torque constants 20 % below the model's",
        |s| s.drive_gain = 0.8,
    ),
    (
        "glitches",
        "0.1 % of the positions with a flipped bit",
        |s| s.faults.glitches = 0.001,
    ),
    ("lost-and-late", "5 % of the samples lost, 5 % late", |s| {
        (s.faults.lost, s.faults.late) = (0.05, 0.05);
    }),
    ("not-a-number", "1 % of the samples not finite", |s| {
        s.faults.not_a_number = 0.01;
    }),
];

impl Scenario {
    /// All scenarios, or those of the short form.
    pub(super) fn all(quick: bool) -> impl Iterator<Item = Self> {
        let scenarios = SCENARIOS.iter().map(|(name, shows, change)| {
            let mut scenario = PLAIN;
            (scenario.name, scenario.shows) = (name, shows);
            change(&mut scenario);
            scenario
        });
        scenarios.filter(move |scenario| !quick || scenario.quick_s > 0.0)
    }

    /// The runs whose names begin with `only`: name, start and source of the torque.
    pub(super) fn runs(&self, only: &str) -> impl Iterator<Item = (String, Start, Source)> {
        let starts = self.starts.iter().map(|&(start, source)| {
            let of = format!("{start:?}-{source:?}").to_lowercase();
            (format!("{}-{of}", self.name), start, source)
        });
        starts.filter(move |(name, ..)| name.starts_with(only))
    }

    pub(super) fn ticks(&self, quick: bool) -> usize {
        let seconds = if quick { self.quick_s } else { self.seconds };
        (seconds / PERIOD_S).round() as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use foretorque::learning::rated_payload;
    use foretorque_workbench::board::Described;
    use foretorque_workbench::dynamics::{Joints, ReferenceModel};
    use foretorque_workbench::plant::Payload;

    /// Largest weight torque of `mass` at the origin of the last link over the torque limit, over 200 poses and all joints.
    fn heaviest<const N: usize>(robot: &Robot, mass: f64) -> f64 {
        let empty = ReferenceModel::<N>::new(robot).expect("as many joints");
        let loaded = empty.with_payload(&Payload::cube(mass, [0.0; 3], 0.0, 0.0).body);
        let mut random = ChaCha8Rng::seed_from_u64(0);
        let mut worst = 0.0_f64;
        for _ in 0..200 {
            let q = Joints::from_fn(|j, _| {
                let (low, high) = robot.joints[j].limits.position;
                random.random_range(low..high)
            });
            let weight = loaded.gravity_torques(&q) - empty.gravity_torques(&q);
            for (torque, joint) in weight.iter().zip(&robot.joints) {
                worst = worst.max(torque.abs() / joint.limits.torque);
            }
        }
        worst
    }

    #[test]
    fn every_arm_carries_its_rated_payload_with_a_third_of_its_torque() {
        for WorldArm {
            described: robot, ..
        } in WorldArm::all().expect("described")
        {
            let share = foretorque_workbench::arms!(robot, N, P => {
                Described::<N, P>::read(&robot).expect("as many joints");
                heaviest::<N>(&robot, rated_payload::<Described<N, P>, N, P>().into())
            }, else panic!("{}: no such arm", robot.name));
            // Random poses are not stretched out; with less than half of it the rating would be too low.
            assert!(
                (1.0 / 6.0..=0.34).contains(&share),
                "{}: {share}",
                robot.name
            );
        }
    }
    #[test]
    fn a_run_is_chosen_by_the_name_it_has_in_the_report() {
        for scenario in Scenario::all(false) {
            let all: Vec<_> = scenario.runs("").collect();
            assert_eq!(all.len(), scenario.starts.len());
            for run in all {
                assert_eq!(scenario.runs(&run.0).collect::<Vec<_>>(), [run]);
            }
        }
    }
}
