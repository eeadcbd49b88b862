//! Ranges of a log joint by joint: units, quantities in each other's columns, single wrong rows, and sensors that are cut
//! off or stuck.

use super::{Judgement, MOVED};
use crate::dynamics::RigidBodies;
use crate::identification::IdentifyError;
use crate::identification::clock::GAP_PERIODS;
use crate::identification::log::{LogRow, Roughness, SWAPPED, WITHOUT_ROWS};
use crate::identification::whole_log::WholeLog;
use crate::robot::{Joint, Robot};
use std::collections::VecDeque;
use std::path::Path;

/// Positions and torques this many times their limits are in other units.
const BEYOND: f64 = 3.0;
/// Largest torque over its limit of a log that uses an arm: its drives carry at least its own weight.
const LITTLE: f64 = 0.1;
/// Change of a sound position over its logged velocity, or its reciprocal.
const SOUND_RATE: f64 = 1.25;
/// [`Rate::agreement`] from which noise changes no ratio.
const CLEAR: f64 = 0.9;
/// Share of the rows in which a sensor is stuck or a torque is cut off that is noted, and that is refused.
const CUT_SHARE: (f64, f64) = (0.01, 0.05);
/// Time for which no sensor gives one value while its joint moves, s.
const STUCK_S: f64 = 0.5;
/// Time over which an arm is looked at to see whether it moves, s.
const SPAN_S: f64 = 0.05;
/// Largest share of rows that count as errors of single rows.
const FEW: f64 = 0.01;

/// Sums of a joint: range, speed, torque, scatter between rows, rows, spikes.
#[derive(Clone, Copy, Default)]
pub(super) struct Extremes {
    pub(super) position: (f64, f64),
    /// The position counts turns of the joint: it has no ends.
    unwrapped: bool,
    pub(super) speed: f64,
    /// Time of that speed, s, and steps beyond what the joint can do.
    fastest_s: f64,
    fast: f64,
    torque: f64,
    /// Time of that torque, s, and rows beyond what the joint can do.
    strongest_s: f64,
    strong: f64,
    /// Largest torques of either sign while the joint moves, and rows in which it does.
    tops: [Top; 2],
    moving: f64,
    /// Of position and torque.
    unchanged: [Unchanged; 2],
    /// Position by the logged velocity, rad.
    by_velocity: f64,
    held: Held,
    /// Squares of the torque and of its second difference, and rows, while the arm moves: brakes may hold it at rest.
    power: f64,
    scatter: f64,
    busy: f64,
    rows: f64,
    /// Rows just below the torque limit, at it, and above.
    near_limit: [f64; 3],
    spikes: f64,
    /// Of positions and logged velocities, and of these and mapped accelerations.
    rates: [Rate; 2],
    /// Velocities and accelerations are used as they are.
    mapped: bool,
    /// Of position and torque.
    rough: [Roughness; 2],
}

/// Squares of the change of a signal and of its logged derivative, and their product.
#[derive(Clone, Copy, Default)]
struct Rate {
    change: f64,
    logged: f64,
    product: f64,
}

impl Rate {
    fn add(&mut self, change: f64, logged: f64) {
        self.change += change * change;
        self.logged += logged * logged;
        self.product += change * logged;
    }

    /// Range of the change over the logged derivative: noise of either enters one end alone. `None` where they have nothing
    /// in common.
    fn ratio(&self) -> Option<(f64, f64)> {
        (self.product > 0.0).then(|| (self.product / self.logged, self.change / self.product))
    }

    /// The logged derivative is zero, or has the other sign.
    fn is_zero(&self) -> bool {
        self.change > 0.0 && self.logged <= 1e-6 * self.change
    }

    /// Share of the power that the two have in common: the rest is noise of either, alike or not.
    fn agreement(&self) -> f64 {
        self.product.powi(2) / (self.change * self.logged).max(f64::MIN_POSITIVE)
    }

    fn is_turned(&self) -> bool {
        self.product < 0.0 && self.agreement() > 0.25
    }
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

/// Position of a joint whose encoder is read more seldom than the log has rows.
#[derive(Clone, Copy, Default)]
struct Held {
    value: f64,
    /// Time of the last change, s.
    since_s: f64,
    rate: f64,
    /// Rows for which the rate holds.
    rows: u8,
}

impl Held {
    fn at(value: f64, since_s: f64) -> Self {
        Self {
            value,
            since_s,
            ..Self::default()
        }
    }

