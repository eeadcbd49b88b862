//! Torques of a log against those of the description: signs, sizes, noise.

use super::explained::{Explained, SIGN_EVIDENCE, explain, links, weight};
use super::readings::other_reading;
use super::sums::Extremes;
use super::{DEVIATIONS, JointCheck, Judgement, MOVED, NOISE_SHARE, SOUND_SCALE, SOUND_SIZE};
use crate::dynamics::{Motion, PerJoint, RigidBodies};
use crate::identification::columns::SIGN_WIDTH_RAD_S;
use crate::identification::numbers;
use crate::robot::Robot;

/// Compares the torques with those of the description. The first finding that refuses is the last.
///
/// * `gain` of the filter on the noise
/// * `fitted` fall of the logarithm of what free parameters leave, by a clock of another rate
/// * `payload` finding of a body at the flange
pub(super) fn compare(
    judgement: &mut Judgement,
    robot: &Robot,
    rows: &[(Motion, PerJoint<f64>)],
    extremes: &[Extremes],
    gain: f64,
    (fitted, payload): (&dyn Fn(f64) -> f64, &dyn Fn() -> Option<String>),
) {
    let compared = Comparison::new(robot, rows, extremes);
    let joints = 0..extremes.len();
    let checks = joints.map(|joint| compared.check(joint, gain));
    judgement.joints.extend(checks);
    let reading = compared.unsigned().or_else(|| compared.all_noise());
    let reading = reading.or_else(|| other_reading(&compared.bare, rows, extremes, fitted));
    if let Some(text) = reading {
        judgement.find(true, text);
        return;
    }
    for (refuses, text) in compared.noise() {
        judgement.find(refuses, text);
    }
    if let Some(text) = compared.turned() {
        judgement.find(true, text);
        return;
    }
    for (refuses, text) in compared.sizes() {
        judgement.find(refuses, text);
        if refuses {
            return;
        }
    }
    if let Some(text) = compared.gravity(payload) {
        judgement.find(true, text);
    }
    if compared.heavy().next().is_none() {
        let text = "the scale of the torques is unchecked: gravity takes no joint above 5 % of its limit; compare the torques with a known weight or inertia";
        judgement.find(false, text);
    }
}

/// Torques of a log beside those of the description.
struct Comparison<'a> {
    robot: &'a Robot,
    /// The description without rotors.
    bare: Robot,
    rows: &'a [(Motion, PerJoint<f64>)],
    extremes: &'a [Extremes],
    states: Vec<Motion>,
    /// Torques of the links, and of gravity alone, N·m.
    of_links: Vec<[PerJoint<f64>; 2]>,
    own: Vec<Explained>,
}

impl<'a> Comparison<'a> {
    fn new(
        robot: &'a Robot,
        rows: &'a [(Motion, PerJoint<f64>)],
        extremes: &'a [Extremes],
    ) -> Self {
        let mut bare = robot.clone();
        for joint in &mut bare.joints {
            joint.drive.rotor_inertia = 0.0;
        }
        let states: Vec<Motion> = rows.iter().map(|(state, _)| *state).collect();
        let mut compared = Self {
            of_links: links(&RigidBodies::new(&bare), &states),
            robot,
            bare,
            rows,
            extremes,
            states,
            own: Vec::new(),
        };
        let own = |joint| compared.explained(joint, &|row: usize| rows[row].1[joint]);
        compared.own = (0..extremes.len()).map(own).collect();
        compared
    }

    fn explained(&self, joint: usize, tau: &dyn Fn(usize) -> f64) -> Explained {
        let limit = self.robot.joints[joint].limits.torque;
        explain(joint, &self.states, &self.of_links, limit, tau)
    }

    fn joints(&self) -> std::ops::Range<usize> {
        0..self.own.len()
    }

    /// The torque of a joint follows the motion.
    fn is_sound(&self, joint: usize) -> bool {
        self.own[joint].rest <= NOISE_SHARE
    }

    fn heavy(&self) -> impl Iterator<Item = usize> {
        self.joints().filter(|&joint| self.own[joint].heavy)
    }

    fn check(&self, joint: usize, gain: f64) -> JointCheck {
        let (seen, own) = (&self.extremes[joint], &self.own[joint]);
        let is_known = own.deviation < 0.3;
        JointCheck {
            position_rad: seen.position,
            speed_rad_s: seen.speed,
            torque_rms_nm: seen.rms(),
            noise_floor_nm: seen.noise() * gain,
            unexplained_ratio: own.rest,
            scale_ratio: (is_known && own.heavy).then_some(own.scale),
        }
    }

