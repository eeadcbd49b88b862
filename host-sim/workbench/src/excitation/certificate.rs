//! Certificate of an excitation: every limit with its worst value, on a fine grid with bounds between its points.

use super::clearance::Clearances;
use super::information::{Criterion, NOISE, SAMPLES, SIGN_WIDTH_RAD_S, condition_number};
use super::objective::{Objective, SearchConfig};
use super::rates::{MotionBounds, TorqueRates};
use super::rows::{Frames, Rows};
use super::series::Extremes;
use super::{Excitation, refused, unseen};
use crate::Refusal;
use crate::dynamics::{Motion, PerJoint, RigidBodies};
use crate::metrics::MOVING_RAD_S;
use crate::robot::Robot;
use serde::Serialize;
use std::f64::consts::TAU;

/// One limit, and the worst that the path makes of it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LimitCheck {
    /// Quantity: position, velocity, acceleration, torque, clearance, condition number.
    pub limit: &'static str,
    /// Joint, or what is kept clear of what.
    pub of: String,
    /// Unit of the three numbers.
    pub unit: &'static str,
    /// Worst value over the period, between the points included.
    pub worst: f64,
    /// The limit.
    pub allowed: f64,
    /// Distance of the worst value from the limit, negative when it is not kept.
    pub margin: f64,
}

impl LimitCheck {
    /// A value that must not exceed its limit.
    fn at_most(limit: &'static str, of: &str, unit: &'static str, value: (f64, f64)) -> Self {
        let (worst, allowed) = value;
        let margin = allowed - worst;
        Self {
            limit,
            of: of.to_owned(),
            unit,
            worst,
            allowed,
            margin,
        }
    }

    /// A value that must not fall below its limit.
    fn at_least(limit: &'static str, of: &str, unit: &'static str, value: (f64, f64)) -> Self {
        let margin = value.0 - value.1;
        Self {
            margin,
            ..Self::at_most(limit, of, unit, value)
        }
    }

    /// Margin over the limit. Metres of clearance have no size of their own: against a tenth of a metre.
    fn relative_margin(&self) -> f64 {
        self.margin / self.allowed.abs().max(0.1)
    }

    /// Limit, value and requirement, as of a limit that is not kept.
    fn violation(&self) -> String {
        let (limit, of, worst, allowed) = (self.limit, &self.of, self.worst, self.allowed);
        let unit = match self.unit {
            "1" => String::new(),
            unit => format!(" {unit}"),
        };
        format!("{limit} of {of} {worst:.4}{unit}, asked for {allowed:.4}{unit}")
    }
}

/// Limits that were checked before an excitation was handed out.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Certificate {
    /// All limits are kept.
    pub holds: bool,
    /// Points of one period that were checked.
    pub points: usize,
    /// Bounds used between the points.
    pub between_points: &'static str,
    /// Every limit with its worst value.
    pub limits: Vec<LimitCheck>,
    /// Columns behind the condition numbers: base parameters of the links, without rotors and friction.
    pub condition_number_columns: usize,
    /// Condition number of the raw stacked regressor (SI) in standard DH link frames.
    pub condition_number_dh: f64,
    /// Condition number in the board's link frames (Craig).
    pub condition_number_board: f64,
    /// Meaning of the condition numbers.
    pub condition_number_note: &'static str,
    /// Predicted torque error on task motion: RMS over joints of error RMS / torque RMS.
    pub predicted_nrmse_percent: f64,
    /// Predicted torque error of every joint on task motion, N·m RMS.
    pub predicted_error_nm: Vec<f64>,
    /// Those errors as shares of the torque limits.
    pub predicted_error_of_limit: Vec<f64>,
    /// Share of the joints' velocity and acceleration limits that the search used: 1 unless the torque limits, friction
    /// included, allow no more.
    pub speed_share: Vec<f64>,
    /// Link frames of `condition_number_dh`: standard DH where the description has DH rows, joint frames elsewhere.
    pub condition_number_frames: &'static str,
    /// Assumptions of the prediction.
    pub predicted_nrmse_note: String,
    /// Half −ln det of the information, per parameter, SI: what D-optimality makes small. Only differences mean something.
    pub ln_spread: f64,
    /// Objective of the search.
    pub criterion: Criterion,
    /// Seed of the search.
    pub seed: u64,
    /// Starts of the search.
    pub starts: usize,
    /// Version of the program.
    pub version: &'static str,
}

