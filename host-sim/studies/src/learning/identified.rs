//! Starting parameters by least squares over the board's own rows.

use super::controller::Controller;
use super::scenario::Start;
use super::setup::{N, P, PERIOD_S, Set, Setup};
use super::twin::prior_covariance;
use crate::StudyError;
use foretorque::arm::Arm;
use foretorque::arm::ur5::Ur5;
use foretorque::dynamics::FrictionColumn;
use foretorque::feedforward::evaluate;
use foretorque::learning::{
    ConditionedSample, LearnerConfig, LinearParameters, MeasurementWindow, cogging_attenuation,
    torque_row,
};
use foretorque_workbench::closed_loop::{Answer, ClosedLoop};
use foretorque_workbench::plant::PlantConfig;
use foretorque_workbench::trajectory::Trajectory;
use nalgebra::{DMatrix, DVector};
use std::convert::Infallible;

/// Length of the path that is identified on, s.
const IDENTIFICATION_S: f64 = 40.0;
/// Every how many-th tick gives rows.
const STRIDE: usize = 5;
/// Prior standard deviation, in those of the learner, of friction columns that shall stay unused.
const UNUSED: f32 = 1e-4;

/// Sets to start from.
pub(super) struct Starts {
    wrong: Set,
    identified: Set,
    plain: Set,
}

impl Starts {
    /// Identifies the arm of `setup` at the age of zero, without drift.
    pub(super) fn new(setup: &Setup) -> Result<Self, StudyError> {
        let rows = conditioned_rows(setup)?;
        let full = Controller::config();
        Ok(Self {
            wrong: setup.wrong,
            identified: least_squares(&rows, &setup.wrong, &full),
            plain: least_squares(&rows, &setup.wrong, &Start::PlainFriction.config()),
        })
    }

    pub(super) fn set(&self, start: Start) -> &Set {
        match start {
            Start::Wrong => &self.wrong,
            Start::Identified => &self.identified,
            Start::PlainFriction => &self.plain,
        }
    }
}

impl Start {
    /// How the learner goes on from there: as the firmware has it; a plain friction model has viscous and
    /// Coulomb columns, offset and cogging, and gets no others.
    pub(super) fn config(self) -> LearnerConfig<N, P> {
        let mut config = Controller::config();
        if self == Self::PlainFriction {
            for sigma in &mut config.friction_sigma {
                for column in [
                    FrictionColumn::Stribeck,
                    FrictionColumn::ShearThinning,
                    FrictionColumn::Load,
                ] {
                    sigma[column] *= UNUSED;
                }
            }
        }
        config
    }
}

/// The board's training rows: the filtered motion and the torque of the same instant.
fn conditioned_rows(setup: &Setup) -> Result<Vec<ConditionedSample<N>>, StudyError> {
    let quiet = PlantConfig {
        viscous_drift: 0.0,
        ..PlantConfig::default()
    };
    let mut plant = setup.plant(quiet, 1.0, 999)?;
    let pd = setup.pd(6.0);
    let path = Trajectory::Via(setup.task(IDENTIFICATION_S, 0));
    let mut run = ClosedLoop::new(&mut plant, &pd, &path, PERIOD_S, None)?;
    let mut window = MeasurementWindow::<N>::new();
    let mut rows = Vec::new();
    for tick in 0..path.ticks(PERIOD_S) {
        let Ok(_) = run.tick_with::<Infallible>(&mut plant, |sample| {
            let Some(sample) = sample else {
                return Ok(None);
            };
            window.push(sample.measured.as_ref());
            Ok(Some(Answer {
                total: evaluate::<Ur5, N, P>(&setup.wrong, &sample.desired).total,
                shares: None,
                flags: 0,
            }))
        });
        if tick % STRIDE == 0 {
            rows.extend(window.conditioned(1.0 / PERIOD_S as f32));
        }
    }
    Ok(rows)
}

/// The torque row of `joint` after the filter of the motion, for a torque without compensation of cogging.
fn filtered_row(joint: usize, seen: &ConditionedSample<N>) -> LinearParameters<N, P> {
    let mut row = torque_row::<Ur5, N, P>(joint, seen);
    let cycles = <Ur5 as Arm<N, P>>::COGGING_CYCLES[joint];
    let share = cogging_attenuation(cycles * seen.motion.qd[joint] * PERIOD_S as f32);
    row.attenuate_cogging(joint, share, &LinearParameters::filled(0.0));
    row
}

/// Weighted least squares with the prior covariance of `config` around `prior`.
fn least_squares(rows: &[ConditionedSample<N>], prior: &Set, config: &LearnerConfig<N, P>) -> Set {
    let start = LinearParameters::of(prior);
    let sigma = config.sigma();
    let n = start.iter().count();
    let prior_information = prior_covariance().try_inverse();
    let mut normal = prior_information.unwrap_or_else(|| DMatrix::identity(n, n));
    let mut right = DVector::<f64>::zeros(n);
    for seen in rows {
        for joint in 0..N {
            if seen.motion.qd[joint].abs() < config.velocity_gate {
                continue;
            }
            let row = filtered_row(joint, seen);
            let limit = <Ur5 as Arm<N, P>>::LIMITS[joint].torque;
            let inv_noise = f64::from(1.0 / (config.noise * limit));
            let phi = DVector::from_iterator(
                n,
                row.iter()
                    .zip(sigma.iter())
                    .map(|(row, sigma)| f64::from(row * sigma) * inv_noise),
            );
            let left = f64::from(seen.tau[joint] - row.dot(&start)) * inv_noise;
            right.axpy(left, &phi, 1.0);
            normal.syger(1.0, &phi, &phi, 1.0);
        }
    }
    let moved = normal.cholesky().map(|normal| normal.solve(&right));
    let mut found = start;
    if let Some(moved) = moved {
        let columns = found.iter_mut().zip(sigma.iter());
        for ((found, sigma), moved) in columns.zip(moved.iter()) {
            *found += sigma * *moved as f32;
        }
    }
    let mut set = *prior;
    found.write(&mut set);
    set
}