    /// Torques that are always positive, although their joints need both signs: those of the links or of the velocity explain
    /// them far better.
    fn unsigned(&self) -> Option<String> {
        let unsigned = self.joints().filter(|&joint| {
            // Squares, not shares: two signs give a sensor's zero the variance of a square wave, which friction explains.
            let left = |sign: &dyn Fn(usize) -> f64| {
                let tau = |row: usize| self.rows[row].1[joint].copysign(sign(row));
                self.explained(joint, &tau).square
            };
            self.extremes[joint].unsigned() && {
                let links = left(&|row| self.of_links[row][0][joint]);
                let drive = left(&|row| self.states[row].qd[joint]);
                (self.own[joint].square / f64::min(links, drive)).ln() > SIGN_EVIDENCE
            }
        });
        let unsigned = numbers(unsigned);
        (!unsigned.is_empty()).then(|| {
            format!("torque of joint {unsigned} is never negative: is it an absolute value? Log it with its sign")
        })
    }

    fn all_noise(&self) -> Option<String> {
        let noise = !self.joints().any(|joint| self.is_sound(joint));
        noise.then(|| {
            "the torques of all joints are noise: they follow neither the motion nor gravity"
                .to_owned()
        })
    }

    /// Findings on joints whose torque does not follow the motion, and whether they refuse.
    fn noise(&self) -> impl Iterator<Item = (bool, String)> {
        let noise = self.joints().filter(|&joint| !self.is_sound(joint));
        noise.map(|joint| {
            let (number, seen) = (joint + 1, &self.extremes[joint]);
            if let Some(value) = seen.constant() {
                // Of a passive joint in free swing, inertia takes up gravity.
                let power = |k: usize| {
                    let squares = self.of_links.iter().map(|links| links[k][joint].powi(2));
                    squares.sum::<f64>()
                };
                let passive = value == 0.0 && power(0) < 0.25 * power(1);
                let text = format!(
                    "joint {number}: its torque is always {value:.4} N·m, does the sensor work?"
                );
                return (!passive, text);
            }
            let share = 100.0 * self.own[joint].rest;
            let noise = match seen.noise() > 0.5 * seen.rms() {
                true => ": it is noise",
                false => "",
            };
            let text = format!(
                "joint {number}: {share:.0} % of the variance of its torque does not follow the motion{noise}"
            );
            (false, text)
        })
    }

    /// Torques of the wrong sign, of one joint or of all, or its positions: the readings that leave the least unexplained.
    fn turned(&self) -> Option<String> {
        let certain = |joint: usize| weight(&self.bare, &self.of_links, joint) > 1.0;
        let sound = || self.joints().filter(|&joint| self.is_sound(joint));
        // Stiction alone carries a light joint at rest.
        let turned = sound()
            .filter(|&joint| self.own[joint].heavy || self.extremes[joint].moved())
            .filter(|&joint| self.own[joint].is_turned(certain(joint)));
        let turned: Vec<usize> = turned.collect();
        if turned.is_empty() {
            return None;
        }
        let sound: Vec<usize> = sound().collect();
        let number = numbers(turned.iter().copied());
        let all = "the torques of all joints have the wrong sign: positive ones must accelerate +q; is this a log that counts the other way (--units tau=-Nm or i=-A)?".to_owned();
        let one = format!(
            "torque of joint {number} has the wrong sign: it must be positive where it accelerates +q"
        );
        let positions =
            format!("positions of joint {number} count the other way: turn their sign in the log");
        let (none, some) = (&[][..], &turned[..]);
        let mut readings = vec![(none, &sound[..], all), (some, none, positions)];
        if turned.len() < sound.len() {
            readings.push((none, some, one));
        }
        let left = readings.into_iter();
        let left = left.map(|(positions, torques, text)| (self.left(positions, torques), text));
        let mut left: Vec<(f64, String)> = left.collect();
        left.sort_by(|a, b| a.0.total_cmp(&b.0));
        let most = left[0].0 + SIGN_EVIDENCE;
        let fits = left.into_iter().filter(|(left, _)| *left < most);
        let fits: Vec<String> = fits.map(|(_, text)| text).collect();
        Some(fits.join("; or "))
    }

