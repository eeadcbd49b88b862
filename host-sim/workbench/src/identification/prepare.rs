//! From a stretch of a log to the rows of the linear model: motion, regressor and torque through the same filter.

use super::columns::Layout;
use super::filter::{Butterworth, derivative, despiked};
use super::filter_length::{longest_piece, noisiest_cut_off};
use super::log::LogRow;
use super::normal::SpeedSums;
use super::whole_log::WholeLog;
use super::{IdentifyError, refused};
use crate::dynamics::{Motion, PerJoint};
use crate::metrics::MOVING_RAD_S;
use crate::robot::Robot;
use nalgebra::DMatrix;
use std::ops::Range;
use std::path::Path;

/// Rows in a period of the motion's cut-off from which derivatives of the positions are used before logged ones.
const MOTION_ROWS: f64 = 8.0;
/// Largest distance of logged velocities and accelerations from the derivative of the positions, shares of their RMS:
/// beyond it they are set-points. Differentiation is less accurate for accelerations.
const TRUST: [f64; 2] = [0.01, 0.03];
/// Delay of mapped velocities from which they are derived, s.
const LATE_S: f64 = 3e-3;

/// Settings of the filters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PrepareConfig {
    /// Cut-off of the filter on the motion, Hz.
    pub motion_hz: f64,
    /// Cut-off of the filter on torque and regressor, Hz; `None` leaves both as they are.
    pub torque_hz: Option<f64>,
    /// A joint slower than this stands still, rad/s.
    pub still_rad_s: f64,
}