impl Certificate {
    /// By how much the worst limit is missed, relative to its size, and the error of all missed ones of its kind.
    pub(super) fn violation(&self) -> Option<(f64, Refusal)> {
        let relative = LimitCheck::relative_margin;
        let limits = || self.limits.iter();
        let worst = limits().min_by(|a, b| relative(a).total_cmp(&relative(b)))?;
        let alike = limits().filter(|check| check.limit == worst.limit);
        let missed = alike.filter(|check| check.margin < 0.0 || *check == worst);
        let missed: Vec<String> = missed.map(LimitCheck::violation).collect();
        let mend = match worst.limit {
            "torque" => ": correct it with --torque-limits, or narrow the motion with --range-rad",
            "condition number" => ": allow a larger one with --condition-limit",
            _ => "",
        };
        let missed = missed.join("; ");
        let refusal = refused(format!(
            "no path keeps all limits; the nearest one found has {missed}{mend}"
        ));
        Some((-relative(worst), refusal))
    }
}

/// Fewest points of a period that are checked; never farther apart than [`STEP_S`].
const POINTS: usize = 10_000;
const STEP_S: f64 = 1e-3;

const BETWEEN: &str = "position, velocity, acceleration: K h^2/8 with K the bound of the second derivative of the series; \
clearance and torque: h/2 times a bound of their rate of change around each point; points closer where that exceeds a torque limit";
const CONDITION_NOTE: &str = "raw SI base regressor of the links, first independent columns from left to right; it depends on \
link frames and columns: compare with the same frames and columns only";

/// Limits of torque and clearance that `excitation` breaks, as [`certify`] finds them.
pub(super) fn broken(robot: &Robot, excitation: &Excitation) -> Vec<LimitCheck> {
    let points = POINTS.max((excitation.period_s / STEP_S).ceil() as usize);
    let step = excitation.period_s / points as f64;
    let states = (0..points).map(|k| excitation.motion(k as f64 * step));
    let states: Vec<Motion> = states.collect();
    let mut limits = torque_limits(robot, excitation, step, points);
    limits.extend(clearance_limits(
        excitation,
        &Clearances::new(robot),
        &states,
        step,
    ));
    limits.retain(|check| check.margin < 0.0);
    limits
}

/// Checks `excitation` against the limits of `robot`, as `config` has them.
///
/// * `speed_share` share of the joints' limits that the search used
///
/// Errors: an empty range, parameters that the path cannot distinguish.
pub(super) fn certify(
    robot: &Robot,
    excitation: &Excitation,
    objective: &Objective,
    config: &SearchConfig,
    speed_share: &[f64],
) -> Result<Certificate, Refusal> {
    let points = POINTS.max((excitation.period_s / STEP_S).ceil() as usize);
    let step = excitation.period_s / points as f64;
    let states = (0..points).map(|k| excitation.motion(k as f64 * step));
    let states: Vec<Motion> = states.collect();
    let mut limits = joint_limits(robot, excitation, points, config.range_rad)?;
    limits.extend(torque_limits(robot, excitation, step, points));
    limits.extend(clearance_limits(
        excitation,
        &objective.clearances,
        &states,
        step,
    ));

    let board = Rows::new(robot, Frames::Board);
    let experiment = &objective.experiment;
    // Every tenth point: sums over a smooth periodic function do not need more.
    let sparse: Vec<Motion> = states.iter().step_by(10).copied().collect();
    let figures = experiment.figures(&objective.rows, &sparse);
    let (condition_dh, worth, errors) = figures.ok_or_else(unseen)?;
    let of_limits = errors.iter().zip(&robot.joints);
    let of_limits = of_limits.map(|(error, joint)| error / joint.limits.torque);
    let condition_board = condition_number(&board, &board.transposed(&sparse, SIGN_WIDTH_RAD_S));
    let frames = match robot.joints.iter().all(|joint| joint.dh_frame.is_some()) {
        true => "standard DH frames",
        false => "joint frames",
    };
    if config.criterion == Criterion::Constrained && config.condition_limit.is_finite() {
        limits.push(LimitCheck::at_most(
            "condition number",
            &format!("base regressor of the links, {frames}"),
            "1",
            (condition_dh, config.condition_limit),
        ));
    }
    Ok(Certificate {
        holds: limits.iter().all(|check| check.margin >= 0.0),
        points,
        between_points: BETWEEN,
        limits,
        condition_number_columns: objective.rows.link_columns.len(),
        condition_number_dh: condition_dh,
        condition_number_board: condition_board,
        condition_number_note: CONDITION_NOTE,
        predicted_nrmse_percent: 100.0 * worth.ln_error.exp(),
        predicted_error_of_limit: of_limits.collect(),
        predicted_error_nm: errors,
        speed_share: speed_share.to_vec(),
        condition_number_frames: frames,
        predicted_nrmse_note: format!(
            "weighted least squares on {SAMPLES} samples at 1 kHz, white torque noise of {} % of the torque limits, base, \
             rotor, viscous and Coulomb parameters ({} columns), task: 4 quintic via-point paths of 30 s; rows below {MOVING_RAD_S} \
             rad/s left out on both sides",
            100.0 * NOISE,
            objective.rows.count()
        ),
        ln_spread: worth.ln_spread,
        criterion: config.criterion,
        seed: excitation.seed,
        starts: config.starts,
        version: env!("CARGO_PKG_VERSION"),
    })
}

