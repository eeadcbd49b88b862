//! Results of the program, with every board and in every study.

use crate::{Directory, assert_contains, number, states};
use foretorque::arm::Arm;
use foretorque::arm::panda::Panda;
use foretorque::arm::ur5::Ur5;
use foretorque::joint::{JointMotion, JointVector};
use foretorque_workbench::robot::Robot;
use std::fs;
use std::path::Path;

#[test]
fn torque_is_that_of_the_firmware_for_every_arm_it_knows() {
    fn check<A: Arm<N, P>, const N: usize, const P: usize>() {
        let here = Directory::new(&format!("torque-{}", A::NAME));
        here.write("states.csv", states(N));
        let torque = format!("torque --robot {} --in states.csv --out tau.csv", A::NAME);
        here.succeeds(&torque);
        let table = here.text("tau.csv");
        let rows: Vec<&str> = table.lines().skip(1).collect();
        assert_eq!(rows.len(), 2);
        let beta = nalgebra::SVector::from(A::NOMINAL);
        for (row, value) in rows.iter().zip([0.25, -0.5]) {
            let [q, qd, qdd] = [JointVector::<N>::repeat(value); 3];
            let motion = JointMotion { q, qd, qdd };
            let wanted = foretorque::dynamics::rnea::<A, N, P>(&beta, &motion);
            let torque = row.split(',').map(|tau| tau.parse().expect("a number"));
            let torque: Vec<f32> = torque.collect();
            assert_eq!(torque, wanted.as_slice(), "{} at {value}", A::NAME);
        }
    }
    check::<Ur5, 6, 40>();
    check::<Panda, 7, 48>();
}

#[test]
fn an_arm_of_seven_joints_runs_in_a_closed_loop_and_learns() {
    let here = Directory::new("panda-run");
    here.succeeds("run --robot panda --trajectory validation --duration-s 0.5 --learn --out out");
    let report = here.json("out/report.json");
    assert_eq!(report["robot"], "panda");
    assert_eq!(report["ticks"], 500);
    let joints = report["tracking_rms_joint_mrad"].as_array();
    assert_eq!(joints.map(Vec::len), Some(7));
    let shown = here.succeeds("bank out/bank.bin");
    assert_contains(&shown, "usable    yes, on a board that drives panda");
}

#[test]
fn an_arm_of_more_torque_than_a_sample_carries_sends_currents() {
    let here = Directory::new("heavy-run");
    let mut heavy = Robot::load("ur5").expect("built in");
    for joint in &mut heavy.joints {
        joint.link.mass *= 24.0;
        joint.link.inertia_com *= 24.0;
    }
    let heavy = heavy.to_toml().expect("serialises");
    here.write("heavy.toml", heavy);
    let run = "run --robot heavy.toml --torque-limits 3000 --trajectory validation --duration-s 0.5 --learn --out out";
    let reason =
        "3000 N·m at 1 N·m/A is more than the 512 A that a sample carries: give --drive-gains";
    here.refused(format!("{run} --drive-gains 1"), reason);
    here.succeeds(format!("{run} --drive-gains 10"));
    let report = here.json("out/report.json");
    let torque = report["feed_forward_rms_nm"].as_array().expect("torques");
    assert!(torque[1].as_f64() > Some(520.0), "{torque:?}");
    assert_eq!(report["flag_ticks"].get("no_measurement"), None, "{report}");
}

#[test]
fn a_path_of_the_tool_is_played_wherever_a_trajectory_is() {
    let here = Directory::new("tool-path");
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("paths/ur5.toml");
    fs::copy(&path, here.join("path.toml")).expect("copies");
    let torque = "torque --robot ur5 --trajectory path.toml --out tau.csv";
    here.succeeds(torque);
    let rows = here.text("tau.csv");
    assert_eq!(rows.lines().count(), 8502, "8.5 s, a row each millisecond");
    for command in ["simulate --out log.csv", "run --out out"] {
        let played = "--robot ur5 --trajectory path.toml --duration-s 0.2";
        here.succeeds(format!("{command} {played}"));
    }
    let far = here
        .text(&path)
        .replace("-0.5, -0.05, 0.3", "-1.5, -0.05, 0.3");
    here.write("far.toml", far);
    for command in ["torque --out x.csv", "simulate --out x.csv", "run --out x"] {
        let command = format!("{command} --robot ur5 --trajectory far.toml");
        let waypoint =
            "far.toml: move 3 (via), point 2, tool at (-1.500, -0.050, 0.300) m: out of reach";
        here.refused(&command, waypoint);
    }
    assert!(!here.files(".").iter().any(|name| name.starts_with('x')));
}

