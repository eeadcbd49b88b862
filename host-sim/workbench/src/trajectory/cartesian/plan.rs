//! From moves of the tool to motion of the joints, tick by tick.

use super::{Move, Path, Point, parse};
use crate::Refusal;
use crate::dynamics::{Joints, State};
use crate::kinematics::Inverse;
use crate::robot::{Placement, Robot};
use crate::trajectory::{MOST_DURATION_S, ROUNDED, within};

/// Largest difference between predicted and found joint positions, rad. At the speed limit a tick of 1 ms is some
/// milliradians; another branch of solutions is farther away, except where two branches meet.
const JUMP_RAD: f64 = 0.02;

/// Joint motion every `period_s` along the path in `text`, with the time of each sample, s.
///
/// The start takes the solution nearest to `near_q_rad` (else to the middle of the ranges); from there on the branch is
/// the one that goes on, ranges of the joints or not. Every waypoint is looked at before the first tick.
///
/// Errors: a line that names the field, or the waypoint and what is wrong there.
pub fn plan<const N: usize>(
    robot: &Robot,
    text: &str,
    period_s: f64,
) -> Result<Vec<(f64, State<N>)>, Refusal> {
    let path = parse(text)?;
    let inverse = Inverse::<N>::new(robot, &path.tool)
        .ok_or_else(|| Refusal(format!("the robot has not {N} joints")))?;
    if N < 6 {
        let problem = format!("{N} joints cannot give the tool every pose, it takes six");
        return Err(Refusal::of("a path of the tool", problem));
    }
    let near = near(robot, &path)?;
    let refused = |waypoint: String, pose: &Placement, reason: Refusal| {
        let [x, y, z] = pose.origin.into();
        let tool = format!("tool at ({x:.3}, {y:.3}, {z:.3}) m");
        Refusal::of(format!("{waypoint}, {tool}"), reason)
    };
    let q = inverse
        .nearest(&path.start, &near)
        .map_err(|reason| refused("start".to_owned(), &path.start, reason))?;
    for (waypoint, pose) in waypoints(&path) {
        let solutions = inverse.solutions(&pose, &q);
        solutions.map_err(|reason| refused(waypoint, &pose, reason))?;
    }
    let mut total_s = 0.0;
    let end_s = |step: &Move| {
        total_s += step.duration_s;
        total_s
    };
    let ends: Vec<f64> = path.moves.iter().map(end_s).collect();
    if total_s > MOST_DURATION_S {
        let problem =
            format!("the moves take {total_s:.0} s, at most {MOST_DURATION_S} are played");
        return Err(Refusal(problem));
    }
    let ticks = (total_s / period_s).round() as usize;
    let mut samples: Vec<(f64, State<N>)> = Vec::with_capacity(ticks + 1);
    let mut predicted = q;
    for tick in 0..=ticks {
        let t_s = tick as f64 * period_s;
        let number = ends.partition_point(|end| *end < t_s);
        let number = number.min(path.moves.len() - 1);
        let step = &path.moves[number];
        let begun = ends[number] - step.duration_s;
        let point = step.at(t_s - begun);
        let here = name(number, step);
        let state = at(&inverse, &point, &predicted)
            .map_err(|reason| refused(format!("{here} at {t_s:.3} s"), &point.pose, reason))?;
        within(robot, t_s, &state, ROUNDED).map_err(|reason| refused(here, &point.pose, reason))?;
        predicted = state.q + (state.qd + state.qdd * (0.5 * period_s)) * period_s;
        samples.push((t_s, state));
    }
    Ok(samples)
}

fn at<const N: usize>(
    inverse: &Inverse<N>,
    point: &Point,
    predicted: &Joints<N>,
) -> Result<State<N>, Refusal> {
    let q = inverse.onwards(&point.pose, predicted, JUMP_RAD)?;
    let motion = inverse.chain.joint_motion(&q, &point.twist, &point.rate);
    let (qd, qdd) = motion.ok_or_else(|| inverse.singular(&q))?;
    Ok(State { q, qd, qdd })
}

