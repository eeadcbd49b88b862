//! Sums over a log joint by joint, in one pass: ranges, speeds, torques, and the time in which a sensor keeps one value.

use super::MOVED;
use crate::identification::IdentifyError;
use crate::identification::clock::GAP_PERIODS;
use crate::identification::log::{LogRow, Roughness};
use crate::identification::whole_log::WholeLog;
use crate::robot::Robot;
use std::collections::VecDeque;
use std::path::Path;

/// Positions and torques this many times their limits are in other units.
pub(super) const BEYOND: f64 = 3.0;
/// Share of the rows in which a sensor is stuck or a torque is cut off that is noted, and that is refused.
pub(super) const CUT_SHARE: (f64, f64) = (0.01, 0.05);
/// Time for which no sensor gives one value while its joint moves, s.
const STUCK_S: f64 = 0.5;
/// Time over which an arm is looked at to see whether it moves, s.
const SPAN_S: f64 = 0.05;
/// Least time over which the change of a position is compared with the integral of its logged velocity, s.
const WAY_S: f64 = 0.2;

/// Sums of a joint: range, speed, torque, scatter between rows, rows, spikes.
#[derive(Clone, Copy, Default)]
pub(super) struct Extremes {
    pub(super) position: (f64, f64),
    /// The position counts turns of the joint: it has no ends.
    pub(super) unwrapped: bool,
    pub(super) speed: f64,
    /// Time of that speed, s, and steps beyond what the joint can do.
    pub(super) fastest_s: f64,
    pub(super) fast: f64,
    pub(super) torque: f64,
    /// Time of that torque, s, and rows beyond what the joint can do.
    pub(super) strongest_s: f64,
    pub(super) strong: f64,
    /// Largest torques of either sign while the joint moves, and rows in which it does.
    tops: [Top; 2],
    moving: f64,
    /// Of position and torque.
    pub(super) unchanged: [Unchanged; 2],
    /// Position by the logged velocity, rad.
    by_velocity: f64,
    /// Time, position and integral of the logged velocity at the start of the current comparison.
    way_from: Option<[f64; 3]>,
    /// Change of the position and integral of the logged velocity, over [`WAY_S`]: encoder steps are small beside it.
    pub(super) ways: Rate,
    held: Held,
    /// Squares of the torque and of its second difference, and rows, while the arm moves: brakes may hold it at rest.
    power: f64,
    scatter: f64,
    moving_rows: f64,
    pub(super) rows: f64,
    /// Rows just below the torque limit, at it, and above.
    pub(super) near_limit: [f64; 3],
    pub(super) spikes: f64,
    /// Of positions and logged velocities, and of these and mapped accelerations.
    pub(super) rates: [Rate; 2],
    /// Velocities and accelerations are used as they are.
    pub(super) mapped: bool,
    /// Of position and torque.
    pub(super) rough: [Roughness; 2],
}

/// Squares of the change of a signal and of its logged derivative, and their product.
#[derive(Clone, Copy, Default)]
pub(super) struct Rate {
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
    pub(super) fn ratio(&self) -> Option<(f64, f64)> {
        (self.product > 0.0).then(|| (self.product / self.logged, self.change / self.product))
    }

    /// The logged derivative is zero, or has the other sign.
    pub(super) fn is_zero(&self) -> bool {
        self.change > 0.0 && self.logged <= 1e-6 * self.change
    }

    /// Share of the power that the two have in common: the rest is noise of either, alike or not. NaN where one of them is
    /// zero, or without any value.
    pub(super) fn agreement(&self) -> f64 {
        self.product.powi(2) / (self.change * self.logged)
    }

    pub(super) fn is_turned(&self) -> bool {
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
    pub(super) rows: u8,
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
pub(super) struct Run {
    pub(super) value: f64,
    pub(super) from_s: f64,
    pub(super) to_s: f64,
    /// Part of it in which the joint moves, s.
    moving_s: f64,
    /// Range of its positions, rad.
    places: (f64, f64),
}

/// The run of a signal that lasts, and the one with the most motion.
#[derive(Clone, Copy, Default)]
pub(super) struct Unchanged {
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
    pub(super) fn stuck(&self) -> Option<(Run, f64)> {
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
    pub(super) fn cuts(&self) -> impl Iterator<Item = (f64, f64)> {
        let tops = self.tops.iter().zip([1.0, -1.0]);
        let cuts = tops.filter_map(|(top, sign)| {
            let (value, share) = top.cut(self.moving)?;
            Some((sign * value, share))
        });
        cuts.filter(|(value, _)| *value != 0.0)
    }

    /// RMS torque while the arm moves, N·m.
    pub(super) fn rms(&self) -> f64 {
        (self.power / f64::max(self.moving_rows, 1.0)).sqrt()
    }

    /// Noise of a row of the torque, N·m: the second difference of white noise has six times its variance.
    pub(super) fn noise(&self) -> f64 {
        (self.scatter / f64::max(self.moving_rows, 1.0) / 6.0).sqrt()
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
        // A flickering encoder is fast from row to row only.
        while recent
            .get(1)
            .is_some_and(|other| row.t_s - other.t_s >= SPAN_S)
        {
            recent.pop_front();
        }
        let moving_rows = recent.front().is_some_and(|from| {
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
                let qd = (q - a.q[joint]) / (row.t_s - a.t_s);
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
                let here = [row.t_s, q, sums.by_velocity];
                let from = *sums.way_from.get_or_insert(here);
                let [time_s, way, by_velocity] = [0, 1, 2].map(|k| here[k] - from[k]);
                if time_s >= WAY_S {
                    sums.ways.add(way, by_velocity);
                    sums.way_from = Some(here);
                }
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
                if moving_rows {
                    sums.power += tau * tau;
                    sums.scatter += scatter;
                    sums.moving_rows += 1.0;
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
                sums.way_from = None;
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