    /// Speed of the last change, rad/s, where the value before it stood for longer than `span_s`, in which speeds are taken.
    fn rate(&mut self, value: f64, t_s: f64, span_s: f64) -> Option<f64> {
        self.rows = self.rows.saturating_sub(1);
        if value != self.value {
            let held_s = t_s - self.since_s;
            self.rate = (value - self.value) / held_s;
            // After a rest a jump is one.
            let slower = held_s > 1.1 * span_s && held_s < SPAN_S;
            self.rows = if slower { 2 } else { 0 };
            (self.value, self.since_s) = (value, t_s);
        }
        (self.rows > 0).then_some(self.rate)
    }
}

/// Time in which a signal keeps one value.
#[derive(Clone, Copy, Default)]
struct Run {
    value: f64,
    from_s: f64,
    to_s: f64,
    /// Part of it in which the joint moves, s.
    moving_s: f64,
    /// Range of its positions, rad.
    places: (f64, f64),
}

/// The run of a signal that lasts, and the one with the most motion.
#[derive(Clone, Copy, Default)]
struct Unchanged {
    last: Run,
    longest: Run,
    /// Time in which the joint moves, s.
    moving_s: f64,
}

impl Unchanged {
    /// Adds the value at `t_s`; in `moving_s` of the time since the row before, the joint moves, and is at `place`, rad.
    fn add(&mut self, value: f64, t_s: f64, moving_s: f64, place: f64) {
        if value != self.last.value {
            self.last = Run {
                value,
                from_s: t_s,
                to_s: t_s,
                moving_s: 0.0,
                places: (place, place),
            };
        }
        let (low, high) = self.last.places;
        self.last.places = (low.min(place), high.max(place));
        self.last.to_s = t_s;
        self.last.moving_s += moving_s;
        self.moving_s += moving_s;
        if self.last.moving_s >= self.longest.moving_s {
            self.longest = self.last;
        }
    }

    /// End the run: the next value begins one.
    fn pause(&mut self) {
        self.last.value = f64::NAN;
    }

    /// Longest run, if no sound sensor keeps a value for so long, and its share of the motion. An encoder that flickers at
    /// rest is no motion.
    fn stuck(&self) -> Option<(Run, f64)> {
        let share = self.longest.moving_s / self.moving_s;
        let (low, high) = self.longest.places;
        let moved = self.longest.moving_s > STUCK_S && high - low > MOVED.1;
        moved.then_some((self.longest, share))
    }
}

impl Extremes {
    pub(super) fn none() -> Self {
        Self {
            position: (f64::INFINITY, f64::NEG_INFINITY),
            tops: [Top([(f64::NEG_INFINITY, 0.0); 2]); 2],
            ..Self::default()
        }
    }

    /// The joint moved fast and far enough to be judged by its motion.
    pub(super) fn moved(&self) -> bool {
        let (low, high) = self.position;
        self.speed > MOVED.0 && high - low > MOVED.1
    }

    /// The log has velocities.
    pub(super) fn has_velocity(&self) -> bool {
        self.rates[0].logged > 0.0
    }

    /// No torque is below zero while the joint moves, and the torque changes.
    pub(super) fn unsigned(&self) -> bool {
        let [_, Top([(below_zero, _), _])] = self.tops;
        self.moved() && below_zero <= 0.0 && self.constant().is_none()
    }

    /// Torque that never changes while the joint moves, N·m.
    pub(super) fn constant(&self) -> Option<f64> {
        let [(most, rows), _] = self.tops[0].0;
        (rows > 0.0 && rows == self.moving).then_some(most)
    }

    /// Torques at which it is cut off, N·m, with the share of the rows there.
    fn cuts(&self) -> impl Iterator<Item = (f64, f64)> {
        let tops = self.tops.iter().zip([1.0, -1.0]);
        let cuts = tops.filter_map(|(top, sign)| {
            let (value, share) = top.cut(self.moving)?;
            Some((sign * value, share))
        });
        cuts.filter(|(value, _)| *value != 0.0)
    }

    /// RMS torque while the arm moves, N·m.
    pub(super) fn rms(&self) -> f64 {
        (self.power / f64::max(self.busy, 1.0)).sqrt()
    }

