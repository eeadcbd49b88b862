use super::parameters::{JointNetwork, NETWORK_BOUND, NETWORK_HIDDEN, network_inputs};
use super::small_filter::SmallFilter;
use crate::limits::cut;
use crate::network::StepParameters;
use nalgebra::SVector;

/// Weights that lead to the output, with its threshold.
const OUTPUTS: usize = NETWORK_HIDDEN + 1;
/// Rows of a block: 0.1 s at 167 rows a second. What is left of a torque stays for tenths of a second, so it is blocks
/// that are counted, not rows.
const BLOCK_ROWS: u32 = 16;
/// Weight of all older blocks in the one after: 37 % after 4096 rows, 25 s.
const FADE: f32 = 1.0 - BLOCK_ROWS as f32 / 4096.0;
/// Rows of a joint on which a trainee has to prove itself at least, 6 s.
const PROOF_ROWS: u32 = 1000;
/// Rows after which a network in the torque may be found to harm.
const HARM_ROWS: u32 = 256;
/// Significance of a proof.
const SIGNIFICANCE: f32 = 3.0;
/// Significance that a joint's own rows must have, where those of all joints together prove it: noise hides in a joint
/// what is plain in six.
const OWN_SIGNIFICANCE: f32 = 0.5;
/// A trainee has to leave less than this part of the mean square residual of the network in force.
const PROMOTION_RATIO: f32 = 0.995;
/// Residuals count up to this many standard deviations.
const CLIP: f32 = 6.0;
/// Variance that each row gives back to the output weights, in units of the prior's: the drives change.
const WANDERING: f32 = 1e-8;

/// How the networks are trained.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrainerConfig {
    /// Prior standard deviation of the weights that lead to the output, in units of the torque limit; 0 trains nothing.
    pub output_sigma: f32,
    /// Back-propagation step of the hidden layer, as a fraction of the step that would cancel the error of a row; 0 leaves
    /// it as it is.
    pub hidden_rate: f32,
    /// Errors beyond this many standard deviations of the measurement act as if they had this many.
    pub clip_sigmas: f32,
}

/// What one row says to the network of its joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct NetworkRow {
    /// Speed of the joint, rad/s.
    pub qd: f32,
    /// What the linear parameters leave of the torque, in units of the torque limit.
    pub residual: f32,
    /// Standard deviation of the measurement, in units of the torque limit.
    pub sigma: f32,
}

/// What the evidence says of a network.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum NetworkVerdict {
    /// The trainee takes the place of the network in force. Its mean square residual over that of the other.
    Promoted(f32),
    /// The network in force makes the torque worse than none. Its mean square residual over that without.
    Silenced(f32),
}

/// Differences of squared residuals, summed, with the sum of their squares over blocks.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Difference {
    block: f32,
    sum: f32,
    scatter: f32,
}

impl Difference {
    const NONE: Self = Self {
        block: 0.0,
        sum: 0.0,
        scatter: 0.0,
    };

    fn close_block(&mut self) {
        self.sum = FADE * self.sum + self.block;
        self.scatter = FADE * self.scatter + self.block * self.block;
        self.block = 0.0;
    }

    /// The sum lies more than `sigmas` standard deviations above 0.
    fn proves(&self, sigmas: f32) -> bool {
        self.sum > 0.0 && self.sum * self.sum > sigmas * sigmas * self.scatter
    }
}

/// What the rows of a joint say of its networks; squares in variances of a measurement, faded.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Record {
    rows: u32,
    active: f32,
    trainee: f32,
    silent: f32,
    /// active² − trainee².
    advantage: Difference,
    /// active² − silent².
    harm: Difference,
}

impl Record {
    const NONE: Self = Self {
        rows: 0,
        active: 0.0,
        trainee: 0.0,
        silent: 0.0,
        advantage: Difference::NONE,
        harm: Difference::NONE,
    };

    /// Takes the squares of one row. Returns whether it completes a block.
    fn note(&mut self, active: f32, trainee: f32, silent: f32) -> bool {
        self.rows += 1;
        self.active += active;
        self.trainee += trainee;
        self.silent += silent;
        self.advantage.block += active - trainee;
        self.harm.block += active - silent;
        let whole = self.rows.is_multiple_of(BLOCK_ROWS);
        if whole {
            self.advantage.close_block();
            self.harm.close_block();
            for sum in [&mut self.active, &mut self.trainee, &mut self.silent] {
                *sum *= FADE;
            }
        }
        whole
    }
}

