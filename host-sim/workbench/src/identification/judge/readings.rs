//! Other readings of the columns of a log: joints exchanged, positions of another scale, direction or zero, a clock of another
//! rate, and gravity of another direction.

use super::CENTRE_M;
use super::explained::{COLUMNS, Explained, explain, links, of_drive, weight};
use super::sums::Extremes;
use crate::dynamics::{Motion, PerJoint, RigidBodies};
use crate::metrics::even_sample;
use crate::robot::Robot;
use nalgebra::{DMatrix, Matrix3, Vector3};
use std::f64::consts::{FRAC_PI_2, PI};

/// Fall of the sum of the logarithms of unexplained shares that proves another reading of the columns.
const READING_EVIDENCE: f64 = 2.0;
/// Most rows on which other readings are tried.
const READING_ROWS: usize = 300;
/// [`weight`] from which gravity gives the zero of a joint.
const CERTAIN: f64 = 2.0;
/// Part of gravity below which torques are without it.
const WEIGHTLESS: f64 = 0.3;

/// Gravity where a description has none, m/s².
const STANDARD_M_S2: f64 = 9.80665;

/// Another reading of the columns of a log.
struct Reading {
    /// The finding, if it explains the torques far better.
    text: String,
    states: Vec<Motion>,
    /// Column of each joint's torque, and its sign.
    torques: PerJoint<(usize, f64)>,
    /// Gravity in the base frame, m/s², if it is not that of the description.
    gravity: Option<Vector3<f64>>,
    /// Rate of the clock over that of the log.
    rate: f64,
}

/// Motion by a clock of `rate` times the rate.
pub(super) fn at_rate(state: &Motion, rate: f64) -> Motion {
    Motion {
        q: state.q,
        qd: state.qd.map(|qd| qd * rate),
        qdd: state.qdd.map(|qdd| qdd * rate * rate),
    }
}

/// Other readings of the columns that are tried: a clock of another rate, two joints exchanged, and one joint that counts the
/// other way, in another scale or from another zero.
///
/// * `weights` [`weight`] of the joints
fn readings(states: &[Motion], extremes: &[Extremes], weights: &[f64]) -> Vec<Reading> {
    let joints = extremes.len();
    let straight = PerJoint::from_fn(joints, |joint| (joint, 1.0));
    let changed = |change: &dyn Fn(&mut PerJoint<f64>)| -> Vec<Motion> {
        let mut changed = states.to_vec();
        for Motion { q, qd, qdd } in &mut changed {
            [q, qd, qdd].into_iter().for_each(change);
        }
        changed
    };
    let mut readings = Vec::new();
    let mut read = |columns: String, otherwise: &str, states, torques| {
        let text =
            format!("{columns}: {otherwise} they follow the description, as they are they do not");
        readings.push(Reading {
            text,
            states,
            torques,
            gravity: None,
            rate: 1.0,
        });
    };
    let moved = (0..joints).filter(|joint| extremes[*joint].moved());
    let moved: Vec<usize> = moved.collect();
    for (place, &a) in moved.iter().enumerate() {
        for &b in &moved[place + 1..] {
            let mut swap = straight;
            swap.swap(a, b);
            let exchanged = changed(&|own| own.swap(a, b));
            let are = format!("of joints {} and {} are swapped", a + 1, b + 1);
            for (what, states, torques) in [
                ("torques", states.to_vec(), swap),
                ("positions", exchanged.clone(), straight),
                ("positions and torques", exchanged, swap),
            ] {
                read(format!("{what} {are}"), "exchanged", states, torques);
            }
        }
        let mut turned = straight;
        turned[a].1 = -1.0;
        let scaled = |scale: f64| changed(&|own| own[a] *= scale);
        for (what, torques) in [("positions", straight), ("positions and torques", turned)] {
            let text = format!("{what} of joint {} count the other way", a + 1);
            read(text, "turned", scaled(-1.0), torques);
        }
        // An error of a light joint's centres of mass may turn its gravity by any angle.
        if weights[a] < CERTAIN {
            continue;
        }
        let have = format!("positions of joint {} have another scale", a + 1);
        read(have.clone(), "halved", scaled(0.5), straight);
        read(have, "doubled", scaled(2.0), straight);
        for (angle, more) in [
            (FRAC_PI_2, "90° more"),
            (PI, "180° more"),
            (-FRAC_PI_2, "90° less"),
        ] {
            let mut moved = states.to_vec();
            moved.iter_mut().for_each(|state| state.q[a] += angle);
            let have = format!("positions of joint {} have another zero", a + 1);
            read(have, &format!("with {more}"), moved, straight);
        }
    }
    // Logged velocities would contradict the positions.
    let rates: &[_] = match extremes.iter().any(Extremes::has_velocity) {
        true => &[],
        false => &[
            (2.0, "halved"),
            (0.5, "doubled"),
            (1.25, "multiplied by 0.8"),
            (0.8, "multiplied by 1.25"),
        ],
    };
    for &(rate, otherwise) in rates {
        let text = format!(
            "times: {otherwise} they follow the description and any other parameters of this arm, as they are they do not"
        );
        readings.push(Reading {
            text,
            states: states.iter().map(|state| at_rate(state, rate)).collect(),
            torques: straight,
            gravity: None,
            rate,
        });
    }
    readings
}

