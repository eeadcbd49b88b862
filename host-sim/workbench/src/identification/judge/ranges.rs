//! Findings on the ranges of a log joint by joint: units, quantities in each other's columns, single wrong rows, and sensors
//! that are cut off or stuck.

use super::Judgement;
use super::sums::{BEYOND, CUT_SHARE, Extremes, Rate};
use crate::dynamics::RigidBodies;
use crate::identification::log::{Roughness, SWAPPED, WITHOUT_ROWS};
use crate::report::page::figure;
use crate::robot::{Joint, Robot};

/// Largest torque over its limit of a log that uses an arm: its drives carry at least its own weight.
const LITTLE: f64 = 0.1;
/// Change of a sound position over its logged velocity, or its reciprocal.
const SOUND_RATE: f64 = 1.25;
/// [`Rate::agreement`] from which noise changes no ratio.
const CLEAR: f64 = 0.9;
/// Largest share of rows that count as errors of single rows.
const FEW: f64 = 0.01;

/// Findings on ranges: units, quantities in each other's columns, single wrong rows, spikes, saturation.
///
/// * `currents` the torques are drive gain × current
pub(super) fn units(
    judgement: &mut Judgement,
    robot: &Robot,
    extremes: &[Extremes],
    currents: bool,
) {
    let joints = || robot.joints.iter().zip(extremes).enumerate();
    let most = |(low, high): (f64, f64)| low.abs().max(high.abs());
    let is_far = |joint: &Joint, seen: &Extremes| {
        !seen.unwrapped && most(seen.position) > BEYOND * most(joint.limits.position)
    };
    let far = joints().find(|(_, (joint, seen))| {
        is_far(joint, seen) || seen.speed > BEYOND * joint.limits.velocity
    });
    let fits = |joint: &Joint, seen: &Extremes| seen.torque <= 1.1 * most(joint.limits.position);
    // A torque without noise is smooth, too, but no position.
    let swapped = Roughness::are_swapped(extremes.iter().map(|seen| seen.rough))
        && joints().all(|(_, (joint, seen))| fits(joint, seen));
    let far = far.map(|(number, (joint, seen))| {
        let (most, (low, high)) = (most(seen.position), joint.limits.position);
        if !is_far(joint, seen) && seen.fast <= 2.0 * FEW * seen.rows {
            format!(
                "q{} jumps at {:.3} s, by {:.4} rad/s where its largest speed is {:.3} rad/s, {} such steps in all: {WITHOUT_ROWS}; or are the limits too low (--velocity-limits)?",
                number + 1,
                seen.fastest_s,
                seen.speed,
                joint.limits.velocity,
                seen.fast
            )
        } else if !is_far(joint, seen) {
            format!(
                "q{} moves at {:.4} rad/s at {:.3} s and stays in its range, its largest speed is {:.3} rad/s: are the times in another unit (--units t=ms, t=us or t=ns, for all logs), or are the limits too low (--velocity-limits)?",
                number + 1,
                seen.speed,
                seen.fastest_s,
                joint.limits.velocity
            )
        } else {
            format!(
                "q{} reaches {most:.4} rad, and {:.4} rad/s at {:.3} s; its range is {low:.3} … {high:.3} rad, its largest speed {:.3} rad/s: are these degrees (--units q=deg, for all logs), does it jump there, or are the limits too low (--velocity-limits; range of the description)?",
                number + 1,
                seen.speed,
                seen.fastest_s,
                joint.limits.velocity
            )
        }
    });
    let swapped = swapped.then(|| SWAPPED.to_owned());
    if let Some(text) = swapped.or(far).or_else(|| rates(extremes)) {
        judgement.find(true, text);
        return;
    }
    stuck(judgement, extremes);
    placeholders(judgement, robot.joints.iter().zip(extremes));
    let few = |seen: &Extremes| seen.strong <= FEW * seen.rows;
    let strong: Vec<_> = joints()
        .filter(|(_, (joint, seen))| {
            let beyond = BEYOND * joint.limits.torque;
            seen.rms() > beyond || seen.torque > beyond && few(seen)
        })
        .collect();
    if let Some((number, (joint, seen))) = strong.first() {
        let thousandth = 1e-3 * seen.torque <= BEYOND * joint.limits.torque;
        // One unit holds for all joints; their limits may be of different use.
        let weight = RigidBodies::new(robot).largest_gravity_torques()[*number];
        let unit = match thousandth {
            _ if weight > joint.limits.torque => &format!(
                "below the {} N·m of the arm's own weight: correct it (--torque-limits)",
                figure(weight, 0)
            ),
            _ if few(seen) && seen.near_limit[2] <= FEW * seen.rows => WITHOUT_ROWS,
            true if currents => "are these mA (--units i=mA)?",
            true if strong.len() * 3 > extremes.len() => {
                "is this mN·m or N·cm (--units tau=mNm or tau=Ncm), or a share of the rated torque (effort = \"motor\" and gear_ratios in --columns-from FILE)?"
            }
            true => {
                "those of the others are nearer to theirs; drive gain, unit, or a limit of the description (--torque-limits)?"
            }
            false => {
                "drive gain, unit, a limit of the description (--torque-limits), or another arm?"
            }
        };
        let text = format!(
            "tau{} reaches {} N·m at {:.3} s, its limit is {} N·m: {unit}",
            number + 1,
            figure(seen.torque, 1),
            seen.strongest_s,
            joint.limits.torque
        );
        judgement.find(true, text);
    }
    for (number, (joint, seen)) in joints() {
        if seen.constant().is_some() {
            continue;
        }
        for (value, share) in seen.cuts() {
            judgement.find(share > CUT_SHARE.1, format!(
                "torque of joint {} is cut off at {value:.4} N·m in {:.1} % of the rows in which it moves: a slower path, or cut these rows out",
                number + 1,
                100.0 * share
            ));
        }
        let [below, at, above] = seen.near_limit;
        let (limit, number) = (joint.limits.torque, number + 1);
        let percent = |count: f64| 100.0 * count / f64::max(seen.rows, 1.0);
        let [spikes, held, beyond] = [seen.spikes, at, above].map(percent);
        if spikes > 0.5 {
            judgement.find(
                false,
                format!("joint {number}: spikes of the torque in {spikes:.1} % of the rows"),
            );
        }
        // Rows gather at a limit that holds the torque, but not where the motion turns it back.
        let is_held = at > 2.0 * f64::max(below, above);
        if is_held && held > 1.0 {
            judgement.find(false, format!(
                "joint {number}: torque held at its limit of {limit} N·m in {held:.1} % of the rows: take a slower path"
            ));
        } else if !is_held && beyond > 1.0 {
            judgement.find(false, format!(
                "joint {number}: torque above its limit of {limit} N·m in {beyond:.1} % of the rows, up to {:.1} N·m: correct the limit (--torque-limits)",
                seen.torque
            ));
        }
    }
}

