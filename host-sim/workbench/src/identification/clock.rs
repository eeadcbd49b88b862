//! Clock of a log: rows are even, stamped on arrival, or taken at their stamps.

use super::log::LogRow;

/// A step in time of more than this many periods cuts the log; the rows lost in a shorter one, four at most, are put in.
pub(super) const GAP_PERIODS: f64 = 5.5;
/// A step shorter than this many periods ends at a row that was stamped in time, and begins at one that was late.
const ARRIVAL_PERIODS: f64 = 0.5;

/// Largest jitter of a clock that counts as even, RMS, share of a period.
const EVEN: f64 = 0.05;

/// Share of the squared way between neighbours that noise does not reach: alone it leaves three quarters.
const MOVES: f64 = 0.1;

/// Fewest rows that decide: as many throws of a coin agree by chance once in 128 times.
const FEWEST: usize = 8;

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

/// Step times that 5, 50 and 95 % of the rows do not exceed, s; of two rows at least.
pub(super) fn step_times(rows: &[LogRow]) -> [f64; 3] {
    let mut steps: Vec<f64> = steps(rows).collect();
    steps.sort_by(f64::total_cmp);
    [0.05, 0.5, 0.95].map(|share| steps[(share * steps.len() as f64) as usize])
}

fn steps(rows: &[LogRow]) -> impl Iterator<Item = f64> {
    rows.windows(2).map(|pair| pair[1].t_s - pair[0].t_s)
}

/// Mean period of the rows, s, from the median of their steps: steps that scatter about two lengths have their median at the
/// edge of the shorter.
pub(super) fn mean_period_s(rows: &[LogRow]) -> f64 {
    let [_, median_s, _] = step_times(rows);
    let short = steps(rows).filter(|step_s| *step_s <= GAP_PERIODS * median_s);
    let (time_s, periods) = short.fold((0.0, 0.0), |(time_s, periods), step_s| {
        (time_s + step_s, periods + whole_periods(step_s, median_s))
    });
    if periods > 0.0 {
        time_s / periods
    } else {
        median_s
    }
}

/// Clock of a log and its period, s, from its first rows. Where steps are uneven, the positions decide: each lies between
/// its neighbours by their stamps, by lost rows, or in the middle.
pub(super) fn clock(rows: &[LogRow]) -> (Clock, f64) {
    let [_, median_s, longest_s] = step_times(rows);
    let on_arrival = || {
        let kept = || steps(rows).filter(|step_s| *step_s <= GAP_PERIODS * longest_s);
        (Clock::Arrival, kept().sum::<f64>() / kept().count() as f64)
    };
    // Rows that come in bursts.
    if longest_s > GAP_PERIODS * median_s {
        return on_arrival();
    }
    let period_s = mean_period_s(rows);
    let (mut jitter, mut count, mut late, mut early) = (0.0, 0.0, 0, 0);
    for step_s in steps(rows).filter(|step_s| *step_s <= GAP_PERIODS * period_s) {
        let whole = whole_periods(step_s, period_s);
        jitter += (step_s / period_s - whole).powi(2);
        count += 1.0;
        late += usize::from(whole > 1.0);
        early += usize::from(step_s < ARRIVAL_PERIODS * period_s);
    }
    let uneven = (jitter / f64::max(count, 1.0)).sqrt() > EVEN;
    let places = Places::of(rows, period_s);
    if uneven && places.are_stamped() {
        return (Clock::Stamps, period_s);
    }
    // A delay is a long step before a short one: where most long steps have one, no row is lost.
    let answered = early > 0 && 2 * early >= late;
    let arrival = on_arrival();
    if places.are_even().unwrap_or(answered) && !drifts(rows, arrival.1, longest_s) {
        return arrival;
    }
    // Rows that were polled: some repeat a state and are left out, as many have passed one over.
    let polled = late > 0 && uneven && places.are_even() == Some(true);
    (if polled { Clock::Stamps } else { Clock::Even }, period_s)
}

/// The stamps leave a count of the rows by more than a delay can.
fn drifts(rows: &[LogRow], period_s: f64, longest_s: f64) -> bool {
    let most_s = GAP_PERIODS * longest_s;
    let (mut late_s, mut range_s) = (0.0, (0.0, 0.0));
    for step_s in steps(rows).filter(|step_s| *step_s <= most_s) {
        late_s += step_s - period_s;
        range_s = (f64::min(range_s.0, late_s), f64::max(range_s.1, late_s));
    }
    range_s.1 - range_s.0 > most_s
}

