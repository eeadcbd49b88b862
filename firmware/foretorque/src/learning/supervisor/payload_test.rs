//! Test of a payload: picked up, released, or a transient disturbance.

use super::config::SupervisorConfig;
use crate::learning::decision::Reason;
use crate::learning::payload::{
    PAYLOAD_PARAMETERS, Payload, PayloadFilter, payload_estimate, payload_sigma, payload_torque,
};
use crate::limits::cut;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum PayloadDecision {
    /// The hypothesis becomes the payload in the torque.
    Promote,
    /// The hand is empty again.
    Release,
    /// The disturbance is over.
    Transient,
    /// Timeout; reason of the refusal, with its figure.
    Refuse(Reason, f32),
}

impl PayloadDecision {
    /// True if the payload in the torque changes.
    pub(crate) fn is_change(self) -> bool {
        matches!(self, Self::Promote | Self::Release)
    }
}

/// Fading of the sums with each block.
const FADE: f32 = 0.75;
/// First blocks, whose residuals do not count against the hypothesis.
const WARM_UP: u32 = 2;
/// Least faded number of rows for a decision: one moving joint is no evidence of a payload.
/// Two moving joints approach 8.
const MIN_ROWS: f32 = 7.5;
/// Least faded number of rows with a learner of one joint: enough to see the end of a disturbance, never to promote.
const MIN_ROWS_SINGLE: f32 = 3.0;
/// Part of the mean square residual of a large disturbance that a hypothesis may leave.
const REMAINDER: f32 = 0.02;
/// Multiple of the usual mean square of blocks that may remain after a disturbance, because no model of a real arm reaches the noise.
const USUAL_FACTOR: f32 = 2.0;

/// Part of the mean square residual that the hypothesis leaves where there is nothing to explain: of noise nearly all.
const UNEXPLAINED: f32 = 0.5;
/// Least evidence for an empty hand: a likelihood ratio without free parameters exceeds 1/p with probability p at most
/// [Ville 1939], and p is that of [`SupervisorConfig::payload_evidence`].
const EMPTY_EVIDENCE: f32 = 45.0;
/// Least evidence for a body without that of the joint with the most: a body loads several joints, an error of one joint's
/// friction does not. χ² of seven degrees of freedom exceeds it with probability 0.006.
const EVIDENCE_OF_OTHERS: f32 = 20.0;
/// Standard deviation of the mass of a payload that is always small enough, as a part of that mass.
const MASS_PART: f32 = 0.1;
/// Evidence that the parameters of a body gain by chance: the mean of χ² with as many degrees of freedom.
const CHANCE: f32 = PAYLOAD_PARAMETERS as f32;
/// Part of the evidence for a body that an empty hand must have for a release.
const EMPTY_PART: f32 = 0.8;

/// Benefit of the payload in the torque: whether the torques measured lately are nearer to those of the active set with it.
///
/// ```text
/// Σ d (r − d/2) < 0     d = torque of the payload     r = measured − active without payload
/// ```
/// Then the squared error with the payload is larger than without it: the hand is empty, or an error of the model on one part
/// of a path was taken for a body.
///
/// While only joints move that carry next to nothing of the body, the others carry it still. So a block forgets in proportion
/// to its own Σ d², and r counts as −d at least and 2 d at most, however large errors of the model are beside d.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PayloadBenefit {
    /// Σ d (r − d/2), faded.
    sum: f32,
    /// Σ d² of the present block.
    power: f32,
    /// Sum of the blocks' Σ d², and of its squares, faded.
    powers: f32,
    squares: f32,
    /// Blocks with rows.
    blocks: u32,
}

impl PayloadBenefit {
    pub(crate) const NONE: Self = Self {
        sum: 0.0,
        power: 0.0,
        powers: 0.0,
        squares: 0.0,
        blocks: 0,
    };

    /// Add a row, in units of the torque limit.
    ///
    /// * `payload` torque of the payload      * `lacking` torque that the active set lacks without it
    pub(crate) fn add_row(&mut self, payload: f32, lacking: f32) {
        let gain = cut(lacking - 0.5 * payload, 1.5 * payload.abs()).0;
        self.sum += payload * gain;
        self.power += payload * payload;
    }

    /// End of a block; `memory` of the sums, blocks of the usual Σ d²: at rest nothing is forgotten.
    pub(crate) fn end_block(&mut self, memory: u32) {
        let power = core::mem::take(&mut self.power);
        if power > 0.0 {
            self.powers += power;
            self.squares += power * power;
            // Σ p²/Σ p is their mean, each weighted by its own: those with next to nothing of the body do not lower it.
            let fade = 1.0 - power * self.powers / (self.squares * memory as f32);
            self.sum *= fade;
            self.powers *= fade;
            self.squares *= fade;
            self.blocks = self.blocks.saturating_add(1);
        }
    }

