use super::dense_ud::DenseUdFilter;
use super::parameters::{
    JointNetwork, NETWORK_BOUND, NETWORK_HIDDEN, NETWORK_INPUTS, network_inputs, network_output,
};
use crate::limits::cut;
use crate::network::StepParameters;
use nalgebra::SVector;

/// Weights of the output layer, with its bias.
const OUTPUTS: usize = NETWORK_HIDDEN + 1;
/// Least rows of a block: 0.1 s at 167 rows a second. Residuals are correlated over tenths of a second, so blocks are the
/// observations, not rows.
const BLOCK_ROWS: u32 = 16;
/// Least rows of a joint before its network is silenced.
const HARM_ROWS: u32 = 256;
/// Significance of a promotion, standard deviations.
const SIGNIFICANCE: f32 = 3.0;
/// Significance of a silencing, standard deviations: a wrong one loses only what the network gains until its next promotion.
const HARM_SIGNIFICANCE: f32 = 1.0;
/// Significance of a joint's own rows if all joints together are significant: noise hides in one joint what six show.
const OWN_SIGNIFICANCE: f32 = 0.5;
/// Largest ratio of mean square residuals, candidate to active network, for a promotion.
const PROMOTION_RATIO: f32 = 0.995;
/// Bound of a residual, standard deviations.
const CLIP: f32 = 6.0;
/// Process noise of the output weights for each row, in units of the prior variance: drives change.
const PROCESS_NOISE: f32 = 1e-8;

/// Training of the networks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrainerConfig {
    /// Prior standard deviation of the output weights, in units of the torque limit; 0 disables training.
    pub output_sigma: f32,
    /// Learning rate of the hidden layer: part of the step that cancels the error of a row; 0 keeps the hidden layer.
    pub hidden_rate: f32,
    /// Bound of an error, standard deviations of the measurement; larger ones count as this many.
    pub clip_sigmas: f32,
    /// Memory of the comparison of networks, rows of a joint.
    pub memory_rows: f32,
}

/// Training row of a joint's network.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct NetworkRow {
    /// Velocity of the joint, rad/s.
    pub qd: f32,
    /// Residual torque of the active linear parameters, in units of the torque limit.
    pub residual: f32,
    /// Standard deviation of the measurement, in units of the torque limit.
    pub sigma: f32,
    /// The residual is that of the arm alone. Else it may be that of a payload: the candidate does not learn it and has no
    /// advantage by it, but the active network is compared with none.
    pub of_arm: bool,
}

/// Result of a comparison of networks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum NetworkDecision {
    /// The candidate replaces the active network. Ratio of mean square residuals, candidate to active.
    Promoted(f32),
    /// The active network is silenced: worse than none. Ratio of mean square residuals, with to without.
    Silenced(f32),
}

/// Sum of paired differences d and of their squares, `t = Σ d / √Σ d²`.
#[derive(Clone, Copy, Debug, PartialEq)]
struct PairedSum {
    sum: f32,
    squares: f32,
}

impl PairedSum {
    const ZERO: Self = Self {
        sum: 0.0,
        squares: 0.0,
    };

