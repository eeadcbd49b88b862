//! Findings on what was fitted: a tilted base, an unknown payload, and parameters that no arm has.

use super::{ANALYTIC, CENTRE_M, DEVIATIONS, Finding, Judgement, ROWS, SOUND_SCALE};
use crate::dynamics::RigidBodies;
use crate::identification::columns::{FrictionTerm, Layout};
use crate::identification::methods::Fit;
use crate::identification::normal::SampleRow;
use crate::identification::normal::solve;
use crate::identification::problem::Candidate;
use crate::identification::record::Report;
use crate::metrics::even_sample;
use crate::robot::{Link, Robot};
use foretorque::dynamics::FrictionColumn;
use foretorque::learning::TORQUE_NOISE;
use nalgebra::{DMatrix, DVector, Matrix3, Vector2, Vector3};

/// Parameters of the description: base set, then viscous and Coulomb friction, all else zero.
pub(in crate::identification) fn description(robot: &Robot, layout: &Layout) -> DVector<f64> {
    let mut theta = robot.base_parameters();
    let friction = layout.parameters.iter().skip(layout.base);
    theta.extend(friction.map(|parameter| parameter.plain_friction(robot).unwrap_or(0.0)));
    DVector::from_vec(theta)
}

/// Share of the torque limit from which an offset is named.
const OFFSET_SHARE: f64 = 0.1;

/// Findings on what was fitted: a tilted base, an unknown payload, parameters that no body has, and offsets of the torque.
///
/// Returns whether the base is tilted. A tilt may pass for a payload, but not the other way: the parameters of the fit
/// contain every payload.
pub(in crate::identification) fn after_fit(
    judgement: &mut Judgement,
    robot: &Robot,
    layout: &Layout,
    fit: &Fit,
    rows: &[SampleRow],
) -> bool {
    let free = with_tilt(robot, layout, fit, rows);
    let tilt = free.as_ref().and_then(|(_, tilt)| tilt.clone());
    let is_tilted = tilt.is_some();
    if let Some(text) = tilt {
        judgement.find(false, text);
    }
    let free = free.as_ref().map_or(fit, |(free, _)| free);
    if let Some(flange) = payload(robot, layout, free).filter(Flange::is_certain) {
        judgement.find(true, flange.finding());
    }
    let deviation = |variance: f64| ANALYTIC * variance.max(0.0).sqrt();
    let deviations = fit.covariance.diagonal().map(deviation);
    for (place, parameter) in layout.parameters.iter().enumerate() {
        let is_plain = parameter.friction.is_some_and(|(term, _)| term.is_plain());
        let is_rotor = parameter.name.starts_with("Ia");
        let value = fit.theta[place];
        if (is_plain || is_rotor) && value < -DEVIATIONS * deviations[place] {
            let (name, unit) = (&parameter.name, parameter.unit);
            let text = format!("{name} is {value:.4} {unit}: no arm has it below zero");
            judgement.find(false, text);
        }
        if let Some((FrictionTerm::Board(FrictionColumn::Offset), joint)) = parameter.friction
            && value.abs() > DEVIATIONS * deviations[place]
        {
            let share = value.abs() / robot.joints[joint].limits.torque;
            if share > OFFSET_SHARE {
                let text = format!(
                    "torque of joint {} has an offset of {value:.3} N·m, {:.0} % of its limit: is it the zero of a sensor, or a spring? A bank adds it to the torque at all times",
                    joint + 1,
                    100.0 * share
                );
                judgement.find(false, text);
            }
        }
    }
    is_tilted
}