/// Warns of limits that no torque comes near.
fn placeholders<'a>(
    judgement: &mut Judgement,
    joints: impl Iterator<Item = (&'a Joint, &'a Extremes)>,
) {
    let reached = joints.map(|(joint, seen)| seen.torque / joint.limits.torque);
    let most = reached.fold(0.0, f64::max);
    if most > 0.0 && most < LITTLE {
        judgement.find(false, format!(
            "no torque of the log is above {:.2} % of its limit: are the limits placeholders? Correct them (--torque-limits), the learner's bounds are shares of them",
            100.0 * most
        ));
    }
}

/// Sensors that keep one value while their joint moves, by its logged velocity for a position, by its position for a torque.
fn stuck(judgement: &mut Judgement, extremes: &[Extremes]) {
    let signals = [
        ("position", "its logged velocity is not zero"),
        ("torque", "the joint moves"),
    ];
    for (signal, (name, moves)) in signals.into_iter().enumerate() {
        for (number, seen) in extremes.iter().enumerate() {
            let Some((run, share)) = seen.unchanged[signal].stuck() else {
                continue;
            };
            // A torque that is cut off or never changes has a finding of its own.
            let cut = seen.cuts().any(|(value, _)| value == run.value);
            if name == "torque" && (cut || seen.constant().is_some()) {
                continue;
            }
            judgement.find(share > CUT_SHARE.1, format!(
                "{name} of joint {} does not change from {:.3} to {:.3} s while {moves}: is its sensor stuck? Leave these rows out: the log is cut there",
                number + 1,
                run.from_s,
                run.to_s
            ));
        }
    }
}