    /// True if t > `sigmas`.
    fn is_above(&self, sigmas: f32) -> bool {
        // Comparing squares avoids the root.
        self.sum * self.sum.abs() > sigmas * sigmas * self.squares
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct BlockSum {
    block: f32,
    rows: u32,
    total: PairedSum,
}

impl BlockSum {
    const ZERO: Self = Self {
        block: 0.0,
        rows: 0,
        total: PairedSum::ZERO,
    };

    /// Add the difference `d` of a row to the open block.
    fn add(&mut self, d: f32) {
        self.block += d;
        self.rows += 1;
    }

    /// Close the block as one observation if it has [`BLOCK_ROWS`]; returns the factor by which older ones fade.
    ///
    /// * `memory` rows after which the sums have faded to 37 %
    fn close_block(&mut self, memory: f32) -> Option<f32> {
        if self.rows < BLOCK_ROWS {
            return None;
        }
        let fade = (1.0 - self.rows as f32 / memory).max(0.0);
        self.total.sum = self.total.sum * fade + self.block;
        self.total.squares = self.total.squares * fade + self.block * self.block;
        (self.block, self.rows) = (0.0, 0);
        Some(fade)
    }
}

/// Comparison of the networks of a joint. Squares are in variances of a measurement, faded.
#[derive(Clone, Copy, Debug, PartialEq)]
struct NetworkTest {
    rows: u32,
    /// Direction of the last row.
    is_negative: bool,
    /// Squares with the active network, with the candidate, and without network.
    active: f32,
    candidate: f32,
    silent: f32,
    /// active² − candidate². A block is the motion between two changes of direction: what a network learns in one
    /// direction may be what the linear parameters lack there, and is wrong in the other.
    advantage: BlockSum,
    /// active² − silent², in blocks of [`BLOCK_ROWS`].
    harm: BlockSum,
}

impl NetworkTest {
    const NONE: Self = Self {
        rows: 0,
        is_negative: false,
        active: 0.0,
        candidate: 0.0,
        silent: 0.0,
        advantage: BlockSum::ZERO,
        harm: BlockSum::ZERO,
    };

    /// Add the squares of one row at the velocity `qd`; returns true if it completes a block of [`BLOCK_ROWS`].
    ///
    /// * `memory` rows after which the sums have faded to 37 %
    fn add_row(&mut self, qd: f32, [active, candidate, silent]: [f32; 3], memory: f32) -> bool {
        if (qd < 0.0) != self.is_negative {
            self.is_negative = !self.is_negative;
            self.advantage.close_block(memory);
        }
        self.rows += 1;
        self.active += active;
        self.candidate += candidate;
        self.silent += silent;
        self.advantage.add(active - candidate);
        self.harm.add(active - silent);
        let Some(fade) = self.harm.close_block(memory) else {
            return false;
        };
        for sum in [&mut self.active, &mut self.candidate, &mut self.silent] {
            *sum *= fade;
        }
        true
    }
}

/// Trainer of the joints' network candidates, on the residuals of the active linear parameters.
///
/// The output layer is linear in the hidden units and is the state of a Kalman filter, which converges in seconds; a
/// gradient descent as slow as the noise demands takes minutes. The hidden layer descends by normalised, clipped
/// back-propagation.
///
/// Candidate, active network and no network predict every row before it is learnt. A candidate enters the torque when it
/// is significantly better; an active network that is probably worse than none is silenced.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct NetworkTrainer<const N: usize> {
    candidate: [JointNetwork; N],
    /// Covariance of each output layer; the estimate is the increment of the weights, zero between rows.
    filter: [DenseUdFilter<OUTPUTS>; N],
    test: [NetworkTest; N],
}

impl<const N: usize> NetworkTrainer<N> {
    pub(super) const fn new(networks: &[JointNetwork; N]) -> Self {
        Self {
            candidate: *networks,
            filter: [DenseUdFilter::new([0.0; OUTPUTS]); N],
            test: [NetworkTest::NONE; N],
        }
    }

    /// Restart with `networks` as candidates, in place.
    #[inline(never)]
    pub(super) fn reset(&mut self, networks: &[JointNetwork; N]) {
        self.candidate = *networks;
        self.filter.fill(DenseUdFilter::new([0.0; OUTPUTS]));
        self.test.fill(NetworkTest::NONE);
    }

