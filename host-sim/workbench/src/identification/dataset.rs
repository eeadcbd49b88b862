//! The dataset of the training logs: sums over all rows, and a bounded sample of them.

use super::cogging::CoggingSums;
use super::columns::Layout;
use super::normal::NormalEquations;
use super::prepare::{Preparation, Prepared};
use super::speed::SpeedSums;
use crate::dynamics::State;

/// One row of the bounded sample.
#[derive(Clone, Debug)]
pub struct SampleRow<const N: usize> {
    /// Motion.
    pub state: State<N>,
    /// Filtered torque, N·m.
    pub tau: [f64; N],
    /// Filtered torque without spikes, N·m.
    pub clean: [f64; N],
    /// True for joints that move.
    pub moving: [bool; N],
    /// Active columns of all joints.
    pub panel: Box<[f64]>,
    /// Sine and cosine of every joint's cogging phase, filtered as the columns are.
    pub cogging_basis: [[f64; 2]; N],
}

impl<const N: usize> SampleRow<N> {
    /// One row of a prepared stretch.
    pub(super) fn of(
        layout: &Layout<N>,
        preparation: &Preparation,
        prepared: &Prepared<N>,
        row: usize,
    ) -> Self {
        let state = prepared.states[row];
        let values = |table: &[f64]| std::array::from_fn(|joint| table[row * N + joint]);
        Self {
            state,
            tau: values(&prepared.tau),
            clean: values(&prepared.clean),
            moving: std::array::from_fn(|joint| state.qd[joint].abs() > preparation.still_rad_s),
            panel: prepared.panel[row * layout.width..(row + 1) * layout.width].into(),
            cogging_basis: std::array::from_fn(|joint| {
                let place = 2 * (row * N + joint);
                [
                    prepared.cogging_basis[place],
                    prepared.cogging_basis[place + 1],
                ]
            }),
        }
    }
}

/// Most rows of the sample.
pub(super) const SAMPLE: usize = 60_000;

/// Result of one pass over the training logs: sums over all rows, and an evenly thinned sample for methods that iterate
/// over rows.
#[derive(Clone, Debug)]
pub struct Dataset<const N: usize> {
    /// Sums over all moving rows.
    pub sums: NormalEquations<N>,
    /// Sums over the same rows without spikes.
    pub clean_sums: NormalEquations<N>,
    /// Their border by the sine and cosine of cogging.
    pub cogging: CoggingSums<N>,
    /// Every `thinning`-th of the rows that went into the sums.
    pub sample: Vec<SampleRow<N>>,
    /// See `sample`.
    pub thinning: usize,
    /// Rows that went into the sums.
    pub rows: usize,
    /// Sums over raw torques by speed.
    pub speeds: SpeedSums<N>,
    /// Rows read, edges left out.
    pub rows_read: usize,
    /// Of these, those in which each joint stands still.
    pub still: [usize; N],
    /// Spikes found.
    pub spikes: usize,
}

impl<const N: usize> Dataset<N> {
    /// An empty dataset.
    pub fn new(layout: &Layout<N>) -> Self {
        Self {
            sums: NormalEquations::new(layout),
            clean_sums: NormalEquations::new(layout),
            cogging: CoggingSums::new(layout),
            sample: Vec::new(),
            thinning: 1,
            rows: 0,
            speeds: SpeedSums::new(),
            rows_read: 0,
            still: [0; N],
            spikes: 0,
        }
    }

    /// Adds a stretch.
    pub fn add(&mut self, layout: &Layout<N>, preparation: &Preparation, prepared: &Prepared<N>) {
        let stride = preparation.stride();
        self.spikes += prepared.spikes;
        self.speeds.merge(&prepared.speeds);
        self.rows_read += prepared.core.len();
        for row in prepared.core.clone() {
            for (still, qd) in self.still.iter_mut().zip(prepared.states[row].qd.iter()) {
                *still += usize::from(qd.abs() <= preparation.still_rad_s);
            }
        }
        let rows: Vec<usize> = prepared.core.clone().step_by(stride).collect();
        for joint in 0..N {
            let (mut x, mut tau, mut clean) = (Vec::new(), Vec::new(), Vec::new());
            let mut cogging_basis = Vec::new();
            for &row in &rows {
                if prepared.states[row].qd[joint].abs() > preparation.still_rad_s {
                    x.extend_from_slice(prepared.columns(layout, row, joint));
                    tau.push(prepared.tau[row * N + joint]);
                    clean.push(prepared.clean[row * N + joint]);
                    cogging_basis
                        .extend_from_slice(&prepared.cogging_basis[2 * (row * N + joint)..][..2]);
                }
            }
            self.sums.joints[joint].add(&x, &tau);
            self.clean_sums.joints[joint].add(&x, &clean);
            self.cogging.add(joint, &x, &cogging_basis, &clean);
        }
        for &row in &rows {
            if self.rows.is_multiple_of(self.thinning) {
                self.sample
                    .push(SampleRow::of(layout, preparation, prepared, row));
            }
            self.rows += 1;
            if self.sample.len() > SAMPLE {
                // Even thinning: the rows that stay are those a doubled stride would have taken.
                let mut position = 0;
                self.sample.retain(|_| {
                    position += 1;
                    position % 2 == 1
                });
                self.thinning *= 2;
            }
        }
    }
}
