//! Arms read at run time give the bits of compiled ones and of emulated boards, for any number of joints; modules of arms
//! agree with the generator and with their descriptions.
//!
//! A test of the studies, because these hold the compiled boards of most numbers of joints already.

use foretorque::arm::panda::Panda;
use foretorque::arm::ur5::Ur5;
use foretorque::arm::{Arm, ArmModel, LinkInertia, base_parameters};
use foretorque::dynamics::{FrictionColumn, regressor, rnea};
use foretorque::feedforward::evaluate;
use foretorque::joint::{JointMeasurement, JointMotion, JointSample, JointVector};
use foretorque::learning::{LearnerConfig, ParameterSet, prior_factor, prior_factor_count};
use foretorque_link::bank::{ColumnKind, NETWORK_SEED, ParameterBank};
use foretorque_workbench::arms;
use foretorque_workbench::board::qemu::{Emulator, Image, QemuOptions};
use foretorque_workbench::board::{BoardError, Client, Described, Native, Transport};
use foretorque_workbench::generate::{arm_hash, arm_module, write_arm_module};
use foretorque_workbench::robot::Robot;
use std::path::Path;
use std::time::Duration;

use crate::arms::{oblique::Oblique, ur5_calibrated::Ur5Calibrated};
use crate::{description, each_arm, native};

/// Longest time to an answer of the emulator on a busy machine.
const TIMEOUT: Duration = Duration::from_secs(5);

fn motion<const N: usize>(t: f32, middle: &[(f32, f32); N]) -> JointMotion<N> {
    let phase = |joint: usize| t + joint as f32;
    JointMotion {
        q: JointVector::from_fn(|j, _| 0.5 * (middle[j].0 + middle[j].1) + 0.4 * phase(j).sin()),
        qd: JointVector::from_fn(|j, _| 0.4 * phase(j).cos()),
        qdd: JointVector::from_fn(|j, _| -0.4 * phase(j).sin()),
    }
}

/// A smooth motion of an arm a tenth heavier than `A` and with friction, measured exactly.
fn sample<A: Arm<N, P>, const N: usize, const P: usize>(tick: u32) -> JointSample<N> {
    let mut truth = ParameterSet::nominal::<A>(NETWORK_SEED);
    truth.rigid *= 1.1;
    for friction in &mut truth.friction {
        friction[FrictionColumn::Viscous] = 0.4;
        friction[FrictionColumn::Coulomb] = 0.2;
    }
    let ranges = A::limits().map(|limits| limits.position);
    let desired = motion(tick as f32 * 1e-3, &ranges);
    let (q, tau) = (desired.q, evaluate::<A, N, P>(&truth, &desired).total);
    let measured = Some(JointMeasurement { q, tau });
    JointSample { desired, measured }
}

#[test]
fn a_motion_beyond_the_range_of_a_sample_is_refused_and_nothing_is_sent() {
    let mut board = native::<Panda, 7, 48>();
    let mut sample = sample::<Panda, 7, 48>(0);
    let tick = board.sample(&sample).unwrap().tick;
    sample.desired.qdd[2] = -70.5;
    let reason = "the desired motion of joint 3 reaches -70.5 rad/s², a sample carries up to 64 rad/s²: lower the limits of \
                  the arm, or slow the path down";
    assert_eq!(board.sample(&sample).unwrap_err().to_string(), reason);
    sample.desired.qdd[2] = 0.0;
    assert_eq!(board.sample(&sample).unwrap().tick, tick + 1);
}

/// Everything that a session answers, compiled and read: torques, flags, and the bank after learning.
fn the_same_session<A: Arm<N, P>, const N: usize, const P: usize>(name: &str) {
    let read: &ArmModel<N, P> = Described::read(&Robot::load(name).unwrap()).unwrap();
    let compiled = A::COMPILED.unwrap();
    assert_eq!((read, read.hash()), (&compiled, A::HASH));
    for t in 0..20 {
        let motion = motion(t as f32, &[(-3.0, 3.0); N]);
        let torques = [
            rnea::<A, N, P>(&compiled.nominal, &motion),
            rnea::<Described<N, P>, N, P>(&read.nominal, &motion),
        ];
        let rows = [
            regressor::<A, N, P>(&motion),
            regressor::<Described<N, P>, N, P>(&motion),
        ];
        assert_eq!(torques[0].map(f32::to_bits), torques[1].map(f32::to_bits));
        assert_eq!(rows[0].map(f32::to_bits), rows[1].map(f32::to_bits));
    }
    let config = LearnerConfig::for_arm::<Described<N, P>>(1e-3);
    assert_eq!(LearnerConfig::for_arm::<A>(1e-3), config);
    for index in 0..prior_factor_count(N) {
        let read = prior_factor::<Described<N, P>, N, P>(index);
        assert_eq!(prior_factor::<A, N, P>(index), read);
    }
    let compiled = native::<A, N, P>();
    let read = native::<Described<N, P>, N, P>();
    assert_eq!(compiled.hello(), read.hello());
    the_same_learning::<A, N, P>([compiled, read], 4000);
}