    /// Train with one row of `joint`; a row that is not finite is ignored.
    ///
    /// * `active` active network, replaced by a promotion or silencing
    ///
    /// Cost: the network of the joint forwards three times and backwards once, one row of a filter of seven.
    #[inline(never)]
    pub(super) fn train(
        &mut self,
        config: &TrainerConfig,
        joint: usize,
        row: &NetworkRow,
        active: &mut JointNetwork,
    ) -> Option<NetworkDecision> {
        if config.output_sigma <= 0.0 {
            return None;
        }
        let inverse = 1.0 / row.sigma;
        let x = network_inputs(row.qd);
        let candidate = self.candidate.get(joint)?;
        let hidden = candidate.hidden(&x);
        let output = candidate.output(&hidden)[0];
        let square = |output: f32| {
            let z = cut((row.residual - output) * inverse, CLIP).0;
            z * z
        };
        let bounded = |output: f32| cut(output, NETWORK_BOUND).0;
        let silent = square(0.0);
        let active_square = square(bounded(network_output(active, row.qd)));
        let candidate_square = square(bounded(output));
        if !(row.residual + inverse + active_square + candidate_square + silent).is_finite() {
            return None;
        }
        let candidate_square = if row.of_arm {
            candidate_square
        } else {
            active_square
        };
        let complete = self.test.get_mut(joint)?.add_row(
            row.qd,
            [active_square, candidate_square, silent],
            config.memory_rows,
        );
        if row.of_arm {
            self.learn(config, joint, row, (&x, &hidden, output));
        }
        if complete {
            self.decide(joint, active)
        } else {
            None
        }
    }

    /// Update the candidate of `joint` with its inputs `x`, hidden units and output at the row.
    fn learn(
        &mut self,
        config: &TrainerConfig,
        joint: usize,
        row: &NetworkRow,
        (x, hidden, output): (
            &SVector<f32, NETWORK_INPUTS>,
            &SVector<f32, NETWORK_HIDDEN>,
            f32,
        ),
    ) {
        let (Some(candidate), Some(filter)) =
            (self.candidate.get_mut(joint), self.filter.get_mut(joint))
        else {
            return;
        };
        let inverse = 1.0 / row.sigma;
        let step = StepParameters {
            learning_rate: config.hidden_rate,
            error_clip: config.clip_sigmas * row.sigma,
        };
        // The filter updates the output layer.
        candidate.update_hidden(x, hidden, &SVector::from([output - row.residual]), &step);
        let scale = config.output_sigma * inverse;
        let mut phi = [scale; OUTPUTS];
        for (phi, hidden) in phi.iter_mut().zip(hidden.iter()) {
            *phi = scale * hidden;
        }
        filter.add_process_noise(PROCESS_NOISE);
        let error = cut((row.residual - output) * inverse, config.clip_sigmas).0;
        filter.update(&phi, error, 1.0);
        let increments = core::mem::replace(&mut filter.theta, [0.0; OUTPUTS]);
        let weights = candidate.output_weights.iter_mut();
        let weights = weights.chain(candidate.output_bias.iter_mut());
        for (weight, increment) in weights.zip(increments) {
            *weight += config.output_sigma * increment;
        }
    }

    /// Decision for `joint` at the end of a block, if there is one.
    fn decide(&mut self, joint: usize, active: &mut JointNetwork) -> Option<NetworkDecision> {
        let mut all = PairedSum::ZERO;
        for test in &self.test {
            all.sum += test.advantage.total.sum;
            all.squares += test.advantage.total.squares;
        }
        let candidate = self.candidate.get(joint)?;
        let test = self.test.get_mut(joint)?;
        let own = test.advantage.total;
        let better = own.is_above(SIGNIFICANCE)
            || all.is_above(SIGNIFICANCE) && own.is_above(OWN_SIGNIFICANCE);
        let decision = if better
            && test.candidate < PROMOTION_RATIO * test.active
            && test.candidate < test.silent
        {
            *active = *candidate;
            NetworkDecision::Promoted(test.candidate / test.active)
        } else if test.rows >= HARM_ROWS && test.harm.total.is_above(HARM_SIGNIFICANCE) {
            *active = active.silenced();
            NetworkDecision::Silenced(test.active / test.silent)
        } else {
            return None;
        };
        *test = NetworkTest::NONE;
        Some(decision)
    }
}

#[cfg(test)]
mod tests;
