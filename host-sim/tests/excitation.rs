//! The optimised excitation keeps its limits on a grid that the search never saw, its certificate is true, and a board plays it.

use crate::{Directory, assert_contains};
use foretorque::arm::Arm;
use foretorque::arm::ur5::{JOINTS as N, PARAMETERS as P, Ur5};
use foretorque::joint::{JointMeasurement, JointMotion, JointSample, JointVector};
use foretorque_link::excitation::{ExcitationCommand, ExcitationProgram, ExcitationState};
use foretorque_studies::excitation::recount;
use foretorque_workbench::board::qemu::{Emulator, Image, QemuOptions};
use foretorque_workbench::board::{Client, Native, Transport};
use foretorque_workbench::closed_loop::{ClosedLoop, PdConfig};
use foretorque_workbench::dynamics::{ReferenceModel, State};
use foretorque_workbench::excitation::{
    Certificate, Criterion, Excitation, SearchConfig, optimise,
};
use foretorque_workbench::plant::{Plant, PlantConfig, ReportFaults};
use foretorque_workbench::robot::Robot;
use foretorque_workbench::trajectory::Trajectory;
use std::f64::consts::PI;
use std::time::Duration;

fn ur5() -> Robot {
    Robot::load("ur5").expect("built in")
}

fn short(seed: u64) -> SearchConfig {
    SearchConfig {
        seed,
        starts: 4,
        iterations: 40,
        // A short search does not reach the lowest condition numbers.
        condition_limit: 200.0,
        ..SearchConfig::default()
    }
}

fn found(robot: &Robot, config: &SearchConfig) -> Excitation {
    optimise(robot, config, None, |_, _| {}).expect("feasible")
}

fn certificate(excitation: &Excitation) -> &Certificate {
    excitation.certificate.as_deref().expect("certified")
}

#[test]
fn every_limit_holds_between_the_points_that_were_checked() {
    let robot = ur5();
    for seed in 1..=2 {
        let excitation = found(&robot, &short(seed));
        assert!(certificate(&excitation).holds);
        let counted = recount(&robot, &excitation, PI, 20_011).expect("certified");
        let missed = (counted.violations, counted.beyond_certificate);
        assert_eq!(missed, (0, 0), "seed {seed}");
    }
}

#[test]
fn a_recount_sees_what_breaks_a_limit() {
    let robot = ur5();
    let excitation = found(&robot, &short(1));
    let changes: [fn(&mut Robot); 6] = [
        |robot| robot.joints[0].limits.velocity *= 0.5,
        |robot| robot.joints[1].limits.acceleration *= 0.3,
        |robot| robot.joints[2].limits.torque *= 0.2,
        |robot| robot.joints[3].limits.position = (-0.1, 0.1),
        |robot| robot.workspace.table_height = Some(0.4),
        |robot| robot.workspace.clearance = 0.3,
    ];
    for (place, change) in changes.iter().enumerate() {
        let mut other = robot.clone();
        change(&mut other);
        let counted = recount(&other, &excitation, PI, 2000).expect("certified");
        assert!(counted.violations > 0, "change {place}");
    }
}

#[test]
fn where_no_path_keeps_the_condition_number_the_error_is_least_and_the_limits_hold() {
    let mut slow = ur5();
    let joints = slow.joints.iter_mut();
    joints.for_each(|joint| joint.limits.velocity = 0.6);
    let config = SearchConfig {
        condition_limit: 60.0,
        condition_required: false,
        ..short(1)
    };
    let plain = SearchConfig {
        criterion: Criterion::VOptimal,
        ..config.clone()
    };
    let [constrained, plain] = [config, plain].map(|config| found(&slow, &config));
    let error = |found: &Excitation| certificate(found).predicted_nrmse_percent;
    assert!(
        error(&constrained) <= 1.01 * error(&plain),
        "{}",
        error(&constrained)
    );
    let counted = recount(&slow, &constrained, PI, 20_011).expect("certified");
    assert_eq!(counted.violations, 0);
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let robot = ur5();
    let on = |threads| {
        let config = SearchConfig {
            iterations: 16,
            criterion: Criterion::VOptimal,
            threads: std::num::NonZeroUsize::new(threads),
            ..short(3)
        };
        serde_json::to_string(&found(&robot, &config)).expect("serialises")
    };
    assert_eq!(on(1), on(3));
}