    /// Logarithm of what is left of all torques that follow the motion, with those of some joints and the positions of others
    /// turned.
    fn left(&self, positions: &[usize], torques: &[usize]) -> f64 {
        let mut states = self.states.clone();
        for Motion { q, qd, qdd } in &mut states {
            for own in [q, qd, qdd] {
                positions.iter().for_each(|joint| own[*joint] *= -1.0);
            }
        }
        let of_links = links(&RigidBodies::new(&self.bare), &states);
        let sound = self.joints().filter(|&joint| self.is_sound(joint));
        let left = sound.map(|joint| {
            let sign = if torques.contains(&joint) { -1.0 } else { 1.0 };
            let limit = self.robot.joints[joint].limits.torque;
            let tau = |row: usize| sign * self.rows[row].1[joint];
            let explained = explain(joint, &states, &of_links, limit, tau);
            explained.left(1.0, SOUND_SCALE).ln()
        });
        left.sum()
    }

    /// Torques far from the size of the description's, where that has friction, and whether they refuse.
    fn sizes(&self) -> impl Iterator<Item = (bool, String)> {
        let (smallest, largest) = SOUND_SIZE;
        let sizes = self
            .joints()
            .filter_map(|joint| Some((joint, self.size(joint)?)));
        let other = sizes.filter(move |(_, size)| *size < smallest || *size > largest);
        other.map(move |(joint, size)| {
            let text = format!(
                "torque of joint {} is {size:.2} times the description's: drive gain or unit?",
                joint + 1
            );
            // A sensor behind the gear does not see the friction of a description.
            (size > largest, text)
        })
    }

    /// Torque of a moving joint over the description's, in RMS; `None` where the description has no friction.
    fn size(&self, joint: usize) -> Option<f64> {
        let described = &self.robot.joints[joint];
        let moved = self.states.iter();
        let moved = moved
            .filter(|state| state.qd[joint].abs() > MOVED.0)
            .count();
        let known = described.friction.coulomb > 0.0 && self.is_sound(joint);
        if !known || moved * 10 < self.states.len() {
            return None;
        }
        // Where the description has no rotor, its inertia is unknown.
        let rotor = match described.drive.rotor_inertia {
            0.0 => self.own[joint].rotor.max(0.0),
            rotor => rotor,
        };
        let torques = self
            .states
            .iter()
            .zip(&self.of_links)
            .map(|(state, links)| {
                let (qd, rotor) = (state.qd[joint], rotor * state.qdd[joint]);
                let coulomb = described.friction.coulomb * (qd / SIGN_WIDTH_RAD_S).tanh();
                links[0][joint] + rotor + coulomb + described.friction.viscous * qd
            });
        let power = torques.map(|tau| tau * tau).sum::<f64>() / self.states.len() as f64;
        Some(self.extremes[joint].rms() / power.sqrt())
    }

    /// Gravity of another size than described, by a body at the flange, in one joint or in several.
    fn gravity(&self, payload: &dyn Fn() -> Option<String>) -> Option<String> {
        let (low, high) = SOUND_SCALE;
        let others = |own: usize| {
            let mut others = self.heavy().filter(|joint| *joint != own);
            others.all(|joint| (low..=high).contains(&self.own[joint].scale))
        };
        let off = self.heavy().filter(|&joint| {
            let own = &self.own[joint];
            let clear = own.deviation * DEVIATIONS < (own.scale - 1.0).abs();
            let (least, most) = (own.scale.min(own.scale_back), own.scale.max(own.scale_back));
            self.is_sound(joint) && clear && (most < low || least > high)
        });
        let off: Vec<usize> = off.collect();
        let unexplained = self
            .heavy()
            .filter(|&joint| self.own[joint].rest > 0.6)
            .count();
        if off.is_empty() && unexplained == 0 {
            return None;
        }
        payload().or_else(|| {
            Some(match (&off[..], unexplained) {
                (&[joint], 0) if self.heavy().count() > 1 && others(joint) => format!(
                    "torque of joint {} is {:.2} times the description's, those of the others are not: drive gain, unit, mass, or another arm?",
                    joint + 1,
                    self.own[joint].scale
                ),
                _ => {
                    let scales = self.heavy().map(|joint| {
                        let own = &self.own[joint];
                        let (number, rest) = (joint + 1, 100.0 * own.rest);
                        format!("J{number} {:.2} ± {:.2}, {rest:.0} % unexplained", own.scale, own.deviation)
                    });
                    format!(
                        "gravity does not fit description '{}' (times its torque: {}): another arm, another base (its gravity_m_s2), or a heavy payload?",
                        self.robot.name,
                        scales.collect::<Vec<_>>().join("; ")
                    )
                }
            })
        })
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
            compare(
                &mut judgement,
                &robot,
                &rows,
                &seen,
                1.0,
                (&|_| 0.0, &|| None),
            );
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
