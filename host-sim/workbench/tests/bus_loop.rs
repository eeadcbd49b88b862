//! Six simulated MIT drives on their bus, driven by the loop: tracking, and what faults of bus and drives do.

use foretorque::arm::ur5::Ur5;
use foretorque::joint::JointMotion;
use foretorque::learning::ParameterSet;
use foretorque_link::bus::{BusPhase, BusTick};
use foretorque_link::drives::{Cia402, ControlMode, Moteus, Odrive, Protocol, Ranges, Resolution};
use foretorque_link::safety::SafetyState;
use foretorque_workbench::bus::sim::{
    DriveTruth, LineFault, LineFaults, SimulatedDrive, SimulatedNetwork, plant_config,
};
use foretorque_workbench::bus::{BusPlayer, Network, Profile};
use foretorque_workbench::closed_loop::motion_f32;
use foretorque_workbench::dynamics::Joints;
use foretorque_workbench::plant::{Plant, PlantConfig};
use foretorque_workbench::robot::{Perturbation, Robot};
use foretorque_workbench::trajectory::Trajectory;
use foretorque_workbench::trajectory::via::ViaPath;
use std::path::Path;

type Player = BusPlayer<Ur5, SimulatedNetwork<6>, 6, 40>;

fn profile(rate_hz: f64) -> Profile {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../profiles/sim-ur5.toml");
    let mut profile = Profile::load(&file).expect("it is a profile");
    profile.rate_hz = rate_hz;
    profile
}

fn path(robot: &Robot, duration_s: f64) -> Trajectory<6> {
    Trajectory::Via(ViaPath::random(robot, 1, duration_s, 2.0))
}

/// An arm that waits on its brakes at the begin of the path.
fn player(profile: &Profile, path: &Trajectory<6>, forward: bool) -> Player {
    let robot = Robot::load("ur5").expect("built in");
    let truth = robot.perturbed(1, &Perturbation::PLANT);
    let plant = plant_config(PlantConfig::default());
    let mut plant = Plant::<6>::new(&truth, plant, 1).expect("six joints");
    plant.place(&path.at(0.0).q);
    let config = profile.config::<Ur5, 6, 40>().expect("it fits the arm");
    let noise = Joints::from_fn(|j, _| if j < 3 { 1.5 } else { 0.28 });
    let network = SimulatedNetwork::new(plant, &config, profile.bus[0], &noise, 1);
    let mut set = ParameterSet::nominal::<Ur5>(1);
    if !forward {
        set.rigid.fill(0.0);
    }
    BusPlayer::new(config, set, network).expect("it fits the arm")
}

/// RMS tracking error, mrad, over the end of a path that is learnt for `learn_s`; then the arm is parked.
fn tracking_mrad(profile: &Profile, forward: bool, learn_s: f64) -> f64 {
    const JUDGED_S: f64 = 6.0;
    let robot = Robot::load("ur5").expect("built in");
    let path = path(&robot, learn_s + JUDGED_S);
    let mut player = player(profile, &path, forward);
    player.arm().expect("it arms");
    player.approach(&path.at(0.0).q).expect("it comes there");
    player.controller.set_learning(forward);
    let (mut sum, mut count) = (0.0, 0);
    for tick in 0..path.ticks(player.period_s()) {
        let t_s = tick as f64 * player.period_s();
        let motion = motion_f32(&path.at(t_s + profile.lead_s()));
        player.tick(Some(&motion)).expect("the bus is there");
        player.check().expect("no fault");
        if t_s > learn_s {
            let error = player.network.plant.q() - path.at(t_s).q;
            sum += error.norm_squared() / 6.0;
            count += 1;
        }
    }
    let counters = (0..6).map(|joint| player.controller.counters(joint).lost as usize);
    let (lost, replies) = (counters.sum::<usize>(), 6 * path.ticks(player.period_s()));
    assert!(1000 * lost < replies, "{lost} of {replies} replies lost");
    let reason = player.park().expect("the bus is there");
    assert!(player.network.all_off(), "{reason}");
    (sum / f64::from(count)).sqrt() * 1e3
}

#[test]
fn feed_forward_from_the_description_tracks_three_times_better_than_the_drives_alone_after_30_s() {
    for rate_hz in [250.0, 500.0, 1000.0] {
        let profile = profile(rate_hz);
        let alone = tracking_mrad(&profile, false, 30.0);
        let with = tracking_mrad(&profile, true, 30.0);
        println!(
            "{rate_hz} Hz: {alone:.3} mrad alone, {with:.3} mrad with, ratio {:.2}",
            alone / with
        );
        assert!(
            alone > 3.0 * with,
            "{rate_hz} Hz: {alone} mrad alone, {with} mrad with"
        );
    }
}