fn joint_limits(
    robot: &Robot,
    excitation: &Excitation,
    points: usize,
    range_rad: f64,
) -> Result<Vec<LimitCheck>, Refusal> {
    let allowed = Extremes::of_limits(robot, range_rad, 1.0)?;
    let omega = TAU / excitation.period_s;
    let mut checks = Vec::new();
    for ((joint, series), limits) in robot.joints.iter().zip(&excitation.joints).zip(&allowed) {
        let (extremes, of) = (series.extremes(omega, points), &joint.name);
        checks.push(if extremes.q.0 - limits.q.0 < limits.q.1 - extremes.q.1 {
            LimitCheck::at_least("position", of, "rad", (extremes.q.0, limits.q.0))
        } else {
            LimitCheck::at_most("position", of, "rad", (extremes.q.1, limits.q.1))
        });
        let (qd, qdd) = ((extremes.qd, limits.qd), (extremes.qdd, limits.qdd));
        checks.push(LimitCheck::at_most("velocity", of, "rad/s", qd));
        checks.push(LimitCheck::at_most("acceleration", of, "rad/s^2", qdd));
    }
    Ok(checks)
}

/// Bounds of the motion within half a step of `state`.
fn around(state: &Motion, jerk: &PerJoint<f64>, step: f64) -> MotionBounds {
    let (joints, half) = (jerk.len(), 0.5 * step);
    let qdd = PerJoint::from_fn(joints, |j| state.qdd[j].abs() + jerk[j] * half);
    MotionBounds {
        qd: PerJoint::from_fn(joints, |j| state.qd[j].abs() + qdd[j] * half),
        qdd,
        jerk: *jerk,
    }
}

fn jerks(excitation: &Excitation) -> PerJoint<f64> {
    let omega = TAU / excitation.period_s;
    let series = &excitation.joints;
    PerJoint::from_fn(series.len(), |j| series[j].higher_bounds(omega).0)
}

/// Parts of a step, at most, where the bound between its ends exceeds a limit: a power of [`PARTS`].
const MOST_PARTS: usize = 256;
const PARTS: usize = 4;

