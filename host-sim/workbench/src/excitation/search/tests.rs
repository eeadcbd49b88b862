use super::*;

#[test]
fn the_gradient_agrees_with_central_differences() {
    let robot = Robot::load("ur5").expect("built in");
    use Criterion::{Condition, Constrained, DOptimal, VOptimal};
    for criterion in [Condition, DOptimal, VOptimal, Constrained] {
        let config = SearchConfig {
            criterion,
            starts: 1,
            ..SearchConfig::default()
        };
        let search = Search::new(&robot, &config).expect("a search");
        let start = search.starts().remove(0);
        // Beyond the limits, so that every penalty takes part.
        let start: Vec<f64> = start.iter().map(|x| 1.3 * x).collect();
        let penalties = search.penalties(10.0, 0.0);
        let mut gradient = vec![0.0; start.len()];
        search
            .objective
            .value(&start, &penalties, Some(&mut gradient));
        let size = gradient.iter().map(|g| g * g).sum::<f64>().sqrt();
        for v in 0..start.len() {
            let h = 1e-5;
            let at = |step: f64| {
                let mut moved = start.clone();
                moved[v] += step;
                search.objective.value(&moved, &penalties, None)
            };
            let expected = (at(h) - at(-h)) / (2.0 * h);
            assert!(
                (gradient[v] - expected).abs() < 1e-4 * size,
                "{criterion:?}, variable {v}: {} {expected}",
                gradient[v]
            );
        }
    }
}

#[test]
fn joints_slow_down_to_what_friction_leaves_and_a_weak_one_is_named() {
    let config = SearchConfig::default();
    let adapted = |robot: &Robot| {
        let mut search = Search::new(robot, &config).expect("a search");
        let found = search.adapt_speed();
        (found, search.speed_share)
    };
    let mut robot = Robot::load("ur5").expect("built in");
    assert_eq!(adapted(&robot), (Ok(()), vec![1.0; 6]));
    // At the speed limit friction alone would take four times the torque limit.
    let limits = robot.joints[2].limits;
    robot.joints[2].friction.viscous = 4.0 * limits.torque / limits.velocity;
    let (found, shares) = adapted(&robot);
    assert_eq!(found, Ok(()));
    assert!(
        shares[2] < 1.0 && shares[2] > 0.1 && shares[5] == 1.0,
        "{shares:?}"
    );
    // Gravity at the shoulder and at the elbow.
    robot.joints[1].limits.torque = 1.0;
    robot.joints[2].limits.torque = 0.5;
    let message = adapted(&robot).0.expect_err("too weak").to_string();
    assert!(
        message.contains("its limit is 1 N·m; ")
            && message.ends_with("its limit is 0.5 N·m: correct it with --torque-limits"),
        "{message}"
    );
    for joint in &robot.joints[1..3] {
        assert!(message.contains(&joint.name), "{message}");
    }
}

#[test]
fn friction_of_half_a_torque_limit_leaves_a_path() {
    let mut robot = Robot::load("ur5").expect("built in");
    // Friction that helps to brake: the certificate does not count on it.
    robot.joints[5].friction.coulomb = 0.5 * robot.joints[5].limits.torque;
    robot.joints[4].friction.coulomb = 0.5 * robot.joints[4].limits.torque;
    let config = SearchConfig {
        starts: 4,
        iterations: 40,
        condition_required: false,
        ..SearchConfig::default()
    };
    let found = optimise(&robot, &config, None, |_, _| {}).expect("a path");
    assert!(found.certificate.expect("certified").holds);
}
