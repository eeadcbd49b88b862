//! From a stretch of a log to the rows of the linear model: motion, regressor and torque through the same filter.

use super::columns::Layout;
use super::filter::{Butterworth, derivative, despiked};
use super::log::LogRow;
use super::speed::SpeedSums;
use crate::dynamics::{Joints, State};
use nalgebra::DMatrix;
use std::ops::Range;

/// Source of velocities or accelerations.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MotionSource {
    /// The log's own columns.
    Logged,
    /// Central differences of the filtered quantity below.
    Derived,
}

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

/// Filters and sources of one log.
#[derive(Clone, Debug, PartialEq)]
pub struct Preparation {
    /// Time of the first row, s.
    pub start_s: f64,
    /// Period of the rows, s.
    pub period_s: f64,
    /// Source of the velocities.
    pub velocity: MotionSource,
    /// Source of the accelerations.
    pub acceleration: MotionSource,
    /// A joint slower than this stands still, rad/s.
    pub still_rad_s: f64,
    /// Stride of rows that were folded into one period and projected on harmonics.
    pub(super) folded_stride: Option<usize>,
    motion: Option<Butterworth>,
    torque: Option<Butterworth>,
}

impl Preparation {
    /// The filters for rows `period_s` apart. A cut-off that rows this far apart cannot show is no filter at all.
    pub fn new(
        config: &PrepareConfig,
        start_s: f64,
        period_s: f64,
        velocity: MotionSource,
        acceleration: MotionSource,
    ) -> Self {
        Self {
            start_s,
            period_s,
            velocity,
            acceleration,
            still_rad_s: config.still_rad_s,
            folded_stride: None,
            motion: Butterworth::new(config.motion_hz, period_s),
            torque: config
                .torque_hz
                .and_then(|hz| Butterworth::new(hz, period_s)),
        }
    }

    /// Rows a stretch must overlap its neighbours by, so that its core does not depend on where the log was cut.
    pub fn margin(&self) -> usize {
        let settling =
            |filter: &Option<Butterworth>| filter.as_ref().map_or(0, |f| f.settling_rows);
        settling(&self.motion) + settling(&self.torque) + 4
    }

    /// Rows at the ends of a log in which the filters still feel the end. A reflection about the end point has no
    /// acceleration there, so derived accelerations are wrong for about one period of the cut-off.
    pub fn edge(&self) -> usize {
        let derived =
            self.velocity == MotionSource::Derived || self.acceleration == MotionSource::Derived;
        let periods = |filter: &Option<Butterworth>, periods: f64| {
            filter.as_ref().map_or(0, |f| {
                (periods / (f.cutoff_hz() * self.period_s)).ceil() as usize
            })
        };
        periods(&self.motion, if derived { 1.5 } else { 0.25 }) + periods(&self.torque, 0.25)
    }