    /// True if the torques of at least `memory` blocks are nearer to those without the payload.
    pub(crate) fn is_cost(&self, memory: u32) -> bool {
        self.blocks > memory && self.sum < 0.0
    }
}

/// Test of a payload hypothesis. Squares are in variances of a measurement and fade with each block.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PayloadHypothesisTest<const N: usize> {
    /// Payload filter of the hypothesis.
    pub(crate) filter: PayloadFilter,
    /// Blocks since the alarm or the last window.
    pub(crate) blocks: u32,
    /// The hypothesis is a body with enough evidence, whose mass is not certain enough yet.
    pub(crate) undecided: bool,
    /// Evidence for the hypothesis by joint, over the estimate that goes on learning, and for an empty hand, each over the payload
    /// in the torque: twice a log-likelihood ratio.
    evidence: [f32; N],
    empty_evidence: f32,
    /// Likewise for an empty hand since some block before, whichever is the most: a CUSUM, kept from window to window.
    empty_cusum: f32,
    rows: f32,
    /// Squares with the payload in the torque, with the hypothesis, and with an empty hand.
    current: f32,
    hypothesis: f32,
    empty: f32,
    /// Consecutive blocks for which each condition holds.
    promote_blocks: u32,
    release_blocks: u32,
    quiet_blocks: u32,
}

impl<const N: usize> PayloadHypothesisTest<N> {
    /// Test without blocks, with the hypothesis at `payload`.
    pub(crate) const fn new(config: &SupervisorConfig, payload: &Payload) -> Self {
        Self {
            filter: PayloadFilter::new(payload, &payload_sigma(config.max_payload_mass)),
            blocks: 0,
            undecided: false,
            evidence: [0.0; N],
            empty_evidence: 0.0,
            empty_cusum: 0.0,
            rows: 0.0,
            current: 0.0,
            hypothesis: 0.0,
            empty: 0.0,
            promote_blocks: 0,
            release_blocks: 0,
            quiet_blocks: 0,
        }
    }

    /// Start anew, with the hypothesis at `payload`.
    #[inline(never)]
    pub(crate) fn restart(&mut self, config: &SupervisorConfig, payload: &Payload) {
        *self = Self::new(config, payload);
    }

    /// Start the next window, with the hypothesis at `payload`; the evidence for an empty hand since the promotion stays.
    pub(crate) fn next_window(&mut self, config: &SupervisorConfig, payload: &Payload) {
        let (cusum, blocks) = (self.empty_cusum, self.release_blocks);
        self.restart(config, payload);
        (self.empty_cusum, self.release_blocks) = (cusum, blocks);
    }

    /// Add the residual torque `tau` of `joint` without payload, N·m, of the parameters of before the window, with its payload
    /// row.
    ///
    /// * `payload` payload in the torque      * `rival` residual of the estimate with it, N·m
    /// * `sigma` standard deviation of a measurement, N·m
    /// * `inflated` standard deviation of a block for the payload filter, N·m
    #[inline(never)]
    pub(crate) fn add_row(
        &mut self,
        joint: usize,
        payload: &Payload,
        row: &Payload,
        [tau, rival]: [f32; 2],
        [sigma, inflated]: [f32; 2],
    ) {
        let inverse = 1.0 / sigma;
        let square = |residual: f32| {
            let z = residual * inverse;
            z * z
        };
        self.rows += 1.0;
        self.current += square(tau - payload_torque(payload, row));
        // Before the update, on a row new to the hypothesis.
        self.hypothesis += square(self.filter.residual(row, tau));
        let ratio = sigma / inflated;
        let weight = ratio * ratio;
        let before = weight * square(tau - payload_torque(payload, row));
        let empty = before - weight * square(tau);
        self.empty += square(tau);
        self.empty_evidence += empty;
        self.empty_cusum += empty;
        let body = weight * square(rival) - self.filter.update(row, tau, inflated);
        if let Some(evidence) = self.evidence.get_mut(joint) {
            *evidence += body;
        }
    }

    /// Add a joint at rest, with the residual torque `tau` without payload, N·m.
    ///
    /// * `payload` torque of the payload, N·m
    /// * `variance` of a block and of the friction that holds the joint, (N·m)²
    ///
    /// This friction does not change while the joint rests: all its blocks are one observation, and have to show the empty hand
    /// each by itself. The square with an empty hand counts twice: where a brake holds the joint, its torque is that of neither.
    pub(crate) fn add_rest(&mut self, payload: f32, tau: f32, variance: f32) {
        let with = tau - payload;
        let empty = (with * with - 2.0 * tau * tau) / variance;
        // Just enough, so that the next rows of motion decide.
        if empty > EMPTY_EVIDENCE {
            self.empty_cusum = EMPTY_EVIDENCE;
            self.empty_evidence = EMPTY_EVIDENCE;
            if self.rows < MIN_ROWS {
                self.rows = MIN_ROWS;
            }
        }
    }

