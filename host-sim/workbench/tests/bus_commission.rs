//! Commissioning of a simulated arm, as it is described and with planted mistakes.

use foretorque::arm::Arm;
use foretorque::arm::ur5::Ur5;
use foretorque::learning::ParameterSet;
use foretorque_link::drives::{DriveState, Frame, Protocol, Ranges};
use foretorque_workbench::bus::sim::{
    DriveTruth, LineFault, SimulatedDrive, SimulatedNetwork, TimedFault, plant_config,
};
use foretorque_workbench::bus::{Ask, BusError, BusPlayer, Commissioning, Network, Profile, Step};
use foretorque_workbench::dynamics::{Joints, ReferenceModel};
use foretorque_workbench::plant::{Payload, Plant, PlantConfig};
use foretorque_workbench::robot::{Link, Perturbation, Robot};
use std::f64::consts::FRAC_PI_2;
use std::path::Path;
use std::time::Duration;

type Arm6 = Commissioning<Ur5, SimulatedNetwork<6>, 6, 40>;

/// Changes the drives that the profile describes.
type Plant6 = fn(&mut [DriveTruth; 6]);

fn arm(plant_mistake: Plant6) -> Arm6 {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../profiles/sim-ur5.toml");
    let profile = Profile::load(&file).expect("it is a profile");
    let robot = Robot::load("ur5").expect("built in");
    let truth = robot.perturbed(1, &Perturbation::PLANT);
    let rest = Joints::from_row_slice(&profile.rest_rad);
    let mut plant =
        Plant::<6>::new(&truth, plant_config(PlantConfig::default()), 1).expect("six joints");
    plant.place(&rest);
    let config = profile.config::<Ur5, 6, 40>().expect("it fits the arm");
    let mut network =
        SimulatedNetwork::new(plant, &config, profile.bus[0], &Joints::repeat(0.1), 1);
    let mut truths: [DriveTruth; 6] = std::array::from_fn(|j| *network.drives[j].truth());
    plant_mistake(&mut truths);
    network.drives = truths.map(SimulatedDrive::new);
    let set = ParameterSet::nominal::<Ur5>(1);
    let player = BusPlayer::new(config, set, network).expect("it fits the arm");
    let model = ReferenceModel::new(&robot).expect("six joints");
    Commissioning::new(player, model, rest)
}

fn ranges(truth: &mut DriveTruth) -> &mut Ranges {
    match &mut truth.profile.protocol {
        Protocol::Damiao(ranges) => ranges,
        other => panic!("{other:?}"),
    }
}