/// Positions that change in another way than the logged velocities, and these than the logged accelerations.
fn rates(extremes: &[Extremes]) -> Option<String> {
    // Derivatives of noisy velocities have another size than the change over two rows.
    let signals = [
        (("positions", "velocities"), 0.0),
        (("velocities", "accelerations"), CLEAR),
    ];
    let mapped = extremes.iter().any(|seen| seen.mapped);
    let found = signals
        .into_iter()
        .enumerate()
        .find_map(|(signal, (names, clear))| {
            let moved = extremes.iter().enumerate().filter(|(_, seen)| seen.moved());
            let mut rates: Vec<_> = moved
                .map(|(joint, seen)| (joint + 1, seen.rates[signal]))
                .collect();
            let contradicts = mapped.then(|| contradiction(names, &rates)).flatten();
            rates.retain(|(_, rate)| rate.agreement() > clear);
            contradicts.or_else(|| other_scale(names, &rates))
        });
    found.or_else(|| foreign(extremes).filter(|_| mapped))
}

/// Finding on velocities that are not those of their joint.
fn foreign(extremes: &[Extremes]) -> Option<String> {
    const COMMON: f64 = 0.5;
    let foreign = |(joint, seen): (usize, &Extremes)| {
        (seen.moved() && seen.ways.agreement() < COMMON).then(|| (joint + 1).to_string())
    };
    let joints: Vec<String> = extremes.iter().enumerate().filter_map(foreign).collect();
    (!joints.is_empty()).then(|| {
        format!(
            "logged velocities of joint {} are not the change of their positions: columns of other joints? Mend qd_rad_s of --columns-from FILE, or leave it out",
            joints.join(", ")
        )
    })
}

/// Finding on logged derivatives that are zero or of the other sign; joints from 1.
fn contradiction((changing, logged): (&str, &str), rates: &[(usize, Rate)]) -> Option<String> {
    let of = |is: fn(&Rate) -> bool| {
        let joints = rates.iter().filter(|(_, rate)| is(rate));
        let joints: Vec<String> = joints.map(|(joint, _)| joint.to_string()).collect();
        (!joints.is_empty()).then(|| joints.join(", "))
    };
    if let Some(joints) = of(Rate::is_zero) {
        return Some(format!(
            "logged {logged} of joint {joints} are zero while their {changing} change: leave these columns out of the map in --columns-from FILE"
        ));
    }
    of(Rate::is_turned).map(|joints| {
        format!(
            "logged {logged} of joint {joints} have the other sign than the change of their {changing}: turn one of the two, or leave these columns out of the map in --columns-from FILE"
        )
    })
}

/// Finding on logged derivatives of another size; joints from 1.
fn other_scale((changing, logged): (&str, &str), rates: &[(usize, Rate)]) -> Option<String> {
    let ratios = rates.iter();
    let ratios = ratios.filter_map(|(joint, rate)| Some((*joint, rate.ratio()?)));
    let ratios: Vec<(usize, (f64, f64))> = ratios.collect();
    let off = ratios
        .iter()
        .filter(|(_, (least, most))| *least > SOUND_RATE || *most < 1.0 / SOUND_RATE);
    let off: Vec<_> = off.collect();
    let (joint, (least, most)) = *off.first()?;
    let ratio = (least * most).sqrt();
    Some(if off.len() * 2 > ratios.len() {
        format!(
            "{changing} change {ratio:.2} times as fast as the logged {logged}: are the times right (else rate_hz in --columns-from FILE), and the units (--units)?"
        )
    } else {
        format!(
            "{changing} of joint {joint} change {ratio:.2} times as fast as its logged {logged}, those of the others do not: is the scale of one of the two wrong?"
        )
    })
}