/// Joints where the fitted parameters leave half of the power of the torque, and most of what they leave is not noise. The
/// power of noise alone, which is in torque and error, is taken off both. One joint may have a defect of its own; two refuse,
/// and so does one whose error is as large as its torque.
pub fn unexplained(report: &Report) -> Option<Finding> {
    let noise = report.data_check.iter().flat_map(|check| &check.joints);
    let noise = noise.map(|joint| joint.noise_floor_nm);
    let errors = report.headline_rmse_nm.iter();
    let joints = errors.zip(&report.headline_torque_rms_nm).zip(noise);
    let shares = joints
        .enumerate()
        .filter_map(|(joint, ((error, size), noise))| {
            let (error, size) = ((*error)?, size.filter(|size| *size > 0.0)?);
            let (number, percent) = (joint + 1, 100.0 * error / size);
            let [left, all] = [error, size].map(|rms| rms * rms - noise * noise);
            (left > 0.5 * all && left > noise * noise).then(|| {
                let noise = 100.0 * noise / size;
                (
                    left >= all,
                    format!("J{number} {percent:.0} %, {noise:.0} % noise"),
                )
            })
        });
    let (useless, shares): (Vec<bool>, Vec<String>) = shares.unzip();
    (!shares.is_empty()).then(|| Finding {
        refuses: shares.len() > 1 || useless.contains(&true),
        text: format!(
            "no parameters of description '{}' explain the torques (error left: {}): another arm, joints in another order, or coupled ones ([coupling])?",
            report.robot,
            shares.join("; ")
        ),
    })
}

/// Largest change of a joint's torque error from one part of the logs to the rest: a body picked up, a sensor that drifts.
/// Returns the place of the row behind it, and the finding.
///
/// Two means m_1, m_2 of n_1 and n_2 rows explain the share `(n_1 m_1² + n_2 m_2²) / Σ e²` of the errors e. What a model
/// lacks scatters over the motion and has means near zero: on the logs of `tests/data` the share stays below 0.1. A line over
/// the torque, which is the gain of a drive and the zero of its sensor, must explain less: both stay the same all along.
/// A change below [`TORQUE_NOISE`] is none, however small the other errors.
pub(in crate::identification) fn change(
    robot: &Robot,
    layout: &Layout,
    rows: &[SampleRow],
    model: &Candidate,
) -> Option<(usize, String)> {
    const SHARE: f64 = 0.35;
    let predicted: Vec<_> = rows.iter().map(|row| model.torque(layout, row)).collect();
    let of_joint = |joint: usize| {
        let pairs = rows.iter().zip(&predicted).enumerate();
        let moving = pairs.filter(|(_, (row, _))| row.moving[joint]);
        let errors: Vec<_> = moving
            .map(|(place, (row, own))| (place, row.tau[joint] - own[joint], own[joint]))
            .collect();
        let count = errors.len();
        let mut sums = Matrix3::zeros();
        for (_, error, torque) in &errors {
            let column = Vector3::new(1.0, *torque, *error);
            sums += column * column.transpose();
        }
        let (sum, power) = (sums.m13, sums.m33);
        let line = sums.fixed_view::<2, 2>(0, 0).try_inverse();
        let line = line.map_or(0.0, |inverse| {
            let moment = Vector2::new(sums.m13, sums.m23);
            moment.dot(&(inverse * moment)) / power
        });
        let mut before = 0.0;
        let splits = errors.iter().enumerate().map(|(seen, (place, error, _))| {
            let (one, other) = (seen as f64, (count - seen) as f64);
            let [first, second] = [before / one, (sum - before) / other];
            before += error;
            let share = (one * first * first + other * second * second) / power;
            (share, joint + 1, *place, second - first)
        });
        let inside = splits.skip(count / 20).take(count - count / 10);
        let least = f64::from(TORQUE_NOISE) * robot.joints[joint].limits.torque;
        inside
            .filter(|(share, _, _, step)| *share > line.max(SHARE) && step.abs() > least)
            .max_by(|a, b| a.0.total_cmp(&b.0))
    };
    let most = (0..layout.joints())
        .filter_map(of_joint)
        .max_by(|a, b| a.0.total_cmp(&b.0));
    most.map(|(_, joint, place, step)| {
        let t_s = rows[place].t_s;
        let text = format!(
            "torque error of joint {joint} changes by {step:.3} N·m on average at {t_s:.1} s: was a body picked up or put down, or does the sensor drift? Cut the logs there"
        );
        (place, text)
    })
}

/// Gravity along two axes across the described one, m/s², of its size, and the arm under it.
pub(super) fn across(robot: &Robot) -> [(Vector3<f64>, RigidBodies); 2] {
    let (down, size) = (robot.gravity, robot.gravity.norm());
    let one = down.cross(&Vector3::ith(down.iamin(), 1.0));
    let other = down.cross(&one);
    let sized = |axis: Vector3<f64>| axis * (size / axis.norm().max(f64::MIN_POSITIVE));
    [sized(one), sized(other)].map(|gravity| {
        let robot = robot.clone();
        (gravity, RigidBodies::new(&Robot { gravity, ..robot }))
    })
}