/// Torques, flags and the bank of two boards of one arm that learn.
fn the_same_learning<A: Arm<N, P>, const N: usize, const P: usize>(
    mut boards: [Client<N>; 2],
    ticks: u32,
) {
    for client in &mut boards {
        client.arm(&sample::<A, N, P>(0)).unwrap();
        client.learning(true).unwrap();
    }
    let adopted = boards[0].read_bank().unwrap();
    for tick in 1..ticks {
        let sample = sample::<A, N, P>(tick);
        let boards = boards.each_mut();
        let replies = boards.map(|board| board.sample(&sample).unwrap());
        assert!(replies[0].total.iter().all(|tau| tau.is_finite()));
        let [a, b] = replies.map(|reply| (reply.flags, reply.total.map(f32::to_bits)));
        assert_eq!(a, b, "tick {tick}");
    }
    let learnt = boards.each_mut().map(|board| board.read_bank().unwrap());
    assert!(learnt[0] == learnt[1], "learnt banks differ");
    assert!(learnt[0] != adopted, "nothing was learnt");
}

#[test]
fn a_ur5_read_at_run_time_has_the_bits_of_the_compiled_one() {
    the_same_session::<Ur5, 6, 40>("ur5");
}

#[test]
fn a_panda_read_at_run_time_has_the_bits_of_the_compiled_one() {
    the_same_session::<Panda, 7, 48>("panda");
}

#[test]
fn emulated_boards_of_seven_and_eight_joints_give_the_bits_of_the_native_ones() {
    for name in ["panda7", "eight"] {
        let mut options = QemuOptions::new(Image::Joint);
        options.elf = Image::Joint.elf_of(name);
        let built = options.elf.with_file_name(format!("{name}.toml"));
        let missing = format!("no images of `{name}`: `cargo xtask test` builds them");
        assert!(built.is_file(), "{missing}");
        let robot = Robot::load(&built.to_string_lossy()).unwrap();
        // Room for no more than the base parameters of the arm: sums of the learner have the order of the image.
        arms!(robot, N, P in (7, 48) (8, 56) => {
            Described::<N, P>::read(&robot).unwrap();
            let native: Box<dyn Transport> = Box::new(Native::<Described<N, P>, N, P>::new().unwrap());
            let emulated: Box<dyn Transport> = Box::new(Emulator::start(&options).unwrap());
            let boards = [native, emulated]
                .map(|board| Client::connect::<Described<N, P>, P>(board, TIMEOUT).unwrap());
            the_same_learning::<Described<N, P>, N, P>(boards, 600);
        }, else unreachable!());
    }
}

#[test]
fn arms_of_one_to_eight_joints_run_and_learn() {
    let panda = Robot::load("panda").unwrap();
    for count in 1..=8 {
        let mut robot = panda.clone();
        robot.name = format!("arm_of_{count}");
        // Gravity along no axis, so that the first link has most base parameters.
        robot.gravity = nalgebra::Vector3::new(3.0, 4.0, -8.0);
        robot.joints.push(panda.joints[4].clone());
        robot.joints.truncate(count);
        arms!(robot, N, P => {
            let arm = Described::<N, P>::read(&robot).expect("room for all base parameters");
            assert!(arm.index.count + 5 > P, "{} of {P}", arm.index.count);
            let mut client = native::<Described<N, P>, N, P>();
            client.upload_bank(&ParameterBank::nominal::<Described<N, P>, N, P>()).unwrap();
            client.arm(&sample::<Described<N, P>, N, P>(0)).unwrap();
            client.learning(true).unwrap();
            for tick in 1..200 {
                let reply = client.sample(&sample::<Described<N, P>, N, P>(tick)).unwrap();
                assert!(reply.total.iter().all(|tau| tau.is_finite()), "{count} joints");
            }
        }, else unreachable!());
    }
}