fn near<const N: usize>(robot: &Robot, path: &Path) -> Result<Joints<N>, Refusal> {
    match &path.near_q {
        Some(near) if near.len() != N => {
            let problem = format!("{} values for {N} joints", near.len());
            Err(Refusal::of("near_q_rad", problem))
        }
        Some(near) => Ok(Joints::from_column_slice(near)),
        None => Ok(Joints::from_fn(|j, _| {
            let (low, high) = robot.joints[j].limits.position;
            0.5 * (low + high)
        })),
    }
}

fn name(number: usize, step: &Move) -> String {
    format!("move {} ({})", number + 1, step.kind)
}

/// The poses that the file names, after the start.
fn waypoints(path: &Path) -> Vec<(String, Placement)> {
    let mut all = Vec::new();
    for (number, step) in path.moves.iter().enumerate() {
        let name = name(number, step);
        if step.points.is_empty() {
            all.push((format!("{name}, end"), step.end()));
        }
        let points = (1..).zip(&step.points);
        all.extend(points.map(|(point, pose)| (format!("{name}, point {point}"), *pose)));
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinematics::Chain;
    use nalgebra::Vector3;

    const PERIOD_S: f64 = 1e-3;

    /// Line, circle and via points in front of a UR5, tool down.
    const PATH: &str = include_str!("../../../../paths/ur5.toml");

    fn ur5() -> Robot {
        Robot::load("ur5").expect("built in")
    }

    fn is_followed<const N: usize>(robot: &Robot, text: &str, path: &Path) {
        let samples = plan::<N>(robot, text, PERIOD_S).expect("it can be followed");
        let chain = Chain::<N>::new(robot, &path.tool).expect("its size");
        let mut worst = 0.0_f64;
        for window in samples.windows(3) {
            let [(_, before), (t_s, now), (_, after)] = window else {
                panic!("three samples");
            };
            // The end of a move is the start of the next: its own derivatives are one-sided there.
            let slope = (after.q - before.q) / (2.0 * PERIOD_S);
            let bend = (after.qd - before.qd) / (2.0 * PERIOD_S);
            assert!((slope - now.qd).amax() < 2e-4, "{t_s}");
            let bent = (bend - now.qdd).amax();
            assert!(bent < 0.05, "{t_s}: {bent}");
            let (mut left, mut number) = (*t_s, 0);
            while number + 1 < path.moves.len() && left > path.moves[number].duration_s {
                left -= path.moves[number].duration_s;
                number += 1;
            }
            let target = path.moves[number].at(left).pose;
            let there = chain.forward(&now.q);
            worst = worst
                .max((there.origin - target.origin).amax())
                .max((there.rot_parent_child - target.rot_parent_child).amax());
        }
        assert!(worst < 2e-9, "{worst}");
        let (first, last) = (samples[0].1, samples[samples.len() - 1].1);
        assert!(first.qd.amax() < 1e-12 && last.qd.amax() < 1e-9 && last.qdd.amax() < 1e-6);
    }

    #[test]
    fn the_tool_follows_lines_circles_and_via_points() {
        let path = parse(PATH).expect("parses");
        is_followed::<6>(&ur5(), PATH, &path);
    }

    #[test]
    fn an_arm_of_seven_joints_follows_a_path_by_steps() {
        let text = PATH
            .replace("near_q_rad = [0.0, -1.2, 1.6, -2.0, -1.57, 0.0]", "")
            .replace("-0.4", "0.4")
            .replace("-0.5", "0.5");
        let path = parse(&text).expect("parses");
        let panda = Robot::load("panda").expect("built in");
        is_followed::<7>(&panda, &text, &path);
    }

    #[test]
    fn a_circle_keeps_its_radius_and_carries_the_tool_when_asked() {
        let path = parse(&PATH.replace("carry = false", "carry = true")).expect("parses");
        let curve = &path.moves[1];
        let centre = Vector3::new(-0.45, 0.15, 0.3);
        for k in 0..=100 {
            let point = curve.at(0.03 * f64::from(k));
            assert!(((point.pose.origin - centre).norm() - 0.05).abs() < 1e-12);
        }
        let (start, half) = (curve.at(0.0).pose, curve.at(1.5).pose);
        let turned = half.rot_parent_child * start.rot_parent_child.transpose();
        assert!((turned.m11 + 1.0).abs() < 1e-12 && (turned.m33 - 1.0).abs() < 1e-12);
    }

    #[test]
    fn an_arm_of_fewer_than_six_joints_is_refused() {
        let mut robot = ur5();
        robot.joints.truncate(5);
        let path = PATH.replacen(", 0.0]", "]", 1);
        let text = plan::<5>(&robot, &path, PERIOD_S).expect_err("too few");
        let line = "a path of the tool: 5 joints cannot give the tool every pose, it takes six";
        assert_eq!(text.to_string(), line);
    }

    #[test]
    fn a_bad_path_is_refused_with_waypoint_and_reason() {
        // Text of the path's file, its replacement, start of the message.
        let cases = "
            [-0.5, -0.05, 0.3] | [-1.5, -0.05, 0.3] | move 3 (via), point 2, tool at (-1.500, -0.050, 0.300) m: out of reach: the wrist would be
            start = { xyz_m = [-0.4, -0.15 | start = { xyz_m = [-0.01, -0.05 | start, tool at (-0.010, -0.050, 0.250) m: out of reach: the wrist would be 0.051 m from the axis of joint 1
            duration_s = 1.5 | duration_s = 0.2 | move 1 (line), tool at (
            duration_s = 1.5 | duration_s = -1 | move[1].duration_s: is -1, must be above 0
            normal = [0, 0, 2] | normal = [0, 0, 0] | move[2].circle.normal: has no direction
            centre_m = [-0.45, 0.15 | centre_m = [-0.4, 0.15 | move[2].circle: the move starts on the axis
            rpy_rad = [2.8, 0.3, 0.5] | rpy_rad = [0.0, 0.0, 0.0] | move[1].line: turns the tool by more than 3 rad
            rpy_rad = [2.8, 0.3, 0.5] | rpy_rad = [180.0, 0.0, 0.0] | move[1].line.rpy_rad: is in radians, and has more than a turn
            [[move]]\\nduration_s = 1.5 | [[moves]]\\nduration_s = 1.5 | line 6: unknown field `moves`
            0.25], rpy_rad = [3.141592653589793, 0.0, 0.0] }\\n\\n[[ | 0.25] }\\n\\n[[ | start.rpy_rad: is missing
            -1.57, 0.0] | -1.57] | near_q_rad: 5 values for 6 joints
            xyz_m = [0.0, 0.0, 0.1] | xyz_m = [0.0, 0.0, nan] | tool.xyz_m: is not a finite number";
        let text = PATH.to_owned()
            + &"\n[[move]]\nduration_s = 3600\nline = { xyz_m = [-0.4, -0.15, 0.25] }".repeat(28);
        let error = plan::<6>(&ur5(), &text, PERIOD_S).expect_err("too long");
        assert_eq!(
            error.to_string(),
            "the moves take 100808 s, at most 100000 are played"
        );
        for case in cases.trim().lines() {
            let [good, bad, message] = case.split('|').map(str::trim).collect::<Vec<_>>()[..]
            else {
                panic!("three columns: {case}");
            };
            let [good, bad] = [good, bad].map(|text| text.replace("\\n", "\n"));
            assert!(PATH.contains(&good), "{good}");
            let error = plan::<6>(&ur5(), &PATH.replacen(&good, &bad, 1), PERIOD_S);
            let text = error.expect_err(message).to_string();
            assert!(text.starts_with(message), "{text}");
            assert_eq!(text.lines().count(), 1);
        }
    }

    #[test]
    fn a_path_that_meets_a_singularity_is_refused_there() {
        // Tool level and across: axis 6 is parallel to axis 4.
        let text = "
            start = { xyz_m = [-0.4, -0.19145, 0.3], rpy_rad = [1.5707963267948966, 0.0, 0.0] }
            [[move]]
            duration_s = 2.0
            line = { xyz_m = [-0.4, -0.25, 0.3] }
        ";
        let error = plan::<6>(&ur5(), text, PERIOD_S).map(|samples| samples.len());
        let line = "move 1 (line) at 0.000 s, tool at (-0.400, -0.191, 0.300) m: singular: axes 4 and 6 are parallel (wrist)";
        assert_eq!(error.expect_err("singular").to_string(), line);
    }
}