/// Whole periods of a step, at least one.
fn whole_periods(step_s: f64, period_s: f64) -> f64 {
    (step_s / period_s).round().max(1.0)
}

/// Errors of positions that are expected on the line between their neighbours: at the place of their stamps, of whole
/// periods with lost rows, and in the middle.
#[derive(Default)]
struct Places {
    /// Sums of the squared errors.
    errors: [f64; 3],
    /// Sums of the squared distances from the place of the stamps.
    apart: [f64; 3],
    /// Where one step is more periods than the other: errors by whole periods and in the middle, squared distances of the
    /// neighbours.
    differing: [f64; 3],
    /// Rows there.
    count: usize,
}

impl Places {
    fn of(rows: &[LogRow], period_s: f64) -> Self {
        let mut sums = Self::default();
        for three in rows.windows(3) {
            let [before_s, after_s] = [0, 1].map(|k| three[k + 1].t_s - three[k].t_s);
            if before_s.max(after_s) > GAP_PERIODS * period_s {
                continue;
            }
            let share = |before: f64, after: f64| before / (before + after);
            let stamped = share(before_s, after_s);
            let [before, after] = [before_s, after_s].map(|step| whole_periods(step, period_s));
            let shares = [stamped, share(before, after), 0.5];
            sums.count += usize::from(before != after);
            for joint in 0..three[0].q.len() {
                let [here, way] = [1, 2].map(|k| three[k].q[joint] - three[0].q[joint]);
                let errors = shares.map(|share| (here - way * share).powi(2));
                let own = sums.errors.iter_mut().zip(&mut sums.apart);
                for (((error, apart), share), own) in own.zip(shares).zip(errors) {
                    *error += own;
                    *apart += (way * (stamped - share)).powi(2);
                }
                if before != after {
                    let more = [errors[1], errors[2], way * way];
                    let sums = sums.differing.iter_mut().zip(more);
                    sums.for_each(|(sum, more)| *sum += more);
                }
            }
        }
        sums
    }

    /// The stamps are true. Noise and bends are in all errors: then the others err by as much more as they are apart, and
    /// half of that is the border.
    fn are_stamped(&self) -> bool {
        let more = |other: usize| self.errors[other] - self.errors[0];
        more(1) > 0.5 * self.apart[1] && more(2) > 0.5 * self.apart[2]
    }

    /// The rows are even and none is lost; `None` where the motion does not decide: an arm begins to move, or hardly moves,
    /// or too few rows show it.
    fn are_even(&self) -> Option<bool> {
        let [by_losses, by_count, ways] = self.differing;
        let decides = self.count >= FEWEST && by_losses.min(by_count) < MOVES * ways;
        decides.then_some(by_count < by_losses)
    }
}

#[cfg(test)]
mod tests {
    use crate::identification::whole_log::tests::{motion, written};

    #[test]
    fn an_uneven_clock_is_put_on_a_grid_by_its_stamps() {
        let mut times = vec![0.0];
        for k in 0..400 {
            times.push(times[k] + if k % 2 == 0 { 10e-3 } else { 12e-3 });
        }
        let (rows, log) = written(&times, &times, Some(0.0));
        assert!((log.period_s() - 11e-3).abs() < 1e-12);
        assert!(log.notes.concat().contains("grid of 11.00 ms"));
        for (k, row) in rows.iter().enumerate() {
            let (q, _) = motion(row.t_s);
            assert!((row.t_s - 11e-3 * k as f64).abs() < 1e-9);
            assert!((row.q[0] - q).abs() < 1e-9, "{} at {}", row.q[0], row.t_s);
        }
        assert!(rows.len() > 398, "{}", rows.len());
    }

    #[test]
    fn positions_distinguish_true_stamps_from_those_of_arrival() {
        let even: Vec<f64> = (0..400).map(|k| 1e-3 * f64::from(k)).collect();
        let jitter = |(k, t): (usize, &f64)| t + [0.0, 2e-4, -2e-4][k * 7 % 5 % 3];
        let uneven: Vec<f64> = even.iter().enumerate().map(jitter).collect();
        for error in [Some(0.5), None] {
            let grid = |times: &[f64]| {
                let (_, log) = written(times, &uneven, error);
                log.notes.concat().contains("put on a grid")
            };
            assert!(grid(&uneven), "rows at their stamps, {error:?}");
            assert!(!grid(&even), "even rows with uneven stamps, {error:?}");
        }
    }

