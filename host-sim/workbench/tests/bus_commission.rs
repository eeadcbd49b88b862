//! Commissioning of a simulated arm, as it is described and with planted mistakes; shipped profiles.

use crate::bus_loop::profile;
use foretorque::arm::Arm;
use foretorque::arm::ur5::Ur5;
use foretorque_link::bank::Parameters;
use foretorque_link::drives::{Protocol, Ranges};
use foretorque_workbench::board::Described;
use foretorque_workbench::bus::sim::{
    DriveTruth, LineFault, SimulatedDrive, SimulatedNetwork, TimedFault, plant_config,
};
use foretorque_workbench::bus::{BusError, BusPlayer, Commissioning, Profile, Step};
use foretorque_workbench::dynamics::{Joints, ReferenceModel};
use foretorque_workbench::plant::{Payload, Plant, PlantConfig};
use foretorque_workbench::robot::{Link, Robot};
use std::f64::consts::FRAC_PI_2;
use std::path::Path;

type Arm6 = Commissioning<Ur5, SimulatedNetwork<6>, 6, 40>;

/// Changes the drives that the profile describes.
type Plant6 = fn(&mut [DriveTruth; 6]);

fn arm(plant_mistake: Plant6) -> Arm6 {
    let robot = Robot::load("ur5").expect("built in");
    arm_of(&robot, &profile(1000.0), 1, plant_mistake)
}

/// Arm around which drives of `profile` run, whose masses differ from those of `robot` by `seed`.
fn arm_of<A: Arm<6, 40>>(
    robot: &Robot,
    profile: &Profile,
    seed: u64,
    plant_mistake: impl Fn(&mut [DriveTruth; 6]),
) -> Commissioning<A, SimulatedNetwork<6>, 6, 40> {
    let truth = robot.perturbed(seed);
    let rest = Joints::from_row_slice(&profile.rest_rad);
    let mut plant =
        Plant::<6>::new(&truth, plant_config(PlantConfig::default()), seed).expect("six joints");
    plant.place(&rest);
    let config = profile.config::<A, 6, 40>().expect("it fits the arm");
    let noise = Joints::repeat(0.1);
    let mut network = SimulatedNetwork::new(plant, &config, profile.bus[0], &noise, seed);
    let mut truths: [DriveTruth; 6] = std::array::from_fn(|j| network.drives[j].truth);
    plant_mistake(&mut truths);
    network.drives = truths.map(SimulatedDrive::new);
    let parameters = Parameters::nominal::<A>();
    let player = BusPlayer::new(config, &parameters, network).expect("it fits the arm");
    let model = ReferenceModel::new(robot).expect("six joints");
    let mut arm = Commissioning::new(player, model, rest);
    arm.friction_nm = Joints::from_fn(|joint, _| robot.joints[joint].friction.coulomb);
    arm
}

fn ranges(truth: &mut DriveTruth) -> &mut Ranges {
    match &mut truth.profile.protocol {
        Protocol::Damiao(ranges) => ranges,
        other => panic!("{other:?}"),
    }
}

/// Runs every step; the message of the first mistake, and the largest torque over the joint's limit.
fn commissioned(arm: &mut Arm6) -> (Option<String>, f64) {
    // No torque exceeds a tenth of its limit in the first four.
    let steps = Step::ALL.into_iter().take(4);
    let failed = steps.map(|step| arm.step(step)).find_map(Result::err);
    let failed = failed.map(|error| error.to_string());
    let shares = arm.player.network.peak_nm.iter().zip(Ur5::LIMITS);
    let shares = shares.map(|(peak, limits)| peak / f64::from(limits.torque));
    (failed, shares.fold(0.0, f64::max))
}

