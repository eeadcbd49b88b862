//! The black-box BP network: all positions, velocities and accelerations in, all torques out, 32 hidden units.

use super::TrainingNetwork;
use crate::dynamics::{Motion, PerJoint};
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

/// Hidden units.
const HIDDEN: usize = 32;
/// Rows of one step of the descent.
const BATCH: usize = 64;
/// Most rows of the training: more do not reduce the error on unseen paths.
const ROWS: usize = 8000;
/// Passes over the rows.
const EPOCHS: usize = 80;
/// Learning rate at first; it falls to a hundredth.
const RATE: f64 = 3e-3;

/// A trained black box with the scales of its inputs and outputs.
#[derive(Clone, Debug, PartialEq)]
pub struct BlackBox {
    network: TrainingNetwork,
    centre: Vec<f64>,
    spread: Vec<f64>,
    torque_centre: PerJoint<f64>,
    torque_spread: PerJoint<f64>,
    /// RMSE of each epoch over the spread of the torques, a ratio.
    pub losses: Vec<f64>,
}

impl BlackBox {
    /// Network trained on states and torques, N·m; a joint that stands still in a row has no error there.
    ///
    /// Gradient descent on batches with a rate of its own for every weight [Kingma and Ba 2015].
    pub fn train(
        rows: &[(Motion, PerJoint<f64>, PerJoint<bool>)],
        seed: u64,
        watch: &mut dyn FnMut(usize, f64),
    ) -> Self {
        let stride = rows.len().div_ceil(ROWS).max(1);
        let rows: Vec<_> = rows.iter().step_by(stride).collect();
        let inputs: Vec<Vec<f64>> = rows.iter().map(|(state, ..)| raw_inputs(state)).collect();
        let joints = rows.first().map_or(1, |(motion, ..)| motion.q.len());
        let (centre, spread) = (0..3 * joints)
            .map(|i| moments(inputs.iter().map(|x| x[i])))
            .unzip();
        let torques = PerJoint::from_fn(joints, |joint| {
            moments(rows.iter().map(|(_, tau, _)| tau[joint]))
        });
        let mut out = Self {
            network: TrainingNetwork::silent(3 * joints, HIDDEN, joints, seed),
            centre,
            spread,
            torque_centre: torques.map(|(centre, _)| centre),
            torque_spread: torques.map(|(_, spread)| spread),
            losses: Vec::new(),
        };
        let inputs: Vec<Vec<f64>> = inputs.iter().map(|x| out.scaled(x)).collect();
        let size = out.network.weights.len();
        let (mut mean, mut square) = (vec![0.0; size], vec![0.0; size]);
        let mut order: Vec<usize> = (0..rows.len()).collect();
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut step = 0;
        for epoch in 0..EPOCHS {
            order.shuffle(&mut random);
            let rate = RATE * 0.01_f64.powf(epoch as f64 / EPOCHS as f64);
            let (mut sum, mut count) = (0.0, 0.0);
            for batch in order.chunks(BATCH) {
                let mut gradient = vec![0.0; size];
                for &row in batch {
                    let (_, tau, moving) = rows[row];
                    let (mut a, mut e) = ([0.0; HIDDEN], PerJoint::repeat(joints, 0.0));
                    out.network.forward(&inputs[row], &mut a, &mut e);
                    for joint in 0..joints {
                        let target =
                            (tau[joint] - out.torque_centre[joint]) / out.torque_spread[joint];
                        e[joint] = f64::from(u8::from(moving[joint])) * (e[joint] - target);
                        sum += e[joint] * e[joint];
                        count += f64::from(u8::from(moving[joint]));
                    }
                    out.network.backward(&inputs[row], &a, &e, &mut gradient);
                }
                step += 1;
                let (lean, drift) = (1.0 - 0.9_f64.powi(step), 1.0 - 0.999_f64.powi(step));
                for (k, g) in gradient.iter().enumerate() {
                    let g = g / batch.len() as f64;
                    mean[k] += 0.1 * (g - mean[k]);
                    square[k] += 0.001 * (g * g - square[k]);
                    out.network.weights[k] -=
                        rate * (mean[k] / lean) / ((square[k] / drift).sqrt() + 1e-8);
                }
            }
            let loss = (sum / f64::max(count, 1.0)).sqrt();
            out.losses.push(loss);
            watch(epoch + 1, loss);
        }
        out
    }

    /// Torques at `state`, N·m.
    pub fn torque(&self, state: &Motion) -> PerJoint<f64> {
        let (mut a, mut y) = ([0.0; HIDDEN], self.torque_centre);
        self.network
            .forward(&self.scaled(&raw_inputs(state)), &mut a, &mut y);
        PerJoint::from_fn(y.len(), |joint| {
            self.torque_centre[joint] + self.torque_spread[joint] * y[joint]
        })
    }

    fn scaled(&self, x: &[f64]) -> Vec<f64> {
        let scales = self.centre.iter().zip(&self.spread);
        let scaled = x.iter().zip(scales);
        scaled
            .map(|(x, (centre, spread))| (x - centre) / spread)
            .collect()
    }
}

fn raw_inputs(state: &Motion) -> Vec<f64> {
    let parts = [&state.q, &state.qd, &state.qdd];
    parts.iter().flat_map(|part| part.iter()).copied().collect()
}

/// Mean and standard deviation; 1 for the deviation of a constant.
fn moments(values: impl Iterator<Item = f64> + Clone) -> (f64, f64) {
    let count = values.clone().count().max(1) as f64;
    let mean = values.clone().sum::<f64>() / count;
    let spread = (values.map(|v| (v - mean).powi(2)).sum::<f64>() / count).sqrt();
    (mean, if spread > 1e-12 { spread } else { 1.0 })
}