/// Reading with the gravity that explains the torques best; none where errors of the described centres of mass make a change
/// of gravity as large.
///
/// ```text
/// tau = Σ_k g_k G_k(q) + s M(q) q̈ + …    G_k = torques under unit gravity along axis k of the base
/// ```
/// The three g_k are common to all joints; scale s of the torque of motion, friction, rotor and offset are each joint's own.
fn other_gravity(
    bare: &Robot,
    states: &[Motion],
    rows: &[&(Motion, PerJoint<f64>)],
) -> Option<Reading> {
    let along = |gravity: Vector3<f64>| {
        let robot = Robot {
            gravity,
            ..bare.clone()
        };
        links(&RigidBodies::new(&robot), states)
    };
    let axes = [Vector3::x(), Vector3::y(), Vector3::z()].map(along);
    let (mut gram, mut moment) = (Matrix3::zeros(), Vector3::zeros());
    for joint in 0..bare.joint_count() {
        let own = DMatrix::from_fn(states.len(), COLUMNS, |row, column| {
            let [all, gravity] = axes[0][row];
            of_drive(&states[row], joint, column, all[joint] - gravity[joint])
        });
        let common = DMatrix::from_fn(states.len(), 4, |row, column| match column {
            3 => rows[row].1[joint],
            axis => axes[axis][row][1][joint],
        });
        // What a joint's own columns explain is taken off.
        let inverse = own.clone().pseudo_inverse(1e-9).ok()?;
        let left = &common - &own * (inverse * &common);
        let (x, y) = (left.columns(0, 3), left.column(3));
        let weight = y.norm_squared();
        if weight > 0.0 {
            gram += x.tr_mul(&x) / weight;
            moment += x.tr_mul(&y) / weight;
        }
    }
    // Gravity along the axes of an arm whose axes are parallel gives no torque, and stays as it is described.
    let eigen = gram.symmetric_eigen();
    let visible = |k: usize| eigen.eigenvalues[k] > 1e-6 * eigen.eigenvalues.max();
    let (mut seen, mut hidden, mut described_seen) =
        (Vector3::zeros(), Vector3::zeros(), Vector3::<f64>::zeros());
    for (k, axis) in eigen.eigenvectors.column_iter().enumerate() {
        let described = axis * axis.dot(&bare.gravity);
        if visible(k) {
            seen += axis * (axis.dot(&moment) / eigen.eigenvalues[k]);
            described_seen += described;
        } else {
            hidden += described;
        }
    }
    // Every base has gravity of one size: torques of another size are those of drive gains, units or masses.
    let size = match bare.gravity.norm() {
        0.0 => STANDARD_M_S2,
        size => size,
    };
    let carried = described_seen.norm();
    let weightless = carried > WEIGHTLESS * size && seen.norm() < WEIGHTLESS * carried;
    let (gravity, text) = if weightless {
        let text =
            "the torques are without gravity: add what the drives or their software take off";
        (Vector3::zeros(), text.to_owned())
    } else {
        let rest = (size.powi(2) - seen.norm_squared()).max(0.0).sqrt();
        let found = match hidden.norm() / size {
            0.0..1e-6 => seen,
            share => seen + hidden * (rest / (share * size)),
        };
        let gravity = found * (size / found.norm().max(f64::MIN_POSITIVE));
        let angle = gravity.angle(&bare.gravity);
        // Adding 0 takes the sign off a zero.
        let [x, y, z] = gravity.map(|g| (10.0 * g).round() / 10.0 + 0.0).into();
        let text = format!(
            "gravity is another one than in the description: with gravity_m_s2 = [{x:.1}, {y:.1}, {z:.1}], a base turned by {angle:.2} rad, the torques follow it"
        );
        (gravity, text)
    };
    let change = gravity - bare.gravity;
    let changed = |joint: usize| {
        let along = |row: usize, axis: usize| change[axis] * axes[axis][row][1][joint];
        let torques = (0..states.len()).map(|row| (0..3).map(|axis| along(row, axis)).sum::<f64>());
        torques.map(|torque| torque.powi(2)).sum::<f64>()
    };
    // Of all joints together: under vertical gravity, centres of mass give an upright axis no torque.
    let share = |joint: usize| bare.joints[joint].limits.torque.powi(-2);
    let moved = of_centres(bare, states).into_iter().enumerate();
    let moved: f64 = moved.map(|(joint, moved)| share(joint) * moved).sum();
    let changed: f64 = (0..bare.joint_count())
        .map(|joint| share(joint) * changed(joint))
        .sum();
    if changed <= CERTAIN * CERTAIN * moved {
        return None;
    }
    Some(Reading {
        text,
        states: states.to_vec(),
        torques: PerJoint::from_fn(bare.joint_count(), |joint| (joint, 1.0)),
        gravity: Some(gravity),
        rate: 1.0,
    })
}