/// A joint has no new measurement in most of its turns.
#[test]
fn arms_of_few_joints_learn_with_a_sensor_slower_than_the_tick() {
    let panda = Robot::load("panda").unwrap();
    for count in 1..=4 {
        let mut robot = panda.clone();
        robot.name = format!("slow_arm_of_{count}");
        robot.joints.truncate(count);
        arms!(robot, N, P => {
            Described::<N, P>::read(&robot).unwrap();
            for phase in 0..4 {
                let mut client = native::<Described<N, P>, N, P>();
                client.arm(&sample::<Described<N, P>, N, P>(0)).unwrap();
                client.learning(true).unwrap();
                let loaded = client.read_bank().unwrap();
                for tick in 1..6000 {
                    let mut now = sample::<Described<N, P>, N, P>(tick);
                    let before = tick.saturating_sub((tick + phase) % 4);
                    now.measured = sample::<Described<N, P>, N, P>(before).measured;
                    client.sample(&now).unwrap();
                }
                assert!(client.read_bank().unwrap() != loaded, "{count} joints, {phase}");
            }
        }, else unreachable!());
    }
}

/// Banks name their columns. An arm read at run time has room for more base parameters than it has, so places differ.
#[test]
fn friction_of_a_bank_stays_with_its_joint() {
    for name in ["small5", "mit6", "ur10e", "gen3", "eight", "ur5"] {
        let file = format!(
            "{}/../host-sim/robots/{name}.toml",
            env!("CARGO_MANIFEST_DIR")
        );
        let robot = Robot::load(&file).unwrap();
        arms!(robot, N, P => {
            Described::<N, P>::read(&robot).unwrap();
            let mut bank = ParameterBank::nominal::<Described<N, P>, N, P>();
            let viscous = ColumnKind::friction(FrictionColumn::Viscous);
            for column in bank.columns.iter_mut().filter(|column| column.id.kind == viscous) {
                column.value = 0.01 * f32::from(column.id.joint + 1);
                column.deviation = 0.5 * column.value;
            }
            let set = bank.set::<Described<N, P>, N, P>().unwrap();
            for (joint, friction) in set.friction.iter().enumerate() {
                assert_eq!(friction[FrictionColumn::Viscous], 0.01 * (joint + 1) as f32, "{name}");
                assert_eq!(friction[FrictionColumn::Coulomb], 0.0, "{name}");
            }
            let again = ParameterBank::from_set::<Described<N, P>, N, P>(&set);
            let values = |bank: &ParameterBank| -> Vec<_> {
                bank.columns.iter().map(|column| (column.id, column.value)).collect()
            };
            assert_eq!(values(&again), values(&bank), "{name}");
            let mut client = native::<Described<N, P>, N, P>();
            client.upload_bank(&bank).unwrap();
            assert_eq!(client.read_bank().unwrap().columns, bank.columns, "{name}");
        }, else unreachable!());
    }
}

#[test]
fn a_bank_of_another_arm_is_named() {
    let mut client = native::<Panda, 7, 48>();
    let bank = ParameterBank::nominal::<Ur5, 6, 40>();
    let error = client.upload_bank(&bank).unwrap_err();
    assert!(matches!(error, BoardError::WrongBank { .. }));
    let text = error.to_string();
    let named = text.starts_with("the bank is for ur5 (") && text.contains("drives panda (");
    assert!(named, "{text}");
}

#[test]
fn another_geometry_is_another_arm() {
    let mut robot = Robot::load("ur5").unwrap();
    robot.joints[3].placement.origin.x += 1e-4;
    assert_ne!(arm_hash(&robot), Ur5::HASH);
}

#[test]
fn new_arm_is_declared_beside_the_others_once() {
    let robot = Robot::load("panda").unwrap();
    let folder = tempfile::tempdir().unwrap();
    let parent = folder.path().join("mod.rs");
    std::fs::write(&parent, "//! Arms.\n\nmod identity;\npub mod ur5;\n").unwrap();
    let file = folder.path().join("my_panda.rs");
    for _ in 0..2 {
        write_arm_module(&robot, &file).unwrap();
        let declared = "//! Arms.\n\npub mod my_panda;\nmod identity;\npub mod ur5;\n";
        assert_eq!(std::fs::read_to_string(&parent).unwrap(), declared);
    }
    assert_eq!(std::fs::read_to_string(&file).unwrap(), arm_module(&robot));
    for bad in ["My.rs", "7.rs", "a-b.rs", "arm.txt"] {
        let error = write_arm_module(&robot, &folder.path().join(bad)).unwrap_err();
        assert_eq!(error.kind(), std::io::ErrorKind::InvalidInput, "{bad}");
    }
}

