//! A BP network with one hidden layer in f64, for training.

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
        let value = |net: &TrainingNetwork| {
            let (mut a, mut y) = ([0.0; 6], [0.0; 2]);
            net.forward(&x, &mut a, &mut y);
            y[0] * e[0] + y[1] * e[1]
        };
        let (mut a, mut y) = ([0.0; 6], [0.0; 2]);
        net.forward(&x, &mut a, &mut y);
        let mut gradient = vec![0.0; net.weights.len()];
        net.backward(&x, &a, &e, &mut gradient);
        for (k, found) in gradient.iter().enumerate() {
            let at = |step: f64| {
                let mut moved = net.clone();
                moved.weights[k] += step;
                value(&moved)
            };
            let slope = (at(1e-6) - at(-1e-6)) / 2e-6;
            assert!((slope - found).abs() < 1e-7, "{k}");
        }
    }
}
