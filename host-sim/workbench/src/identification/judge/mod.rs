//! Judgement of logs against the description: units, signs, order of joints, delay, excitation; and of what was fitted.
//!
//! A log is compared with the description's torques of its own motion, which need not be accurate: masses 30 % off leave
//! the sign, the order of the joints and the unit visible.

mod compare;
mod delay;
mod explained;
mod fitted;

pub use fitted::unexplained;
pub(super) use fitted::{after_fit, change, description};

use super::IdentifyError;
use super::clock::GAP_PERIODS;
use super::columns::{ColumnSet, Layout};
use super::dataset::Thinned;
use super::log::{LogRow, Roughness};
use super::normal::NormalEquations;
use super::prepare::{PrepareConfig, other_unit_of_time};
use super::stream::for_each_prepared;
use super::whole_log::WholeLog;
use crate::dynamics::PerJoint;
use crate::robot::{Joint, Robot};
use compare::compare;
use delay::{Delay, delay};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Most rows that are compared with the description.
const ROWS: usize = 1199;
/// Positions and torques this many times their limits are in other units.
const BEYOND: f64 = 3.0;
/// Gravity decides over sign and size where its RMS is this share of the torque limit.
const GRAVITY_SHARE: f64 = 0.05;
/// Range of the RMS torque over that of a description with friction.
const SOUND_SIZE: (f64, f64) = (0.2, 5.0);
/// Speed and range from which a joint counts as moved, rad/s and rad.
const MOVED: (f64, f64) = (0.2, 0.2);
/// Speed from which the delay is estimated, rad/s: the step of friction at a reversal passes for a delay.
const FAST_RAD_S: f64 = 0.2;
/// Change of a sound position over its logged velocity, or its reciprocal.
const SOUND_RATE: f64 = 1.25;
/// Range of a sound torque over that of the description.
const SOUND_SCALE: (f64, f64) = (0.4, 2.4);
/// Error of the centre of mass of a body of the description, m.
const CENTRE_M: f64 = 0.03;
/// A torque with more than this share of its variance unexplained is noise.
const NOISE_SHARE: f64 = 0.9;
/// Share of the rows in which a torque is cut off that is noted, and that is refused.
const CUT_SHARE: (f64, f64) = (0.01, 0.05);
/// Time for which no sensor gives one value while its joint moves, s.
const STUCK_S: f64 = 0.5;
/// Largest share of rows that count as errors of single rows.
const FEW: f64 = 0.01;
/// Delay of the torque that is refused, and that is noted, s.
const DELAY_S: (f64, f64) = (10e-3, 4e-3);
/// Standard deviations from which an estimate counts; analytic ones are about 2.5 times too small.
const DEVIATIONS: f64 = 5.0;
const ANALYTIC: f64 = 2.5;

/// Remedy for single rows that are wrong.
const ROWS_REMEDY: &str = "delete these rows (up to four in a row are put in again)";

/// One finding.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// No bank is written.
    pub refuses: bool,
    /// One line.
    pub text: String,
}

/// Figures of one joint.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct JointCheck {
    /// Range of positions, rad.
    pub position_rad: (f64, f64),
    /// Largest speed, rad/s.
    pub speed_rad_s: f64,
    /// RMS torque while the joint moves, N·m.
    pub torque_rms_nm: f64,
    /// Noise of the filtered torque, N·m, from its scatter between neighbouring rows.
    pub noise_floor_nm: f64,
    /// Share of the variance of the torque that neither the description nor friction nor a rotor explains.
    pub unexplained_ratio: f64,
    /// Torque over that of the description's links; none where gravity is too small to tell.
    pub scale_ratio: Option<f64>,
}

/// Judgement of logs.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Judgement {
    /// Findings, refusals first.
    pub findings: Vec<Finding>,
    /// Joint by joint.
    pub joints: Vec<JointCheck>,
    /// Time between rows, s.
    pub period_s: f64,
    /// Delay of the torques behind the positions, s, and its standard deviation.
    pub delay_s: Option<(f64, f64)>,
    /// Parameters that the motion does not show.
    pub unseen: Vec<String>,
    /// Condition number of all columns at unit length.
    pub condition_number_equilibrated: Option<f64>,
    /// Remarks of the readers.
    pub notes: Vec<String>,
}

impl Judgement {
    /// There is a finding that refuses a bank.
    pub fn refuses(&self) -> bool {
        self.findings.iter().any(|finding| finding.refuses)
    }

    pub(super) fn find(&mut self, refuses: bool, text: impl Into<String>) {
        let text = text.into();
        self.findings.push(Finding { refuses, text });
        self.findings.sort_by_key(|finding| !finding.refuses);
    }
}

