//! Torques of a log against those of the description: signs, sizes, order of the joints, noise.

use super::{
    CENTRE_M, DEVIATIONS, Extremes, GRAVITY_SHARE, JointCheck, Judgement, MOVED, NOISE_SHARE,
    SOUND_SCALE, SOUND_SIZE, SWAP_EVIDENCE, SWAPPED_REST,
};
use crate::dynamics::{Motion, PerJoint, RigidBodies};
use crate::identification::columns::SIGN_WIDTH_RAD_S;
use crate::robot::Robot;
use nalgebra::{DMatrix, DVector, Matrix5, Vector5};

/// Most rows on which other orders of the joints are tried.
const SWAP_ROWS: usize = 300;

/// Regression of one joint's torque on the description's link torque, friction and a rotor.
#[derive(Clone, Copy)]
struct Explained {
    /// Share of the variance left.
    rest: f64,
    /// Torque over that of the description's links.
    scale: f64,
    deviation: f64,
    /// Inertia beside that of the description's links, kg·m².
    rotor: f64,
    /// Gravity is large enough to decide.
    heavy: bool,
    /// Matrix and right side of the normal equations, and square of the torque.
    normal: (Matrix5<f64>, Vector5<f64>, f64),
}

/// Fall of the logarithm of the unexplained share that proves a torque of the wrong sign.
const SIGN_EVIDENCE: f64 = 1.0;
/// Rounds of the fit within bounds.
const ROUNDS: usize = 300;

impl Explained {
    /// Square of what a torque of this sign leaves: friction and rotors of an arm are not negative.
    ///
    /// * `scales` range of the torque over that of the description's links
    fn left(&self, sign: f64, scales: (f64, f64)) -> f64 {
        let (gram, moment, square) = &self.normal;
        let moment = moment * sign;
        let least = [scales.0, 0.0, 0.0, 0.0, f64::NEG_INFINITY];
        let mut beta = Vector5::zeros();
        for k in (0..ROUNDS).flat_map(|_| 0..least.len()) {
            let own = (moment[k] - (gram.row(k) * beta)[0]) / gram[(k, k)] + beta[k];
            let most = if k == 0 { scales.1 } else { f64::INFINITY };
            beta[k] = own.clamp(least[k], most);
        }
        let left = square - 2.0 * moment.dot(&beta) + beta.dot(&(gram * beta));
        // What rounding leaves of an exact torque is no evidence.
        left.max(1e-9 * square)
    }

    /// The torque is explained by its opposite alone.
    ///
    /// * `certain` gravity is beyond what an error of the described centres of mass makes; else it may have either sign
    fn is_turned(&self, certain: bool) -> bool {
        let evidence = |scales: (f64, f64)| {
            let [kept, turned] = [1.0, -1.0].map(|sign| self.left(sign, scales));
            (kept / turned).ln()
        };
        // Where gravity may have either sign, the evidence of friction and rotor counts as much.
        let free = match certain {
            true => 0.0,
            false => evidence((f64::NEG_INFINITY, f64::INFINITY)),
        };
        evidence(SOUND_SCALE) + free > SIGN_EVIDENCE
    }
}

/// Torque of the links of the description and gravity at every row.
fn links(model: &RigidBodies, states: &[Motion]) -> Vec<[PerJoint<f64>; 2]> {
    let torques = |state: &Motion| {
        [
            model.inverse_dynamics(state),
            model.gravity_torques(&state.q),
        ]
    };
    states.iter().map(torques).collect()
}