#[test]
fn improving_a_trajectory_never_makes_it_worse() {
    let robot = ur5();
    let config = SearchConfig {
        criterion: Criterion::VOptimal,
        ..short(4)
    };
    let first = found(&robot, &config);
    let second = optimise(&robot, &config, Some(&first), |_, _| {}).expect("feasible");
    let error = |excitation: &Excitation| certificate(excitation).predicted_nrmse_percent;
    assert!(error(&second) <= error(&first));
}

#[test]
fn each_criterion_is_lower_where_it_was_asked_for() {
    let robot = ur5();
    let by = |criterion| {
        let config = SearchConfig {
            criterion,
            ..short(5)
        };
        found(&robot, &config)
    };
    let (condition, error) = (by(Criterion::Condition), by(Criterion::VOptimal));
    let (condition, error) = (certificate(&condition), certificate(&error));
    assert!(condition.condition_number_dh < error.condition_number_dh);
    assert!(error.predicted_nrmse_percent < condition.predicted_nrmse_percent);
    // The same path is well conditioned in one set of frames and badly in another.
    assert!(error.condition_number_board < error.condition_number_dh);
}

#[test]
fn a_path_that_shows_no_parameters_is_refused() {
    let here = Directory::new("excite-short");
    let short = "excite --robot panda --out out --period-s 0.2 --starts 1";
    here.refused(short, "a longer --period-s");
    assert!(!here.join("out/excitation.json").exists());
}

#[test]
fn rotors_that_simulate_assumes_are_those_of_excite() {
    let here = Directory::new("excite-rotors");
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/robots/small5.toml");
    let mut robot = Robot::load(file).expect("described");
    let mut assumed = Vec::new();
    for joint in &mut robot.joints {
        joint.drive.rotor_inertia = 0.0;
        assumed.push((joint.limits.torque / 200.0).to_string());
    }
    here.write("bare.toml", robot.to_toml().expect("text"));
    let search = "excite --robot bare.toml --starts 1 --iterations 8 --out";
    let silent = here.succeeds(format!("{search} assumed"));
    assert_contains(&silent, "rotor inertias are not described");
    let unchecked = "from table and own links are not checked: its description has no capsules";
    assert_contains(&silent, unchecked);
    let table = "excite --robot bare.toml --out none --table-m 5";
    here.refused(table, "--table-m 5: no table is checked for 'small5'");
    assert!(!here.join("none").exists());
    let stated = format!("{search} stated --rotor-inertia {}", assumed.join(","));
    here.succeeds(&stated);
    let [one, other] = ["assumed", "stated"].map(|out| here.text(format!("{out}/excitation.json")));
    assert_eq!(one, other);
}

const BOOT: Duration = Duration::from_secs(5);
/// Ticks of one run: check, approach, one period of 2 s, rest.
const TICKS: usize = 5000;

fn excitation() -> Excitation {
    Excitation::quick(&ur5(), 1, 2.0, 200, || ()).expect("the UR5 can move")
}

fn program() -> ExcitationProgram<N> {
    let program = excitation().program(Ur5::HASH, 1, 0.05);
    program.expect("six joints")
}

fn client(transport: Box<dyn Transport>) -> Client<N> {
    let connected = Client::connect::<Ur5, P>(transport, BOOT);
    let mut client = connected.unwrap_or_else(|error| panic!("{error}"));
    // A machine that is busy with other tests may keep the emulator waiting.
    client.timeout = Duration::from_secs(20);
    client
}

fn native() -> Client<N> {
    client(Box::new(Native::<Ur5, N, P>::new().expect("usable limits")))
}

fn emulated() -> Client<N> {
    let emulator = Emulator::start(&QemuOptions::new(Image::Bulk));
    client(Box::new(emulator.unwrap_or_else(|error| panic!("{error}"))))
}

/// Reply of the board in one tick: torque bit for bit, state, desired motion.
type Reply = (Vec<u32>, Option<(ExcitationState, JointMotion<N>)>);