/// Sums of a joint: range, speed, torque, scatter between rows, rows, spikes.
#[derive(Clone, Copy, Default)]
struct Extremes {
    position: (f64, f64),
    speed: f64,
    /// Time of that speed, s, and steps beyond what the joint can do.
    fastest_s: f64,
    fast: f64,
    torque: f64,
    /// Time of that torque, s, and rows beyond what the joint can do.
    strongest_s: f64,
    strong: f64,
    /// Torques are drive gain × current.
    currents: bool,
    /// Largest torques of either sign while the joint moves, and rows in which it does.
    tops: [Top; 2],
    moving: f64,
    /// Longest time for which the torque of the moving joint did not change, and that which lasts, from … to, s.
    stuck: [(f64, f64); 2],
    power: f64,
    scatter: f64,
    rows: f64,
    at_top: f64,
    spikes: f64,
    /// Squares of the change of positions and of the logged velocities, and their product.
    rates: [f64; 3],
    /// Of position and torque.
    rough: [Roughness; 2],
}

/// Largest value of a signal and the largest below it, and rows with each.
#[derive(Clone, Copy, Default)]
struct Top([(f64, f64); 2]);

impl Top {
    fn add(&mut self, value: f64) {
        let [first, second] = &mut self.0;
        if value > first.0 {
            (*second, *first) = (*first, (value, 1.0));
        } else if value == first.0 {
            first.1 += 1.0;
        } else if value > second.0 {
            *second = (value, 1.0);
        } else if value == second.0 {
            second.1 += 1.0;
        }
    }

    /// Value at which a signal of so many `rows` is cut off, with the share of the rows there. A signal of coarse steps has
    /// rows at its second largest value, too.
    fn cut(&self, rows: f64) -> Option<(f64, f64)> {
        let [first, second] = self.0;
        let share = first.1 / f64::max(rows, 1.0);
        (share > CUT_SHARE.0 && first.1 > 10.0 * second.1).then_some((first.0, share))
    }
}

/// Judges logs before anything is identified.
///
/// Errors: [`IdentifyError`] of a log that cannot be read.
pub fn judge(
    robot: &Robot,
    logs: &[PathBuf],
    columns: &ColumnSet,
    config: &PrepareConfig,
) -> Result<Judgement, IdentifyError> {
    let layout = Layout::new(robot, columns);
    let joints = layout.joints();
    let mut judgement = Judgement::default();
    let mut extremes = vec![Extremes::none(); joints];
    for path in logs {
        config.check(path, robot)?;
        judgement.period_s = scan(path, robot, &mut extremes)?;
        let hint = other_unit_of_time(judgement.period_s);
        if !hint.is_empty() {
            let text = format!("its rows are {:.3} s apart{hint}", judgement.period_s);
            judgement.find(true, text);
            return Ok(judgement);
        }
    }
    units(&mut judgement, robot, &extremes);
    if judgement.refuses() {
        return Ok(judgement);
    }
    let mut sample = Thinned::new(ROWS);
    let mut sums = NormalEquations::new(&layout);
    let mut delays: Vec<Delay> = (0..joints).map(|_| Delay::default()).collect();
    let (mut gain, mut period_s) = (1.0, judgement.period_s);
    for path in logs {
        for_each_prepared(
            path,
            robot,
            &layout,
            config,
            &mut judgement.notes,
            &mut |own, prepared| {
                (gain, period_s) = (own.noise_gain(), own.period_s);
                let stride = own.stride();
                for row in prepared.core.clone().step_by(stride) {
                    let tau = PerJoint::from(&prepared.tau[row * joints..][..joints]);
                    sample.push((prepared.states[row], tau));
                    for joint in 0..joints {
                        let x = prepared.columns(&layout, row, joint);
                        let qd = prepared.states[row].qd[joint];
                        if qd.abs() > own.still_rad_s {
                            sums.joints[joint].add(x, &[tau[joint]]);
                        }
                        let tau = |row: usize| prepared.tau.get(row * joints + joint).copied();
                        delays[joint].add(x, qd, (row, stride, own.period_s), &tau);
                    }
                }
            },
        )?;
    }
    if sums.count() == 0.0 {
        return Ok(judgement);
    }
    match sums.check_rank(&layout) {
        Err(IdentifyError::RankDeficient(_, _, names)) => {
            let names_text = names.join(", ");
            judgement.find(false, format!("the motion does not show {names_text}"));
            judgement.unseen = names;
        }
        Err(other) => return Err(other),
        Ok(()) => {
            judgement.condition_number_equilibrated = Some(sums.condition_numbers(&layout).1);
        }
    }
    compare(&mut judgement, robot, &sample.kept, &extremes, gain);
    if !judgement.refuses() {
        delay(&mut judgement, &layout, &delays, period_s);
    }
    Ok(judgement)
}