fn explain(
    joint: usize,
    states: &[Motion],
    links: &[[PerJoint<f64>; 2]],
    limit: f64,
    tau: impl Fn(usize) -> f64,
) -> Explained {
    const COLUMNS: usize = 5;
    let count = states.len();
    let x = DMatrix::from_fn(count, COLUMNS, |row, column| {
        let state = &states[row];
        match column {
            0 => links[row][0][joint],
            1 => (state.qd[joint] / (5.0 * SIGN_WIDTH_RAD_S)).tanh(),
            2 => state.qd[joint],
            3 => state.qdd[joint],
            _ => 1.0,
        }
    });
    let y = DVector::from_fn(count, |row, _| tau(row));
    let mean = y.mean();
    let variance = y.iter().map(|tau| (tau - mean).powi(2)).sum::<f64>();
    let mut gram: Matrix5<f64> = x.tr_mul(&x).fixed_view::<5, 5>(0, 0).into();
    let moment: Vector5<f64> = x.tr_mul(&y).fixed_rows::<5>(0).into();
    // A joint without link torque, or one that stands still, has a column of zeros.
    for k in 0..COLUMNS {
        gram[(k, k)] += 1e-9 * gram[(k, k)] + 1e-12;
    }
    let normal = (gram, moment, y.norm_squared());
    let Some(inverse) = gram.try_inverse() else {
        return Explained {
            rest: 1.0,
            scale: 1.0,
            deviation: f64::INFINITY,
            rotor: 0.0,
            heavy: false,
            normal,
        };
    };
    let beta = inverse * moment;
    let rest = (&y - &x * beta).norm_squared();
    let noise = rest / (count.max(COLUMNS + 1) - COLUMNS) as f64;
    let gravity = links.iter().map(|link| link[1][joint].powi(2)).sum::<f64>();
    Explained {
        // A torque that never changes follows nothing.
        rest: if variance > 0.0 { rest / variance } else { 1.0 },
        scale: beta[0],
        deviation: (noise * inverse[(0, 0)]).sqrt(),
        rotor: beta[3],
        normal,
        heavy: (gravity / count.max(1) as f64).sqrt() > GRAVITY_SHARE * limit,
    }
}