#[cfg(test)]
mod tests {
    use super::super::sums::scan;
    use super::*;
    use crate::identification::log_tests::{first_joints, log_of};
    use std::f64::consts::{PI, TAU};

    /// Ranges and findings of a log of one joint: times, positions and torques of its rows.
    fn scanned(rows: impl Iterator<Item = [f64; 3]>) -> (Extremes, Vec<String>) {
        let (_here, path) = log_of("t_s,q1_rad,tau1_nm", rows);
        let robot = first_joints(1);
        let mut extremes = [Extremes::none()];
        scan(&path, &robot, &mut extremes).expect("a log");
        let mut judgement = Judgement::default();
        units(&mut judgement, &robot, &extremes, false);
        let findings = judgement.findings.into_iter().map(|finding| finding.text);
        (extremes[0], findings.collect())
    }

    #[test]
    fn a_joint_that_turns_on_is_not_out_of_its_range() {
        let log = |wrapped: bool| {
            let rows = (0..4000).map(|k| {
                let t = 0.01 * f64::from(k);
                let q = if wrapped { (t + PI) % TAU - PI } else { t };
                [t, q, 100.0 * (0.3 * t).sin()]
            });
            scanned(rows)
        };
        let (seen, findings) = log(true);
        assert!(seen.position.1 > 6.0 * TAU, "{:?}", seen.position);
        assert!(findings.is_empty(), "{findings:?}");
        assert!(log(false).1.concat().contains("are these degrees"));
    }

    #[test]
    fn a_jump_over_a_gap_is_no_noise_of_the_torque() {
        // Five seconds lost, and another torque behind them.
        let rows = (0..400).map(|k| {
            let (t, behind) = (0.01 * f64::from(k), f64::from(k / 200));
            [t + 5.0 * behind, t.sin(), t + 50.0 * behind]
        });
        let (seen, _) = scanned(rows);
        assert!(seen.noise() < 1e-6, "{}", seen.noise());
    }

    #[test]
    fn an_encoder_that_is_read_more_seldom_than_the_others_does_not_jump() {
        let rows = (0..4000).map(|k| {
            let t = 2e-3 * f64::from(k);
            [t, 2.0 * (t - t % 20e-3).sin(), 50.0 * t.sin()]
        });
        let (seen, findings) = scanned(rows);
        assert!((seen.speed - 2.0).abs() < 0.3, "{}", seen.speed);
        assert!(findings.is_empty(), "{findings:?}");
        // A single wrong row does, and so does a turn that is lost.
        for wrong in [2000..2001, 2000..4000] {
            let rows = (0..4000).map(|k| {
                let t = 2e-3 * f64::from(k);
                [
                    t,
                    if wrong.contains(&k) { 1.0 } else { 0.3 },
                    50.0 * t.sin(),
                ]
            });
            assert!(scanned(rows).0.speed > 100.0, "{wrong:?}");
        }
    }

    #[test]
    fn rest_with_closed_brakes_and_a_flickering_encoder_changes_no_figure() {
        let of = |rest: u32| {
            let rows = (0..rest + 8000).map(|k| {
                let t = 1e-3 * f64::from(k);
                let flicker = 1.5e-3 * f64::from(k / 2 % 2);
                match f64::from(k) - f64::from(rest) {
                    before if before < 0.0 => [t, flicker, 0.0],
                    k => {
                        let noise = f64::from(u8::from(k % 2.0 == 0.0));
                        [t, (1e-3 * k).sin(), 40.0 * (1e-3 * k).cos() + noise]
                    }
                }
            });
            let (seen, findings) = scanned(rows);
            assert!(findings.is_empty(), "{findings:?}");
            [seen.rms(), seen.noise()]
        };
        for (with, without) in of(10_000).iter().zip(of(0)) {
            assert!((with / without - 1.0).abs() < 0.1, "{with} {without}");
        }
    }
}
