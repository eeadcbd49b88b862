//! Torques of a log against those of the description: signs, sizes, noise.

use super::explained::{Explained, SIGN_EVIDENCE, explain, links, other_reading, weight};
use super::ranges::Extremes;
use super::{DEVIATIONS, JointCheck, Judgement, MOVED, NOISE_SHARE, SOUND_SCALE, SOUND_SIZE};
use crate::dynamics::{Motion, PerJoint, RigidBodies};
use crate::identification::columns::SIGN_WIDTH_RAD_S;
use crate::robot::Robot;

/// Compares the torques with those of the description.
///
/// * `gain` of the filter on the noise      * `fitted` as in [`other_reading`]      * `payload` of the fit, as a finding
pub(super) fn compare(
    judgement: &mut Judgement,
    robot: &Robot,
    rows: &[(Motion, PerJoint<f64>)],
    extremes: &[Extremes],
    gain: f64,
    fitted: &dyn Fn(f64) -> f64,
    payload: &dyn Fn() -> Option<String>,
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
    // A torque that is always positive, although its joint needs both signs: those of its links or of its velocity explain it
    // far better.
    let unsigned = (0..joints).filter(|&joint| extremes[joint].unsigned());
    let unsigned = unsigned.filter(|&joint| {
        let rest = |sign: &dyn Fn(usize) -> f64| {
            let tau = |row: usize| rows[row].1[joint].copysign(sign(row));
            explain(joint, &states, &of_links, limit(joint), tau).rest
        };
        let links = rest(&|row| of_links[row][0][joint]);
        let drive = rest(&|row| states[row].qd[joint]);
        (own[joint].rest / f64::min(links, drive)).ln() > SIGN_EVIDENCE
    });
    let unsigned: Vec<String> = unsigned.map(|joint| (joint + 1).to_string()).collect();
    if !unsigned.is_empty() {
        judgement.find(true, format!(
            "torque of joint {} is never negative: is it an absolute value? Log it with its sign",
            unsigned.join(", ")
        ));
        return;
    }
    if noise.len() == joints {
        judgement.find(
            true,
            "the torques of all joints are noise: they follow neither the motion nor gravity",
        );
        return;
    }
    if let Some(text) = other_reading(&bare, rows, extremes, fitted) {
        judgement.find(true, text);
        return;
    }
    for joint in &noise {
        if let Some(value) = extremes[*joint].constant() {
            // Of a passive joint in free swing, inertia takes up gravity.
            let power = |k: usize| {
                of_links
                    .iter()
                    .map(|links| links[k][*joint].powi(2))
                    .sum::<f64>()
            };
            let passive = value == 0.0 && power(0) < 0.25 * power(1);
            judgement.find(
                !passive,
                format!(
                    "joint {}: its torque is always {value:.4} N·m, does the sensor work?",
                    joint + 1
                ),
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
    let certain = |joint: usize| weight(&bare, &of_links, joint) > 1.0;
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
        let own = &own[**joint];
        let (low, high) = SOUND_SCALE;
        let clear = own.deviation * DEVIATIONS < (own.scale - 1.0).abs();
        let (least, most) = (own.scale.min(own.scale_back), own.scale.max(own.scale_back));
        sound(**joint) && clear && (most < low || least > high)
    };
    let off: Vec<&usize> = heavy.iter().filter(off).collect();
    let unexplained = heavy.iter().filter(|&&joint| own[joint].rest > 0.6).count();
    if off.is_empty() && unexplained == 0 {
        return;
    }
    if let Some(text) = payload() {
        judgement.find(true, text);
        return;
    }
    match (&off[..], unexplained) {
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
            compare(&mut judgement, &robot, &rows, &seen, 1.0, &|_| 0.0);
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