/// Weighted least squares with the direction of gravity as two parameters more, and the finding of a tilt that is certain;
/// `None` where the parameters of the arm explain all that a tilt does.
///
/// ```text
/// tau = Y theta + t_1 G_1 + t_2 G_2    G_k = torque of the description under gravity along axis k across the described one
/// ```
fn with_tilt(
    robot: &Robot,
    layout: &Layout,
    fit: &Fit,
    rows: &[SampleRow],
) -> Option<(Fit, Option<String>)> {
    let size = layout.parameters.len();
    let across = across(robot);
    let mut gram = DMatrix::zeros(size + 2, size + 2);
    let mut moment = DVector::zeros(size + 2);
    for row in even_sample(rows, ROWS) {
        let turned = across
            .each_ref()
            .map(|(_, model)| model.gravity_torques(&row.state.q));
        for joint in (0..layout.joints()).filter(|joint| row.moving[*joint]) {
            let mut x = DVector::zeros(size + 2);
            for (value, place) in row.columns(layout, joint).iter().zip(&layout.active[joint]) {
                x[*place] = *value;
            }
            (x[size], x[size + 1]) = (turned[0][joint], turned[1][joint]);
            let weight = fit.sigma[joint].powi(-2);
            gram.ger(weight, &x, &x, 1.0);
            moment.axpy(weight * row.clean[joint], &x, 1.0);
        }
    }
    layout.add_prior(&mut gram);
    let (theta, covariance) = solve(&gram, &moment).ok()?;
    let tilt = Vector2::new(theta[size], theta[size + 1]);
    let spread = covariance.fixed_view::<2, 2>(size, size).into_owned();
    let gravity = robot.gravity + across[0].0 * tilt.x + across[1].0 * tilt.y;
    let angle = tilt.norm().atan();
    let free = Fit {
        theta: theta.rows(0, size).into_owned(),
        covariance: covariance.view((0, 0), (size, size)).into_owned(),
        ..fit.clone()
    };
    let deviation = ANALYTIC * spread.symmetric_eigenvalues().max().sqrt();
    let gravity = gravity * (robot.gravity.norm() / gravity.norm());
    let [x, y, z] = gravity.map(|g| (100.0 * g).round() / 100.0 + 0.0).into();
    let tilt = (angle > DEVIATIONS * deviation).then(|| {
        format!(
            "the base is tilted by {angle:.3} ± {deviation:.3} rad against the described gravity: set gravity_m_s2 = [{x:.2}, {y:.2}, {z:.2}] in the description, or level the base"
        )
    });
    Some((free, tilt))
}

/// Mass at the flange that a fit has and the description has not, or a scale of all torques that makes it.
pub(super) struct Flange {
    /// Mass and its standard deviation, kg.
    mass: f64,
    deviation: f64,
    /// Mass of all links, kg.
    links: f64,
    /// Share of the difference of fit and description that it explains.
    share: f64,
    /// Scale of all torques in its place, the scale's deviation, and the share that it explains.
    scale: [f64; 3],
}

impl Flange {
    /// Mass of a body that is no error of the description, share of the mass of all links: 0.3 kg on a UR5.
    const LEAST_SHARE: f64 = 0.016;

    /// The description's own uncertainty does not explain it. A spring in one joint makes a common scale certain that explains
    /// little: a scale has to explain most, too.
    fn is_certain(&self) -> bool {
        let [scale, deviation, _] = self.scale;
        match self.is_scale() {
            true => (scale - 1.0).abs() > DEVIATIONS * deviation && self.is_most(),
            false => {
                self.mass > Self::LEAST_SHARE * self.links
                    && self.mass > DEVIATIONS * self.deviation
            }
        }
    }

    /// It explains most of the difference: of that which another defect makes, it explains little.
    pub(super) fn is_most(&self) -> bool {
        match self.is_scale() {
            true => self.scale[2] > 0.5,
            false => self.share > 0.5 && self.mass > self.deviation,
        }
    }