#[test]
fn an_arm_as_described_passes_below_a_tenth_of_its_torque() {
    let mut arm = arm(|_| ());
    let (failed, share) = commissioned(&mut arm);
    println!("{failed:?} {share} {:#?}", arm.found);
    assert_eq!(failed, None);
    assert!(share <= 0.1, "{share} of the limit");
    for found in &arm.found {
        assert!((found.turn_ratio.expect("turned") - 1.0).abs() < 0.01);
        assert!(found.zero_error_rad.expect("seen").abs() < 0.01);
        let ratio = found.torque_ratio.expect("pushed");
        assert!((0.6..1.6).contains(&ratio), "{found:?}");
    }
    assert!(arm.player.network.all_off());
    arm.step(Step::Turn).expect("a step may be repeated");
    arm.step(Step::Friction).expect("the loop runs");
    // Coulomb and viscous friction of the simulated arm at 0.15 rad/s: within a factor of the described.
    let robot = Robot::load("ur5").expect("built in");
    for (found, joint) in arm.found.iter().zip(&robot.joints) {
        let described = joint.friction.coulomb + 0.15 * joint.friction.viscous;
        let share = found.friction_nm.expect("swept") / described;
        assert!((0.6..1.8).contains(&share), "{share} of {described} N·m");
    }
    let sent = arm.found;
    arm.step(Step::Weight).expect("nothing to weigh");
    assert_eq!(arm.found, sent);
    arm.weight = Some(weight());
    arm.step(Step::Weight).expect("the gains are right");
    println!("{:#?}", arm.found.map(|found| found.gain));
    for (joint, found) in arm.found.iter().enumerate() {
        // Gravity has no lever about a vertical axis, and next to none about the last two.
        assert!(joint > 3 || found.gain.is_some() == (joint > 0), "{joint}");
        if let Some((gain, deviation)) = found.gain {
            assert!((gain - 1.0).abs() < 3.0 * deviation + 0.01, "{found:?}");
        }
    }
    assert!(arm.player.network.all_off());
}

#[test]
fn an_interrupt_of_the_parking_switches_every_drive_off_all_the_same() {
    for at_s in [0.002, 0.3, 0.9] {
        let mut player = arm(|_| ()).player;
        player.arm().expect("sound drives");
        let from_s = player.network.t_s() + at_s;
        player.network.fault = TimedFault::new(LineFault::Interrupt, from_s..1e9);
        let ended = player.park().expect_err("interrupted");
        assert!(matches!(ended, BusError::Interrupted(_)), "{ended}");
        assert!(player.network.all_off(), "{at_s} s");
    }
}

/// Drives that fall silent before and in the push of joint 3, the pushed one among them, while two others hold their pose.
#[test]
fn no_joint_is_pushed_or_held_without_replies() {
    for (fault, joint) in [
        (LineFault::Dead(5), 6),
        (LineFault::LostReplies(2, 1.0), 3),
        (LineFault::LostReplies(0, 1.0), 1),
    ] {
        let mut arm = arm(|_| ());
        arm.step(Step::Find).expect("sound drives");
        // Joints 1 and 2 take about two seconds.
        let now_s = arm.player.network.t_s();
        arm.player.network.fault = TimedFault::new(fault, now_s + 1.7..1e9);
        let failed = arm.step(Step::Torque).err().map(|error| error.to_string());
        let wanted = format!("torque off: joint {joint}: the drive does not answer");
        let dead = matches!(fault, LineFault::Dead(_));
        assert!(dead || failed.as_deref() == Some(&wanted), "{failed:?}");
        let limits = Ur5::LIMITS.map(|limits| 0.1 * f64::from(limits.torque));
        for (peak, limit) in arm.player.network.peak_nm.iter().zip(limits) {
            assert!(*peak <= limit, "{peak} of {limit}");
        }
        assert!(arm.step(Step::Zero).is_err(), "{fault:?}");
    }
}

/// 2 kg, 5 cm aside of the flange.
fn weight() -> Link {
    Payload::cube(2.0, [0.05, 0.0, 0.05], 0.0, 0.0).body
}

#[test]
fn a_known_weight_finds_a_gain_that_the_described_masses_do_not_show() {
    for (joint, gain) in [(1, 1.4), (2, 0.7), (3, 1.3)] {
        let mut arm = arm(|_| ());
        let truth = arm.player.network.drives[joint].truth;
        arm.player.network.drives[joint] = SimulatedDrive::new(DriveTruth { gain, ..truth });
        let (failed, _) = commissioned(&mut arm);
        assert_eq!(failed, None);
        arm.weight = Some(weight());
        let failed = arm.step(Step::Weight).expect_err("a wrong gain");
        let failed = failed.to_string();
        println!("{failed}");
        let expected = format!("joint {}: gain of torque: 2 kg are ", joint + 1);
        assert!(failed.starts_with(&expected), "{failed}");
        let (found, _) = arm.found[joint].gain.expect("it is measured");
        assert!((found / gain - 1.0).abs() < 0.1, "{found} for {gain}");
    }
}

