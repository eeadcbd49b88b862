//! The dataset of the training logs: sums over all rows, and a bounded sample of them.

use super::columns::Layout;
use super::normal::{NormalEquations, SampleRow, SpeedSums};
use super::prepare::{Preparation, Prepared};
use crate::dynamics::PerJoint;
use std::borrow::Borrow;

impl Prepared {
    /// Row of a sample.
    pub(super) fn sample_row(
        &self,
        layout: &Layout,
        preparation: &Preparation,
        row: usize,
    ) -> SampleRow {
        let state = self.states[row];
        let joints = layout.joints();
        let values = |table: &[f64]| PerJoint::from(&table[row * joints..][..joints]);
        SampleRow {
            t_s: self.t_s[row],
            state,
            tau: values(&self.tau),
            clean: values(&self.clean),
            moving: state.qd.map(|qd| qd.abs() > preparation.still_rad_s),
            panel: self.panel[row * layout.width..][..layout.width].into(),
        }
    }
}

/// Sums over filtered rows.
#[derive(Clone, Debug)]
pub(super) struct RowSums {
    /// Sums over all moving rows.
    pub(super) all: NormalEquations,
    /// Sums over the same rows without spikes.
    pub(super) clean: NormalEquations,
    /// Clean sums with sine and cosine of each joint's cogging behind its columns.
    pub(super) cogging: NormalEquations,
    pub(super) rows: usize,
}

impl RowSums {
    pub(super) fn new(layout: &Layout) -> Self {
        Self {
            all: NormalEquations::new(layout, 0),
            clean: NormalEquations::new(layout, 0),
            cogging: NormalEquations::new(layout, 2),
            rows: 0,
        }
    }

    pub(super) fn of(layout: &Layout, rows: &[impl Borrow<SampleRow>]) -> Self {
        let mut sums = Self::new(layout);
        sums.add(layout, rows);
        sums
    }

    fn add(&mut self, layout: &Layout, rows: &[impl Borrow<SampleRow>]) {
        let columns = |row, joint| SampleRow::columns(row, layout, joint);
        self.all
            .add(rows, |row, joint| (columns(row, joint), row.tau[joint]));
        self.clean
            .add(rows, |row, joint| (columns(row, joint), row.clean[joint]));
        self.cogging.add(rows, |row, joint| {
            let columns = layout.columns_and_cogging(joint, &row.panel);
            (columns, row.clean[joint])
        });
        self.rows += rows.len();
    }
}

/// An even sample of a stream of items, of `most` at most.
#[derive(Clone, Debug)]
pub(super) struct Thinned<T> {
    pub(super) kept: Vec<T>,
    /// Every how many of the items it has.
    pub(super) stride: usize,
    seen: usize,
    most: usize,
}

impl<T> Thinned<T> {
    pub(super) fn new(most: usize) -> Self {
        Self {
            kept: Vec::new(),
            stride: 1,
            seen: 0,
            most,
        }
    }

    /// Adds an item. Those that stay are the ones that a doubled stride would have taken.
    pub(super) fn push(&mut self, item: T) {
        if self.seen.is_multiple_of(self.stride) {
            self.kept.push(item);
        }
        self.seen += 1;
        if self.kept.len() > self.most {
            let mut place = 0;
            self.kept.retain(|_| {
                place += 1;
                place % 2 == 1
            });
            self.stride *= 2;
        }
    }
}

const SAMPLE: usize = 60_000;

/// Result of one pass over the training logs: sums over all rows, and an evenly thinned sample for methods that iterate
/// over rows.
#[derive(Clone, Debug)]
pub(super) struct Dataset {
    /// Sums over filtered rows.
    pub(super) sums: RowSums,
    /// A sample of the rows that went into the sums.
    pub(super) sample: Thinned<SampleRow>,
    /// Number of these rows up to the end of each log.
    ends: Vec<usize>,
    /// Sums over raw torques by speed.
    pub(super) speeds: SpeedSums,
    /// Rows read, edges left out.
    pub(super) rows_read: usize,
    /// Of these, those in which each joint stands still.
    pub(super) still: PerJoint<usize>,
    pub(super) spikes: usize,
}

impl Dataset {
    pub(super) fn new(layout: &Layout) -> Self {
        Self {
            sums: RowSums::new(layout),
            sample: Thinned::new(SAMPLE),
            ends: Vec::new(),
            speeds: SpeedSums::new(layout.joints()),
            rows_read: 0,
            still: PerJoint::repeat(layout.joints(), 0),
            spikes: 0,
        }
    }

    pub(super) fn add(&mut self, layout: &Layout, preparation: &Preparation, prepared: &Prepared) {
        self.spikes += prepared.spikes;
        self.speeds.merge(&prepared.speeds);
        self.rows_read += prepared.core.len();
        for state in &prepared.states[prepared.core.clone()] {
            for (still, qd) in self.still.iter_mut().zip(state.qd.iter()) {
                *still += usize::from(qd.abs() <= preparation.still_rad_s);
            }
        }
        let rows = prepared.core.clone().step_by(preparation.stride());
        let rows: Vec<SampleRow> = rows
            .map(|row| prepared.sample_row(layout, preparation, row))
            .collect();
        self.sums.add(layout, &rows);
        rows.into_iter().for_each(|row| self.sample.push(row));
    }

    pub(super) fn end_log(&mut self) {
        self.ends.push(self.sample.seen);
    }

    /// Log of the row at `place` of the sample, from 0.
    pub(super) fn log_of(&self, place: usize) -> usize {
        let seen = place * self.sample.stride;
        self.ends.partition_point(|end| *end <= seen)
    }
}

/// Rows of random motion that all joints take part in when faster than 0.05 rad/s.
///
/// * `reach` of positions, velocities and accelerations; `noise` of the torques, N·m
/// * `torque` N·m of a joint at a row without torques
#[cfg(test)]
pub(super) fn random_rows(
    layout: &Layout,
    count: usize,
    seed: u64,
    reach: [f64; 3],
    noise: f64,
    torque: impl Fn(&SampleRow, usize) -> f64,
) -> Vec<SampleRow> {
    use rand::{Rng, SeedableRng};
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
    let mut scratch = nalgebra::DMatrix::zeros(6, (crate::robot::LINK_PARAMETERS + 1) * 6);
    let mut draw = |reach: f64| PerJoint::from_fn(6, |_| random.random_range(-reach..reach));
    (0..count)
        .map(|row| {
            let [q, qd, qdd] = reach.map(&mut draw);
            let state = crate::dynamics::Motion { q, qd, qdd };
            let mut panel = Vec::new();
            layout.append_row(&state, 0.01 * row as f64, &mut scratch, &mut panel);
            let mut row = SampleRow {
                t_s: 0.01 * row as f64,
                state,
                tau: PerJoint::repeat(6, 0.0),
                clean: PerJoint::repeat(6, 0.0),
                moving: qd.map(|qd| qd.abs() > 0.05),
                panel: panel.into(),
            };
            let noise = draw(noise);
            row.tau = PerJoint::from_fn(6, |joint| torque(&row, joint) + noise[joint]);
            row.clean = row.tau;
            row
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thinned_sample_is_even_and_reaches_the_end() {
        let mut sample = Thinned::new(2000);
        (0..16_000).for_each(|item| sample.push(item));
        assert_eq!((sample.kept.len(), sample.stride), (2000, 8));
        let even = sample.kept.iter().zip((0..).step_by(8));
        assert!(even.into_iter().all(|(item, place)| *item == place));
    }
}
