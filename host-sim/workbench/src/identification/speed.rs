//! Sums over a joint's raw torque by speed, from which the mean residual of any linear model follows.
//!
//! A filter wide enough to make torques readable is wider than the passage of a joint through its Stribeck peak. The mean
//! over all rows of one speed needs no filter, forgets cogging and noise, and streams.

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
    /// Sine and cosine of the cogging phase.
    cogging_basis: [f64; 2],
    x: Vec<f64>,
}

/// Sums of every joint, for two halves of the log that take turns.
#[derive(Clone, Debug, PartialEq)]
pub struct SpeedSums<const N: usize> {
    /// One sparse row of bins a half and joint.
    bins: Vec<Vec<Option<Box<Bin>>>>,
}

impl Bin {
    fn new(columns: usize) -> Self {
        Self {
            count: 0.0,
            qd: 0.0,
            tau: 0.0,
            cogging_basis: [0.0; 2],
            x: vec![0.0; columns],
        }
    }

    fn add(&mut self, count: f64, qd: f64, tau: f64, cogging_basis: &[f64], x: &[f64]) {
        self.count += count;
        self.qd += qd;
        self.tau += tau;
        for (sum, basis) in self.cogging_basis.iter_mut().zip(cogging_basis) {
            *sum += basis;
        }
        for (sum, x) in self.x.iter_mut().zip(x) {
            *sum += x;
        }
    }
}

impl<const N: usize> SpeedSums<N> {
    /// No rows yet.
    pub(super) fn new() -> Self {
        Self {
            bins: vec![vec![None; BINS]; 2 * N],
        }
    }

    /// Adds one row of one joint in one half of the log.
    ///
    /// * `columns` active columns of the joint; `cogging_basis` sine and cosine of its cogging phase; `tau` N·m
    pub(super) fn add(
        &mut self,
        (joint, half): (usize, usize),
        qd: f64,
        columns: &[f64],
        cogging_basis: &[f64],
        tau: f64,
    ) {
        let share = (qd / FINE_RAD_S).asinh() / (FASTEST_RAD_S / FINE_RAD_S).asinh();
        let place = ((0.5 * (share + 1.0) * BINS as f64).max(0.0) as usize).min(BINS - 1);
        let bin = self.bins[2 * joint + half][place]
            .get_or_insert_with(|| Box::new(Bin::new(columns.len())));
        bin.add(1.0, qd, tau, cogging_basis, columns);
    }

    /// Adds all rows of another part of the log.
    pub(super) fn merge(&mut self, other: &Self) {
        let pairs = self.bins.iter_mut().flatten();
        for (own, other) in pairs.zip(other.bins.iter().flatten()) {
            match (own.as_mut(), other) {
                (Some(own), Some(other)) => {
                    own.add(
                        other.count,
                        other.qd,
                        other.tau,
                        &other.cogging_basis,
                        &other.x,
                    );
                }
                (None, Some(other)) => *own = Some(other.clone()),
                (_, None) => (),
            }
        }
    }

    /// Takes a torque that depends on the speed alone (N·m) from the equations of a joint.
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
            for (moment, x) in sums.moment.iter_mut().zip(&bin.x) {
                *moment -= share * torque * x;
            }
        }
    }

    /// Mean residuals of a linear model and cogging at each speed, divided by `unit`, N·m, in one half of the log.
    pub(super) fn residuals(
        &self,
        layout: &Layout<N>,
        theta: &DVector<f64>,
        cogging: [f64; 2],
        joint: usize,
        half: usize,
        unit: f64,
    ) -> Vec<SpeedPoint> {
        let bins = self.bins[2 * joint + half].iter().flatten();
        bins.map(|bin| {
            let active = layout.active[joint].iter();
            let linear: f64 = bin
                .x
                .iter()
                .zip(active)
                .map(|(x, &place)| x * theta[place])
                .sum();
            let cogging = cogging[0] * bin.cogging_basis[0] + cogging[1] * bin.cogging_basis[1];
            SpeedPoint {
                qd: bin.qd / bin.count,
                residual: (bin.tau - linear - cogging) / bin.count / unit,
                weight: bin.count,
            }
        })
        .collect()
    }
}