/// Runs every step; the message of the first mistake, and the largest torque over the joint's limit.
fn commissioned(arm: &mut Arm6) -> (Option<String>, f64) {
    let steps = Step::ALL.into_iter().take(Step::BELOW_A_TENTH);
    let failed = steps.map(|step| arm.step(step)).find_map(Result::err);
    let shares = arm.player.network.peak_nm.iter().zip(Ur5::LIMITS);
    let share = shares.map(|(peak, limits)| peak / f64::from(limits.torque));
    (
        failed.map(|error| error.to_string()),
        share.fold(0.0, f64::max),
    )
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
        assert!(
            (0.6..1.6).contains(&found.torque_ratio.expect("pushed")),
            "{found:?}"
        );
    }
    assert!(arm.player.network.all_off());
    arm.step(Step::Turn).expect("a step may be repeated");
    arm.step(Step::Friction).expect("the loop runs");
    // Coulomb and viscous friction of the simulated arm at 0.15 rad/s: within a factor of the described.
    for (found, joint) in arm
        .found
        .iter()
        .zip(Robot::load("ur5").expect("built in").joints)
    {
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

/// 2 kg, 5 cm aside of the flange.
fn weight() -> Link {
    Payload::cube(2.0, [0.05, 0.0, 0.05], 0.0, 0.0).body
}

#[test]
fn a_known_weight_finds_a_gain_that_the_described_masses_do_not_show() {
    for (joint, gain) in [(1, 1.4), (2, 0.7), (3, 1.3)] {
        let mut arm = arm(|_| ());
        let truth = *arm.player.network.drives[joint].truth();
        arm.player.network.drives[joint] = SimulatedDrive::new(DriveTruth { gain, ..truth });
        let (failed, _) = commissioned(&mut arm);
        assert_eq!(failed, None);
        arm.weight = Some(weight());
        let failed = arm
            .step(Step::Weight)
            .expect_err("a wrong gain")
            .to_string();
        println!("{failed}");
        let expected = format!("joint {}: gain of torque: 2 kg are ", joint + 1);
        assert!(failed.starts_with(&expected), "{failed}");
        let (found, _) = arm.found[joint].gain.expect("it is measured");
        assert!((found / gain - 1.0).abs() < 0.1, "{found} for {gain}");
    }
}

#[test]
fn every_planted_mistake_is_named_before_a_tenth_of_the_torque() {
    let cases: [(&str, Plant6, &str); 16] = [
        (
            "mounted the other way round",
            |d| d[1].profile.sign = 1.0,
            "joint 2: sign -1: ",
        ),
        (
            "phases swapped",
            |d| d[2].gain = -1.0,
            "joint 3: torque sign: ",
        ),
        (
            "ten times the torque",
            |d| d[0].gain = 10.0,
            "joint 1: scale of torque: ",
        ),
        (
            "a tenth of the torque",
            |d| d[3].gain = 0.1,
            "joint 4: scale of torque: no motion",
        ),
        (
            "three times the torque",
            |d| d[4].gain = 3.0,
            "joint 5: scale of torque: ",
        ),
        (
            "other T_MAX",
            |d| ranges(&mut d[2]).torque = 28.0,
            "torque off: joint 3: scale of torque is 54 in the profile, 28 in the drive",
        ),
        (
            "other P_MAX",
            |d| ranges(&mut d[4]).position = 12.5,
            "torque off: joint 5: range of position is 20 in the profile, 12.5 in the drive",
        ),
        (
            "other V_MAX",
            |d| ranges(&mut d[0]).velocity = 20.0,
            "torque off: joint 1: range of velocity is 45 in the profile, 20 in the drive",
        ),
        (
            "swapped ids",
            |d| {
                let (one, other) = (d[1].profile, d[2].profile);
                d[1].profile = foretorque_link::drives::DriveProfile {
                    sign: one.sign,
                    ..other
                };
                d[2].profile = foretorque_link::drives::DriveProfile {
                    sign: other.sign,
                    ..one
                };
            },
            "joint 2: id 2 is not its drive: turning it moves the position of joint 3",
        ),
        (
            "other gear",
            |d| d[0].profile.gear = 9.0,
            "joint 1: gear 6: ",
        ),
        ("no gear", |d| d[5].profile.gear = 1.0, "joint 6: gear 3: "),
        (
            "other zero",
            |d| d[3].profile.zero = 0.4,
            "joint 4: zero 0: ",
        ),
        (
            "another id",
            |d| d[4].profile.id = 9,
            "joint 5: no drive answers at id 5 on bus 1; ids that answer: 1 on bus 0, 2 on bus 0, 3 on bus 0",
        ),
        (
            "the other bus",
            |d| d[0].bus = 1,
            "joint 1: no drive answers at id 1 on bus 0; ids that answer: ",
        ),
        (
            "one id twice",
            |d| {
                d[5].profile.id = 5;
                d[5].profile.host_id = d[4].profile.host_id;
            },
            "joint 5: two drives answer at id 5",
        ),
        (
            "a frozen encoder",
            |d| d[2].profile.gear = 1e-3,
            "joint 3: ",
        ),
    ];
    let mut named = 0;
    for (what, plant_mistake, message) in cases {
        let mut arm = arm(plant_mistake);
        let (failed, share) = commissioned(&mut arm);
        let failed = failed.unwrap_or_else(|| panic!("{what}: nothing is named"));
        assert!(failed.starts_with(message), "{what}: {failed}");
        assert!(share <= 0.1, "{what}: {share} of the limit");
        assert!(
            arm.player.network.all_off() || failed.contains("torque"),
            "{what}"
        );
        named += 1;
    }
    assert_eq!(named, 16);
}

/// The simulated arm of a user who interrupts in a period.
struct Interrupted {
    inner: SimulatedNetwork<6>,
    left: u32,
}

impl Network for Interrupted {
    fn name(&self) -> String {
        self.inner.name()
    }

    fn send(&mut self, bus: u8, frame: &Frame) -> Result<(), BusError> {
        self.inner.send(bus, frame)
    }

    fn receive(&mut self) -> Result<Option<(u8, Frame)>, BusError> {
        match self.left {
            1 => {
                self.left = 0;
                Err(BusError::Interrupted(1))
            }
            _ => self.inner.receive(),
        }
    }

    fn wait(&mut self) -> Duration {
        self.left = self.left.saturating_sub(u32::from(self.left > 1));
        self.inner.wait()
    }

    fn ask(&mut self, ask: &Ask) -> Result<(), BusError> {
        self.inner.ask(ask)
    }
}

#[test]
fn an_interrupt_in_any_step_switches_every_drive_off() {
    let parts = |left| {
        let arm = arm(|_| ());
        let set = ParameterSet::nominal::<Ur5>(1);
        let config = *arm.player.controller.config();
        let inner = arm.player.network;
        let player = BusPlayer::new(config, set, Interrupted { inner, left });
        let robot = Robot::load("ur5").expect("built in");
        let model = ReferenceModel::new(&robot).expect("six joints");
        let rest = Joints::from_row_slice(&[0.0, FRAC_PI_2, 0.0, -FRAC_PI_2, 0.0, 0.0]);
        Commissioning::<Ur5, _, 6, 40>::new(player.expect("it fits the arm"), model, rest)
    };
    for step in [Step::Torque, Step::Friction] {
        for left in [20, 150, 300, 700] {
            let mut arm = parts(left);
            let outcome = arm.step(step);
            assert!(
                matches!(outcome, Err(BusError::Interrupted(_))),
                "{step:?}, {left}: {outcome:?}"
            );
            assert!(arm.player.network.inner.all_off(), "{step:?}, {left}");
        }
    }
}

#[test]
fn a_missing_drive_and_one_with_a_fault_are_named() {
    let mut missing = arm(|_| ());
    missing.player.network.fault = TimedFault::new(LineFault::Dead(3), 0.0..1e9);
    let (failed, _) = commissioned(&mut missing);
    let failed = failed.expect("it is missing");
    assert!(
        failed.starts_with("joint 4: no drive answers at id 4 on bus 1; ids that answer: "),
        "{failed}"
    );
    let mut faulty = arm(|_| ());
    faulty.player.network.fault = TimedFault::new(LineFault::DriveFault(1, 9), 0.0..1e9);
    let (failed, _) = commissioned(&mut faulty);
    assert_eq!(
        failed.as_deref(),
        Some("torque off: joint 2: the drive reports fault 0x9")
    );
    assert!(
        faulty
            .player
            .network
            .drives
            .iter()
            .all(|drive| drive.state() != DriveState::Enabled)
    );
}
