//! The BP network with physical weights: one linear layer fed with the regressor, whose trained weights are the
//! parameters (eq. 16, 20, 21).
//!
//! Over a whole log the RMSE loss and its gradient are functions of `XᵀX`, `Xᵀτ` and `τᵀτ` alone:
//!
//! ```text
//! J(w)² = (τᵀτ − 2 wᵀXᵀτ + wᵀXᵀX w) / n        ∇J = (XᵀX w − Xᵀτ) / (n J)
//! ```
//!
//! so an epoch sees every row and costs the square of the number of weights. Columns are brought to unit RMS first:
//! without that, gradient descent on SI columns does not arrive.

use crate::metrics::scaled;
use nalgebra::{DMatrix, DVector};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Share of the loss by which it has hardly fallen.
const SETTLED: f64 = 1e-7;

/// Kind of gradient descent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Descent {
    /// eq. 21 unchanged.
    Plain,
    /// Nesterov's momentum, reset whenever the loss rises [O'Donoghue and Candès 2015].
    Accelerated,
}

impl Descent {
    /// Epochs over which a loss that has hardly fallen ends the training.
    fn epochs_without_gain(self) -> usize {
        match self {
            Self::Plain => 500,
            Self::Accelerated => 50,
        }
    }
}

/// Settings of the training.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PhysicalConfig {
    /// Seed of the random starts.
    pub seed: u64,
    /// Random starts; the one with the lowest loss is kept.
    pub starts: usize,
    /// Most epochs of one start.
    pub max_epochs: usize,
    /// Kind of gradient descent.
    pub descent: Descent,
}

impl PhysicalConfig {
    /// Three starts, and enough epochs for each kind of descent.
    pub fn new(descent: Descent, seed: u64) -> Self {
        Self {
            seed,
            starts: 3,
            max_epochs: 40 * descent.epochs_without_gain(),
            descent,
        }
    }
}

/// The training problem: sums of rows that are already divided by each joint's noise.
#[derive(Clone, Debug, PartialEq)]
pub struct LinearLayer {
    gram: DMatrix<f64>,
    moment: DVector<f64>,
    power: f64,
    /// Parameters over weights of the normalised layer.
    scale: DVector<f64>,
    /// Learning rate over the loss: the reciprocal of the largest curvature of J²/2.
    rate: f64,
}

/// A trained layer.
#[derive(Clone, Debug, PartialEq)]
pub struct Trained {
    /// The parameters, SI.
    pub theta: DVector<f64>,
    /// Loss before each epoch, RMSE over noise, a ratio.
    pub losses: Vec<f64>,
}

impl Trained {
    /// Epochs until the loss was within `factor` of `reference`, if ever.
    pub fn epochs_to(&self, factor: f64, reference: f64) -> Option<usize> {
        let mut losses = self.losses.iter();
        losses.position(|&loss| loss <= factor * reference)
    }
}

impl LinearLayer {
    /// The layer of `count` rows with XᵀX = `gram`, Xᵀτ = `moment` and τᵀτ = `power`.
    pub fn new(gram: &DMatrix<f64>, moment: &DVector<f64>, power: f64, count: f64) -> Self {
        let scale = gram.diagonal().map(|square| match square > 0.0 {
            true => (count / square).sqrt(),
            false => 0.0,
        });
        let gram = scaled(gram, &scale) / count;
        let largest = gram.clone().symmetric_eigenvalues().max();
        Self {
            gram,
            moment: moment.component_mul(&scale) / count,
            power: power / count,
            scale,
            rate: 1.0 / largest.max(f64::MIN_POSITIVE),
        }
    }

    /// Loss J (eq. 20) of normalised weights.
    fn loss(&self, w: &DVector<f64>) -> f64 {
        let square = self.power - 2.0 * self.moment.dot(w) + w.dot(&(&self.gram * w));
        square.max(0.0).sqrt()
    }

    /// Loss of parameters.
    pub fn loss_of(&self, theta: &DVector<f64>) -> f64 {
        let weight = |theta, scale| if scale > 0.0 { theta / scale } else { 0.0 };
        self.loss(&theta.zip_map(&self.scale, weight))
    }

    /// J ∇J, the step of eq. 21 at a rate proportional to J. Unlike ∇J it is finite at J = 0, the loss of rows without noise.
    fn slope(&self, w: &DVector<f64>) -> DVector<f64> {
        &self.gram * w - &self.moment
    }

