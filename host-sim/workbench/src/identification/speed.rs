//! Sums over a joint's raw torque by speed, from which the mean residual of any linear model follows.
//!
//! A filter wide enough to make torques readable is wider than the passage of a joint through its Stribeck peak. The mean
//! over all rows of one speed needs no filter, averages cogging and noise out, and streams.

use super::columns::Layout;
use super::normal::JointSums;
use crate::training::SpeedPoint;
use nalgebra::DVector;

/// Bins from −fastest to fastest.
const BINS: usize = 600;
/// Speed at which bins begin to grow with the speed, rad/s, and the largest that has a bin of its own.
const FINE_RAD_S: f64 = 0.05;
const FASTEST_RAD_S: f64 = 10.0;

/// Sums over the rows of one bin.
#[derive(Clone, Debug, PartialEq)]
struct Bin {
    count: f64,
    qd: f64,
    tau: f64,
    /// Sine and cosine of the cogging phase, then the active columns.
    x: Vec<f64>,
}

/// Sums of every joint, for two halves of the log that take turns.
#[derive(Clone, Debug, PartialEq)]
pub struct SpeedSums {
    /// One sparse row of bins a half and joint.
    bins: Vec<Vec<Option<Box<Bin>>>>,
}

impl Bin {
    fn add(&mut self, other: &Self) {
        self.count += other.count;
        self.qd += other.qd;
        self.tau += other.tau;
        for (sum, x) in self.x.iter_mut().zip(&other.x) {
            *sum += x;
        }
    }
}

impl SpeedSums {
    /// Sums over no rows of so many joints.
    pub(super) fn new(joints: usize) -> Self {
        Self {
            bins: vec![vec![None; BINS]; 2 * joints],
        }
    }

    fn put(&mut self, row: usize, place: usize, new: Bin) {
        match &mut self.bins[row][place] {
            Some(bin) => bin.add(&new),
            empty => *empty = Some(Box::new(new)),
        }
    }

    /// Adds one row of one joint in one half of the log.
    ///
    /// * `basis` sine and cosine of the cogging phase; `columns` active columns of the joint; `tau` N·m
    pub(super) fn add(
        &mut self,
        (joint, half): (usize, usize),
        qd: f64,
        basis: &[f64; 2],
        columns: &[f64],
        tau: f64,
    ) {
        let share = (qd / FINE_RAD_S).asinh() / (FASTEST_RAD_S / FINE_RAD_S).asinh();
        let place = ((0.5 * (share + 1.0) * BINS as f64).max(0.0) as usize).min(BINS - 1);
        let (count, x) = (1.0, [basis, columns].concat());
        self.put(2 * joint + half, place, Bin { count, qd, tau, x });
    }

    /// Adds all rows of another part of the log.
    pub(super) fn merge(&mut self, other: &Self) {
        for (row, bins) in other.bins.iter().enumerate() {
            for (place, bin) in bins.iter().enumerate() {
                if let Some(bin) = bin {
                    self.put(row, place, Bin::clone(bin));
                }
            }
        }
    }

    /// Subtracts a torque that depends on the speed alone (N·m) from the equations of a joint.
    ///
    /// The equations come from filtered and thinned rows, these sums from raw ones: inner products with the slow columns of
    /// a motion are the same but for the number of rows.
    pub(super) fn subtract(&self, joint: usize, sums: &mut JointSums, torque: &dyn Fn(f64) -> f64) {
        let halves = &self.bins[2 * joint..2 * joint + 2];
        let bins = || halves.iter().flatten().flatten();
        let all: f64 = bins().map(|bin| bin.count).sum();
        let share = sums.count / all.max(1.0);
        for bin in bins() {
            let torque = torque(bin.qd / bin.count);
            sums.power -= share * torque * (2.0 * bin.tau - torque * bin.count);
            for (moment, x) in sums.moment.iter_mut().zip(&bin.x[2..]) {
                *moment -= share * torque * x;
            }
        }
    }

    /// Mean residuals of a linear model and cogging at each speed, divided by `unit`, N·m, in one half of the log.
    pub(super) fn residuals(
        &self,
        layout: &Layout,
        theta: &DVector<f64>,
        cogging: [f64; 2],
        (joint, half): (usize, usize),
        unit: f64,
    ) -> Vec<SpeedPoint> {
        let bins = self.bins[2 * joint + half].iter().flatten();
        bins.map(|bin| {
            let linear = layout.torque(joint, &bin.x[2..], theta);
            let cogging = cogging[0] * bin.x[0] + cogging[1] * bin.x[1];
            SpeedPoint {
                qd: bin.qd / bin.count,
                residual: (bin.tau - linear - cogging) / bin.count / unit,
                weight: bin.count,
            }
        })
        .collect()
    }
}