/// Rigid body and rotors exactly, friction at its largest. The bound between points is far from the torque where an arm is fast:
/// where it exceeds a limit, the points come closer.
fn torque_limits(
    robot: &Robot,
    excitation: &Excitation,
    step: f64,
    points: usize,
) -> Vec<LimitCheck> {
    let model = RigidBodies::new(robot);
    let rates = TorqueRates::new(robot);
    let jerk = jerks(excitation);
    let drag = |j: usize, qd: f64| {
        let f = &robot.joints[j].friction;
        f.viscous * qd + f.coulomb * (1.0 + f.stribeck_ratio) + f.cogging
    };
    // Torques at t_s, and their bounds within half of `step` around it.
    let torques = |t_s: f64, step: f64| {
        let motion = excitation.motion(t_s);
        let bounds = around(&motion, &jerk, step);
        let rigid = model.inverse_dynamics(&motion).map(f64::abs);
        let between = rates.bound(&bounds);
        let here = |j: usize| rigid[j] + drag(j, motion.qd[j].abs());
        let bound = |j: usize| rigid[j] + drag(j, bounds.qd[j]) + between[j] * (0.5 * step);
        let joints = rigid.len();
        (
            PerJoint::from_fn(joints, here),
            PerJoint::from_fn(joints, bound),
        )
    };
    let exceeds = |torque: &PerJoint<f64>| {
        let mut joints = robot.joints.iter().zip(torque.iter());
        joints.any(|(joint, torque)| joint.limits.torque < *torque)
    };
    let larger = |one: PerJoint<f64>, other: PerJoint<f64>| {
        PerJoint::from_fn(one.len(), |j| one[j].max(other[j]))
    };
    let zero = PerJoint::repeat(model.joints(), 0.0);
    let mut worst = zero;
    for k in 0..points {
        let t_s = k as f64 * step;
        let (here, mut bound) = torques(t_s, step);
        let mut parts = 1;
        while exceeds(&bound) && !exceeds(&here) && parts < MOST_PARTS {
            parts *= PARTS;
            let part = step / parts as f64;
            let places = (0..parts).map(|i| t_s + (i as f64 + 0.5) * part - 0.5 * step);
            bound = places.map(|t_s| torques(t_s, part).1).fold(zero, larger);
        }
        worst = larger(worst, bound);
    }
    let joints = robot.joints.iter().zip(worst.iter());
    let check = joints.map(|(joint, worst)| {
        LimitCheck::at_most("torque", &joint.name, "N*m", (*worst, joint.limits.torque))
    });
    check.collect()
}

fn clearance_limits(
    excitation: &Excitation,
    clearances: &Clearances,
    states: &[Motion],
    step: f64,
) -> Vec<LimitCheck> {
    let jerk = jerks(excitation);
    let mut worst = vec![f64::INFINITY; clearances.count()];
    let mut distances = worst.clone();
    for state in states {
        clearances.write(&state.q, &mut distances);
        let speeds = around(state, &jerk, step).qd;
        for (index, distance) in distances.iter().enumerate() {
            let between = clearances.rate(index, &speeds) * 0.5 * step;
            worst[index] = worst[index].min(distance - between);
        }
    }
    let check = |(index, worst): (usize, f64)| {
        let value = (worst, clearances.required);
        LimitCheck::at_least("clearance", &clearances.name(index), "m", value)
    };
    worst.into_iter().enumerate().map(check).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::excitation::series::JointSeries;

    /// One joint far from its torque limit, with a fast and light one behind it.
    #[test]
    fn a_coarse_bound_between_points_refuses_no_motion_that_keeps_its_limit() {
        let mut robot = Robot::load("ur5").expect("built in");
        let swing = |size: f64| JointSeries {
            q0_rad: 0.3,
            a_rad_s: [size, 0.0, 0.0, 0.0, -size],
            b_rad_s: [0.0; 5],
        };
        let excitation = Excitation::of(&robot, 10.0, 1, vec![swing(1.4); 6]);
        let worst = |robot: &Robot, points: usize| -> Vec<f64> {
            let checks = torque_limits(robot, &excitation, 10.0 / points as f64, points);
            checks.iter().map(|check| check.worst).collect()
        };
        let (coarse, fine) = (worst(&robot, 1000), worst(&robot, 100_000));
        let between: Vec<f64> = coarse.iter().zip(&fine).map(|(c, f)| c - f).collect();
        assert!(between.iter().all(|between| *between > 0.0), "{between:?}");
        // A limit that the motion keeps, and the bound between a thousand points does not.
        for (joint, (fine, between)) in robot.joints.iter_mut().zip(fine.iter().zip(&between)) {
            joint.limits.torque = fine + 0.3 * between;
        }
        let closer = worst(&robot, 1000);
        for ((joint, fine), closer) in robot.joints.iter().zip(&fine).zip(closer) {
            let (name, allowed) = (&joint.name, joint.limits.torque);
            let within = 0.99 * fine <= closer && closer <= allowed;
            assert!(within, "{name}: {fine} {closer} {allowed}");
        }
        // One that the motion does not keep is missed with any points.
        robot.joints[1].limits.torque = 0.95 * fine[1];
        assert!(worst(&robot, 1000)[1] > robot.joints[1].limits.torque);
    }
}
