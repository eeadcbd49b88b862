//! Watch for a payload whose torque is too small for the change detection of single joints.

use super::payload::{Payload, PayloadFilter, payload_sigma, payload_torque};
use super::supervisor::config::SupervisorConfig;

/// Evidence of all joints together that the payload is another one than that in the torque.
///
/// ```text
/// evidence = Σ r²/σ² − Σ e²/S     r: residual with the payload in the torque     e, S: innovation of the payload filter
/// ```
/// Twice the log-likelihood ratio of the most likely payload over the present one: χ² of seven degrees of freedom without a
/// change. It starts again with each window. Errors of a model are no bodies: the change must be that of a body picked up or
/// put down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PayloadWatch {
    filter: PayloadFilter,
    evidence: f32,
    blocks: u32,
}

impl PayloadWatch {
    /// Watch at the begin of a window with `payload` in the torque.
    pub(super) const fn new(config: &SupervisorConfig, payload: &Payload) -> Self {
        Self {
            filter: PayloadFilter::new(payload, &payload_sigma(config.max_payload_mass)),
            evidence: 0.0,
            blocks: 0,
        }
    }

    /// Add the residual torque `tau` of one joint without payload, N·m, with its payload row.
    ///
    /// * `payload` payload in the torque      * `sigma` standard deviation of a block, correlated rows included, N·m
    pub(super) fn add_row(&mut self, payload: &Payload, row: &Payload, tau: f32, sigma: f32) {
        let residual = (tau - payload_torque(payload, row)) / sigma;
        self.evidence += residual * residual - self.filter.update(row, tau, sigma);
    }

    /// End of a block: the evidence if it is enough for an alarm.
    pub(super) fn end_block(
        &mut self,
        config: &SupervisorConfig,
        payload: &Payload,
    ) -> Option<f32> {
        self.blocks += 1;
        let evidence = self.evidence;
        if self.is_alarm(config, payload) {
            return Some(evidence);
        }
        // A sum that is not finite starts again, too.
        if self.blocks >= config.watch_blocks || !evidence.is_finite() {
            *self = Self::new(config, payload);
        }
        None
    }

    /// True if the evidence is enough for an alarm, and the change of `payload` is a body.
    pub(super) fn is_alarm(&self, config: &SupervisorConfig, payload: &Payload) -> bool {
        let mut change = self.filter.payload();
        for (change, present) in change.iter_mut().zip(payload) {
            *change -= present;
        }
        self.evidence > config.payload_evidence
            && config.is_body(&change)
            && self.filter.mass_sigma() < config.max_mass_sigma
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arm::ur5::{LearnerConfig, Ur5};
    use crate::learning::payload::{NO_PAYLOAD, PAYLOAD_PARAMETERS};

    /// Blocks until the alarm with `felt` where `carried` is in the torque, and its evidence; noise of one standard deviation.
    fn alarm(carried: &Payload, felt: &Payload) -> Option<(u32, f32)> {
        let config = LearnerConfig::for_arm::<Ur5>(1e-3).supervisor;
        let mut watch = PayloadWatch::new(&config, carried);
        let mut random = 1u64;
        (1..2000).find_map(|block| {
            for k in 0..PAYLOAD_PARAMETERS {
                let mut row = NO_PAYLOAD;
                row[k] = 10.0;
                random = random
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1);
                // Uniform, of variance 1.
                let noise = 3.0f32.sqrt() * ((random >> 40) as f32 / (1 << 23) as f32 - 1.0);
                watch.add_row(carried, &row, payload_torque(felt, &row) + noise, 1.0);
            }
            Some((block, watch.end_block(&config, carried)?))
        })
    }

    #[test]
    fn a_payload_below_the_noise_of_a_block_is_seen_and_noise_is_not() {
        let mut light = NO_PAYLOAD;
        light[0] = 0.09;
        assert_eq!(alarm(&NO_PAYLOAD, &NO_PAYLOAD), None);
        assert_eq!(alarm(&light, &light), None);
        for (carried, felt) in [(NO_PAYLOAD, light), (light, NO_PAYLOAD)] {
            let (blocks, evidence) = alarm(&carried, &felt).expect("an alarm");
            assert!((30..300).contains(&blocks) && evidence > 60.0, "{blocks}");
        }
    }

    #[test]
    fn numbers_that_are_not_finite_are_forgotten() {
        let config = LearnerConfig::for_arm::<Ur5>(1e-3).supervisor;
        let fresh = PayloadWatch::new(&config, &NO_PAYLOAD);
        let mut watch = fresh;
        watch.add_row(&NO_PAYLOAD, &[1.0; PAYLOAD_PARAMETERS], f32::NAN, 1.0);
        assert_eq!(watch.end_block(&config, &NO_PAYLOAD), None);
        assert_eq!(watch, fresh);
    }
}
