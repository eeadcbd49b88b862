//! Errors against known true parameters.

use super::columns::{FrictionTerm, Layout};
use super::methods::Fit;
use super::problem::TrainingData;
use crate::robot::Robot;
use crate::training::{Descent, PhysicalConfig};
use foretorque::dynamics::FrictionColumn;
use nalgebra::DVector;

/// True parameters of the layout; `None` for a column that takes up friction of another kind.
pub(super) fn truths(robot: &Robot, layout: &Layout) -> Vec<Option<f64>> {
    let base = robot.base_parameters();
    let mut out: Vec<Option<f64>> = base.into_iter().map(Some).collect();
    for parameter in layout.parameters.iter().skip(layout.base) {
        out.push(parameter.friction.and_then(|(term, joint)| {
            let friction = &robot.joints[joint].friction;
            let simple = friction.stribeck_ratio == 0.0;
            let FrictionTerm::Board(column) = term else {
                return Some(0.0);
            };
            match column {
                FrictionColumn::Viscous => simple.then_some(friction.viscous),
                FrictionColumn::Coulomb => simple.then_some(friction.coulomb),
                FrictionColumn::CoggingSine => Some(friction.cogging),
                FrictionColumn::Stribeck | FrictionColumn::ShearThinning => simple.then_some(0.0),
                _ => Some(0.0),
            }
        }));
    }
    out
}

/// Norm of the error of the base parameters over their norm.
pub(super) fn base_error(theta: &DVector<f64>, truth: &[Option<f64>], base: usize) -> Option<f64> {
    let truth: Vec<f64> = truth.iter().take(base).copied().collect::<Option<_>>()?;
    let pairs = truth.iter().zip(theta.iter());
    let error: f64 = pairs.map(|(a, b)| (a - b).powi(2)).sum();
    let size: f64 = truth.iter().map(|value| value * value).sum();
    Some((error / size).sqrt())
}

/// Error of the base parameters by epoch of the accelerated layer; empty without a truth.
pub(super) fn error_curve(
    data: &TrainingData<'_>,
    layout: &Layout,
    reference: &Fit,
    truth: Option<&[Option<f64>]>,
    seed: u64,
) -> Vec<(usize, f64)> {
    let Some(truth) = truth else {
        return Vec::new();
    };
    let layer = data.layer(layout, reference);
    let mut curve = Vec::new();
    for max_epochs in [1, 2, 5, 10, 20, 30, 50, 75, 100, 150, 200, 300, 500, 1000] {
        let config = PhysicalConfig {
            max_epochs,
            starts: 1,
            ..PhysicalConfig::new(Descent::Accelerated, seed)
        };
        let trained = layer.train(&config, &mut |_, _| ());
        if let Some(error) = base_error(&trained.theta, truth, layout.base) {
            curve.push((max_epochs, error));
        }
    }
    curve
}