/// Question for the unit of the times of a log whose rows are so far apart that no filter keeps a motion; else empty.
pub(super) fn other_unit_of_time(period_s: f64) -> String {
    const LONGEST_S: f64 = 0.2;
    let units = [("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)];
    let fits = units.iter().find(|(_, unit)| period_s * unit <= LONGEST_S);
    match fits {
        Some((unit, _)) if *unit != "s" => format!(
            ": are its times in {unit} (--units t={unit})? A motion needs 5 rows a second or more"
        ),
        _ => String::new(),
    }
}

/// Share of the rate of the rows that the cut-off of the motion keeps below.
const MOTION_SHARE: f64 = 0.4;

impl PrepareConfig {
    /// A joint slower than this stands still, rad/s, by default.
    pub const STILL_RAD_S: f64 = MOVING_RAD_S;

    /// Filters of an identification for the slowest and noisiest of `logs`.
    ///
    /// Errors: the log's.
    pub fn for_logs(logs: &[&Path], robot: &Robot) -> Result<Self, IdentifyError> {
        let mut motion_hz = 40.0_f64;
        for path in logs {
            let log = WholeLog::open(path, robot)?;
            let period_s = log.period_s();
            let motion = noisiest_cut_off(&log, robot).min(MOTION_SHARE / period_s);
            motion_hz = motion_hz.min(motion);
        }
        Ok(Self {
            motion_hz,
            torque_hz: Some(0.5 * motion_hz),
            still_rad_s: Self::STILL_RAD_S,
        })
    }

    /// These filters, or lower ones where the rows of an unseen log are too far apart for them; `notes` receives that.
    ///
    /// Errors: the log's.
    pub fn lowered(
        &self,
        path: &Path,
        robot: &Robot,
        notes: &mut Vec<String>,
    ) -> Result<Self, IdentifyError> {
        let period_s = WholeLog::open(path, robot)?.period_s();
        let bears = |hz: f64| Butterworth::new(hz, period_s).is_some();
        if bears(self.motion_hz) && self.torque_hz.is_none_or(bears) {
            return Ok(*self);
        }
        let motion_hz = self.motion_hz.min(MOTION_SHARE / period_s);
        notes.push(format!(
            "{}: filtered at {motion_hz:.4} Hz, for its rows are {:.1} ms apart",
            path.display(),
            1e3 * period_s
        ));
        Ok(Self {
            motion_hz,
            torque_hz: self.torque_hz.map(|hz| hz.min(0.5 * motion_hz)),
            ..*self
        })
    }

    /// Check that the rows of a log are near enough for the filters.
    ///
    /// Errors: the log's; its rows are too far apart.
    pub(super) fn check(&self, path: &Path, robot: &Robot) -> Result<(), IdentifyError> {
        let period_s = WholeLog::open(path, robot)?.period_s();
        let torque = self.torque_hz.map(|hz| ("--torque-hz", hz));
        for (option, hz) in [("--motion-hz", self.motion_hz)].into_iter().chain(torque) {
            if Butterworth::new(hz, period_s).is_none() {
                let (rate_hz, share) = (1.0 / period_s, Butterworth::RATE_SHARE);
                let hint = other_unit_of_time(period_s);
                return Err(refused(
                    path,
                    format!(
                        "{option} is {hz}, must be below {:.4}, {share} of its {rate_hz:.4} rows a second{hint}",
                        share * rate_hz
                    ),
                ));
            }
        }
        Ok(())
    }
}

/// Filters and sources of motion of one log.
#[derive(Clone, Debug, PartialEq)]
pub struct Preparation {
    /// Time of the first row, s.
    pub start_s: f64,
    /// Period of the rows, s.
    pub period_s: f64,
    /// Velocities and accelerations are the log's own, not central differences of the filtered quantity below.
    pub logged: [bool; 2],
    /// A joint slower than this stands still, rad/s.
    pub still_rad_s: f64,
    /// Stride of rows that were folded into one period and projected on harmonics.
    pub(super) folded_stride: Option<usize>,
    motion: Option<Butterworth>,
    torque: Option<Butterworth>,
}

impl Preparation {
    /// The filters for rows `period_s` apart; none for a cut-off above the limit of that rate.
    pub(super) fn new(
        config: &PrepareConfig,
        start_s: f64,
        period_s: f64,
        logged: [bool; 2],
    ) -> Self {
        let filter = |hz| Butterworth::new(hz, period_s);
        Self {
            start_s,
            period_s,
            logged,
            still_rad_s: config.still_rad_s,
            folded_stride: None,
            motion: filter(config.motion_hz),
            torque: config.torque_hz.and_then(filter),
        }
    }

    /// Filters and sources of motion of a log, from its first rows; `notes` receives the sources.
    pub(super) fn of_log(
        log: &WholeLog,
        config: &PrepareConfig,
        path: &Path,
        notes: &mut Vec<String>,
    ) -> Self {
        let (reader, period_s, name) = (&log.reader, log.period_s(), path.display());
        notes.extend_from_slice(&log.notes);
        let start_s = log.preview.first().map_or(0.0, |row| row.t_s);
        let preview = longest_piece(log);
        let at = |logged| Self::new(config, start_s, period_s, logged);
        let edge = at([false; 2]).edge().min(preview.len() / 3);
        let mut logged = [false; 2];
        let kinds = [
            (reader.has_velocity(), "velocities"),
            (reader.qdd.is_some(), "accelerations"),
        ];
        for (order, (there, kind)) in kinds.into_iter().enumerate() {
            if !there {
                notes.push(format!(
                    "{name}: no {kind}, derived by central differences of the filtered motion"
                ));
                continue;
            }
            // Mapped columns are measurements. The project's own may be set-points beside measured positions, and their
            // filter is unknown: derivatives of frequent positions share the known filter of the torque.
            if !reader.is_mapped && MOTION_ROWS * config.motion_hz * period_s <= 1.0 {
                notes.push(format!(
                    "{name}: {kind} derived from the positions, which come every {:.1} ms; the log's own have another filter",
                    1e3 * period_s
                ));
                continue;
            }
            let mut own = logged;
            own[order] = true;
            let (own, derived) = (at(own).motion(preview), at(logged).motion(preview));
            let of = |state: &Motion| [state.qd, state.qdd][order];
            let (mut error, mut size) = (0.0, 0.0);
            let (mut behind, mut change) = (0.0, 0.0);
            for (own, derived) in own.iter().zip(&derived).take(own.len() - edge).skip(edge) {
                for (joint, qdd) in derived.qdd.iter().enumerate() {
                    let apart = of(own)[joint] - of(derived)[joint];
                    error += apart * apart;
                    size += of(derived)[joint].powi(2);
                    behind -= apart * qdd;
                    change += qdd * qdd;
                }
            }
            // A signal that is late by L is off by L times its derivative.
            let late_s = behind / f64::max(change, f64::MIN_POSITIVE);
            if reader.is_mapped && order == 0 && late_s.abs() > LATE_S.max(0.5 * period_s) {
                let side = if late_s > 0.0 { "behind" } else { "ahead of" };
                notes.push(format!(
                    "{name}: logged velocities are {:.1} ms {side} the positions, which a filter of the driver does; derived instead",
                    1e3 * late_s.abs()
                ));
                continue;
            }
            logged[order] = reader.is_mapped || error <= TRUST[order].powi(2) * size;
            if !logged[order] {
                let apart = match size > 0.0 {
                    true => format!("{:.1} % of their RMS", 100.0 * (error / size).sqrt()),
                    false => "not zero, and so".to_owned(),
                };
                notes.push(format!(
                    "{name}: logged {kind} are {apart} off the derivative of the positions, taken for set-points; derived instead"
                ));
            }
        }
        at(logged)
    }

    /// Rows a stretch must overlap its neighbours by, so that its core does not depend on where the log was cut.
    pub(super) fn margin(&self) -> usize {
        let filters = [&self.motion, &self.torque].into_iter().flatten();
        filters.map(|filter| filter.settling_rows).sum::<usize>() + 4
    }

    /// Rows at the ends of a log that the ends disturb. A reflection about the end point has no acceleration there, so derived accelerations are wrong for about one period of the cut-off.
    pub(super) fn edge(&self) -> usize {
        let derived = self.logged != [true; 2];
        let periods = |filter: &Option<Butterworth>, periods: f64| {
            let rows = |filter: &Butterworth| periods / (filter.cutoff_hz * self.period_s);
            let filter = filter.as_ref();
            filter.map_or(0, |filter| rows(filter).ceil() as usize)
        };
        periods(&self.motion, if derived { 1.5 } else { 0.25 }) + periods(&self.torque, 0.25)
    }

    /// Rows over which the filter of the torques spreads a step to each side: half a period of its cut-off.
    pub(super) fn smear(&self) -> usize {
        let rows = |filter: &Butterworth| 0.5 / (filter.cutoff_hz * self.period_s);
        self.torque.as_ref().map_or(0.0, rows).ceil() as usize
    }

    /// Stride of independent rows.
    ///
    /// White noise through this filter has the variance of a band of 2 × 0.898 cut-offs (∫ dx / (1 + x⁸)² = 0.898). Rows at
    /// just that rate are white again: the motion is slower, and the variance of the residuals gives the deviations of the
    /// parameters without correction.
    pub fn stride(&self) -> usize {
        if let Some(stride) = self.folded_stride {
            return stride;
        }
        self.torque.as_ref().map_or(1, |filter| {
            let rate_hz = 2.0 * 0.898 * filter.cutoff_hz;
            ((1.0 / (rate_hz * self.period_s)).round() as usize).max(1)
        })
    }

    /// Noise of a filtered torque over that of its rows, white noise assumed; see [`stride`](Self::stride).
    pub(super) fn noise_gain(&self) -> f64 {
        let band = |filter: &Butterworth| (2.0 * 0.898 * filter.cutoff_hz * self.period_s).sqrt();
        let torque = self.torque.as_ref();
        torque.map_or(1.0, |filter| band(filter).min(1.0))
    }

    /// Half width of the running median that finds spikes: 7 ms, in which a joint torque hardly bends, 2 rows at least.
    pub(super) fn spike_reach(&self) -> usize {
        ((0.007 / self.period_s).round() as usize).clamp(2, 7)
    }

    /// Filters torque-like columns as the torque was.
    pub fn smooth_torque(&self, table: &mut [f64], width: usize) {
        if let Some(filter) = &self.torque {
            filter.smooth(table, width);
        }
    }

    /// Smoothed motion of a stretch of rows.
    pub(super) fn motion(&self, rows: &[LogRow]) -> Vec<Motion> {
        let joints = rows.first().map_or(1, |row| row.q.len());
        let column = |pick: fn(&LogRow) -> PerJoint<f64>| -> Vec<f64> {
            let mut table: Vec<f64> = rows.iter().flat_map(|row| pick(row).to_vec()).collect();
            if let Some(filter) = &self.motion {
                filter.smooth(&mut table, joints);
            }
            table
        };
        let q = column(|row| row.q);
        let qd = match self.logged[0] {
            true => column(|row| row.qd),
            false => derivative(&q, joints, self.period_s),
        };
        let qdd = match self.logged[1] {
            true => column(|row| row.qdd),
            false => derivative(&qd, joints, self.period_s),
        };
        states(joints, [&q, &qd, &qdd])
    }
}

/// Motion from tables of positions, velocities and accelerations, so many joints a row.
pub(super) fn states(joints: usize, tables: [&[f64]; 3]) -> Vec<Motion> {
    let [q, qd, qdd] = tables.map(|table| table.chunks_exact(joints).map(PerJoint::from));
    let rows = q.zip(qd).zip(qdd);
    rows.map(|((q, qd), qdd)| Motion { q, qd, qdd }).collect()
}

/// Rows of the linear model from a stretch.
#[derive(Clone, Debug)]
pub struct Prepared {
    /// Motion of all its rows, margins included.
    pub states: Vec<Motion>,
    /// Active columns and cogging of all joints, row after row, filtered.
    pub panel: Vec<f64>,
    /// Torques, one a joint and row, filtered, N·m.
    pub tau: Vec<f64>,
    /// Torques with spikes taken out before filtering, N·m.
    pub clean: Vec<f64>,
    /// Spikes taken out.
    pub spikes: usize,
    /// The rows that count.
    pub core: Range<usize>,
    /// Times of all rows, s.
    pub t_s: Vec<f64>,
    /// Sums over raw torques by speed.
    pub speeds: SpeedSums,
}

impl Prepared {
    /// Rows of a log, margins included, of which those in `core` count.
    pub(super) fn new(
        rows: &[LogRow],
        core: &Range<usize>,
        preparation: &Preparation,
        layout: &Layout,
    ) -> Self {
        let tau: Vec<f64> = rows.iter().flat_map(|row| row.tau.to_vec()).collect();
        let (clean, spikes) = despiked(&tau, layout.joints(), preparation.spike_reach());
        let raw = Self {
            states: preparation.motion(rows),
            panel: Vec::new(),
            tau,
            clean,
            spikes,
            core: core.clone(),
            t_s: rows.iter().map(|row| row.t_s).collect(),
            speeds: SpeedSums::new(layout.joints()),
        };
        raw.filled(preparation, layout, &|table, width| {
            preparation.smooth_torque(table, width);
        })
    }

    /// Adds the regressor to motion and torques, and puts all but the motion through the filter `smooth`, which takes a table
    /// and its width.
    pub(super) fn filled(
        mut self,
        preparation: &Preparation,
        layout: &Layout,
        smooth: &dyn Fn(&mut [f64], usize),
    ) -> Self {
        let joints = layout.joints();
        let mut scratch = DMatrix::zeros(joints, (crate::robot::LINK_PARAMETERS + 1) * joints);
        for (state, t_s) in self.states.iter().zip(&self.t_s) {
            let age_s = t_s - preparation.start_s;
            layout.append_row(state, age_s, &mut scratch, &mut self.panel);
        }
        for row in self.core.clone() {
            // Blocks of a second take turns.
            let half = ((self.t_s[row] - preparation.start_s) as usize) % 2;
            let panel = &self.panel[row * layout.width..];
            for joint in 0..joints {
                let (qd, place) = (self.states[row].qd[joint], row * joints + joint);
                if qd.abs() > preparation.still_rad_s {
                    let columns = layout.columns_and_cogging(joint, panel);
                    self.speeds
                        .add((joint, half), qd, columns, self.clean[place]);
                }
            }
        }
        smooth(&mut self.panel, layout.width);
        smooth(&mut self.tau, joints);
        smooth(&mut self.clean, joints);
        self
    }
}

#[cfg(test)]
mod tests {
    use super::super::log_tests::{first_joints, log_of};
    use super::*;

    #[test]
    fn filters_are_lowered_for_an_unseen_log_that_does_not_bear_them() {
        let config = PrepareConfig {
            motion_hz: 40.0,
            torque_hz: Some(20.0),
            still_rad_s: 0.05,
        };
        for (period_s, wanted) in [(4e-3, (40.0, 20.0)), (40e-3, (10.0, 5.0))] {
            let rows = (0..100).map(|k| {
                let t = period_s * f64::from(k);
                [t, (3.0 * t).sin(), 1.0]
            });
            let (_here, path) = log_of("t_s,q1_rad,tau1_nm", rows);
            let mut notes = Vec::new();
            let lowered = config.lowered(&path, &first_joints(1), &mut notes);
            let lowered = lowered.expect("a log");
            let found = (lowered.motion_hz, lowered.torque_hz.expect("a filter"));
            assert!((found.0 - wanted.0).abs() + (found.1 - wanted.1).abs() < 1e-6);
            assert_eq!(notes.len(), usize::from(wanted.0 < 40.0));
        }
    }

    #[test]
    fn velocities_that_a_driver_has_delayed_are_derived() {
        for (late_s, logged) in [(0.0, true), (1e-3, true), (15e-3, false), (-15e-3, false)] {
            let rows = (0..4000).map(|k| {
                let t = 4e-3 * f64::from(k);
                [
                    t,
                    0.5 * (3.0 * t).sin(),
                    1.5 * (3.0 * (t - late_s)).cos(),
                    1.0,
                ]
            });
            let (_here, path) = log_of("T,q1,v1,e1", rows);
            let columns = "t_s = 'T'\nq_rad = 'q{}'\nqd_rad_s = 'v{}'\ntau_nm = 'e{}'";
            let robot = Robot {
                log_columns: Some(toml::from_str(columns).expect("a map")),
                ..first_joints(1)
            };
            let log = WholeLog::open(&path, &robot).expect("a log");
            let config = PrepareConfig {
                motion_hz: 10.0,
                torque_hz: None,
                still_rad_s: 0.05,
            };
            let mut notes = Vec::new();
            let found = Preparation::of_log(&log, &config, &path, &mut notes);
            assert_eq!(found.logged[0], logged, "{late_s} s: {notes:?}");
        }
    }
}
