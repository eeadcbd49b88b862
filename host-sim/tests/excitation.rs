//! The optimised excitation keeps its limits on a grid that the search never saw, and its certificate is true.

use crate::program::{directory, refused, succeeds, text, write};
use foretorque_studies::excitation::recount;
use foretorque_workbench::excitation::{
    Certificate, Criterion, Excitation, SearchConfig, optimise,
};
use foretorque_workbench::robot::Robot;
use std::f64::consts::PI;

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
        assert_eq!(
            (counted.violations, counted.beyond_certificate),
            (0, 0),
            "seed {seed}"
        );
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
fn what_no_excitation_can_keep_ends_with_one_line() {
    let directory = directory("excite");
    let ur5 = include_str!("../robots/ur5.toml");
    // Of the shoulder, whose torque against gravity no path of this arm keeps below 1 N·m.
    let limit = "torque_nm = 150";
    let parts: Vec<&str> = ur5.splitn(3, limit).collect();
    let weak = format!("{}{limit}{}torque_nm = 1{}", parts[0], parts[1], parts[2]);
    write(directory.join("weak.toml"), weak);
    let no_path = "no path keeps all limits";
    let badly_conditioned = "no path keeps all limits; the best one has condition number";
    for (arguments, message) in [
        ("ur5 --criterion e-optimal", "invalid value 'e-optimal'"),
        ("ur5 --range-rad 0", "--range-rad is 0, must be positive"),
        // The arm cannot stand in a table up to its shoulder.
        ("ur5 --table-m 0.5", no_path),
        ("ur5 --condition-limit 5", badly_conditioned),
        ("ur5 --improve no_such_file.json", "no_such_file.json"),
        ("weak.toml --range-rad 3", "even where it hardly moves"),
        (
            "ur5 --range-rad 0.001",
            "within these limits torque cannot see all base parameters",
        ),
        ("ur5 --period-s 0.3 --condition-limit 60", badly_conditioned),
    ] {
        let search = "excite --starts 1 --iterations 8 --out x --robot";
        refused(&directory, &format!("{search} {arguments}"), message);
        assert!(!directory.join("x").exists(), "{arguments} leaves files");
    }
}

#[test]
fn rotors_that_simulate_assumes_are_those_of_excite() {
    let directory = directory("excite-rotors");
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/robots/small5.toml");
    let mut robot = Robot::load(file).expect("described");
    let mut assumed = Vec::new();
    for joint in &mut robot.joints {
        joint.drive.rotor_inertia = 0.0;
        assumed.push((joint.limits.torque / 200.0).to_string());
    }
    write(directory.join("bare.toml"), robot.to_toml().expect("text"));
    let search = "excite --robot bare.toml --starts 1 --iterations 8 --out";
    let silent = succeeds(&directory, &format!("{search} assumed"));
    assert!(
        silent.contains("rotor inertias are not described"),
        "{silent}"
    );
    let stated = format!("{search} stated --rotor-inertia {}", assumed.join(","));
    succeeds(&directory, &stated);
    let [one, other] =
        ["assumed", "stated"].map(|out| text(directory.join(out).join("excitation.json")));
    assert_eq!(one, other);
}