/// Plays it on an arm that follows within the resolution of the link.
fn play(client: &mut Client<N>) -> Vec<Reply> {
    client.load_excitation(&program()).expect("it is taken");
    let beside = excitation().at::<N>(0.0).q.add_scalar(-0.1);
    let mut desired = JointMotion {
        q: beside.cast(),
        ..JointMotion::zero()
    };
    let (q, tau) = (desired.q, JointVector::zeros());
    let measured = Some(JointMeasurement { q, tau });
    let standing = JointSample { desired, measured };
    client.arm(&standing).expect("the board can be armed");
    let started = client.excitation(ExcitationCommand::Start);
    started.expect("it may be started");
    client.learning(true).expect("the board learns");
    let mut replies = Vec::new();
    for _ in 0..TICKS {
        let (q, tau) = (desired.q, desired.qd * 8.0);
        let measured = Some(JointMeasurement { q, tau });
        let sample = JointSample { desired, measured };
        let reply = client.sample(&sample).expect("a torque");
        if let Some((_, motion)) = reply.excited {
            desired = motion;
        }
        let torque = reply.total.iter().map(|tau| tau.to_bits()).collect();
        replies.push((torque, reply.excited));
    }
    replies
}

fn stages(replies: &[Reply]) -> Vec<Option<ExcitationState>> {
    let stages = replies.iter().map(|(_, e)| e.map(|(stage, _)| stage));
    let mut stages: Vec<_> = stages.collect();
    stages.dedup();
    stages
}

#[test]
fn the_board_plays_the_series_of_the_file_the_same_natively_and_emulated() {
    let replies = play(&mut native());
    let expected = [
        None,
        Some(ExcitationState::Approaching),
        Some(ExcitationState::Playing),
        Some(ExcitationState::Holding),
    ];
    assert_eq!(stages(&replies), expected);
    let series = excitation();
    let excited = replies.iter().filter_map(|(_, excited)| *excited);
    let playing = excited.filter(|(stage, _)| *stage == ExcitationState::Playing);
    let playing: Vec<_> = playing.collect();
    assert_eq!(playing.len(), 2000);
    // The wire's resolution is the coarsest part: 2^-20 rad, 2^-18 rad/s, 2^-9 rad/s², half a step of each, and f32.
    for (k, (_, motion)) in playing.iter().enumerate() {
        let exact = series.at::<N>(k as f64 * 1e-3);
        for (seen, exact, most) in [
            (motion.q, exact.q, 1.5e-6),
            (motion.qd, exact.qd, 1e-5),
            (motion.qdd, exact.qdd, 1.1e-3),
        ] {
            assert!((seen.cast::<f64>() - exact).amax() < most, "tick {k}");
        }
    }
    let emulated = play(&mut emulated());
    assert!(emulated == replies, "the emulator differs");
}

#[test]
fn the_desired_motion_stands_still_where_a_report_is_lost() {
    let mut board = native();
    board.load_excitation(&program()).expect("it is taken");
    let robot = ur5();
    let model = ReferenceModel::<N>::new(&robot).expect("six joints");
    let pd = PdConfig::tuned(&model, 6.0, 1e-3);
    let plant = Plant::<N>::new(&robot, PlantConfig::default(), 1).expect("six joints");
    let mut plant = plant.with_faults(ReportFaults {
        lost: 0.1,
        ..ReportFaults::NONE
    });
    let beside = State::rest(excitation().at::<N>(0.0).q.add_scalar(-0.1));
    let path = Trajectory::Sampled(vec![(0.0, beside)]);
    let play = ClosedLoop::new(&mut plant, &pd, &path, 1e-3, Some(&mut board));
    let mut play = play.expect("armed");
    let started = board.excitation(ExcitationCommand::Start);
    started.expect("it may be started");
    let (mut before, mut lost) = (beside.q, 0);
    for _ in 0..TICKS {
        let record = play.tick(&mut plant, Some(&mut board)).expect("a torque");
        let step = (record.desired.q - before).amax();
        assert!(step < 0.01, "{step} rad at {} s", record.t_s);
        let moving = record.stage == Some(ExcitationState::Playing);
        lost += usize::from(moving && record.reported.is_none());
        before = record.desired.q;
    }
    assert!(lost > 100, "{lost}");
}