impl Extremes {
    fn none() -> Self {
        Self {
            position: (f64::INFINITY, f64::NEG_INFINITY),
            tops: [Top([(f64::NEG_INFINITY, 0.0); 2]); 2],
            ..Self::default()
        }
    }

    /// The joint moved fast and far enough to be judged by its motion.
    fn moved(&self) -> bool {
        let (low, high) = self.position;
        self.speed > MOVED.0 && high - low > MOVED.1
    }

    /// Range of the change of positions over the logged velocities: noise of either enters one end alone.
    fn rate_ratio(&self) -> Option<(f64, f64)> {
        let [change, logged, product] = self.rates;
        (product > 0.0 && self.moved()).then(|| (product / logged, change / product))
    }

    /// Torque that never changes while the joint moves, N·m.
    fn constant(&self) -> Option<f64> {
        let [(most, rows), _] = self.tops[0].0;
        (rows > 0.0 && rows == self.moving).then_some(most)
    }

    /// RMS torque while the joint moves, N·m.
    fn rms(&self) -> f64 {
        (self.power / f64::max(self.rows, 1.0)).sqrt()
    }

    /// Noise of a row of the torque, N·m: the second difference of white noise has six times its variance.
    fn noise(&self) -> f64 {
        (self.scatter / f64::max(self.rows, 1.0) / 6.0).sqrt()
    }
}

/// Ranges of a log as it is, and the time between its rows, s.
fn scan(path: &Path, robot: &Robot, extremes: &mut [Extremes]) -> Result<f64, IdentifyError> {
    let mut log = WholeLog::open(path, robot)?;
    let period_s = log.period_s();
    let currents = log.reader.has_currents;
    extremes
        .iter_mut()
        .for_each(|sums| sums.currents = currents);
    let mut last: Vec<LogRow> = Vec::new();
    let rough = extremes.iter_mut().flat_map(|sums| &mut sums.rough);
    rough.for_each(Roughness::pause);
    while let Some(row) = log.next_row()? {
        // Over a gap an angle may have wrapped.
        let before = last.last();
        if before.is_some_and(|before| row.t_s - before.t_s > GAP_PERIODS * period_s) {
            last.clear();
        }
        for (joint, sums) in extremes.iter_mut().enumerate() {
            let (q, tau) = (row.q[joint], row.tau[joint]);
            let limits = &robot.joints[joint].limits;
            let limit = limits.torque;
            sums.position = (sums.position.0.min(q), sums.position.1.max(q));
            if tau.abs() > sums.torque {
                (sums.torque, sums.strongest_s) = (tau.abs(), row.t_s);
            }
            sums.strong += f64::from(tau.abs() > BEYOND * limit);
            sums.rough[0].add(q);
            sums.scatter += sums.rough[1].add(tau);
            if let [a, b] = &last[..] {
                let qd = (q - a.q[joint]) / (row.t_s - a.t_s);
                if qd.abs() > sums.speed {
                    (sums.speed, sums.fastest_s) = (qd.abs(), b.t_s);
                }
                sums.fast += f64::from(qd.abs() > BEYOND * limits.velocity);
                if qd.abs() > MOVED.0 {
                    let [most, least] = &mut sums.tops;
                    most.add(tau);
                    least.add(-tau);
                    sums.moving += 1.0;
                }
                let [longest, lasting] = &mut sums.stuck;
                if qd.abs() <= MOVED.0 || tau != b.tau[joint] {
                    *lasting = (row.t_s, row.t_s);
                }
                lasting.1 = row.t_s;
                if lasting.1 - lasting.0 > longest.1 - longest.0 {
                    *longest = *lasting;
                }
                let logged = b.qd[joint];
                let products = [qd * qd, logged * logged, qd * logged];
                sums.rates = std::array::from_fn(|k| sums.rates[k] + products[k]);
                sums.power += tau * tau;
                sums.rows += 1.0;
                let jumps = (b.tau[joint] - a.tau[joint]) * (b.tau[joint] - tau);
                sums.spikes += f64::from(jumps > (0.2 * limit).powi(2));
                sums.at_top += f64::from(tau.abs() >= 0.995 * limit);
            } else {
                sums.stuck[1] = (row.t_s, row.t_s);
            }
        }
        if last.len() == 2 {
            last.remove(0);
        }
        last.push(row);
    }
    Ok(period_s)
}