    #[test]
    fn polls_of_a_faster_robot_are_rows_at_their_stamps() {
        // A poll sees the state of the last millisecond: some repeat one, as many pass one over.
        let jitter = |k: u32| 1e-3 * (f64::from(k * 7919 % 1000) / 1000.0 - 0.5);
        for share in [0.1, 0.5] {
            let polls = (0..4000).map(|k| 1e-3 * (f64::from(k) + 0.5) + share * jitter(k));
            let stamps: Vec<f64> = polls.map(|t| t + 3e-4).collect();
            let states: Vec<f64> = stamps.iter().map(|t| 1e-3 * (1e3 * t).floor()).collect();
            let read: Vec<f64> = states.iter().map(|t| (0.5 * t).sin()).collect();
            let (rows, _) = written(&read, &stamps, None);
            let worst = rows
                .iter()
                .map(|row| (row.q[0] - motion((0.5 * row.t_s).sin()).0).abs());
            let worst = worst.fold(0.0, f64::max);
            assert!(worst < 8e-3, "{worst}");
        }
    }

    #[test]
    fn an_arm_that_rests_for_long_first_has_the_clock_of_its_motion() {
        const REST: usize = 5000;
        let even: Vec<f64> = (0..400 + REST).map(|k| 1e-3 * k as f64).collect();
        let jitter = |(k, t): (usize, &f64)| t + [0.0, 2e-4, -2e-4][k * 7 % 5 % 3];
        let stamps: Vec<f64> = even.iter().enumerate().map(jitter).collect();
        let moving = |times: &[f64], every: usize| -> Vec<f64> {
            let rows = (0..times.len()).map(|k| k.max(REST));
            rows.map(|k| times[REST + (k - REST) / every * every] - times[REST])
                .collect()
        };
        let note = |times: &[f64], stamps: &[f64], wanted: &str| {
            let (_, log) = written(times, stamps, None);
            assert!(log.noise[0] > 0.0);
            log.notes.concat().contains(wanted)
        };
        assert!(note(&moving(&stamps, 1), &stamps, "put on a grid"));
        assert!(!note(&moving(&even, 1), &stamps, "put on a grid"));
        assert!(note(&moving(&even, 4), &even, "positions repeat in 4 rows"));
        assert!(!note(&moving(&even, 1), &even, "positions repeat"));
    }

    #[test]
    fn rest_at_the_begin_changes_no_period() {
        for rest in [100, 500, 2000, 5000] {
            for times in [2, 4, 8] {
                // Readings of an arm that rests, then moves, in so many rows each.
                let rows = rest + 2000 * times;
                let stamps: Vec<f64> = (0..rows).map(|k| 1e-3 * k as f64).collect();
                let read = |k: usize| k.max(rest) - (k.max(rest) - rest) % times - rest;
                let place = |k: usize| 0.9 + 0.5 * (0.025 * (read(k) / times) as f64).sin();
                let read: Vec<f64> = (0..rows).map(place).collect();
                let (_, log) = written(&read, &stamps, None);
                let period_s = 1e-3 * times as f64;
                let off = log.period_s() / period_s - 1.0;
                assert!(off.abs() < 1e-3, "{rest} {times}: {}", log.period_s());
            }
        }
        // A logger that is slower at rest.
        let rest = (0..300).map(|k| 1e-2 * f64::from(k));
        let stamps: Vec<f64> = rest
            .chain((0..3500).map(|k| 3.0 + 2e-3 * f64::from(k)))
            .collect();
        let read: Vec<f64> = stamps.iter().map(|t| 0.1 * (t - 3.0).max(0.0)).collect();
        let (_, log) = written(&read, &stamps, None);
        assert!((log.period_s() - 2e-3).abs() < 2e-6, "{}", log.period_s());
    }