/// Files without real limits have 100 rad/s, at which a tenth of the mass is more than the torque limit.
#[test]
fn speed_limits_out_of_reach_refuse_no_bank_of_a_heavier_arm() {
    let mut robot = Robot::load("ur5").unwrap();
    robot.name = "fast".to_owned();
    for joint in &mut robot.joints {
        joint.limits.velocity = 100.0;
    }
    arms!(robot, N, P => {
        Described::<N, P>::read(&robot).unwrap();
        let accepted = |factor: f32| {
            let mut set = ParameterSet::nominal::<Described<N, P>>(NETWORK_SEED);
            set.rigid *= factor;
            let bank = ParameterBank::from_set::<Described<N, P>, N, P>(&set);
            bank.parameters::<Described<N, P>, N, P>().is_ok()
        };
        assert_eq!([1.1, 10.0].map(accepted), [true, false]);
    }, else unreachable!());
}

/// f32 rounding of figures up to some kg·m²: a base parameter is a sum of up to 20 terms.
const BASE_TOLERANCE: f32 = 1e-5;

/// The committed module of a shipped arm.
fn module_is_up_to_date<A: Arm<N, P>, const N: usize, const P: usize>() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../firmware/foretorque/src/arm");
    let name = A::NAME;
    let committed = std::fs::read_to_string(folder.join(format!("{name}.rs")));
    assert!(
        arm_module(&description(name)) == committed.expect("a shipped arm"),
        "the module of '{name}' is stale: run `cargo run -p host-sim -- generate --robot DESCRIPTION --out MODULE.rs`"
    );
}

fn identity_is_that_of_its_description<A: Arm<N, P>, const N: usize, const P: usize>() {
    let robot = description(A::NAME);
    assert_eq!(A::NAME, robot.name);
    assert_eq!(A::HASH, arm_hash(&robot), "{}", A::NAME);
}

fn defaults_of_the_learner_are_valid<A: Arm<N, P>, const N: usize, const P: usize>() {
    for period_s in [1e-4, 1e-3, 2e-2] {
        let checked = LearnerConfig::<N, P>::for_arm::<A>(period_s).validate();
        assert_eq!(checked, Ok(()), "{} {period_s}", A::NAME);
    }
}

fn data_sheet_gives_nominal<A: Arm<N, P>, const N: usize, const P: usize>() {
    let robot = description(A::NAME);
    let links: [LinkInertia; N] = std::array::from_fn(|joint| {
        let link = &robot.joints[joint].link;
        LinkInertia {
            mass: link.mass as f32,
            com: link.com.map(|x| x as f32),
            inertia_com: link.inertia_com.map(|x| x as f32),
        }
    });
    let rotors: [f32; N] =
        std::array::from_fn(|joint| robot.joints[joint].drive.rotor_inertia as f32);
    let beta = base_parameters::<A, N, P>(&links, &rotors);
    for (k, (value, nominal)) in beta.iter().zip(&A::NOMINAL).enumerate() {
        let error = (value - nominal).abs();
        let near = error <= BASE_TOLERANCE;
        assert!(near, "{}: base parameter {k} off by {error:e}", A::NAME);
    }
}

#[test]
fn shipped_arms_are_as_generated_from_their_descriptions() {
    module_is_up_to_date::<Ur5, 6, 40>();
    module_is_up_to_date::<Panda, 7, 48>();
}

#[test]
fn an_arm_and_its_description_have_the_same_identity() {
    each_arm!(identity_is_that_of_its_description);
    identity_is_that_of_its_description::<Oblique, 4, 27>();
    identity_is_that_of_its_description::<Ur5Calibrated, 6, 40>();
}

#[test]
fn data_sheet_figures_give_the_nominal_base_parameters() {
    each_arm!(data_sheet_gives_nominal);
    data_sheet_gives_nominal::<Oblique, 4, 27>();
}

#[test]
fn a_board_needs_no_check_of_its_learner() {
    each_arm!(defaults_of_the_learner_are_valid);
    defaults_of_the_learner_are_valid::<Oblique, 4, 27>();
    defaults_of_the_learner_are_valid::<Ur5Calibrated, 6, 40>();
}