#[test]
fn the_log_of_the_flashable_firmware_is_text() {
    let here = Directory::new("log");
    here.succeeds("run --robot ur5 --board qemu-usart --trajectory validation --duration-s 1.2 --out out --log logs/board.log");
    let log = here.text("logs/board.log");
    let hello = format!(
        "info: hello: arm ur5 {:#x}, Instructions counter, Configuration {{ period_us: 1000, pacing: Link, reply: Decimated, brake_close_ms: 0 }}",
        Ur5::HASH
    );
    let lines: Vec<&str> = log.lines().collect();
    let boot = "info: boot: odrive-v3, clock Virtual at 168000000 Hz, started by Unknown, left before by None at 0x0";
    // Begin and end of each line.
    let expected = [
        (boot, boot),
        ("info: store: ", ""),
        (&hello, " counts (0 us) from clock to hello"),
        ("info: tick 1", " 0 lost, 0 overruns, 0 ticks missed"),
    ];
    assert_eq!(lines.len(), expected.len());
    for (line, (begin, end)) in lines.iter().zip(expected) {
        assert!(line.starts_with(begin) && line.ends_with(end), "{log}");
    }
    assert_eq!(here.files("."), ["logs", "out"]);
    assert_eq!(here.files("logs"), ["board.log"]);
}

/// Runs `study` over seeds from 3 on at once, and in jobs of one seed whose records are concatenated in the wrong order.
fn whole_and_in_jobs(here: &Directory, study: &str, seeds: u64) -> String {
    let whole = format!("{study} --seed 3 --seeds {seeds} --out whole");
    here.succeeds(&whole);
    let mut records = String::new();
    for seed in (3..3 + seeds).rev() {
        let job = format!("{study} --seed {seed} --seeds 1 --records {seed}.jsonl");
        here.succeeds(&job);
        records += &here.text(format!("{seed}.jsonl"));
    }
    here.write("all.jsonl", records);
    let study = format!("{study} --seeds {seeds} --from all.jsonl");
    here.succeeds(format!("{study} --seed 3 --out jobs"));
    let whole = here.text("whole/report.json");
    assert_eq!(whole, here.text("jobs/report.json"));
    let error = here.fails(format!("{study} --seed 4 --out x"));
    for words in ["all.jsonl: ", "records are missing"] {
        assert_contains(&error, words);
    }
    whole
}

#[test]
fn the_papers_experiment_is_whole_in_one_run_and_in_jobs() {
    let here = Directory::new("paper");
    let whole = whole_and_in_jobs(&here, "experiment paper --quick", 2);
    let figures = [
        "fig3-excitation.svg",
        "fig6-predicted-torques.svg",
        "training-loss.svg",
        "robustness.svg",
        "efficiency.svg",
    ];
    for figure in figures {
        let svg = here.text(format!("whole/{figure}"));
        assert_eq!(svg, here.text(format!("jobs/{figure}")), "{figure}");
        let sound = svg.starts_with("<svg xmlns=") && !svg.contains("var(");
        assert!(sound, "{figure}");
    }

    let report: serde_json::Value = serde_json::from_str(&whole).expect("is JSON");
    let steps = &report["steps"];
    assert_eq!(steps["base_parameters"], 36);
    assert_eq!(steps["inverse_kinematics_poses"], 10_000);
    assert!(number(&steps["inverse_kinematics_error_rad"]) < 1e-6);
    // Least squares on noise-free torques is exact; the accelerated network is on its way there.
    let trained = |place: usize, key: &str| number(&steps["trained"][place][key]);
    assert!(trained(0, "base_parameter_error_ratio") < 1e-9);
    assert!(trained(2, "path_nrmse_ratio") < 0.01);
    assert!(trained(2, "validation_loss_ratio") < 0.01);
    assert!(trained(3, "path_nrmse_ratio") > 5.0 * trained(3, "validation_loss_ratio"));
    let condition = &report["conditions"][0]["methods"];
    let error = |method: &str| number(&condition[method]["path_nrmse_ratio"]);
    assert!((error("bp_physical") / error("wls") - 1.0).abs() < 0.05);
    let with_outliers = &report["conditions"][1]["methods"];
    let ratio = number(&with_outliers["irls"]["path_nrmse_ratio"])
        / number(&with_outliers["ols"]["path_nrmse_ratio"]);
    assert!(ratio < 0.7, "{ratio}");
}

