//! Test after an alarm: a payload picked up, a payload released, or a transient disturbance.

use super::config::SupervisorConfig;
use crate::learning::decision::Reason;
use crate::learning::payload::{
    Payload, PayloadFilter, payload_estimate, payload_sigma, payload_torque,
};

/// Result of a payload test.
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

/// Fading of the sums with each block.
const FADE: f32 = 0.75;
/// First blocks, whose residuals do not count against the hypothesis.
const WARM_UP: u32 = 2;
/// Least faded number of rows for a decision: one moving joint is no evidence of a payload.
const MIN_ROWS: f32 = 8.0;
/// Least faded number of rows with a learner of one joint: enough to see the end of a disturbance, never to promote.
const MIN_ROWS_SINGLE: f32 = 3.0;
/// Part of the mean square residual of a large disturbance that a hypothesis may leave.
const REMAINDER: f32 = 0.02;
/// Multiple of the usual mean square of blocks that may remain after a disturbance, because no model of a real arm reaches the noise.
const USUAL_FACTOR: f32 = 2.0;

/// Test of a payload hypothesis. Squares are in variances of a measurement and fade with each block.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PayloadHypothesisTest {
    filter: PayloadFilter,
    blocks: u32,
    rows: f32,
    /// Squares with the payload in the torque, with an empty hand, and with the hypothesis.
    current: f32,
    empty: f32,
    hypothesis: f32,
    /// Consecutive blocks for which each condition holds.
    promote_blocks: u32,
    release_blocks: u32,
    quiet_blocks: u32,
}

impl PayloadHypothesisTest {
    /// Test without blocks, with the hypothesis at `payload`.
    pub(crate) const fn new(config: &SupervisorConfig, payload: &Payload) -> Self {
        Self {
            filter: PayloadFilter::new(payload, &payload_sigma(config.max_payload_mass)),
            blocks: 0,
            rows: 0.0,
            current: 0.0,
            empty: 0.0,
            hypothesis: 0.0,
            promote_blocks: 0,
            release_blocks: 0,
            quiet_blocks: 0,
        }
    }

    /// Add the residual torque `tau` of one joint without payload, N·m, with its payload row.
    ///
    /// * `payload` payload in the torque      * `sigma` standard deviation of a measurement, N·m
    /// * `inflated` standard deviation for the payload filter, N·m
    #[inline(never)]
    pub(crate) fn add_row(
        &mut self,
        payload: &Payload,
        row: &Payload,
        tau: f32,
        sigma: f32,
        inflated: f32,
    ) {
        let inverse = 1.0 / sigma;
        let square = |residual: f32| {
            let z = residual * inverse;
            z * z
        };
        self.rows += 1.0;
        self.current += square(tau - payload_torque(payload, row));
        self.empty += square(tau);
        // Before the update, on a row new to the hypothesis.
        self.hypothesis += square(self.filter.residual(row, tau));
        self.filter.update(row, tau, inflated);
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
        let [current, empty, hypothesis] =
            [self.current, self.empty, self.hypothesis].map(|sum| sum * inverse);
        let accepted = self.rejection(config, current, hypothesis).is_none();
        let explained = config.quiet_level + REMAINDER * current;
        let gone = carries_payload
            && empty < config.residual_ratio * current
            && (empty < explained || empty < 1.2 * hypothesis);
        let count = |counter: &mut u32, holds: bool, enough: bool| {
            *counter = if holds && enough { *counter + 1 } else { 0 };
            *counter >= config.decision_blocks
        };
        let promoted = count(&mut self.promote_blocks, accepted, enough);
        let released = count(&mut self.release_blocks, gone, enough);
        let enough = enough || single && self.rows >= MIN_ROWS_SINGLE;
        let quiet = config.quiet_level + USUAL_FACTOR * usual;
        let over = count(&mut self.quiet_blocks, current < quiet, enough);
        for sum in [
            &mut self.rows,
            &mut self.current,
            &mut self.empty,
            &mut self.hypothesis,
        ] {
            *sum *= FADE;
        }
        if released {
            Some(PayloadDecision::Release)
        } else if promoted {
            Some(PayloadDecision::Promote)
        } else if over {
            Some(PayloadDecision::Transient)
        } else if self.blocks >= config.timeout_blocks {
            let (reason, figure) = self
                .rejection(config, current, hypothesis)
                .unwrap_or((Reason::Uncertain, self.filter.mass_sigma()));
            Some(PayloadDecision::Refuse(reason, figure))
        } else {
            None
        }
    }

    /// Reason to reject the hypothesis, with its figure.
    fn rejection(
        &self,
        config: &SupervisorConfig,
        current: f32,
        hypothesis: f32,
    ) -> Option<(Reason, f32)> {
        let mass_sigma = self.filter.mass_sigma();
        let payload = payload_estimate(&self.filter.payload(), mass_sigma);
        let [x, y, z] = payload.com;
        let distance_squared = x * x + y * y + z * z;
        let plausible = payload.mass >= config.min_payload_mass
            && payload.mass <= config.max_payload_mass
            && distance_squared <= config.max_com_distance * config.max_com_distance;
        let explained = hypothesis <= config.residual_ratio * current
            && hypothesis <= config.quiet_level + REMAINDER * current;
        if !plausible {
            Some((Reason::Implausible, payload.mass))
        } else if mass_sigma >= config.max_mass_sigma {
            Some((Reason::Uncertain, mass_sigma))
        } else if !explained {
            Some((Reason::Residual, hypothesis / current))
        } else {
            None
        }
    }

    /// Payload filter of the hypothesis.
    pub(crate) fn filter(&self) -> &PayloadFilter {
        &self.filter
    }

    /// Number of blocks since the alarm.
    pub(crate) fn blocks(&self) -> u32 {
        self.blocks
    }
}
