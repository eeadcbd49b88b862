//! Clock of a log: even, stamped on arrival, or true stamps; and the rate of its sensors.

use super::log::LogRow;

/// A step in time of more than this many periods cuts the log; rows lost in a shorter one are put in.
pub(super) const GAP_PERIODS: f64 = 5.0;
/// A log with steps shorter than this many periods was timed on arrival: a long step before such a short one was a delay,
/// not a loss.
const ARRIVAL_PERIODS: f64 = 0.5;

/// Largest jitter of a clock that counts as even, RMS, share of a period.
const EVEN: f64 = 0.05;

/// Use of the stamps of a log.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Clock {
    /// Rows are evenly spaced, but for lost ones.
    Even,
    /// Rows are evenly spaced, stamped on arrival.
    Arrival,
    /// Rows were taken at their uneven stamps.
    Stamps,
}

/// Mean period of the steps, s, from their median: steps that scatter about two lengths have their median at the edge of the
/// shorter.
pub(super) fn mean_period_s(steps: impl Iterator<Item = f64>, median_s: f64) -> f64 {
    let short = steps.filter(|step_s| *step_s <= GAP_PERIODS * median_s);
    let (time_s, periods) = short.fold((0.0, 0.0), |(time_s, periods), step_s| {
        (
            time_s + step_s,
            periods + (step_s / median_s).round().max(1.0),
        )
    });
    if periods > 0.0 {
        time_s / periods
    } else {
        median_s
    }
}

/// The clock of a log, from its first rows. Where steps are uneven and the log has velocities, these decide: stamps are
/// true where dq = q̇ dt holds better with them than with even steps.
pub(super) fn clock(rows: &[LogRow], period_s: f64, has_velocity: bool) -> Clock {
    let (mut jitter, mut count, mut shortest) = (0.0, 0.0, f64::INFINITY);
    let steps = rows.windows(2).map(|pair| pair[1].t_s - pair[0].t_s);
    let period_s = mean_period_s(steps, period_s);
    // Squared errors of dq by the stamps and by even steps, and squared differences between both. Errors of the velocities
    // are in both: if the stamps are true, `by_steps − by_stamps` is `apart`; if the steps are even, it is `−apart`.
    let (mut by_stamps, mut by_steps, mut apart) = (0.0, 0.0, 0.0);
    for pair in rows.windows(2) {
        let step_s = pair[1].t_s - pair[0].t_s;
        let periods = step_s / period_s;
        shortest = periods.min(shortest);
        if periods > GAP_PERIODS {
            continue;
        }
        let whole = periods.round().max(1.0);
        jitter += (periods - whole).powi(2);
        count += 1.0;
        for joint in 0..pair[0].q.len() {
            let qd = 0.5 * (pair[0].qd[joint] + pair[1].qd[joint]);
            let dq = pair[1].q[joint] - pair[0].q[joint];
            by_stamps += (dq - qd * step_s).powi(2);
            by_steps += (dq - qd * whole * period_s).powi(2);
            apart += (qd * (step_s - whole * period_s)).powi(2);
        }
    }
    let on_arrival = shortest < ARRIVAL_PERIODS;
    let uneven = (jitter / f64::max(count, 1.0)).sqrt() > EVEN;
    match (uneven, has_velocity, on_arrival) {
        (true, true, _) if by_steps - by_stamps > 0.5 * apart => Clock::Stamps,
        (true, false, false) => Clock::Stamps,
        (_, _, true) => Clock::Arrival,
        _ => Clock::Even,
    }
}

/// Number of rows in which the values of a moving arm are the same, median.
pub(super) fn repeats(rows: &[LogRow]) -> usize {
    let equal = rows.chunk_by(|a, b| (a.q, a.tau) == (b.q, b.tau));
    let mut counts: Vec<usize> = equal.map(<[LogRow]>::len).collect();
    counts.sort_unstable();
    counts.get(counts.len() / 2).copied().unwrap_or(1)
}