/// Squares of the torques by which errors of the described centres of mass change gravity, (N·m)², summed over the rows.
fn of_centres(bare: &Robot, states: &[Motion]) -> Vec<f64> {
    let gravity = |robot: &Robot| -> Vec<PerJoint<f64>> {
        let model = RigidBodies::new(robot);
        let of = |state: &Motion| model.gravity_torques(&state.q);
        states.iter().map(of).collect()
    };
    let described = gravity(bare);
    let mut squares = vec![0.0; bare.joint_count()];
    for (link, axis) in (0..squares.len()).flat_map(|link| (0..3).map(move |axis| (link, axis))) {
        let mut other = bare.clone();
        other.joints[link].link.com[axis] += CENTRE_M;
        for (moved, own) in gravity(&other).iter().zip(&described) {
            for (joint, square) in squares.iter_mut().enumerate() {
                *square += (moved[joint] - own[joint]).powi(2);
            }
        }
    }
    squares
}

/// The reading of the columns that explains the torques far better than the one that was taken, if there is one.
///
/// * `bare` the description without rotors
/// * `fitted` fall of the logarithm of what free parameters leave, by a clock of another rate
pub(super) fn other_reading(
    bare: &Robot,
    rows: &[(Motion, PerJoint<f64>)],
    extremes: &[Extremes],
    fitted: &dyn Fn(f64) -> f64,
) -> Option<String> {
    let rows: Vec<&(Motion, PerJoint<f64>)> = even_sample(rows, READING_ROWS).collect();
    let left = |explained: &Explained| explained.rest.clamp(1e-3, 1.0).ln();
    // A torque of another sign or size than gravity's is no sound explanation.
    let size = |explained: &Explained| match explained.heavy {
        true if explained.scale > 0.05 => explained.scale.ln().abs(),
        true => 3.0,
        false => 0.0,
    };
    // Logarithms of the shares that a reading leaves unexplained, without and with the cost of the sizes.
    let judged = |model: &RigidBodies, states: &[Motion], torques: &PerJoint<(usize, f64)>| {
        let of_links = links(model, states);
        let joints = torques.iter().enumerate().map(|(joint, (place, sign))| {
            let limit = bare.joints[joint].limits.torque;
            let tau = |row: usize| sign * rows[row].1[*place];
            explain(joint, states, &of_links, limit, tau)
        });
        let joints: Vec<Explained> = joints.collect();
        let left: f64 = joints.iter().map(left).sum();
        let sizes: f64 = joints.iter().map(size).sum();
        [left, left + sizes]
    };
    let states: Vec<Motion> = rows.iter().map(|row| row.0).collect();
    let straight = PerJoint::from_fn(extremes.len(), |joint| (joint, 1.0));
    let described = RigidBodies::new(bare);
    let own = judged(&described, &states, &straight);
    let mut best = (0.0, None);
    let gravity = other_gravity(bare, &states, &rows);
    let of_links = links(&described, &states);
    let weights = (0..extremes.len()).map(|joint| weight(bare, &of_links, joint));
    let weights: Vec<f64> = weights.collect();
    for reading in readings(&states, extremes, &weights)
        .into_iter()
        .chain(gravity)
    {
        let model = reading.gravity.map(|gravity| {
            RigidBodies::new(&Robot {
                gravity,
                ..bare.clone()
            })
        });
        let model = model.as_ref().unwrap_or(&described);
        let other = judged(model, &reading.states, &reading.torques);
        // Masses of a description may be wrong, and sizes alone are no evidence.
        let falls = [own[0] - other[0], own[1] - other[1]];
        let least = falls[0].min(falls[1]);
        let proves = match reading.rate == 1.0 {
            true => least > READING_EVIDENCE,
            // The inertias of a description may fit to another clock by chance: free parameters decide.
            false => least > 0.0 && fitted(reading.rate) > READING_EVIDENCE,
        };
        if proves && falls[1] > best.0 {
            best = (falls[1], Some(reading.text));
        }
    }
    best.1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dynamics::random_motions;

    /// Finding of the log of `own`, its base on a slope, by the description `arm`.
    fn read(arm: &Robot, own: &Robot, slope: f64, scale: f64) -> Option<String> {
        let gravity = Vector3::new(slope.sin(), 0.0, -slope.cos()) * 9.81;
        let model = RigidBodies::new(&Robot {
            gravity,
            ..own.clone()
        });
        let joints = arm.joint_count();
        let motions = random_motions(joints, 600).into_iter().zip(0..);
        let rows = motions.map(|(state, row)| {
            let noise = 0.01 * f64::from(row * 7 % 11 - 5);
            let tau = model.inverse_dynamics(&state);
            (state, tau.map(|tau| scale * tau + noise))
        });
        let rows: Vec<_> = rows.collect();
        other_reading(arm, &rows, &vec![Extremes::none(); joints], &|_| 0.0)
    }

    /// An error of the described centre of mass turns the gravity of a single joint as a slope does.
    #[test]
    fn the_centre_of_mass_of_a_single_joint_is_no_slope() {
        let mut arm = Robot::load("ur5").expect("built in");
        arm.joints = vec![arm.joints[1].clone()];
        arm.joints[0].drive.rotor_inertia = 0.0;
        let mut own = arm.clone();
        own.joints[0].link.com.y += CENTRE_M;
        own.joints[0].link.com.x += CENTRE_M;
        assert_eq!(read(&arm, &own, 0.0, 1.0), None);
        let text = read(&arm, &arm, 0.5, 1.0).expect("a slope");
        assert!(text.contains("gravity_m_s2 = [4.7, 0.0, -8.6]"), "{text}");
    }

    /// The upright axis has no torque but that of the slope, however little it is.
    #[test]
    fn a_base_that_is_nearly_level_is_no_other_gravity() {
        let arm = Robot::load("ur5").expect("built in");
        assert_eq!(read(&arm, &arm, 0.02, 1.0), None);
        let text = read(&arm, &arm, 0.3, 1.0).expect("a slope");
        assert!(text.contains("a base turned by 0.30 rad"), "{text}");
    }

    /// Free parameters find the other clock, and the description agrees.
    #[test]
    fn a_clock_a_quarter_wrong_is_named() {
        let arm = Robot::load("ur5").expect("built in");
        let model = RigidBodies::new(&arm);
        let joints = arm.joint_count();
        let motions = random_motions(joints, 600);
        let row = |state: Motion| (at_rate(&state, 0.8), model.inverse_dynamics(&state));
        let rows: Vec<_> = motions.into_iter().map(row).collect();
        let moved = Extremes::none();
        let fitted = |rate: f64| if rate == 1.25 { 3.0 } else { 0.0 };
        let text = other_reading(&arm, &rows, &vec![moved; joints], &fitted).expect("a finding");
        assert!(text.starts_with("times: multiplied by 0.8 they"), "{text}");
        assert_eq!(
            other_reading(&arm, &rows, &vec![moved; joints], &|_| 0.0),
            None
        );
    }

    /// All axes of the arm are vertical, and its base is on a slope.
    #[test]
    fn the_slope_of_an_arm_with_parallel_axes_is_found() {
        let mut arm = Robot::load("ur5").expect("built in");
        for joint in &mut arm.joints {
            joint.placement.rot_parent_child = Matrix3::identity();
            joint.placement.origin = Vector3::new(0.3, 0.0, 0.05);
            joint.drive.rotor_inertia = 0.0;
        }
        assert_eq!(read(&arm, &arm, 0.0, 1.0), None);
        let text = read(&arm, &arm, 0.1, 1.0).expect("a slope");
        assert!(text.contains("gravity_m_s2 = [1.0, 0.0, -9.8]"), "{text}");
        assert!(text.contains("a base turned by 0.10 rad"), "{text}");
        // Gravity has one size, whatever the scale of the torques, and a slope that is not there is no lack of gravity.
        let text = read(&arm, &arm, FRAC_PI_2, 3.0).expect("a wall");
        assert!(text.contains("gravity_m_s2 = [9.8, 0.0, 0.0]"), "{text}");
        arm.gravity = Vector3::new(0.1_f64.sin(), 0.0, -0.1_f64.cos()) * 9.81;
        let text = read(&arm, &arm, 0.0, 1.0).expect("no slope");
        assert!(text.contains("gravity_m_s2 = [0.0, 0.0, -9.8]"), "{text}");
    }
}