    /// A scale of all torques explains more, with one parameter in the place of four.
    fn is_scale(&self) -> bool {
        let ([scale, _, share], (low, high)) = (self.scale, SOUND_SCALE);
        share > self.share && !(low..=high).contains(&scale)
    }

    pub(super) fn finding(&self) -> String {
        let (mass, deviation) = (self.mass, self.deviation);
        if self.is_scale() {
            let [scale, deviation, _] = self.scale;
            return format!(
                "the torques of all joints are {scale:.2} ± {deviation:.2} times the description's: drive gains, unit (--units), or another arm?"
            );
        }
        let [scale, _, share] = self.scale;
        let more = match share > self.share {
            true => &format!(
                ", unless the torques of all joints are {scale:.2} times the true ones, which explains more (drive gains, --units)"
            ),
            false => "",
        };
        format!(
            "a payload of {mass:.2} ± {deviation:.2} kg at the flange explains what the description does not: add it to the description or take it off{more}"
        )
    }
}

/// Mass at the flange by a fit, and the scale of all torques.
///
/// `theta − theta_description = p m + e`, e with the covariance of the fit and of a description whose masses, centres,
/// inertias and rotors are uncertain.
pub(super) fn payload(robot: &Robot, layout: &Layout, fit: &Fit) -> Option<Flange> {
    const MASS: f64 = 0.25;
    let base = layout.base;
    let nominal = DVector::from_vec(robot.base_parameters());
    let moved = |change: &dyn Fn(&mut Robot)| {
        let mut other = robot.clone();
        change(&mut other);
        DVector::from_vec(other.base_parameters()) - &nominal
    };
    let mut covariance: DMatrix<f64> =
        fit.covariance.view((0, 0), (base, base)) * (ANALYTIC * ANALYTIC);
    let mut uncertain = |change: &dyn Fn(&mut Robot)| {
        let step = moved(change);
        covariance.ger(1.0, &step, &step, 1.0);
    };
    for link in 0..robot.joint_count() {
        uncertain(&|other| {
            other.joints[link].link.mass *= 1.0 + MASS;
            other.joints[link].link.inertia_com *= 1.0 + MASS;
        });
        for axis in 0..3 {
            uncertain(&|other| other.joints[link].link.com[axis] += CENTRE_M);
            uncertain(&|other| {
                let inertia = &mut other.joints[link].link.inertia_com;
                inertia[(axis, axis)] *= 1.5;
            });
        }
        uncertain(&|other| {
            let limit = other.joints[link].limits.torque;
            let drive = &mut other.joints[link].drive;
            drive.rotor_inertia = 2.0 * drive.rotor_inertia + 0.01 * limit;
        });
    }
    let at = |place: Vector3<f64>| {
        moved(&|other| {
            let Some(last) = other.joints.last() else {
                return;
            };
            let body = Link {
                mass: 1.0,
                com: robot.flange.point(&place),
                inertia_com: Matrix3::identity() * 1e-4,
            };
            let body = Link::lumped(&[last.link, body]);
            if let (Some(body), Some(last)) = (body, other.joints.last_mut()) {
                last.link = body;
            }
        })
    };
    let inverse = covariance.cholesky()?.inverse();
    let rest = fit.theta.rows(0, base) - &nominal;
    // Mass at the flange and its first moments.
    let here = at(Vector3::zeros());
    let moment = |axis: Vector3<f64>| (at(0.1 * axis) - &here) * 10.0;
    let [x, y, z] = [Vector3::x(), Vector3::y(), Vector3::z()].map(moment);
    let columns = DMatrix::from_columns(&[here, x, y, z]);
    // Of an arm in a plane, moments beside it give no torque.
    let gram = columns.tr_mul(&(&inverse * &columns));
    let least = 1e-14 * gram.amax();
    let gram = gram.pseudo_inverse(least).ok()?;
    let moment = columns.tr_mul(&(&inverse * &rest));
    let found = &gram * &moment;
    let (mass, deviation) = (found[0], gram[(0, 0)].sqrt());
    let all = rest.dot(&(&inverse * &rest));
    let weighted = &inverse * &nominal;
    let (size, along) = (nominal.dot(&weighted), rest.dot(&weighted));
    Some(Flange {
        mass,
        deviation,
        links: robot.joints.iter().map(|joint| joint.link.mass).sum(),
        share: found.dot(&moment) / all,
        scale: [
            1.0 + along / size,
            size.powf(-0.5),
            along * along / size / all,
        ],
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dynamics::PerJoint;
    use crate::identification::ColumnSet;
    use crate::identification::dataset::{RowSums, random_rows};
    use crate::identification::judge::JointCheck;
    use crate::identification::methods::wls;

    /// A small body of this mass, kg, at the flange.
    fn at_flange(robot: &Robot, mass: f64) -> Link {
        Link {
            mass,
            com: robot.flange.origin,
            inertia_com: Matrix3::identity() * 1e-3 * mass,
        }
    }

    /// Fit that gives the parameters of `robot` with this variance of each.
    fn exact(robot: &Robot, layout: &Layout, variance: f64) -> Fit {
        let theta = description(robot, layout);
        Fit {
            covariance: DMatrix::identity(theta.len(), theta.len()) * variance,
            theta,
            sigma: PerJoint::repeat(layout.joints(), 1.0),
            iterations: 1,
        }
    }

    #[test]
    fn a_payload_is_found_where_a_moment_of_it_gives_no_torque() {
        // In a plane: what is beside it gives no torque.
        let mut robot = Robot::load("ur5").expect("built in");
        robot.joints.remove(0);
        robot.joints.truncate(2);
        robot.flange.rot_parent_child = Matrix3::new(0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0);
        let layout = Layout::new(&robot, &ColumnSet::plain());
        let mut loaded = robot.clone();
        let last = &mut loaded.joints[1].link;
        *last = Link::lumped(&[*last, at_flange(&robot, 20.0)]).expect("a body");
        let fit = exact(&loaded, &layout, 1e-6);
        let flange = payload(&robot, &layout, &fit).expect("a payload");
        assert!((flange.mass - 20.0).abs() < 0.1, "{}", flange.mass);
        assert!(flange.is_certain(), "{}", flange.deviation);
    }

    #[test]
    fn a_payload_is_found_on_an_arm_of_half_a_kilogram() {
        const SCALE: f64 = 0.03;
        let mut robot = Robot::load("ur5").expect("built in");
        for joint in &mut robot.joints {
            joint.link.mass *= SCALE;
            joint.link.inertia_com *= SCALE;
            joint.limits.torque *= SCALE;
            joint.drive.rotor_inertia *= SCALE;
        }
        let layout = Layout::new(&robot, &ColumnSet::plain());
        for (mass, found) in [(3.0, true), (0.2, false)] {
            let mut loaded = robot.clone();
            let last = &mut loaded.joints[5].link;
            *last = Link::lumped(&[*last, at_flange(&robot, SCALE * mass)]).expect("a body");
            let fit = exact(&loaded, &layout, 1e-12);
            let flange = payload(&robot, &layout, &fit).expect("a payload");
            assert_eq!(flange.is_certain(), found, "{}", flange.mass);
        }
    }

    #[test]
    fn a_tilted_base_is_no_payload_and_a_payload_no_tilted_base() {
        let robot = Robot::load("ur5").expect("built in");
        let layout = Layout::new(&robot, &ColumnSet::plain());
        let found = |tilt: f64, mass: f64| {
            let mut arm = robot.clone();
            arm.gravity = Vector3::new(tilt.sin(), 0.0, -tilt.cos()) * 9.81;
            let model = RigidBodies::new(&arm).with_payload(&at_flange(&arm, mass));
            // Joint 1 hardly moves: its column of a tilt is nearly one of the parameters.
            let torque = |row: &SampleRow, joint: usize| model.inverse_dynamics(&row.state)[joint];
            let rows = random_rows(&layout, 1500, 1, [0.4, 1.0, 1.0], 1.0, torque);
            let sums = RowSums::of(&layout, &rows);
            let fit = wls(&sums.all, &layout).expect("a fit");
            let mut judgement = Judgement::default();
            after_fit(&mut judgement, &robot, &layout, &fit, &rows);
            let texts = judgement.findings.into_iter().map(|it| it.text);
            texts.collect::<Vec<_>>()
        };
        assert_eq!(found(0.0, 0.0), [""; 0]);
        for tilt in [0.03, 0.1] {
            let texts = found(tilt, 0.0);
            let angle = format!("tilted by {tilt:.2}");
            assert!(
                matches!(&texts[..], [it] if it.contains(&angle)),
                "{texts:?}"
            );
        }
        let texts = found(0.0, 3.0);
        assert!(
            matches!(&texts[..], [it] if it.contains("at the flange")),
            "{texts:?}"
        );
    }

    #[test]
    fn a_body_that_is_picked_up_is_found_with_its_time() {
        let robot = Robot::load("ur5").expect("built in");
        let layout = Layout::new(&robot, &ColumnSet::plain());
        let theta = description(&robot, &layout);
        let found = |step: f64| {
            // Errors of the model come and go with the motion.
            let torque = |row: &SampleRow, joint: usize| {
                let picked_up = joint == 2 && row.t_s >= 12.0;
                row.linear(&layout, &theta, joint) + row.state.q[1] + f64::from(picked_up) * step
            };
            let rows = random_rows(&layout, 2000, 1, [2.0, 1.0, 3.0], 1.0, torque);
            change(&robot, &layout, &rows, &Candidate::Linear(theta.clone()))
        };
        assert_eq!(found(0.0), None);
        let (place, text) = found(4.0).expect("a change");
        assert!((1195..1205).contains(&place), "{place}");
        assert!(text.contains("joint 3 changes by 4.0"), "{text}");
        assert!(text.contains("at 12.0 s"), "{text}");
        // The gain of a drive, while its torque grows along the log.
        let torque = |row: &SampleRow, joint: usize| {
            let gain = if joint == 2 { 1.1 } else { 1.0 };
            gain * row.linear(&layout, &theta, joint)
        };
        let mut rows = random_rows(&layout, 2000, 1, [2.0, 1.0, 3.0], 1.0, torque);
        rows.sort_by(|a, b| a.tau[2].total_cmp(&b.tau[2]));
        assert_eq!(
            change(&robot, &layout, &rows, &Candidate::Linear(theta.clone())),
            None
        );
        // A model without any other error shows a step that is too small to be a body.
        let found = |step: f64| {
            let torque = |row: &SampleRow, joint: usize| {
                let late = joint == 2 && row.t_s >= 12.0;
                row.linear(&layout, &theta, joint) + f64::from(late) * step
            };
            let rows = random_rows(&layout, 2000, 1, [2.0, 1.0, 3.0], 1.0, torque);
            change(&robot, &layout, &rows, &Candidate::Linear(theta.clone()))
        };
        assert_eq!(found(1.0), None);
        assert!(found(2.0).is_some());
    }

    #[test]
    fn torques_that_no_parameters_explain_are_found_joint_by_joint() {
        let joint = |noise_floor_nm: f64| JointCheck {
            noise_floor_nm,
            ..JointCheck::default()
        };
        let found = |errors: [f64; 3], noise: f64| {
            unexplained(&Report {
                headline_rmse_nm: errors.map(Some).to_vec(),
                headline_torque_rms_nm: vec![Some(1.0); 3],
                data_check: Some(Judgement {
                    joints: [0.1, 0.1, noise].map(joint).to_vec(),
                    ..Judgement::default()
                }),
                ..Report::default()
            })
        };
        // Small errors, and one that noise alone leaves.
        assert_eq!(found([0.2, 0.6, 0.8], 0.6), None);
        // Errors, noise of joint 3, whether they refuse, and words of the finding.
        for (errors, noise, refuses, words) in [
            ([0.8, 0.4, 0.8], 0.6, false, "J1 80 %, 10 % noise"),
            ([1.0, 0.4, 0.8], 0.6, true, "J1 100 %"),
            ([0.8, 0.75, 0.8], 0.6, true, "another arm"),
            // Most of what is left of joint 3 is noise, or is not.
            ([0.8, 0.2, 0.84], 0.6, false, "J1 80 %"),
            ([0.8, 0.2, 0.84], 0.4, true, "J3 84 %"),
        ] {
            let found = found(errors, noise).expect("joint 1 at least");
            assert_eq!(found.refuses, refuses, "{found:?}");
            assert!(found.text.contains(words), "{found:?}");
        }
    }
}
