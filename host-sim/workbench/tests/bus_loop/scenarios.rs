//! Every family of drives in the loop, a payload, and friction that drifts. Torques are reported in steps of 12 bits.

use super::{
    Player, Set, described, network, path, play, player, profile, tracking_mrad, tracks_better,
};
use foretorque::arm::ur5::Ur5;
use foretorque::feedforward::evaluate;
use foretorque::learning::rated_payload;
use foretorque_link::bank::Parameters;
use foretorque_link::drives::{Cia402, ControlMode, Moteus, Odrive, Protocol, Ranges, Resolution};
use foretorque_workbench::bus::sim::{DriveTruth, LineFault, SimulatedDrive, TimedFault};
use foretorque_workbench::bus::{BusPlayer, Profile};
use foretorque_workbench::closed_loop::motion_f32;
use foretorque_workbench::dynamics::Joints;
use foretorque_workbench::metrics::MOVING_RAD_S;
use foretorque_workbench::plant::{Events, Payload, PlantConfig};
use foretorque_workbench::robot::Robot;

const RATE_HZ: f64 = 500.0;

/// Plays a path on such an arm while the loop learns; calls `seen` after every tick with the time, s, and the torque.
fn play_on(
    plant: PlantConfig,
    events: Events<6>,
    set: Set,
    duration_s: f64,
    seen: impl FnMut(&Player, f64, &Joints<6>),
) -> Player {
    let (profile, path) = (profile(RATE_HZ), path(duration_s));
    let config = profile.config::<Ur5, 6, 40>().expect("it fits the arm");
    let network = network(&profile, &path, plant, events);
    let parameters = Parameters {
        set,
        ..Parameters::nominal::<Ur5>()
    };
    let mut player = BusPlayer::new(config, &parameters, network).expect("it fits the arm");
    play(&mut player, (&profile, &path), true, seen);
    player
}

/// Parameters that are learnt over the bus, on an arm that does not change.
fn learnt() -> Set {
    let still = PlantConfig {
        viscous_drift: 0.0,
        ..PlantConfig::default()
    };
    let player = play_on(still, Events::default(), described(), 40.0, |_, _, _| {});
    player.controller.feed_forward().in_force()
}

#[test]
fn learnt_torque_follows_friction_that_drifts_by_a_third() {
    let set = learnt();
    let limits = Robot::load("ur5").expect("built in").joints;
    let plant = PlantConfig {
        viscous_drift: 0.3 / 60.0,
        ..PlantConfig::default()
    };
    let (profile, path) = (profile(RATE_HZ), path(60.0));
    let mut squares = [0.0; 2];
    let none = Events::default();
    play_on(plant, none, set, 60.0, |player, t_s, acting| {
        let desired = path.at(t_s + profile.lead_s());
        let needed = player.network.plant.true_torque(&desired);
        let frozen = evaluate::<Ur5, 6, 40>(&set, &motion_f32(&desired)).total;
        for j in (0..6).filter(|&j| desired.qd[j].abs() > MOVING_RAD_S) {
            let torques = [acting[j], f64::from(frozen[j])];
            for (sum, torque) in squares.iter_mut().zip(torques) {
                *sum += ((torque - needed[j]) / limits[j].limits.torque).powi(2);
            }
        }
    });
    let ratio = (squares[0] / squares[1]).sqrt();
    println!("learnt over frozen while friction drifts: {ratio:.3}");
    assert!(ratio <= 0.8, "{ratio}");
}