    /// Noise of a row of the torque, N·m: the second difference of white noise has six times its variance.
    pub(super) fn noise(&self) -> f64 {
        (self.scatter / f64::max(self.busy, 1.0) / 6.0).sqrt()
    }
}

/// Adds the ranges of a log as it is; returns the time between its rows, s, and whether its torques are drive gain × current.
pub(super) fn scan(
    path: &Path,
    robot: &Robot,
    extremes: &mut [Extremes],
) -> Result<(f64, bool), IdentifyError> {
    let mut log = WholeLog::open(path, robot)?;
    let period_s = log.period_s();
    let mut last: Vec<LogRow> = Vec::new();
    let mut recent: VecDeque<LogRow> = VecDeque::new();
    let has_velocity = log.reader.has_velocity();
    let has_acceleration = log.reader.is_mapped && log.reader.qdd.is_some();
    while let Some(row) = log.next_row()? {
        // Over a gap an angle may have wrapped.
        let follows = |before: &LogRow| row.t_s - before.t_s <= GAP_PERIODS * period_s;
        if !last.last().is_some_and(follows) {
            last.clear();
            recent.clear();
            let rough = extremes.iter_mut().flat_map(|sums| &mut sums.rough);
            rough.for_each(Roughness::pause);
        }
        let speed = |joint: usize| match &last[..] {
            [a, _] => (row.q[joint] - a.q[joint]) / (row.t_s - a.t_s),
            _ => 0.0,
        };
        // A flickering encoder is fast from row to row only.
        while recent
            .get(1)
            .is_some_and(|other| row.t_s - other.t_s >= SPAN_S)
        {
            recent.pop_front();
        }
        let busy = recent.front().is_some_and(|from| {
            let way = |joint: usize| (row.q[joint] - from.q[joint]).abs();
            (0..extremes.len()).any(|joint| way(joint) > MOVED.0 * (row.t_s - from.t_s))
        });
        recent.push_back(row);
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
            let scatter = sums.rough[1].add(tau);
            if let [a, b] = &last[..] {
                let qd = speed(joint);
                let fast = sums.held.rate(q, row.t_s, row.t_s - a.t_s).unwrap_or(qd);
                if fast.abs() > sums.speed {
                    (sums.speed, sums.fastest_s) = (fast.abs(), b.t_s);
                }
                sums.fast += f64::from(fast.abs() > BEYOND * limits.velocity);
                if qd.abs() > MOVED.0 {
                    let [most, least] = &mut sums.tops;
                    most.add(tau);
                    least.add(-tau);
                    sums.moving += 1.0;
                }
                let logged = b.qd[joint];
                sums.by_velocity += logged * (row.t_s - b.t_s);
                let signals = [(q, logged, sums.by_velocity), (tau, qd, q)];
                for (unchanged, (value, speed, place)) in sums.unchanged.iter_mut().zip(signals) {
                    let moves = f64::from(speed.abs() > MOVED.0);
                    unchanged.add(value, row.t_s, moves * (row.t_s - b.t_s), place);
                }
                if has_velocity {
                    sums.rates[0].add(qd, logged);
                    if has_acceleration {
                        let qdd = (row.qd[joint] - a.qd[joint]) / (row.t_s - a.t_s);
                        sums.rates[1].add(qdd, b.qdd[joint]);
                    }
                }
                sums.rows += 1.0;
                if busy {
                    sums.power += tau * tau;
                    sums.scatter += scatter;
                    sums.busy += 1.0;
                }
                let jumps = (b.tau[joint] - a.tau[joint]) * (b.tau[joint] - tau);
                sums.spikes += f64::from(jumps > (0.2 * limit).powi(2));
                let share = tau.abs() / limit;
                let bands = [0.97..0.99, 0.99..1.01, 1.01..f64::INFINITY];
                for (rows, band) in sums.near_limit.iter_mut().zip(bands) {
                    *rows += f64::from(band.contains(&share));
                }
            } else {
                sums.unchanged.iter_mut().for_each(Unchanged::pause);
                sums.held = Held::at(q, row.t_s);
            }
        }
        if last.len() == 2 {
            last.remove(0);
        }
        last.push(row);
    }
    for (joint, sums) in extremes.iter_mut().enumerate() {
        sums.unwrapped |= log.reader.has_wrapped(joint);
        sums.mapped |= log.reader.is_mapped;
    }
    Ok((period_s, log.reader.has_currents))
}

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
    let strong: Vec<_> = joints()
        .filter(|(_, (joint, seen))| seen.rms() > BEYOND * joint.limits.torque)
        .collect();
    if let Some((number, (joint, seen))) = strong.first() {
        let thousandth = 1e-3 * seen.torque <= BEYOND * joint.limits.torque;
        // One unit holds for all joints; their limits may be of different use.
        let weight = RigidBodies::new(robot).largest_gravity_torques()[*number];
        let unit = match thousandth {
            _ if weight > joint.limits.torque => &format!(
                "below the {weight:.0} N·m of the arm's own weight: correct it (--torque-limits)"
            ),
            _ if seen.strong <= FEW * seen.rows => WITHOUT_ROWS,
            true if currents => "are these mA (--units i=mA)?",
            true if strong.len() * 3 > extremes.len() => {
                "is this mN·m or N·cm (--units tau=mNm or tau=Ncm)?"
            }
            true => {
                "those of the others are nearer to theirs; drive gain, unit, or a limit of the description (--torque-limits)?"
            }
            false => {
                "drive gain, unit, a limit of the description (--torque-limits), or another arm?"
            }
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
    signals
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