    /// Decision after the last joint of a block, if there is one.
    ///
    /// * `carries_payload` a payload is in the torque      * `single` the learner has rows of one joint only
    /// * `usual` mean square of undisturbed blocks, mean over the joints, in variances of a measurement
    #[inline(never)]
    pub(crate) fn decide(
        &mut self,
        config: &SupervisorConfig,
        carries_payload: bool,
        single: bool,
        usual: f32,
    ) -> Option<PayloadDecision> {
        self.blocks += 1;
        if self.blocks <= WARM_UP {
            self.hypothesis = 0.0;
        }
        let enough = self.rows >= MIN_ROWS;
        let inverse = 1.0 / self.rows;
        let [current, hypothesis] = [self.current, self.hypothesis].map(|sum| sum * inverse);
        let quiet = config.quiet_level + USUAL_FACTOR * usual;
        let (evidence, of_others) = self.evidence();
        let evident = evidence > config.payload_evidence && of_others > EVIDENCE_OF_OTHERS;
        let rejection = self.rejection(config, evident, quiet, [current, hypothesis]);
        self.undecided = matches!(rejection, Some((Reason::Uncertain, _))) && evident && !single;
        self.empty_cusum = self.empty_cusum.max(0.0);
        let body = !matches!(rejection, Some((Reason::Implausible, _)));
        let gone = carries_payload
            && self.empty_cusum >= EMPTY_EVIDENCE
            && (!body || self.empty_evidence > EMPTY_PART * evidence);
        let over = current < quiet && hypothesis >= UNEXPLAINED * current;
        let few = single && self.rows >= MIN_ROWS_SINGLE;
        let [promoted, released, over] = [
            (&mut self.promote_blocks, rejection.is_none() && enough),
            (&mut self.release_blocks, gone && enough),
            (&mut self.quiet_blocks, over && (enough || few)),
        ]
        .map(|(blocks, holds)| {
            *blocks = if holds { *blocks + 1 } else { 0 };
            *blocks >= config.decision_blocks
        });
        let squares = [&mut self.current, &mut self.hypothesis, &mut self.empty];
        for sum in squares.into_iter().chain([&mut self.rows]) {
            *sum *= FADE;
        }
        if released {
            Some(PayloadDecision::Release)
        } else if promoted {
            Some(PayloadDecision::Promote)
        } else if over {
            Some(PayloadDecision::Transient)
        } else if self.blocks >= config.timeout_blocks {
            let uncertain = (Reason::Uncertain, self.filter.mass_sigma());
            let (reason, figure) = rejection.unwrap_or(uncertain);
            Some(PayloadDecision::Refuse(reason, figure))
        } else {
            None
        }
    }

    /// Reason to reject the hypothesis, with its figure.
    ///
    /// * `evident` the evidence is enough for a promotion
    /// * `quiet` mean square that counts as usual
    /// * mean squares with the payload in the torque, and with the hypothesis
    fn rejection(
        &self,
        config: &SupervisorConfig,
        evident: bool,
        quiet: f32,
        [current, hypothesis]: [f32; 2],
    ) -> Option<(Reason, f32)> {
        let mass_sigma = self.filter.mass_sigma();
        let payload = payload_estimate(&self.filter.payload(), mass_sigma);
        let plausible = payload.mass > 0.0 && config.is_body(&self.filter.payload());
        // In a window in which a payload is let go, the best body is half of it: the last rows show the empty hand.
        let explained =
            evident && hypothesis <= quiet + REMAINDER * current && self.hypothesis < self.empty;
        let certain = config.max_mass_sigma.max(MASS_PART * payload.mass);
        if !plausible {
            Some((Reason::Implausible, payload.mass))
        } else if mass_sigma >= certain {
            Some((Reason::Uncertain, mass_sigma))
        } else if !explained {
            Some((Reason::Residual, hypothesis / current))
        } else {
            None
        }
    }

    /// Evidence for the hypothesis, and the part of it without the joint with the most.
    #[inline(never)]
    fn evidence(&self) -> (f32, f32) {
        let (mut sum, mut most) = (0.0, 0.0);
        for &joint in &self.evidence {
            sum += joint;
            if joint > most {
                most = joint;
            }
        }
        (sum, sum - most)
    }

    /// True if the window is over: its evidence is not on the way to that of a promotion within the timeout, or the hypothesis
    /// would no longer be updated as a payload either.
    pub(crate) fn is_over(&self, config: &SupervisorConfig) -> bool {
        let (evidence, _) = self.evidence();
        let part = self.blocks as f32 / config.timeout_blocks as f32;
        self.blocks >= config.payload_update_blocks || evidence < part * config.payload_evidence
    }

    /// True if there is evidence for an empty hand, beyond chance.
    pub(crate) fn may_be_empty(&self) -> bool {
        self.empty_cusum > CHANCE
    }
}

#[cfg(test)]
pub(super) mod tests;
