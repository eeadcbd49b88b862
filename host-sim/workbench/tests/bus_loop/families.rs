//! Every family of drives in the loop.

use super::{path, player, profile, tracking_mrad};
use foretorque_link::drives::{Cia402, ControlMode, Moteus, Odrive, Protocol, Ranges, Resolution};
use foretorque_workbench::bus::Profile;
use foretorque_workbench::bus::sim::{DriveTruth, LineFault, SimulatedDrive, TimedFault};

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
    let path = path(4.0);
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
                    ..*drive.truth()
                });
            }
            let refused = wrong.arm().expect_err("the scales differ").to_string();
            assert!(refused.contains("scale of torque"), "{name}: {refused}");
            assert!(wrong.network.all_off(), "{name}");
        }
    }
}