    /// Every how many-th row carries news.
    ///
    /// White noise through this filter has the variance of a band of 2 × 0.898 cut-offs (∫ dx / (1 + x⁸)² = 0.898).
    /// Rows taken at just that rate are white again: nothing a slow motion says is lost, and the residuals' variance
    /// gives the parameters' deviations without correction.
    pub fn stride(&self) -> usize {
        if let Some(stride) = self.folded_stride {
            return stride;
        }
        self.torque.as_ref().map_or(1, |filter| {
            let rate_hz = 2.0 * 0.898 * filter.cutoff_hz();
            ((1.0 / (rate_hz * self.period_s)).round() as usize).max(1)
        })
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
    pub fn motion<const N: usize>(&self, rows: &[LogRow<N>]) -> Vec<State<N>> {
        let column = |pick: fn(&LogRow<N>) -> &[f64; N]| -> Vec<f64> {
            let mut table: Vec<f64> = rows.iter().flat_map(|row| *pick(row)).collect();
            if let Some(filter) = &self.motion {
                filter.smooth(&mut table, N);
            }
            table
        };
        let q = column(|row| &row.q);
        let qd = match self.velocity {
            MotionSource::Logged => column(|row| &row.qd),
            MotionSource::Derived => derivative(&q, N, self.period_s),
        };
        let qdd = match self.acceleration {
            MotionSource::Logged => column(|row| &row.qdd),
            MotionSource::Derived => derivative(&qd, N, self.period_s),
        };
        let joints = |table: &[f64], row: usize| {
            Joints::<N>::from_column_slice(&table[row * N..(row + 1) * N])
        };
        (0..rows.len())
            .map(|row| State {
                q: joints(&q, row),
                qd: joints(&qd, row),
                qdd: joints(&qdd, row),
            })
            .collect()
    }
}

/// A stretch of a log, with the rows around it that its filters need.
#[derive(Clone, Debug)]
pub struct Stretch<const N: usize> {
    /// Number of the stretch, over all logs.
    pub index: usize,
    /// Rows, margins included.
    pub rows: Vec<LogRow<N>>,
    /// The rows that count.
    pub core: Range<usize>,
}

/// A stretch that is ready to be fitted.
#[derive(Clone, Debug)]
pub struct Prepared<const N: usize> {
    /// Number of the stretch.
    pub index: usize,
    /// Motion of all its rows, margins included.
    pub states: Vec<State<N>>,
    /// Active columns of all joints, row after row, filtered.
    pub panel: Vec<f64>,
    /// Sine and cosine of the cogging phase of all joints, row after row, filtered.
    pub cogging_basis: Vec<f64>,
    /// Torques, N a row, filtered, N·m.
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
    pub speeds: SpeedSums<N>,
}

impl<const N: usize> Prepared<N> {
    /// Prepares a stretch.
    pub fn new(stretch: &Stretch<N>, preparation: &Preparation, layout: &Layout<N>) -> Self {
        let tau: Vec<f64> = stretch.rows.iter().flat_map(|row| row.tau).collect();
        let (clean, spikes) = despiked(&tau, N, preparation.spike_reach());
        let raw = Raw {
            index: stretch.index,
            states: preparation.motion(&stretch.rows),
            tau,
            clean,
            spikes,
            core: stretch.core.clone(),
            t_s: stretch.rows.iter().map(|row| row.t_s).collect(),
        };
        Self::of(raw, preparation, layout, &|table, width| {
            preparation.smooth_torque(table, width);
        })
    }

    /// Active columns of `joint` in `row`, filtered.
    pub(super) fn columns(&self, layout: &Layout<N>, row: usize, joint: usize) -> &[f64] {
        &self.panel[row * layout.width + layout.offset[joint]..][..layout.active[joint].len()]
    }

    /// Regressor and torque through the same filter `smooth`, which takes a table and its width.
    pub(super) fn of(
        raw: Raw<N>,
        preparation: &Preparation,
        layout: &Layout<N>,
        smooth: &dyn Fn(&mut [f64], usize),
    ) -> Self {
        let Raw {
            index,
            states,
            mut tau,
            mut clean,
            spikes,
            core,
            t_s,
        } = raw;
        let mut scratch = DMatrix::zeros(N, (crate::robot::LINK_PARAMETERS + 1) * N);
        let mut panel = Vec::with_capacity(states.len() * layout.width);
        let mut cogging_basis = Vec::with_capacity(states.len() * 2 * N);
        for (state, t_s) in states.iter().zip(&t_s) {
            layout.append_row(state, t_s - preparation.start_s, &mut scratch, &mut panel);
            cogging_basis.extend(layout.cogging_basis(&state.q).as_flattened());
        }
        let mut speeds = SpeedSums::new();
        for row in core.clone() {
            // Blocks of a second take turns.
            let half = ((t_s[row] - preparation.start_s) as usize) % 2;
            let panel = &panel[row * layout.width..(row + 1) * layout.width];
            for joint in 0..N {
                let qd = states[row].qd[joint];
                if qd.abs() > preparation.still_rad_s {
                    let columns = &panel[layout.offset[joint]..][..layout.active[joint].len()];
                    let basis = &cogging_basis[2 * (row * N + joint)..][..2];
                    speeds.add((joint, half), qd, columns, basis, clean[row * N + joint]);
                }
            }
        }
        smooth(&mut panel, layout.width);
        smooth(&mut cogging_basis, 2 * N);
        smooth(&mut tau, N);
        smooth(&mut clean, N);
        Self {
            index,
            states,
            panel,
            cogging_basis,
            tau,
            clean,
            spikes,
            core,
            t_s,
            speeds,
        }
    }
}

/// A stretch before its regressor is made.
pub(super) struct Raw<const N: usize> {
    /// Number of the stretch.
    pub(super) index: usize,
    /// Motion.
    pub(super) states: Vec<State<N>>,
    /// Torques, N a row, N·m.
    pub(super) tau: Vec<f64>,
    /// Torques without spikes.
    pub(super) clean: Vec<f64>,
    /// Spikes taken out.
    pub(super) spikes: usize,
    /// The rows that count.
    pub(super) core: Range<usize>,
    /// Times, s.
    pub(super) t_s: Vec<f64>,
}