    /// Layer trained from random starts; `watch` receives epoch and loss.
    ///
    /// The rate α of eq. 21 is proportional to the loss: the curvature of J grows as 1/J, and a constant rate would
    /// either crawl at first or swing at the end.
    pub fn train(&self, config: &PhysicalConfig, watch: &mut dyn FnMut(usize, f64)) -> Trained {
        let mut random = ChaCha8Rng::seed_from_u64(config.seed);
        let mut attempt = || {
            let w = DVector::from_fn(self.moment.len(), |_, _| random.random_range(-1.0..=1.0));
            let (w, losses) = self.descend(w, config, watch);
            let theta = w.component_mul(&self.scale);
            Trained { theta, losses }
        };
        let mut best = attempt();
        for _ in 1..config.starts {
            let next = attempt();
            if next.losses.last() < best.losses.last() {
                best = next;
            }
        }
        best
    }

    fn descend(
        &self,
        mut w: DVector<f64>,
        config: &PhysicalConfig,
        watch: &mut dyn FnMut(usize, f64),
    ) -> (DVector<f64>, Vec<f64>) {
        let mut losses = vec![self.loss(&w)];
        let mut before = w.clone();
        // Epochs since the last reset of the momentum.
        let mut age = 0.0;
        for epoch in 1..=config.max_epochs {
            let momentum = match config.descent {
                Descent::Plain => 0.0,
                Descent::Accelerated => age / (age + 3.0),
            };
            let ahead = &w + (&w - &before) * momentum;
            let mut next = &ahead - self.slope(&ahead) * self.rate;
            let mut now = self.loss(&next);
            age += 1.0;
            if now > losses[epoch - 1] && momentum > 0.0 {
                age = 0.0;
                next = &w - self.slope(&w) * self.rate;
                now = self.loss(&next);
            }
            before = std::mem::replace(&mut w, next);
            losses.push(now);
            if epoch % 50 == 0 {
                watch(epoch, now);
            }
            let past = epoch.checked_sub(config.descent.epochs_without_gain());
            let past = past.map(|past| losses[past]);
            if past.is_some_and(|past| past - now <= SETTLED * past) {
                break;
            }
        }
        (w, losses)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 400 rows of five columns of very different size, truth known.
    fn problem() -> (LinearLayer, DVector<f64>) {
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let x = DMatrix::from_fn(400, 5, |_, c| {
            10f64.powi(c as i32 - 2) * (random.random_range(-1.0..1.0) + 0.3)
        });
        let truth = DVector::from_row_slice(&[3.0, -2.0, 1.0, 0.5, -0.02]);
        let tau = &x * &truth + DVector::from_fn(400, |_, _| random.random_range(-0.1..0.1));
        let (gram, moment) = (x.tr_mul(&x), x.tr_mul(&tau));
        let exact = gram.clone().cholesky().expect("definite").solve(&moment);
        let layer = LinearLayer::new(&gram, &moment, tau.norm_squared(), 400.0);
        (layer, exact)
    }

    fn train(layer: &LinearLayer, descent: Descent, seed: u64) -> Trained {
        layer.train(&PhysicalConfig::new(descent, seed), &mut |_, _| ())
    }

    #[test]
    fn both_descents_arrive_at_the_least_squares_solution() {
        let (layer, exact) = problem();
        for descent in [Descent::Plain, Descent::Accelerated] {
            let losses = train(&layer, descent, 1).losses;
            let loss = losses.last().expect("one epoch at least");
            assert!(loss / layer.loss_of(&exact) < 1.0 + 1e-4);
            let falls = |pair: &[f64]| pair[1] <= pair[0] * (1.0 + 1e-9);
            assert!(losses.windows(2).all(falls));
        }
    }

    #[test]
    fn rows_without_noise_give_finite_losses_and_their_parameters() {
        // Whole numbers and one column: the loss becomes zero to the last bit, where its gradient is 0 / 0.
        let gram = DMatrix::from_element(1, 1, 4.0);
        let exact = LinearLayer::new(&gram, &DVector::from_element(1, 8.0), 16.0, 4.0);
        for descent in [Descent::Plain, Descent::Accelerated] {
            let trained = train(&exact, descent, 1);
            assert!((trained.theta[0] - 2.0).abs() < 1e-6, "{trained:?}");
            assert_eq!(trained.losses.last(), Some(&0.0));
        }
        let (noisy, _) = problem();
        let truth = DVector::from_row_slice(&[3.0, -2.0, 1.0, 0.5, -0.02]);
        // The same columns, torques without noise.
        let weights = truth.component_div(&noisy.scale);
        let layer = LinearLayer {
            moment: &noisy.gram * &weights,
            power: weights.dot(&(&noisy.gram * &weights)),
            ..noisy
        };
        let trained = train(&layer, Descent::Accelerated, 1);
        assert!(trained.losses.iter().all(|loss| loss.is_finite()));
        assert!((trained.theta.component_div(&truth).add_scalar(-1.0)).amax() < 1e-5);
    }
}