/// Compares the torques with those of the description.
pub(super) fn compare(
    judgement: &mut Judgement,
    robot: &Robot,
    rows: &[(Motion, PerJoint<f64>)],
    extremes: &[Extremes],
    gain: f64,
) {
    let mut bare = robot.clone();
    for joint in &mut bare.joints {
        joint.drive.rotor_inertia = 0.0;
    }
    let model = RigidBodies::new(&bare);
    let joints = model.joints();
    let states: Vec<Motion> = rows.iter().map(|(state, _)| *state).collect();
    let of_links = links(&model, &states);
    let limit = |joint: usize| robot.joints[joint].limits.torque;
    let explained = (0..joints).map(|joint| {
        let tau = |row: usize| rows[row].1[joint];
        explain(joint, &states, &of_links, limit(joint), tau)
    });
    let own: Vec<Explained> = explained.collect();
    for (joint, seen) in extremes.iter().enumerate() {
        let told = own[joint].deviation < 0.3;
        judgement.joints.push(JointCheck {
            position_rad: seen.position,
            speed_rad_s: seen.speed,
            torque_rms_nm: seen.rms(),
            noise_floor_nm: seen.noise() * gain,
            unexplained_ratio: own[joint].rest,
            scale_ratio: (told && own[joint].heavy).then_some(own[joint].scale),
        });
    }
    let noise: Vec<usize> = (0..joints)
        .filter(|&joint| own[joint].rest > NOISE_SHARE)
        .collect();
    let heavy: Vec<usize> = (0..joints).filter(|&joint| own[joint].heavy).collect();
    if noise.len() == joints {
        judgement.find(
            true,
            "the torques of all joints are noise: they follow neither the motion nor gravity",
        );
        return;
    }
    if let Some(text) = order(&model, robot, rows, (&own, extremes)) {
        judgement.find(true, text);
        return;
    }
    for joint in &noise {
        if extremes[*joint].torque == 0.0 {
            judgement.find(
                false,
                format!("joint {}: its torque is always zero", joint + 1),
            );
            continue;
        }
        let share = 100.0 * own[*joint].rest;
        let seen = &extremes[*joint];
        let noise = match seen.noise() > 0.5 * seen.rms() {
            true => ": it is noise",
            false => "",
        };
        judgement.find(
            false,
            format!("joint {}: {share:.0} % of the variance of its torque does not follow the motion{noise}", joint + 1),
        );
    }
    let sound = |joint: usize| own[joint].rest <= NOISE_SHARE;
    let certain = |joint: usize| {
        let mass: f64 = robot.joints[joint..].iter().map(|it| it.link.mass).sum();
        let squares = of_links.iter().map(|links| links[1][joint].powi(2));
        let gravity = (squares.sum::<f64>() / of_links.len() as f64).sqrt();
        gravity > mass * robot.gravity.norm() * CENTRE_M
    };
    // Stiction alone carries a light joint at rest.
    let turned: Vec<usize> = (0..joints)
        .filter(|&joint| sound(joint) && (own[joint].heavy || extremes[joint].moved()))
        .filter(|&joint| own[joint].is_turned(certain(joint)))
        .collect();
    // Where the torques oppose those of the links even without the joint with most of them, all are turned.
    let shares = (0..joints).filter(|&joint| sound(joint)).map(|joint| {
        let products = rows.iter().zip(&of_links);
        let sum = products.map(|((_, tau), links)| tau[joint] * links[0][joint]);
        sum.sum::<f64>() / limit(joint).powi(2)
    });
    let shares: Vec<f64> = shares.collect();
    let most = shares
        .iter()
        .copied()
        .fold(0.0, |a: f64, b| if a.abs() > b.abs() { a } else { b });
    if !turned.is_empty() && most < 0.0 && shares.iter().sum::<f64>() < most {
        judgement.find(
            true,
            "the torques of all joints have the wrong sign: positive ones must accelerate +q; is this a log that counts the other way (--units tau=-Nm or i=-A)?",
        );
        return;
    }
    if !turned.is_empty() {
        let names: Vec<String> = turned.iter().map(|joint| (joint + 1).to_string()).collect();
        judgement.find(true, format!(
            "torque of joint {} has the wrong sign: it must be positive where it accelerates +q",
            names.join(", ")
        ));
        return;
    }
    for (joint, seen) in extremes.iter().enumerate() {
        let friction = &robot.joints[joint].friction;
        let moved = states
            .iter()
            .filter(|state| state.qd[joint].abs() > MOVED.0);
        if friction.coulomb <= 0.0 || !sound(joint) || moved.count() * 10 < states.len() {
            continue;
        }
        // Where the description has no rotor, its inertia is unknown.
        let rotor = match robot.joints[joint].drive.rotor_inertia {
            0.0 => own[joint].rotor.max(0.0),
            rotor => rotor,
        };
        let described = states.iter().zip(&of_links).map(|(state, links)| {
            let (qd, rotor) = (state.qd[joint], rotor * state.qdd[joint]);
            links[0][joint]
                + rotor
                + friction.coulomb * (qd / SIGN_WIDTH_RAD_S).tanh()
                + friction.viscous * qd
        });
        let described = described.map(|tau| tau * tau).sum::<f64>() / states.len() as f64;
        let size = (seen.power / f64::max(seen.rows, 1.0) / described).sqrt();
        let text = format!(
            "torque of joint {} is {size:.2} times the description's: drive gain or unit?",
            joint + 1
        );
        // A sensor behind the gear does not see the friction of a description.
        if size < SOUND_SIZE.0 {
            judgement.find(false, text);
        } else if size > SOUND_SIZE.1 {
            judgement.find(true, text);
            return;
        }
    }
    let off = |joint: &&usize| {
        let scale = &own[**joint];
        let (low, high) = SOUND_SCALE;
        let clear = scale.deviation * DEVIATIONS < (scale.scale - 1.0).abs();
        sound(**joint) && clear && !(low..=high).contains(&scale.scale)
    };
    let off: Vec<&usize> = heavy.iter().filter(off).collect();
    let unexplained = heavy.iter().filter(|&&joint| own[joint].rest > 0.6).count();
    match (&off[..], unexplained) {
        ([], 0) => {}
        ([joint], 0) if heavy.len() > 1 => judgement.find(
            true,
            format!(
                "torque of joint {} is {:.2} times the description's, those of the others are not: drive gain, unit, mass, or another arm?",
                **joint + 1,
                own[**joint].scale
            ),
        ),
        _ => {
            let scales: Vec<String> = heavy
                .iter()
                .map(|&joint| format!("J{} {:.2} ± {:.2}, {:.0} % unexplained", joint + 1, own[joint].scale, own[joint].deviation, 100.0 * own[joint].rest))
                .collect();
            judgement.find(
                true,
                format!(
                    "gravity does not fit description '{}' (times its torque: {}): another arm, another base (its gravity_m_s2), or a heavy payload?",
                    robot.name,
                    scales.join("; ")
                ),
            );
        }
    }
}