#[test]
fn the_excitation_campaign_is_the_same_from_its_record() {
    let here = Directory::new("excitation");
    let study = "experiment excitation --quick";
    let whole = whole_and_in_jobs(&here, study, 1);
    let [one, other] = ["whole", "jobs"].map(|out| here.text(format!("{out}/report.html")));
    assert_eq!(one, other);
    let report: serde_json::Value = serde_json::from_str(&whole).expect("is JSON");
    assert_eq!(report["violations"], 0);
    assert_eq!(report["seeds"].as_array().map(Vec::len), Some(1));

    for (file, defect) in [
        ("all.jsonl", "is of another configuration or version"),
        ("whole/report.json", "is no record"),
    ] {
        let arguments = format!("experiment excitation --from {file} --out x");
        here.refused(&arguments, format!("{file}: line 1 {defect}"));
    }
    let study = "experiment identification --out x";
    here.refused(study, "start in the root of foretorque's sources");
    assert!(!here.join("x").exists());
}

#[test]
fn a_description_of_a_description_is_the_same_arm() {
    let here = Directory::new("described_twice");
    // A URDF without rotors: what a simulation assumes is not the firmware's.
    let panda = concat!(env!("CARGO_MANIFEST_DIR"), "/robots/panda.urdf");
    let described = here.succeeds(format!("describe {panda} --name arm_7"));
    here.write("arm_7.toml", described);
    fs::create_dir(here.join("other")).expect("new");
    here.succeeds(format!(
        "generate --robot {panda} --name arm_7 --out arm_7.rs"
    ));
    here.succeeds("generate --robot arm_7.toml --out other/arm_7.rs");
    let [one, other] = ["arm_7.rs", "other/arm_7.rs"].map(|file| here.text(file));
    let constants = |text: &str| {
        text.split_once("pub const")
            .expect("constants")
            .1
            .to_owned()
    };
    assert_eq!(constants(&one), constants(&other));
}

#[test]
fn a_torque_limit_that_no_drive_of_the_arm_has_is_asked_about() {
    let here = Directory::new("inflated");
    let question = "is more than 10 times the";
    let robots = Path::new(env!("CARGO_MANIFEST_DIR")).join("robots");
    for robot in here.files(&robots) {
        let described = here.succeeds(format!("describe {}", robots.join(robot).display()));
        assert!(!described.contains(question), "{described}");
    }
    let generated = here.succeeds("generate --robot ur5 --torque-limits 1000 --out own.rs");
    // What the shoulder moves takes more than 100 N·m.
    let asked: Vec<&str> = generated
        .lines()
        .filter(|line| line.contains(question))
        .collect();
    assert_eq!(asked.len(), 3, "{generated}");
    assert_contains(
        asked[2],
        "note: joint 'wrist_3': its torque limit of 1000 N·m",
    );
}

#[test]
fn what_options_of_describe_give_is_not_noted_as_assumed() {
    let here = Directory::new("described_with_options");
    let arm = include_str!("../description/src/urdf/tests/two_link.urdf");
    let arm = arm
        .replace(" effort=\"40\"", "")
        .replace(" effort=\"20\"", "");
    here.write("arm.urdf", arm.replace(" velocity=\"3\"", ""));
    let options =
        "--torque-limits 150,60 --velocity-limits 180,2 --rotor-inertia 0.6 --drive-gains 9";
    for format in ["toml", "overlay"] {
        let bare = here.succeeds(format!("describe arm.urdf --format {format}"));
        let given = here.succeeds(format!("describe arm.urdf --format {format} {options}"));
        for note in [
            "no torque limit",
            "no velocity limit",
            "rotor inertias 0",
            "gains not known",
            "rotor inertia of joints",
        ] {
            assert_contains(&bare, note);
            assert!(!given.contains(note), "{given}");
        }
        assert_contains(&given, "# drives are not described: 17-bit encoders");
        assert_contains(
            &given,
            "its velocity limit is 180 rad/s: are these degrees?",
        );
    }
}

#[test]
fn an_arm_of_one_joint_is_generated_and_excited() {
    let here = Directory::new("one-joint");
    let pendulum = r#"<robot name="pendulum"><link name="wall"/>
        <joint name="hinge" type="revolute"><parent link="wall"/><child link="rod"/><axis xyz="0 1 0"/>
          <limit lower="-3" upper="3" velocity="5" effort="20"/></joint>
        <link name="rod"><inertial><origin xyz="0 0 -0.5"/><mass value="2"/>
          <inertia ixx="0.1" iyy="0.1" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>"#;
    here.write("pendulum.urdf", pendulum);
    let generated = here.succeeds("generate --robot pendulum.urdf --out own.rs");
    assert_contains(&generated, "arm 'pendulum' of 1 joint: hinge");
    let excite = "excite --robot pendulum.urdf --starts 1 --iterations 8 --out out";
    here.shows(excite, "N·m RMS");
    let help = here.succeeds("excite --help");
    for words in [
        "Velocity limits, rad/s: one",
        "around zero, rad,",
        "fundamental, s;",
    ] {
        assert_contains(&help, words);
    }
}
