//! Training of BP networks on the host, in f64; the results are the board's own f32 networks.
//!
//! Here the network with one hidden layer, and the black box made of one: all positions, velocities and accelerations in, all
//! torques out, 32 hidden units.

mod physical;
mod residual;

pub use physical::{Descent, LinearLayer, PhysicalConfig, Trained};
pub use residual::{SpeedPoint, train_residual};

use crate::dynamics::{Motion, PerJoint};
use crate::metrics::even_sample;
use rand::seq::SliceRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// `a = relu(W1 x + b1)`, `y = W2 a + b2` (eq. 19), all weights in one vector: W1 unit by unit, b1, W2 output by output,
/// b2.
///
/// The board's `BpNetwork` is this network in f32; sums over thousands of rows need more digits.
#[derive(Clone, Debug, PartialEq)]
pub struct TrainingNetwork {
    inputs: usize,
    hidden: usize,
    outputs: usize,
    /// All weights and thresholds.
    pub weights: Vec<f64>,
}

impl TrainingNetwork {
    /// A random start: hidden weights uniform in ±sqrt(6 / inputs) [He 2015], output weights zero.
    pub fn silent(inputs: usize, hidden: usize, outputs: usize, seed: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let reach = (6.0 / inputs as f64).sqrt();
        let mut weights = vec![0.0; hidden * inputs + hidden + outputs * hidden + outputs];
        for weight in &mut weights[..hidden * inputs] {
            *weight = random.random_range(-reach..=reach);
        }
        // Thresholds spread the kinks over the range of the inputs.
        for weight in &mut weights[hidden * inputs..hidden * inputs + hidden] {
            *weight = random.random_range(-0.5..=0.5);
        }
        Self {
            inputs,
            hidden,
            outputs,
            weights,
        }
    }

    /// W1, b1, W2, b2.
    pub fn layers(&self) -> [&[f64]; 4] {
        let (w1, rest) = self.weights.split_at(self.hidden * self.inputs);
        let (b1, rest) = rest.split_at(self.hidden);
        let (w2, b2) = rest.split_at(self.outputs * self.hidden);
        [w1, b1, w2, b2]
    }

    /// Outputs of the hidden units into `a`, of the network into `y`.
    pub fn forward(&self, x: &[f64], a: &mut [f64], y: &mut [f64]) {
        let [w1, b1, w2, b2] = self.layers();
        let dot = |w: &[f64], x: &[f64]| -> f64 { w.iter().zip(x).map(|(w, x)| w * x).sum() };
        for ((a, w), b) in a.iter_mut().zip(w1.chunks_exact(self.inputs)).zip(b1) {
            *a = (dot(w, x) + b).max(0.0);
        }
        for ((y, w), b) in y.iter_mut().zip(w2.chunks_exact(self.hidden)).zip(b2) {
            *y = dot(w, a) + b;
        }
    }

    /// Back-propagates the errors `e` of the outputs: adds Σ_o e_o ∂y_o/∂w to `gradient`.
    pub fn backward(&self, x: &[f64], a: &[f64], e: &[f64], gradient: &mut [f64]) {
        let [_, _, w2, _] = self.layers();
        let (g1, rest) = gradient.split_at_mut(self.hidden * self.inputs);
        let (gb1, rest) = rest.split_at_mut(self.hidden);
        let (g2, gb2) = rest.split_at_mut(self.outputs * self.hidden);
        for (unit, &a) in a.iter().enumerate() {
            let mut delta = 0.0;
            for (o, &e) in e.iter().enumerate() {
                g2[o * self.hidden + unit] += e * a;
                delta += e * w2[o * self.hidden + unit];
            }
            if a > 0.0 {
                gb1[unit] += delta;
                let own = &mut g1[unit * self.inputs..(unit + 1) * self.inputs];
                for (g, x) in own.iter_mut().zip(x) {
                    *g += delta * x;
                }
            }
        }
        for (g, e) in gb2.iter_mut().zip(e) {
            *g += e;
        }
    }
}

const HIDDEN: usize = 32;
/// Rows of one step of the descent.
const BATCH: usize = 64;
/// Most rows of the training: more do not reduce the error on unseen paths.
const ROWS: usize = 8000;
const EPOCHS: usize = 80;
/// Learning rate at first; it falls to a hundredth.
const RATE: f64 = 3e-3;

/// A trained black box with the scales of its inputs and outputs.
#[derive(Clone, Debug, PartialEq)]
pub struct BlackBox {
    network: TrainingNetwork,
    /// Means and spreads of the inputs.
    inputs: Vec<(f64, f64)>,
    /// Means and spreads of the torques, N·m.
    torques: PerJoint<(f64, f64)>,
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
        let rows: Vec<_> = even_sample(rows, ROWS).collect();
        let inputs: Vec<Vec<f64>> = rows.iter().map(|(state, ..)| raw_inputs(state)).collect();
        let joints = rows.first().map_or(1, |(motion, ..)| motion.q.len());
        let of_input = |i: usize| moments(inputs.iter().map(|x| x[i]));
        let of_torque = |joint: usize| moments(rows.iter().map(|(_, tau, _)| tau[joint]));
        let mut out = Self {
            network: TrainingNetwork::silent(3 * joints, HIDDEN, joints, seed),
            inputs: (0..3 * joints).map(of_input).collect(),
            torques: PerJoint::from_fn(joints, of_torque),
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
                        let (centre, spread) = out.torques[joint];
                        let target = (tau[joint] - centre) / spread;
                        e[joint] = f64::from(moving[joint]) * (e[joint] - target);
                        sum += e[joint] * e[joint];
                        count += f64::from(moving[joint]);
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
        let joints = self.torques.len();
        let (mut a, mut y) = ([0.0; HIDDEN], PerJoint::repeat(joints, 0.0));
        let x = self.scaled(&raw_inputs(state));
        self.network.forward(&x, &mut a, &mut y);
        PerJoint::from_fn(joints, |joint| {
            let (centre, spread) = self.torques[joint];
            centre + spread * y[joint]
        })
    }

    fn scaled(&self, x: &[f64]) -> Vec<f64> {
        let scaled = x.iter().zip(&self.inputs);
        let scaled = scaled.map(|(x, (centre, spread))| (x - centre) / spread);
        scaled.collect()
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn back_propagation_agrees_with_central_differences() {
        let mut net = TrainingNetwork::silent(3, 6, 2, 5);
        let mut random = ChaCha8Rng::seed_from_u64(1);
        for weight in &mut net.weights {
            *weight += random.random_range(-0.3..0.3);
        }
        let (x, e) = ([0.3, -0.7, 0.9], [1.3, -0.4]);
        // Hidden outputs, and the outputs on their errors.
        let forward = |net: &TrainingNetwork| {
            let (mut a, mut y) = ([0.0; 6], [0.0; 2]);
            net.forward(&x, &mut a, &mut y);
            (a, y[0] * e[0] + y[1] * e[1])
        };
        let mut gradient = vec![0.0; net.weights.len()];
        net.backward(&x, &forward(&net).0, &e, &mut gradient);
        for (k, found) in gradient.iter().enumerate() {
            let at = |step: f64| {
                let mut moved = net.clone();
                moved.weights[k] += step;
                forward(&moved).1
            };
            let slope = (at(1e-6) - at(-1e-6)) / 2e-6;
            assert!((slope - found).abs() < 1e-7, "{k}");
        }
    }
}