/// Two joints whose positions or torques stand in each other's columns, if that explains the torques far better.
fn order(
    model: &RigidBodies,
    robot: &Robot,
    rows: &[(Motion, PerJoint<f64>)],
    (own, extremes): (&[Explained], &[Extremes]),
) -> Option<String> {
    let step = rows.len().div_ceil(SWAP_ROWS).max(1);
    let rows: Vec<&(Motion, PerJoint<f64>)> = rows.iter().step_by(step).collect();
    // A torque of another sign or size than gravity's is no sound explanation.
    let cost = |explained: &Explained| {
        let scale = match explained.heavy {
            true if explained.scale > 0.05 => explained.scale.ln().abs(),
            true => 3.0,
            false => 0.0,
        };
        explained.rest.clamp(1e-3, 1.0).ln() + scale
    };
    let states: Vec<Motion> = rows.iter().map(|row| row.0).collect();
    let of_links = links(model, &states);
    // Cost of an order, and the share of each joint that it leaves unexplained.
    let all =
        |states: &[Motion], of_links: &[[PerJoint<f64>; 2]], place: &dyn Fn(usize) -> usize| {
            let joints = (0..own.len()).map(|joint| {
                let limit = robot.joints[joint].limits.torque;
                let tau = |row: usize| rows[row].1[place(joint)];
                explain(joint, states, of_links, limit, tau)
            });
            let joints: Vec<Explained> = joints.collect();
            let sum: f64 = joints.iter().map(cost).sum();
            let rests: Vec<f64> = joints.iter().map(|explained| explained.rest).collect();
            (sum, rests)
        };
    let straight = all(&states, &of_links, &|joint| joint);
    let mut best = (straight.0 - SWAP_EVIDENCE, None);
    for a in 0..own.len() {
        for b in a + 1..own.len() {
            if !(extremes[a].moved() && extremes[b].moved()) {
                continue;
            }
            let swap = |joint: usize| match joint {
                _ if joint == a => b,
                _ if joint == b => a,
                _ => joint,
            };
            let moved = states.iter().map(|state| {
                let [q, qd, qdd] = [state.q, state.qd, state.qdd]
                    .map(|own| PerJoint::from_fn(own.len(), |joint| own[swap(joint)]));
                Motion { q, qd, qdd }
            });
            let moved: Vec<Motion> = moved.collect();
            let of_moved = links(model, &moved);
            for (what, found) in [
                ("torques", all(&states, &of_links, &swap)),
                ("positions", all(&moved, &of_moved, &|joint| joint)),
                ("positions and torques", all(&moved, &of_moved, &swap)),
            ] {
                let (sum, rest) = found;
                if sum < best.0 && rest[a] < SWAPPED_REST && rest[b] < SWAPPED_REST {
                    best = (sum, Some((what, a, b)));
                }
            }
        }
    }
    best.1.map(|(what, a, b)| {
        format!("{what} of joints {} and {} are swapped: exchanged they follow the description, as they are they do not", a + 1, b + 1)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stiction_at_rest_is_no_wrong_sign_and_a_small_rotor_no_right_one() {
        let mut robot = Robot::load("ur5").expect("built in");
        robot
            .joints
            .iter_mut()
            .for_each(|j| j.friction.coulomb = 0.0);
        let model = RigidBodies::new(&robot);
        // Joint 2 swings, and the torque of joint 6 is the opposite of what its link needs; with a rotor that of joint 2, too.
        let judged = |swing_6: f64, rotor: f64| {
            let mut judgement = Judgement::default();
            let mut seen = vec![Extremes::none(); model.joints()];
            let rows = (0..600).map(|row| {
                let t = 0.01 * f64::from(row);
                let swing = [0.0, 0.8, 0.0, 0.0, 0.0, swing_6];
                let wave = |joint: usize, w: f64| (w * t + joint as f64).sin_cos();
                let of = |value: &dyn Fn(usize) -> f64| PerJoint::from_fn(6, value);
                let w = 2.0;
                let state = Motion {
                    q: of(&|j| 0.5 + swing[j] * wave(j, w).0),
                    qd: of(&|j| swing[j] * w * wave(j, w).1),
                    qdd: of(&|j| -swing[j] * w * w * wave(j, w).0),
                };
                let needed = model.inverse_dynamics(&state);
                let tau = of(&|j| match j {
                    1 if rotor > 0.0 => rotor * state.qdd[j] - needed[j],
                    5 => -needed[j],
                    _ => needed[j],
                });
                for (joint, seen) in seen.iter_mut().enumerate() {
                    let (low, high) = seen.position;
                    seen.position = (low.min(state.q[joint]), high.max(state.q[joint]));
                    seen.speed = seen.speed.max(state.qd[joint].abs());
                }
                (state, tau)
            });
            let rows: Vec<_> = rows.collect();
            compare(&mut judgement, &robot, &rows, &seen, 1.0);
            judgement.findings
        };
        assert_eq!(judged(0.0, 0.0), []);
        // A small rotor beside a torque of the wrong sign is no proof of the right one.
        for (swing, rotor) in [(0.8, 0.0), (0.8, 0.2)] {
            let found = judged(swing, rotor);
            let wrong = match rotor {
                0.0 => "torque of joint 6 has the wrong sign",
                _ => "torque of joint 2, 6 has the wrong sign",
            };
            assert!(found.iter().any(|it| it.text.contains(wrong)), "{found:?}");
        }
    }
}
