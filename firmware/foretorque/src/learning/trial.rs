//! What is weighed in the shadow after an alarm: is it a payload, is a payload gone, or was it nothing that stays?

use super::decision::Reason;
use super::guard_config::SupervisorConfig;
use super::payload::{Payload, PayloadFilter, describe, payload_sigma, payload_torque};

/// How a trial ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Verdict {
    /// The candidate is believed.
    Promote,
    /// The hand is empty again.
    Release,
    /// Nothing is left to explain.
    Transient,
    /// Time is up; why the candidate was not believed, with the figure of that reason.
    Refuse(Reason, f32),
}

/// Weight of a slice's squares in the slice after.
const FADE: f32 = 0.75;
/// Slices whose residuals do not count against the candidate.
const WARM_UP: u32 = 2;
/// Rows that the faded sums must stand for: fewer joints than two in motion prove nothing.
const LEAST_ROWS: f32 = 8.0;
/// The same where only one joint is listened to: enough to see that it is calm again, never to believe a payload.
const LEAST_ROWS_ALONE: f32 = 3.0;
/// What a candidate may leave of the mean square residual of a large disturbance and still count as explaining it.
const REMAINDER: f32 = 0.02;

/// Times what is usually left that may be left besides when a disturbance is over: real arms are never explained to the
/// noise.
const USUAL: f32 = 2.0;

/// A trial. Squares in variances of a measurement, faded from slice to slice.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Trial {
    filter: PayloadFilter,
    slices: u32,
    rows: f32,
    current: f32,
    empty: f32,
    candidate: f32,
    proven: u32,
    released: u32,
    calm: u32,
}

impl Trial {
    /// Begins around `payload`, with everything open.
    pub(super) const fn new(config: &SupervisorConfig, payload: &Payload) -> Self {
        Self {
            filter: PayloadFilter::new(payload, &payload_sigma(config.max_payload_mass)),
            slices: 0,
            rows: 0.0,
            current: 0.0,
            empty: 0.0,
            candidate: 0.0,
            proven: 0,
            released: 0,
            calm: 0,
        }
    }

    /// Takes the torque `tau`, N·m, that the bare arm leaves on one joint, with the row of the payload.
    ///
    /// * `payload` the payload in the torque      * `sigma` standard deviation of a measurement, N·m
    /// * `inflated` the one the candidate's filter believes, N·m
    #[inline(never)]
    pub(super) fn note(
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
        // Before the update: on a row the candidate has not seen.
        self.candidate += square(self.filter.residual(row, tau));
        self.filter.update(row, tau, inflated);
    }

    /// After the last joint of a slice: what the evidence says by now.
    ///
    /// * `alone` only one joint is listened to
    /// * `usual` mean square of the slices while nothing happens, mean of the joints, in variances of a measurement
    #[inline(never)]
    pub(super) fn judge(
        &mut self,
        config: &SupervisorConfig,
        loaded: bool,
        alone: bool,
        usual: f32,
    ) -> Option<Verdict> {
        self.slices += 1;
        if self.slices <= WARM_UP {
            // The first rows only tell the candidate where to look.
            self.candidate = 0.0;
        }
        let enough = self.rows >= LEAST_ROWS;
        let inverse = 1.0 / self.rows;
        let [current, empty, candidate] =
            [self.current, self.empty, self.candidate].map(|sum| sum * inverse);
        let believed = self.doubt(config, current, candidate).is_none();
        let explained = config.quiet_level + REMAINDER * current;
        let gone = loaded
            && empty < config.residual_ratio * current
            && (empty < explained || empty < 1.2 * candidate);
        let count = |counter: &mut u32, holds: bool, enough: bool| {
            *counter = if holds && enough { *counter + 1 } else { 0 };
            *counter >= config.decision_blocks
        };
        let promoted = count(&mut self.proven, believed, enough);
        let released = count(&mut self.released, gone, enough);
        let enough = enough || alone && self.rows >= LEAST_ROWS_ALONE;
        let quiet = config.quiet_level + USUAL * usual;
        let calm = count(&mut self.calm, current < quiet, enough);
        for sum in [
            &mut self.rows,
            &mut self.current,
            &mut self.empty,
            &mut self.candidate,
        ] {
            *sum *= FADE;
        }
        if released {
            Some(Verdict::Release)
        } else if promoted {
            Some(Verdict::Promote)
        } else if calm {
            Some(Verdict::Transient)
        } else if self.slices >= config.timeout_blocks {
            let (reason, figure) = self
                .doubt(config, current, candidate)
                .unwrap_or((Reason::Uncertain, self.filter.mass_sigma()));
            Some(Verdict::Refuse(reason, figure))
        } else {
            None
        }
    }

    /// Why the candidate is not believed.
    fn doubt(
        &self,
        config: &SupervisorConfig,
        current: f32,
        candidate: f32,
    ) -> Option<(Reason, f32)> {
        let mass_sigma = self.filter.mass_sigma();
        let payload = describe(&self.filter.payload(), mass_sigma);
        let [x, y, z] = payload.com;
        let distance = x * x + y * y + z * z;
        let plausible = payload.mass >= config.min_payload_mass
            && payload.mass <= config.max_payload_mass
            && distance <= config.max_com_distance * config.max_com_distance;
        let explained = candidate <= config.residual_ratio * current
            && candidate <= config.quiet_level + REMAINDER * current;
        if !plausible {
            Some((Reason::Implausible, payload.mass))
        } else if mass_sigma >= config.max_mass_sigma {
            Some((Reason::Uncertain, mass_sigma))
        } else if !explained {
            Some((Reason::Residual, candidate / current))
        } else {
            None
        }
    }

    /// The filter of the candidate.
    pub(super) fn filter(&self) -> &PayloadFilter {
        &self.filter
    }

    /// Slices since the alarm.
    pub(super) fn slices(&self) -> u32 {
        self.slices
    }
}