#[test]
fn every_planted_mistake_is_named_before_a_tenth_of_the_torque() {
    const TORQUE: &str =
        "torque off: joint 3: scale of torque is 54 in the profile, 28 in the drive";
    const POSITION: &str =
        "torque off: joint 5: range of position is 20 in the profile, 12.5 in the drive";
    const VELOCITY: &str =
        "torque off: joint 1: range of velocity is 45 in the profile, 20 in the drive";
    const ID: &str = "joint 5: no drive answers at id 5 on bus 1; ids that answer: 1 on bus 0, 2 on bus 0, 3 on bus 0";
    const BUS: &str = "joint 1: no drive answers at id 1 on bus 0; ids that answer: ";
    let cases: [(Plant6, &str); 16] = [
        // Mounted the other way round; phases swapped.
        (|d| d[1].profile.sign = 1.0, "joint 2: sign -1: "),
        (|d| d[2].gain = -1.0, "joint 3: torque sign: "),
        // Ten times, a tenth and three times the torque.
        (|d| d[0].gain = 10.0, "joint 1: scale of torque: "),
        (|d| d[3].gain = 0.1, "joint 4: scale of torque: no motion"),
        (|d| d[4].gain = 3.0, "joint 5: scale of torque: "),
        // T_MAX, P_MAX and V_MAX of the drive.
        (|d| ranges(&mut d[2]).torque = 28.0, TORQUE),
        (|d| ranges(&mut d[4]).position = 12.5, POSITION),
        (|d| ranges(&mut d[0]).velocity = 20.0, VELOCITY),
        (
            |d| {
                let [one, other] = [d[1].profile, d[2].profile];
                (d[1].profile, d[2].profile) = (other, one);
                (d[1].profile.sign, d[2].profile.sign) = (one.sign, other.sign);
            },
            "joint 2: id 2 is not its drive: turning it moves the position of joint 3",
        ),
        (|d| d[0].profile.gear = 9.0, "joint 1: gear 6: "),
        (|d| d[5].profile.gear = 1.0, "joint 6: gear 3: "),
        (|d| d[3].profile.zero = 0.4, "joint 4: zero 0: "),
        (|d| d[4].profile.id = 9, ID),
        (|d| d[0].bus = 1, BUS),
        (
            |d| (d[5].profile.id, d[5].profile.host_id) = (5, d[4].profile.host_id),
            "joint 5: two drives answer at id 5",
        ),
        // A frozen encoder.
        (|d| d[2].profile.gear = 1e-3, "joint 3: "),
    ];
    for (plant_mistake, message) in cases {
        let mut arm = arm(plant_mistake);
        let (failed, share) = commissioned(&mut arm);
        let failed = failed.unwrap_or_else(|| panic!("{message}: nothing is named"));
        assert!(failed.starts_with(message), "{message}: {failed}");
        assert!(share <= 0.1, "{message}: {share} of the limit");
        let off = arm.player.network.all_off() || failed.contains("torque");
        assert!(off, "{message}");
    }
}

/// A UR5 with viscous friction, a UR10e without; the profile of the first with the torque of the second.
fn arms() -> [(Robot, Profile); 2] {
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../robots/ur10e.toml");
    ["ur5", file].map(|name| {
        let (robot, mut profile) = (Robot::load(name).expect(name), profile(1000.0));
        for (entry, joint) in profile.joint.iter_mut().zip(&robot.joints) {
            let limit = joint.limits.torque as f32;
            entry.drive.torque_limit = limit;
            let gear = entry.drive.gear;
            if let Protocol::Damiao(ranges) = &mut entry.drive.protocol {
                ranges.torque = 1.01 * limit / gear;
            }
        }
        (robot, profile)
    })
}

/// Runs the step of torque at a Coulomb friction of `share` of the limits: the message of the mistake, and the ratios.
fn pushed(
    (robot, profile): &(Robot, Profile),
    (share, seed): (f64, u64),
    plant_mistake: impl Fn(&mut [DriveTruth; 6]),
) -> (Option<String>, [Option<f64>; 6]) {
    let mut robot = robot.clone();
    for joint in &mut robot.joints {
        joint.friction.coulomb = share * joint.limits.torque;
    }
    Described::<6, 40>::read(&robot).expect("six joints");
    let mut arm = arm_of::<Described<6, 40>>(&robot, profile, seed, plant_mistake);
    let failed = arm.step(Step::Torque).err().map(|error| error.to_string());
    let peaks = arm.player.network.peak_nm.iter().zip(&robot.joints);
    for (peak, joint) in peaks {
        let share = peak / joint.limits.torque;
        assert!(share <= 0.1, "{} at {share} of its limit", joint.name);
    }
    assert!(arm.player.network.all_off());
    (failed, arm.found.map(|found| found.torque_ratio))
}