#[test]
fn a_payload_is_weighed_within_a_tenth_and_let_go() {
    let set = learnt();
    let rated = f64::from(rated_payload::<Ur5, 6, 40>());
    for share in [0.15, 0.6] {
        let mass = share * rated;
        let (mut weighed, mut path_begins_s) = (Vec::new(), 0.0);
        // Times of events are those of the plant, which waits on its brakes and approaches first.
        let held = [(14.0, 20.0), (26.0, 32.0)];
        let events = Events {
            payloads: held
                .map(|(from_s, to_s)| Payload::cube(mass, [0.02, -0.01, 0.05], from_s, to_s))
                .to_vec(),
            ..Events::default()
        };
        let plant = PlantConfig::default();
        let player = play_on(plant, events, set, 38.0, |player, t_s, _| {
            let plant_s = player.network.plant.t_s();
            path_begins_s = plant_s - t_s;
            let next = held.get(weighed.len());
            if next.is_some_and(|(_, to_s)| plant_s >= to_s - 1.0) {
                let quality = player.learner.state().report.quality;
                weighed.push(f64::from(quality.payload.mass));
            }
        });
        println!("{mass:.3} kg: {weighed:.3?}, path from {path_begins_s:.2} s");
        assert_eq!(weighed.len(), held.len());
        for found in weighed {
            assert!((found / mass - 1.0).abs() <= 0.1, "{found} kg of {mass} kg");
        }
        let left = player.learner.state().report.quality.payload.mass;
        assert!(left == 0.0, "{left} kg are left");
    }
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
    let over = |protocol: &dyn Fn(Ranges) -> Protocol| spoken(&profile, protocol);
    let moteus = |resolution| {
        let moteus = Moteus {
            kp: 1000.0,
            kd: 40.0,
            watchdog_s: 0.05,
            resolution,
        };
        over(&|_| Protocol::Moteus(moteus))
    };
    let odrive = |torque_scale, polled| {
        let odrive = Odrive {
            mode: ControlMode::Position,
            velocity_scale: 1000.0,
            torque_scale,
            torque_scale_endpoint: 5,
            polled,
        };
        over(&|_| Protocol::Odrive(odrive))
    };
    let cia402 = |rated_torque| {
        let cia402 = Cia402 {
            mode: ControlMode::Position,
            counts_per_turn: 1_048_576.0,
            rated_torque,
        };
        over(&|_| Protocol::Cia402(cia402))
    };
    let limited = |ranges: Ranges| Ranges {
        torque: 0.3 * ranges.torque,
        ..ranges
    };
    let weak_gear = over(&|ranges| Protocol::CyberGear(limited(ranges)));
    let weak_stride = over(&|ranges| Protocol::RobStride(limited(ranges)));
    vec![
        ("cyber-gear", over(&Protocol::CyberGear), Some(weak_gear)),
        ("robstride", over(&Protocol::RobStride), Some(weak_stride)),
        ("moteus int32", moteus(Resolution::Int32), None),
        ("moteus f32", moteus(Resolution::F32), None),
        ("odrive", odrive(1000.0, false), Some(odrive(100.0, false))),
        ("polled odrive", odrive(1000.0, true), None),
        ("cia402", cia402(20.0), Some(cia402(2.0))),
    ]
}

#[test]
fn every_family_of_drives_is_driven_and_a_fault_or_another_scale_ends_the_torque() {
    let path = path(4.0);
    for (name, profile, other) in families() {
        let tracking = |forward| tracking_mrad(&profile, forward, 10.0);
        tracks_better(name, 1.5, tracking);
        // The first torque of a drive that is switched on holds the arm where it stands.
        let mut arming = player(&profile, &path, true);
        let before = *arming.network.plant.q();
        arming.arm().expect("it arms");
        let moved = (arming.network.plant.q() - before).amax();
        assert!(moved < 0.01, "{name}: {moved} rad");
        let dead = "torque off: joint 5: the drive does not answer";
        let reports = "torque off: joint 2: the drive reports fault 0x8";
        for (fault, message) in [
            (LineFault::Dead(4), dead),
            (LineFault::DriveFault(1, 0x8), reports),
        ] {
            let mut faulty = player(&profile, &path, true);
            faulty.arm().expect("it arms");
            let t_s = faulty.network.t_s();
            faulty.network.fault = TimedFault::new(fault, t_s + 0.1..1e9);
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
                    ..drive.truth
                });
            }
            let refused = wrong.arm().expect_err("the scales differ").to_string();
            assert!(refused.contains("scale of torque"), "{name}: {refused}");
            assert!(wrong.network.all_off(), "{name}");
        }
    }
}