/// Trains the networks of the joints on what the linear parameters leave, out of sight of the torque.
///
/// The output layer is a Kalman filter's state: it is linear in what the hidden units say, and a descent at a rate that
/// noise allows would take minutes to find what the filter has found after some seconds. The hidden layer goes down the
/// gradient by back-propagation, normalised and clipped.
///
/// Every row is first predicted by the trainee, by the network in force and by none, then learnt: no prediction has seen
/// its row. Only a trainee whose record proves it better goes into the torque; one that harms is taken out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct NetworkTrainer<const N: usize> {
    trainee: [JointNetwork; N],
    /// Doubt about each output layer. Its state is what is still to be added to the weights: nothing.
    filter: [SmallFilter<OUTPUTS>; N],
    record: [Record; N],
}

impl<const N: usize> NetworkTrainer<N> {
    /// Starts from `networks`.
    pub(super) const fn new(networks: &[JointNetwork; N]) -> Self {
        Self {
            trainee: *networks,
            filter: [SmallFilter::new([0.0; OUTPUTS]); N],
            record: [Record::NONE; N],
        }
    }

    /// Takes one row of `joint`.
    ///
    /// * `active` the network in force, replaced where the verdict says so
    ///
    /// Cost: the network of the joint forwards three times and backwards once, one row of a filter of seven.
    #[inline(never)]
    pub(super) fn train(
        &mut self,
        config: &TrainerConfig,
        joint: usize,
        row: &NetworkRow,
        active: &mut JointNetwork,
    ) -> Option<NetworkVerdict> {
        if config.output_sigma <= 0.0 {
            return None;
        }
        let inverse = 1.0 / row.sigma;
        let x = network_inputs(row.qd);
        let trainee = self.trainee.get_mut(joint)?;
        let hidden = trainee.hidden(&x);
        let said = trainee.output(&hidden)[0];
        let square = |said: f32| {
            let z = cut((row.residual - said) * inverse, CLIP).0;
            z * z
        };
        let bounded = |said: f32| cut(said, NETWORK_BOUND).0;
        let silent = square(0.0);
        let active_left = square(bounded(active.forward(&x)[0]));
        let trainee_left = square(bounded(said));
        if !(row.residual + inverse + active_left + trainee_left + silent).is_finite() {
            return None;
        }
        let whole = self
            .record
            .get_mut(joint)?
            .note(active_left, trainee_left, silent);
        let step = StepParameters {
            learning_rate: config.hidden_rate,
            error_clip: config.clip_sigmas * row.sigma,
        };
        let before = *trainee;
        trainee.update_layers(&x, &SVector::from([row.residual]), &step, 1.0);
        // The output layer is the filter's.
        trainee.output_weights = before.output_weights;
        trainee.output_bias = before.output_bias;
        let filter = self.filter.get_mut(joint)?;
        let scale = config.output_sigma * inverse;
        let mut phi = [scale; OUTPUTS];
        for (phi, hidden) in phi.iter_mut().zip(hidden.iter()) {
            *phi = scale * hidden;
        }
        filter.wander(WANDERING);
        let left = cut((row.residual - said) * inverse, config.clip_sigmas).0;
        filter.update(&phi, left, 1.0);
        let found = core::mem::replace(&mut filter.theta, [0.0; OUTPUTS]);
        let weights = trainee.output_weights.iter_mut();
        let weights = weights.chain(trainee.output_bias.iter_mut());
        for (weight, found) in weights.zip(found) {
            *weight += config.output_sigma * found;
        }
        if whole {
            self.judge(joint, active)
        } else {
            None
        }
    }

    /// What the record of `joint` says at the end of a block.
    fn judge(&mut self, joint: usize, active: &mut JointNetwork) -> Option<NetworkVerdict> {
        let mut all = Difference::NONE;
        for record in &self.record {
            all.sum += record.advantage.sum;
            all.scatter += record.advantage.scatter;
        }
        let trainee = self.trainee.get(joint)?;
        let record = self.record.get_mut(joint)?;
        let better = record.advantage.proves(SIGNIFICANCE)
            || all.proves(SIGNIFICANCE) && record.advantage.proves(OWN_SIGNIFICANCE);
        let verdict = if better
            && record.rows >= PROOF_ROWS
            && record.trainee < PROMOTION_RATIO * record.active
            && record.trainee < record.silent
        {
            *active = *trainee;
            NetworkVerdict::Promoted(record.trainee / record.active)
        } else if record.rows >= HARM_ROWS && record.harm.proves(SIGNIFICANCE) {
            *active = active.silenced();
            NetworkVerdict::Silenced(record.active / record.silent)
        } else {
            return None;
        };
        *record = Record::NONE;
        Some(verdict)
    }
}

#[cfg(test)]
mod tests;