#[test]
fn sound_drives_pass_at_any_friction_and_wrong_ones_at_none() {
    for arm in &arms() {
        let name = &arm.0.name;
        for (case, share) in (1..).zip([0.0, 0.06]) {
            let (failed, ratios) = pushed(arm, (share, case), |_| ());
            assert_eq!(failed, None, "{name}, {share}");
            let right = |ratio: &Option<f64>| ratio.is_some_and(|r| (r - 1.0).abs() < 0.25);
            assert!(ratios.iter().all(right), "{name}, {share}: {ratios:?}");
        }
        for (joint, gain, share) in [(1, -1.0, 0.0), (4, 0.5, 0.0), (2, 2.0, 0.03)] {
            let (failed, _) = pushed(arm, (share, 1), |drives| drives[joint].gain = gain);
            let word = match gain < 0.0 {
                true => "torque sign",
                false => "scale of torque",
            };
            let message = format!("joint {}: {word}: of ", joint + 1);
            let named = failed
                .as_ref()
                .is_some_and(|failed| failed.starts_with(&message));
            assert!(named, "{name}, {gain}, {share}: {failed:?}");
        }
        // A joint that is held by more than it is pushed has no ratio, and that is no mistake.
        assert_eq!(pushed(arm, (0.15, 1), |_| ()), (None, [None; 6]), "{name}");
    }
}

/// Pose of the UR5 that stands straight up: no torque of gravity, and no rest either.
const UPRIGHT: [f64; 6] = [0.0, -FRAC_PI_2, 0.0, -FRAC_PI_2, 0.0, 0.0];

#[test]
fn joints_that_give_way_end_a_push_and_are_held_by_no_more_than_a_tenth() {
    for (robot, mut profile) in arms() {
        profile.rest_rad = UPRIGHT.to_vec();
        let arm = (robot, profile);
        for (seed, share) in [(1, 0.0), (2, 0.01), (4, 0.03)] {
            let (failed, ratios) = pushed(&arm, (share, seed), |_| ());
            assert_eq!(failed, None, "{}, {seed}, {share}", arm.0.name);
            // Its axis is vertical: it does not fall.
            assert!(ratios[0].is_some(), "{ratios:?}");
        }
    }
}

#[test]
fn an_interrupt_in_any_step_switches_every_drive_off() {
    for step in [Step::Torque, Step::Friction] {
        for at_s in [0.02, 0.15, 0.3, 0.7] {
            let mut arm = arm(|_| ());
            arm.player.network.fault = TimedFault::new(LineFault::Interrupt, at_s..1e9);
            let outcome = arm.step(step);
            let interrupted = matches!(outcome, Err(BusError::Interrupted(_)));
            assert!(interrupted, "{step:?}, {at_s} s: {outcome:?}");
            assert!(arm.player.network.all_off(), "{step:?}, {at_s} s");
        }
    }
}

#[test]
fn a_drive_with_a_fault_is_named() {
    let mut faulty = arm(|_| ());
    faulty.player.network.fault = TimedFault::new(LineFault::DriveFault(1, 9), 0.0..1e9);
    let (failed, _) = commissioned(&mut faulty);
    let named = "torque off: joint 2: the drive reports fault 0x9";
    assert_eq!(failed.as_deref(), Some(named));
    assert!(faulty.player.network.all_off());
}

#[test]
fn shipped_profiles_are_sound() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../profiles");
    let mut names = Vec::new();
    for entry in folder.read_dir().unwrap() {
        let path = entry.unwrap().path();
        let profile = Profile::load(&path).unwrap();
        let name = path.file_stem().unwrap().display().to_string();
        for (place, joint) in profile.joint.iter().enumerate() {
            assert_eq!(joint.drive.check(), Ok(()), "{name}, joint {}", place + 1);
            let joints = profile.joint.iter();
            let same = joints.filter(|o| (o.bus, o.drive.id) == (joint.bus, joint.drive.id));
            assert_eq!(same.count(), 1, "{name}");
        }
        names.push(name);
    }
    for name in ["openarm", "yam", "piper-class", "moteus", "odrive"] {
        assert!(names.iter().any(|shipped| shipped == name), "{name}");
    }
}
