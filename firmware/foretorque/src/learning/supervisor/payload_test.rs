//! Test of a payload: picked up, released, or a transient disturbance.

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
const MIN_ROWS: f32 = 8.0;
/// Least faded number of rows with a learner of one joint: enough to see the end of a disturbance, never to promote.
const MIN_ROWS_SINGLE: f32 = 3.0;
/// Part of the mean square residual of a large disturbance that a hypothesis may leave.
const REMAINDER: f32 = 0.02;
/// Multiple of the usual mean square of blocks that may remain after a disturbance, because no model of a real arm reaches the noise.
const USUAL_FACTOR: f32 = 2.0;

/// Part of the evidence for the hypothesis that an empty hand must have for a release.
const EMPTY_PART: f32 = 0.8;

/// Test of a payload hypothesis. Squares are in variances of a measurement and fade with each block.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PayloadHypothesisTest {
    filter: PayloadFilter,
    blocks: u32,
    /// Evidence for the hypothesis and for an empty hand, each over the payload in the torque: twice a log-likelihood ratio.
    evidence: f32,
    empty_evidence: f32,
    rows: f32,
    /// Squares with the payload in the torque and with the hypothesis.
    current: f32,
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
            evidence: 0.0,
            empty_evidence: 0.0,
            rows: 0.0,
            current: 0.0,
            hypothesis: 0.0,
            promote_blocks: 0,
            release_blocks: 0,
            quiet_blocks: 0,
        }
    }

    /// Add the residual torque `tau` of one joint without payload, N·m, with its payload row.
    ///
    /// * `payload` payload in the torque      * `sigma` standard deviation of a measurement, N·m
    /// * `inflated` standard deviation of a block for the payload filter, N·m
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
        // Before the update, on a row new to the hypothesis.
        self.hypothesis += square(self.filter.residual(row, tau));
        let ratio = sigma / inflated;
        let weight = ratio * ratio;
        let before = weight * square(tau - payload_torque(payload, row));
        self.empty_evidence += before - weight * square(tau);
        self.evidence += before - self.filter.update(row, tau, inflated);
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
        let rejection = self.rejection(config, quiet, current, hypothesis);
        let gone = carries_payload
            && self.evidence > config.payload_evidence
            && self.empty_evidence > EMPTY_PART * self.evidence;
        let count = |counter: &mut u32, holds: bool, enough: bool| {
            *counter = if holds && enough { *counter + 1 } else { 0 };
            *counter >= config.decision_blocks
        };
        let promoted = count(&mut self.promote_blocks, rejection.is_none(), enough);
        let released = count(&mut self.release_blocks, gone, enough);
        let enough = enough || single && self.rows >= MIN_ROWS_SINGLE;
        let over = count(&mut self.quiet_blocks, current < quiet, enough);
        for sum in [&mut self.rows, &mut self.current, &mut self.hypothesis] {
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
    /// * `quiet` mean square that counts as usual
    fn rejection(
        &self,
        config: &SupervisorConfig,
        quiet: f32,
        current: f32,
        hypothesis: f32,
    ) -> Option<(Reason, f32)> {
        let mass_sigma = self.filter.mass_sigma();
        let payload = payload_estimate(&self.filter.payload(), mass_sigma);
        let plausible = payload.mass > 0.0 && config.is_body(&self.filter.payload());
        let explained =
            self.evidence > config.payload_evidence && hypothesis <= quiet + REMAINDER * current;
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arm::ur5::{LearnerConfig, Ur5};
    use crate::learning::payload::{MAX_COM_DISTANCE, NO_PAYLOAD, PAYLOAD_PARAMETERS};

    fn config() -> SupervisorConfig {
        LearnerConfig::for_arm::<Ur5>(1e-3).supervisor
    }

    /// Decision after blocks of a payload `carried`, N·m a unit, under which the arm feels `felt`; one row of every
    /// parameter a block, and two in the directions of the mass.
    fn decided(carried: &Payload, felt: &Payload, noise: f32) -> (u32, PayloadDecision) {
        let (block, decision, _) = decided_at(carried, felt, noise, 0.1);
        (block, decision)
    }

    /// Likewise for rows of the deviation `inflated`, N·m; with the standard deviation of the mass then, kg.
    fn decided_at(
        carried: &Payload,
        felt: &Payload,
        noise: f32,
        inflated: f32,
    ) -> (u32, PayloadDecision, f32) {
        let config = config();
        let mut test = PayloadHypothesisTest::new(&config, carried);
        for block in 1.. {
            for k in 0..PAYLOAD_PARAMETERS + 2 {
                let mut row = NO_PAYLOAD;
                row[k % PAYLOAD_PARAMETERS] = 10.0;
                let sign = if (block + k as u32).is_multiple_of(2) {
                    1.0
                } else {
                    -1.0
                };
                let tau = payload_torque(felt, &row) + sign * noise;
                test.add_row(carried, &row, tau, 0.1, inflated);
            }
            let carries = *carried != NO_PAYLOAD;
            if let Some(decision) = test.decide(&config, carries, false, 0.0) {
                return (block, decision, test.filter.mass_sigma());
            }
        }
        unreachable!("the test has a time-out");
    }

    #[test]
    fn every_disturbance_has_its_decision() {
        let config = config();
        let of =
            |mass: f32, [x, y, z]: [f32; 3]| [mass, mass * x, mass * y, mass * z, 0.0, 0.0, 0.0];
        let two = of(2.0, [0.05; 3]);
        let (far, light) = (1.02 * MAX_COM_DISTANCE, 0.9 * config.min_payload_mass);
        let heavy = of(1.01 * config.max_payload_mass, [0.0; 3]);
        let implausible = |mass: f32| PayloadDecision::Refuse(Reason::Implausible, mass);
        let five = config.decision_blocks;
        let (warm, late) = (five, config.timeout_blocks);
        for (carried, felt, blocks, wanted) in [
            (NO_PAYLOAD, two, warm, PayloadDecision::Promote),
            (two, NO_PAYLOAD, five, PayloadDecision::Release),
            (NO_PAYLOAD, NO_PAYLOAD, five, PayloadDecision::Transient),
            (two, two, five, PayloadDecision::Transient),
            // Heavier by a little: another payload, not an empty hand.
            (two, of(3.0, [0.05; 3]), warm, PayloadDecision::Promote),
            (two, of(0.9, [0.05; 3]), warm, PayloadDecision::Promote),
            (NO_PAYLOAD, of(2.0, [far, 0.0, 0.0]), late, implausible(2.0)),
            (NO_PAYLOAD, of(2.0, [0.0, far, 0.0]), late, implausible(2.0)),
            (NO_PAYLOAD, of(2.0, [0.0, 0.0, far]), late, implausible(2.0)),
            (NO_PAYLOAD, of(light, [0.0; 3]), late, implausible(light)),
            (NO_PAYLOAD, heavy, late, implausible(heavy[0])),
        ] {
            let (block, decision) = decided(&carried, &felt, 0.03);
            let near = match (decision, wanted) {
                (PayloadDecision::Refuse(a, x), PayloadDecision::Refuse(b, y)) => {
                    a == b && (x - y).abs() < 0.02 * y
                }
                (decision, wanted) => decision == wanted,
            };
            assert!(near, "{carried:?} {felt:?}: {decision:?}");
            assert!((blocks..=blocks + 3).contains(&block), "{felt:?}: {block}");
        }
        // An empty hand under noise that no payload explains, and a payload that is hardly felt.
        let (_, released) = decided(&two, &NO_PAYLOAD, 2.0);
        assert_eq!(released, PayloadDecision::Release);
        let tiny = of(0.005, [0.0; 3]);
        let (_, over) = decided(&tiny, &tiny, 0.03);
        assert_eq!(over, PayloadDecision::Transient);
        // A disturbance that a payload explains in part.
        let (block, decision) = decided(&NO_PAYLOAD, &two, 3.0);
        assert!(
            matches!(decision, PayloadDecision::Refuse(Reason::Residual, _)),
            "{decision:?}"
        );
        assert_eq!(block, late);
        // Evidence comes before a mass that is certain enough.
        let (block, decision, sigma) = decided_at(&NO_PAYLOAD, &two, 0.03, 20.0);
        assert_eq!(decision, PayloadDecision::Promote);
        assert!(
            block > 60 && sigma < config.max_mass_sigma,
            "{block}: {sigma} kg"
        );
    }

    /// First change of the payload in the window of the background test with `felt` where `carried` is in the torque, and
    /// its block; torques below the noise of one standard deviation.
    fn found(carried: &Payload, felt: &Payload) -> Option<(u32, PayloadDecision)> {
        let config = config();
        let mut test = PayloadHypothesisTest::new(&config, carried);
        let mut random = 1u64;
        (1..config.window_blocks).find_map(|block| {
            for k in 0..PAYLOAD_PARAMETERS + 2 {
                let mut row = NO_PAYLOAD;
                row[k % PAYLOAD_PARAMETERS] = 0.3;
                random = random
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1);
                // Uniform, of variance 1.
                let noise = 3.0f32.sqrt() * ((random >> 40) as f32 / (1 << 23) as f32 - 1.0);
                let tau = payload_torque(felt, &row) + 0.1 * noise;
                test.add_row(carried, &row, tau, 0.1, 0.1);
            }
            let decision = test.decide(&config, *carried != NO_PAYLOAD, false, 1.0)?;
            decision.is_change().then_some((block, decision))
        })
    }

    #[test]
    fn a_payload_below_the_noise_is_found_in_the_background_and_noise_is_none() {
        let mut light = NO_PAYLOAD;
        light[0] = 0.3;
        assert_eq!(found(&NO_PAYLOAD, &NO_PAYLOAD), None);
        assert_eq!(found(&light, &light), None);
        for (carried, felt, wanted) in [
            (NO_PAYLOAD, light, PayloadDecision::Promote),
            (light, NO_PAYLOAD, PayloadDecision::Release),
        ] {
            let (block, decision) = found(&carried, &felt).expect("a change");
            assert!(decision == wanted && block > 20, "{block}: {decision:?}");
        }
    }
}