    #[test]
    fn late_stamps_behind_the_first_rows_lose_none() {
        let even: Vec<f64> = (0..8000).map(|k| 4e-3 * f64::from(k)).collect();
        let mut late_s = 0.0_f64;
        let stamps = even.iter().enumerate().map(|(k, t)| {
            late_s = if k > 5000 && k % 125 == 0 {
                11.2e-3
            } else {
                (late_s - 2e-3).max(0.0)
            };
            t + late_s
        });
        let stamps: Vec<f64> = stamps.collect();
        let read: Vec<f64> = even.iter().map(|t| 0.02 * t).collect();
        let (rows, log) = written(&read, &stamps, None);
        assert_eq!((log.lost, rows.len()), (0, even.len()));
        for (row, t) in rows.iter().zip(&even) {
            assert!((row.t_s - t).abs() < 2e-3, "{} at {t}", row.t_s);
        }
        // Rows that are lost after them are put in.
        let kept = |k: &usize| *k < 6000 || k % 50 > 1;
        let kept: Vec<usize> = (0..8000).filter(kept).collect();
        let even: Vec<f64> = kept.iter().map(|k| even[*k]).collect();
        let read: Vec<f64> = even.iter().map(|t| 0.02 * t).collect();
        let (rows, log) = written(&read, &even, None);
        assert_eq!((rows.len(), log.lost), (8000, 8000 - kept.len()));
    }

    #[test]
    fn stamps_that_are_rounded_have_the_period_of_their_mean() {
        for period_s in [10.45e-3, 50e-3 / 3.0, 1.04e-3] {
            let even: Vec<f64> = (0..400).map(|k| period_s * f64::from(k)).collect();
            let step_s = if period_s > 2e-3 { 1e-3 } else { 1e-4 };
            let rounded: Vec<f64> = even.iter().map(|t| (t / step_s).round() * step_s).collect();
            let (_, log) = written(&even, &rounded, None);
            let off = log.period_s() / period_s - 1.0;
            assert!(off.abs() < 3e-4, "{period_s}: {off:e}");
        }
    }

    #[test]
    fn a_row_lost_where_the_motion_begins_is_no_delay() {
        let kept = (0..4000).filter(|k| *k != 1 && (*k < 3000 || k % 50 != 0));
        let even: Vec<f64> = kept.map(|k| 1e-3 * f64::from(k)).collect();
        let read: Vec<f64> = even.iter().map(|t| 0.02 * t.powi(3)).collect();
        let (rows, log) = written(&read, &even, None);
        assert_eq!((rows.len(), log.lost), (4000, 4000 - even.len()));
    }

    #[test]
    fn one_odd_step_changes_no_clock() {
        // Two of three steps are 10 ms, the first is 2 ms.
        let mut uneven = vec![0.0, 2e-3];
        let mut lost = vec![0.0, 2e-3];
        for k in 1..400 {
            uneven.push(uneven[k] + if k % 3 == 0 { 12e-3 } else { 10e-3 });
            lost.push(lost[k] + if k % 5 == 0 { 16e-3 } else { 8e-3 });
        }
        // Rows of 2 ms in bursts of eight, and with delays of up to a period.
        let even: Vec<f64> = (0..400).map(|k| 2e-3 * f64::from(k)).collect();
        let burst = |(k, _): (usize, &f64)| 16e-3 * (k / 8) as f64 + 2e-5 * (k % 8) as f64;
        let delay = |(k, t): (usize, &f64)| t + 1.9e-3 * (k * 7 % 19) as f64 / 19.0;
        let bursts: Vec<f64> = even.iter().enumerate().map(burst).collect();
        let delays: Vec<f64> = even.iter().enumerate().map(delay).collect();
        // Even rows whose stamps are rounded to 2 ms: the median step is 10 ms.
        let mean_s = 32e-3 / 3.0;
        let slow: Vec<f64> = (0..400).map(|k| mean_s * f64::from(k)).collect();
        let rounded: Vec<f64> = slow.iter().map(|t| (t / 2e-3).round() * 2e-3).collect();
        // Times, stamps, error of the velocities, period and its error, s, and lost rows.
        for (times, stamps, error, [period_s, within_s], lost) in [
            (&uneven, &uneven, Some(0.0), [mean_s, 1e-4], 0..400),
            (&uneven, &uneven, None, [mean_s, 1e-4], 0..400),
            (&lost, &lost, Some(0.0), [8e-3, 1e-4], 71..400),
            (&lost, &lost, None, [8e-3, 1e-4], 71..400),
            (&even, &bursts, None, [2e-3, 5e-5], 0..1),
            (&even, &delays, None, [2e-3, 5e-5], 0..1),
            (&slow, &rounded, None, [mean_s, 1e-4], 0..400),
        ] {
            let (rows, log) = written(times, stamps, error);
            let found_s = log.period_s();
            assert!((found_s - period_s).abs() < within_s, "{found_s}");
            assert!(lost.contains(&log.lost), "{} of {lost:?}", log.lost);
            if lost == (0..1) {
                assert_eq!(rows.len(), times.len());
            }
        }
    }
}
