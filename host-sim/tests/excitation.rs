//! The optimised excitation keeps its limits on a grid that the search never saw, and says so truthfully.

use host_sim::dynamics::{Joints, ReferenceModel};
use host_sim::excitation::{Certificate, Criterion, Excitation, SearchConfig, optimise};
use host_sim::robot::{Robot, segment_distance};
use nalgebra::{Matrix3, Rotation3, Vector3};
use std::f64::consts::PI;
use std::process::Command;

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
    optimise::<6>(robot, config, None, |_, _| {}).expect("feasible")
}

fn certificate(excitation: &Excitation) -> &Certificate {
    excitation.certificate.as_deref().expect("certified")
}

/// Ends of all capsules in the base frame, and their radii, link by link.
fn placed(robot: &Robot, q: &Joints<6>) -> Vec<Vec<([Vector3<f64>; 2], f64)>> {
    let (mut rot, mut origin) = (Matrix3::identity(), Vector3::zeros());
    let links = robot.joints.iter().zip(q.iter()).map(|(joint, q)| {
        origin += rot * joint.placement.origin;
        rot = rot
            * joint.placement.rot_parent_child
            * Rotation3::from_axis_angle(&Vector3::z_axis(), *q).matrix();
        let here = |capsule: &host_sim::robot::Capsule| {
            (capsule.ends.map(|end| origin + rot * end), capsule.radius)
        };
        joint.capsules.iter().map(here).collect()
    });
    links.collect()
}

/// Number of limits violated at `points` instants, each worst value compared with the certificate's, too.
fn violations(robot: &Robot, excitation: &Excitation, points: u32) -> usize {
    let model = ReferenceModel::<6>::new(robot).expect("six joints");
    let table = robot.workspace.table_height.expect("the UR5 stands on one");
    let clear = robot.workspace.clearance;
    let worst = |limit: &str, of: &str| {
        let mut checks = certificate(excitation).limits.iter();
        let check = checks.find(|check| check.limit == limit && check.of == of);
        check.map(|check| check.worst).expect("certified")
    };
    let names: Vec<&str> = robot
        .joints
        .iter()
        .map(|joint| joint.name.as_str())
        .collect();
    let peaks: Vec<[f64; 3]> = names
        .iter()
        .map(|name| {
            [
                worst("velocity", name),
                worst("acceleration", name),
                worst("torque", name),
            ]
        })
        .collect();
    let mut count = 0;
    let mut expect = |kept: bool| count += usize::from(!kept);
    for k in 0..points {
        let state = excitation.at::<6>(excitation.period_s * f64::from(k) / f64::from(points));
        let rigid = model.inverse_dynamics(&state);
        for (j, joint) in robot.joints.iter().enumerate() {
            let limits = &joint.limits;
            let friction = joint.friction.viscous * state.qd[j]
                + joint.friction.coulomb * state.qd[j].signum();
            let tau = (rigid[j] + friction).abs();
            expect(state.q[j].abs() <= PI);
            expect(state.qd[j].abs() <= limits.velocity.min(peaks[j][0]));
            expect(state.qdd[j].abs() <= limits.acceleration.min(peaks[j][1]));
            expect(tau <= limits.torque.min(peaks[j][2]));
        }
        let links = placed(robot, &state.q);
        for (outer, capsules) in links.iter().enumerate() {
            for (ends, radius) in capsules {
                let lowest = ends[0].z.min(ends[1].z) - radius;
                expect(outer == 0 || lowest >= table + clear);
                for inner in links.iter().take(outer.saturating_sub(1)) {
                    for (other, width) in inner {
                        expect(segment_distance(ends, other) - radius - width >= clear);
                    }
                }
            }
        }
    }
    count
}

#[test]
fn every_limit_holds_between_the_points_that_were_checked() {
    let robot = ur5();
    for seed in 1..=2 {
        let excitation = found(&robot, &short(seed));
        assert!(certificate(&excitation).holds);
        assert_eq!(violations(&robot, &excitation, 20_011), 0, "seed {seed}");
    }
}

/// `cargo test --release -p host-sim --test excitation -- --ignored`
#[test]
#[ignore = "20 full searches take minutes"]
fn no_limit_is_missed_on_100_000_points_of_20_seeds() {
    let robot = ur5();
    for seed in 1..=20 {
        let config = SearchConfig {
            seed,
            ..SearchConfig::default()
        };
        let excitation = found(&robot, &config);
        let certificate = certificate(&excitation);
        println!(
            "seed {seed}: {:.4} %, condition number {:.2}",
            certificate.predicted_nrmse_percent, certificate.condition_number_dh
        );
        assert!(certificate.condition_number_dh <= 60.0, "seed {seed}");
        assert_eq!(violations(&robot, &excitation, 100_000), 0, "seed {seed}");
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
    let second = optimise::<6>(&robot, &config, Some(&first), |_, _| {}).expect("feasible");
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
fn what_cannot_be_done_ends_with_one_line_and_a_failure() {
    let out = std::env::temp_dir().join(format!("foretorque-excite-{}", std::process::id()));
    let cases: [(&[&str], &str); 5] = [
        (&["--criterion", "e-optimal"], "invalid value 'e-optimal'"),
        (&["--range-rad", "0"], "--range-rad is 0, must be positive"),
        // The arm cannot stand in a table up to its shoulder.
        (&["--table-m", "0.5"], "no path keeps all limits"),
        (
            &["--condition-limit", "5"],
            "no path keeps all limits; the best one has condition number",
        ),
        (&["--improve", "no_such_file.json"], "no_such_file.json"),
    ];
    for (arguments, message) in cases {
        let run = Command::new(env!("CARGO_BIN_EXE_host-sim"))
            .args([
                "excite",
                "--robot",
                "ur5",
                "--starts",
                "1",
                "--iterations",
                "8",
                "--out",
            ])
            .arg(&out)
            .args(arguments)
            .output()
            .expect("runs");
        assert!(!run.status.success(), "{arguments:?}");
        let said = String::from_utf8_lossy(&run.stderr);
        let first = said.lines().next().unwrap_or_default();
        assert!(first.contains(message), "{arguments:?}: {said}");
        assert!(!out.exists(), "{arguments:?} leaves files");
    }
}