/// End of a campaign.
#[derive(Clone, Copy, Debug, PartialEq)]
enum End {
    /// The torque flows on.
    Armed,
    /// The torque has ended, and the message begins so.
    Off(&'static str),
}

/// Watches every torque that reaches a drive.
struct Witness {
    /// Torques that the loop has released, newest last.
    released: Vec<Joints<6>>,
    /// Steps of the torque in the frames, N·m.
    step: Joints<6>,
    wrong: Vec<String>,
}

impl Witness {
    /// Every torque in force is one that was released for that joint within the watchdog's time, or zero.
    fn watch(&mut self, player: &Player, tick: &BusTick<6>) {
        let t_s = player.network.t_s();
        let seen = player.network.feed_forward();
        for j in 0..6 {
            // Carried rounding adds up to a step to the half of one.
            let near = |torque: f64| (torque - seen[j]).abs() <= 1.01 * self.step[j];
            let known = self
                .released
                .iter()
                .rev()
                .take(60)
                .any(|released| near(released[j]));
            if !(known || near(0.0)) {
                self.wrong
                    .push(format!("{t_s:.3} s: joint {} has {} N·m", j + 1, seen[j]));
            }
        }
        self.released.push(tick.torque.total.cast());
    }
}

/// Plays 1 s, then 1.5 s with `fault`; returns the end, and the torques that were wrong.
fn campaign(fault: LineFault, at_s: f64, for_s: f64) -> (Result<(), String>, Vec<String>, Player) {
    let profile = profile(500.0);
    let robot = Robot::load("ur5").expect("built in");
    let path = path(&robot, 10.0);
    let mut player = player(&profile, &path, true);
    player.arm().expect("it arms");
    player.approach(&path.at(0.0).q).expect("it comes there");
    let begin_s = player.network.t_s();
    player.network.faults = LineFaults::one(fault, begin_s + at_s..begin_s + at_s + for_s);
    let steps = player
        .controller
        .config()
        .joints
        .map(|joint| joint.drive.torque_resolution());
    let mut witness = Witness {
        released: vec![player.network.feed_forward()],
        step: Joints::from_iterator(steps.iter().map(|step| f64::from(*step))),
        wrong: Vec::new(),
    };
    // The same arm and path without the fault: the right torques, as long as the loop is armed.
    let mut twin = self::player(&profile, &path, true);
    twin.arm().expect("it arms");
    twin.approach(&path.at(0.0).q).expect("it comes there");
    let (mut end, mut ended_s) = (Ok(()), None);
    for tick in 0..1250 {
        let t_s = f64::from(tick) * 2e-3;
        let motion = motion_f32(&path.at(t_s + profile.lead_s()));
        let result = player
            .tick(Some(&motion))
            .expect("the simulated bus is there");
        let right = twin
            .tick(Some(&motion))
            .expect("the simulated bus is there");
        witness.watch(&player, &result);
        if result.status.state == SafetyState::Armed {
            if result.torque.total != right.torque.total {
                witness
                    .wrong
                    .push(format!("{t_s:.3} s: released {}", result.torque.total));
            }
        } else if ended_s.is_none() {
            ended_s = Some(t_s);
            end = player.check().map_err(|error| error.to_string());
        }
        let over = ended_s.is_some_and(|ended_s| t_s > ended_s + 0.08);
        if over && player.network.feed_forward().amax() > witness.step.amax() {
            witness
                .wrong
                .push(format!("{t_s:.3} s: {}", player.network.feed_forward()));
        }
        if ended_s.is_some() && result.status.state == SafetyState::Armed {
            witness.wrong.push(format!("{t_s:.3} s: armed again"));
        }
    }
    (end, witness.wrong, player)
}

#[test]
fn no_fault_of_bus_or_drives_makes_a_wrong_torque() {
    use LineFault as F;
    let cases: [(F, f64, End); 20] = [
        (F::LostReplies(2, 0.1), 1.5, End::Armed),
        (
            F::LostReplies(2, 1.0),
            1.5,
            End::Off("torque off: joint 3: the drive does not answer"),
        ),
        (
            F::LostReplies(4, 0.5),
            1.5,
            End::Off("torque off: the bus loses"),
        ),
        (F::LostCommands(1, 0.1), 1.5, End::Armed),
        (
            F::LostCommands(1, 1.0),
            1.5,
            End::Off("torque off: joint 2: the drive does not answer"),
        ),
        (F::LateReplies(3, 1), 1.5, End::Armed),
        (F::LateReplies(0, 6), 1.5, End::Armed),
        (F::DoubledCommands(5), 1.5, End::Armed),
        (F::DoubledReplies(0), 1.5, End::Armed),
        (
            F::StuckReply(1),
            1.5,
            End::Off("torque off: joint 2: the reply of the drive repeats itself"),
        ),
        (
            F::WrongIdentifier(0, 2),
            1.5,
            End::Off("torque off: joint "),
        ),
        (
            F::WrongIdentifier(3, 9),
            1.5,
            End::Off("torque off: joint 4: the drive does not answer"),
        ),
        (F::FlippedBits(1, 0.02), 1.5, End::Armed),
        (
            F::Dead(4),
            1.5,
            End::Off("torque off: joint 5: the drive does not answer"),
        ),
        (
            F::Reset(2),
            1.5,
            End::Off("torque off: joint 3: the drive has switched itself off"),
        ),
        (
            F::DriveFault(5, 0xa),
            1.5,
            End::Off("torque off: joint 6: the drive reports fault 0xa"),
        ),
        (F::BusOff, 1.5, End::Off("torque off: the bus is off")),
        (F::BusOff, 0.01, End::Off("torque off: the bus is off")),
        (F::Babble(0), 1.5, End::Off("torque off: joint ")),
        (F::Overload(0.3), 1.5, End::Off("torque off: ")),
    ];
    for (fault, for_s, expected) in cases {
        let (end, wrong, player) = campaign(fault, 1.0, for_s);
        assert!(
            wrong.is_empty(),
            "{fault:?}: {} wrong torques, {}",
            wrong.len(),
            wrong[0]
        );
        match (expected, &end) {
            (End::Armed, Ok(())) => {}
            (End::Off(message), Err(error)) if error.starts_with(message) => {
                assert!(
                    !matches!(player.controller.phase(), BusPhase::Running(_)),
                    "{fault:?}"
                );
            }
            _ => panic!("{fault:?}: {end:?}, expected {expected:?}"),
        }
    }
}

#[test]
fn a_host_that_is_silent_ends_the_torque_and_so_do_the_drives_when_the_loop_hangs() {
    let profile = profile(500.0);
    let robot = Robot::load("ur5").expect("built in");
    let path = path(&robot, 10.0);
    let mut silent = player(&profile, &path, true);
    silent.arm().expect("it arms");
    silent.approach(&path.at(0.0).q).expect("it comes there");
    for _ in 0..40 {
        silent.tick(None).expect("the bus is there");
    }
    assert!(silent.check().is_err());
    assert!(silent.network.feed_forward().amax() < 0.2);
    let mut hung = player(&profile, &path, true);
    hung.arm().expect("it arms");
    hung.approach(&path.at(0.0).q).expect("it comes there");
    assert!(hung.network.feed_forward().amax() > 1.0);
    for _ in 0..30 {
        hung.network.wait();
    }
    assert!(hung.network.all_off() && hung.network.feed_forward().amax() == 0.0);
    // The loop that comes back finds the drives off and does not arm again by itself.
    let motion: JointMotion<6> = motion_f32(&path.at(0.0));
    for _ in 0..30 {
        hung.tick(Some(&motion)).expect("the bus is there");
    }
    assert!(hung.check().is_err());
    assert!(hung.network.all_off());
}

#[test]
fn drives_whose_limits_are_not_those_of_the_profile_are_not_armed() {
    let profile = profile(500.0);
    let robot = Robot::load("ur5").expect("built in");
    let path = path(&robot, 10.0);
    let mut other = profile.clone();
    if let Protocol::Damiao(ranges) = &mut other.joint[3].drive.protocol {
        ranges.torque = 100.0;
    }
    let mut player = player(&profile, &path, true);
    let wired = self::player(&other, &path, true).network;
    player.network = wired;
    let refused = player.arm().expect_err("the scales differ").to_string();
    assert_eq!(
        refused,
        "torque off: joint 4: scale of torque is 10 in the profile, 100 in the drive"
    );
    assert!(player.network.all_off());
}

/// Gear, torque and gains of the drives of `profile`, over another protocol.
fn spoken(profile: &Profile, protocol: impl Fn(Ranges) -> Protocol) -> Profile {
    let mut profile = profile.clone();
    for joint in &mut profile.joint {
        let Protocol::Damiao(ranges) = joint.drive.protocol else {
            panic!("{joint:?}");
        };
        joint.drive.protocol = protocol(ranges);
        joint.drive.host_id = 0;
    }
    profile
}

/// Every other family of drives: its codec, and a scale that the drive reports otherwise than the profile.
fn families() -> Vec<(&'static str, Profile, Option<Profile>)> {
    let profile = profile(500.0);
    let moteus = |resolution| {
        spoken(&profile, |_| {
            Protocol::Moteus(Moteus {
                kp: 1000.0,
                kd: 40.0,
                watchdog_s: 0.05,
                resolution,
            })
        })
    };
    let odrive = |torque_scale| {
        spoken(&profile, move |_| {
            Protocol::Odrive(Odrive {
                mode: ControlMode::Position,
                velocity_scale: 1000.0,
                torque_scale,
                torque_scale_endpoint: 5,
                polled: false,
            })
        })
    };
    let cia402 = |rated_torque| {
        spoken(&profile, move |_| {
            Protocol::Cia402(Cia402 {
                mode: ControlMode::Position,
                counts_per_turn: 1_048_576.0,
                rated_torque,
            })
        })
    };
    let limited = |mut ranges: Ranges| {
        ranges.torque *= 0.3;
        ranges
    };
    vec![
        (
            "cyber-gear",
            spoken(&profile, Protocol::CyberGear),
            Some(spoken(&profile, |ranges| {
                Protocol::CyberGear(limited(ranges))
            })),
        ),
        (
            "robstride",
            spoken(&profile, Protocol::RobStride),
            Some(spoken(&profile, |ranges| {
                Protocol::RobStride(limited(ranges))
            })),
        ),
        ("moteus int16", moteus(Resolution::Int16), None),
        ("moteus f32", moteus(Resolution::F32), None),
        ("odrive", odrive(1000.0), Some(odrive(100.0))),
        ("cia402", cia402(20.0), Some(cia402(2.0))),
    ]
}

#[test]
fn every_family_of_drives_is_driven_and_a_fault_or_another_scale_ends_the_torque() {
    let robot = Robot::load("ur5").expect("built in");
    let path = path(&robot, 4.0);
    for (name, profile, other) in families() {
        let alone = tracking_mrad(&profile, false, 10.0);
        let with = tracking_mrad(&profile, true, 10.0);
        println!("{name}: {alone:.3} mrad alone, {with:.3} mrad with");
        assert!(
            alone > 1.5 * with,
            "{name}: {alone} mrad alone, {with} mrad with"
        );
        // The first torque of a drive that is switched on holds the arm where it stands.
        let mut arming = player(&profile, &path, true);
        let before = *arming.network.plant.q();
        arming.arm().expect("it arms");
        let moved = (arming.network.plant.q() - before).amax();
        assert!(moved < 0.01, "{name}: {moved} rad");
        for (fault, message) in [
            (
                LineFault::Dead(4),
                "torque off: joint 5: the drive does not answer",
            ),
            (
                LineFault::DriveFault(1, 0x8),
                "torque off: joint 2: the drive reports fault 0x8",
            ),
        ] {
            let mut faulty = player(&profile, &path, true);
            faulty.arm().expect("it arms");
            let t_s = faulty.network.t_s();
            faulty.network.faults = LineFaults::one(fault, t_s + 0.1..1e9);
            let failed = faulty.approach(&path.at(0.0).q).expect_err("a fault");
            assert_eq!(failed.to_string(), message, "{name}");
            for _ in 0..30 {
                faulty.tick(None).expect("the bus is there");
            }
            assert!(faulty.network.feed_forward().amax() < 0.5, "{name}");
        }
        if let Some(other) = other {
            let mut wrong = player(&profile, &path, true);
            for (drive, other) in wrong.network.drives.iter_mut().zip(&other.joint) {
                *drive = SimulatedDrive::new(DriveTruth {
                    profile: other.drive,
                    ..*drive.truth()
                });
            }
            let refused = wrong.arm().expect_err("the scales differ").to_string();
            assert!(refused.contains("scale of torque"), "{name}: {refused}");
            assert!(wrong.network.all_off(), "{name}");
        }
    }
}