/// Findings on ranges: units, quantities in each other's columns, spikes, saturation.
fn units(judgement: &mut Judgement, robot: &Robot, extremes: &[Extremes]) {
    let joints = || robot.joints.iter().zip(extremes).enumerate();
    let swapped = Roughness::are_swapped(extremes.iter().map(|seen| seen.rough));
    let most = |(low, high): (f64, f64)| low.abs().max(high.abs());
    let far = joints().find(|(_, (joint, seen))| {
        let beyond = most(seen.position) > BEYOND * most(joint.limits.position);
        beyond || seen.speed > BEYOND * joint.limits.velocity
    });
    let fits = |joint: &Joint, seen: &Extremes| seen.torque <= 1.1 * most(joint.limits.position);
    let many = swapped && joints().all(|(_, (joint, seen))| fits(joint, seen));
    if let Some((number, (joint, seen))) = far {
        let text = if many {
            "positions and torques are swapped: what stands for a torque is smoother than what stands for a position".to_owned()
        } else {
            let (most, (low, high)) = (most(seen.position), joint.limits.position);
            let fits = most <= BEYOND * low.abs().max(high.abs());
            if fits && seen.fast <= 2.0 * FEW * seen.rows {
                format!(
                    "q{} jumps at {:.3} s, by {:.4} rad/s where its largest speed is {:.3} rad/s, {} such steps in all: {ROWS_REMEDY}, or are the limits too low (--velocity-limits)?",
                    number + 1,
                    seen.fastest_s,
                    seen.speed,
                    joint.limits.velocity,
                    seen.fast
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
        };
        judgement.find(true, text);
        return;
    }
    if swapped {
        let text = "positions and torques are swapped: the torque is the smoother of the two";
        judgement.find(true, text);
        return;
    }
    if let Some(text) = rates(extremes) {
        judgement.find(true, text);
        return;
    }
    let strong: Vec<_> = joints()
        .filter(|(_, (joint, seen))| seen.rms() > BEYOND * joint.limits.torque)
        .collect();
    if let Some((number, (joint, seen))) = strong.first() {
        let thousandth = 1e-3 * seen.torque <= BEYOND * joint.limits.torque;
        // One unit holds for all joints; their limits may be of different use.
        let unit = match thousandth {
            _ if seen.strong <= FEW * seen.rows => ROWS_REMEDY,
            true if seen.currents => "are these mA (--units i=mA)?",
            true if strong.len() * 3 > extremes.len() => {
                "is this mN·m or N·cm (--units tau=mNm or tau=Ncm)?"
            }
            true => "those of the others are within theirs; drive gain or unit?",
            false => "drive gain, unit, or another arm?",
        };
        let text = format!(
            "tau{} reaches {:.1} N·m at {:.3} s, its limit is {} N·m: {unit}",
            number + 1,
            seen.torque,
            seen.strongest_s,
            joint.limits.torque
        );
        judgement.find(true, text);
    }
    for (number, (_, seen)) in joints() {
        if seen.constant().is_some() {
            continue;
        }
        let findings = judgement.findings.len();
        for (top, sign) in seen.tops.iter().zip([1.0, -1.0]) {
            if let Some((value, share)) = top.cut(seen.moving).filter(|(value, _)| *value != 0.0) {
                let (value, percent) = (sign * value, 100.0 * share);
                judgement.find(share > CUT_SHARE.1, format!(
                    "torque of joint {} is cut off at {value:.4} N·m in {percent:.1} % of the rows in which it moves: a slower path, or cut these rows out",
                    number + 1
                ));
            }
        }
        let [(from_s, to_s), _] = seen.stuck;
        if judgement.findings.len() == findings && to_s - from_s > STUCK_S {
            judgement.find(false, format!(
                "torque of joint {} does not change from {from_s:.3} to {to_s:.3} s while it moves: did its sensor stop, or is it cut off? Leave these rows out",
                number + 1
            ));
        }
        for (count, most, problem) in [
            (seen.spikes, 0.5, "spikes of the torque"),
            (seen.at_top, 1.0, "at its torque limit"),
        ] {
            let percent = 100.0 * count / f64::max(seen.rows, 1.0);
            if percent > most {
                let text = format!(
                    "joint {}: {problem} in {percent:.1} % of the rows",
                    number + 1
                );
                judgement.find(false, text);
            }
        }
    }
}

/// Positions that change faster or slower than the logged velocities.
fn rates(extremes: &[Extremes]) -> Option<String> {
    let ratios = extremes.iter().enumerate();
    let ratios = ratios.filter_map(|(joint, seen)| Some((joint + 1, seen.rate_ratio()?)));
    let ratios: Vec<(usize, (f64, f64))> = ratios.collect();
    let off = ratios
        .iter()
        .filter(|(_, (least, most))| *least > SOUND_RATE || *most < 1.0 / SOUND_RATE);
    let off: Vec<_> = off.collect();
    let (joint, (least, most)) = *off.first()?;
    let ratio = (least * most).sqrt();
    Some(if off.len() * 2 > ratios.len() {
        format!(
            "positions change {ratio:.2} times as fast as the logged velocities: are the times right (else rate_hz in --columns-from FILE), and the units (--units)?"
        )
    } else {
        format!(
            "positions of joint {joint} change {ratio:.2} times as fast as its logged velocities, those of the others do not: is the scale of one of the two wrong?"
        )
    })
}
