//! Test of a payload: picked up, released, or a transient disturbance.

use super::config::SupervisorConfig;
use crate::learning::decision::Reason;
use crate::learning::payload::{
    PAYLOAD_PARAMETERS, Payload, PayloadFilter, payload_estimate, payload_sigma, payload_torque,
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

/// Part of the mean square residual that the hypothesis leaves where there is nothing to explain: of noise nearly all.
const UNEXPLAINED: f32 = 0.5;
/// Least evidence for an empty hand: a likelihood ratio without free parameters exceeds 1/p with probability p at most
/// [Ville 1939], and p is that of [`SupervisorConfig::payload_evidence`].
const EMPTY_EVIDENCE: f32 = 45.0;
/// Least evidence for a body without that of the joint with the most: a body loads several joints, an error of one joint's
/// friction does not. χ² of seven degrees of freedom exceeds it with probability 0.006.
const EVIDENCE_OF_OTHERS: f32 = 20.0;
/// Evidence that the parameters of a body gain by chance: the mean of χ² with as many degrees of freedom.
const CHANCE: f32 = PAYLOAD_PARAMETERS as f32;
/// Part of the evidence for a body that an empty hand must have for a release.
const EMPTY_PART: f32 = 0.8;

/// Benefit of the payload in the torque: whether the torques measured lately are nearer to those of the active set with it.
///
/// ```text
/// v = Σ d r / Σ d²     d = torque of the payload     r = measured − active without payload
/// ```
/// The least-squares share v is near 1 under a body. Below 1/2 the squared error with the payload is larger than without it:
/// the hand is empty, or an error of the model on one part of a path was taken for a body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PayloadBenefit {
    /// Σ d r and Σ d², faded.
    cross: f32,
    power: f32,
}

impl PayloadBenefit {
    /// Benefit without rows.
    pub(crate) const NONE: Self = Self {
        cross: 0.0,
        power: 0.0,
    };

    /// Add a row, in units of the torque limit.
    ///
    /// * `payload` torque of the payload      * `lacking` torque that the active set lacks without it
    pub(crate) fn add_row(&mut self, payload: f32, lacking: f32) {
        self.cross += payload * lacking;
        self.power += payload * payload;
    }

    /// End of a block; `memory` of the sums, blocks.
    pub(crate) fn end_block(&mut self, memory: u32) {
        let fade = 1.0 - 1.0 / memory as f32;
        self.cross *= fade;
        self.power *= fade;
    }

    /// True if the torques are nearer to those without the payload.
    pub(crate) fn is_cost(&self) -> bool {
        self.cross < 0.5 * self.power
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
    /// Evidence for the hypothesis by joint and for an empty hand, each over the payload in the torque: twice a log-likelihood
    /// ratio.
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

    /// Add the residual torque `tau` of `joint` without payload, N·m, with its payload row.
    ///
    /// * `payload` payload in the torque      * `sigma` standard deviation of a measurement, N·m
    /// * `inflated` standard deviation of a block for the payload filter, N·m
    #[inline(never)]
    pub(crate) fn add_row(
        &mut self,
        joint: usize,
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
        let empty = before - weight * square(tau);
        self.empty += square(tau);
        self.empty_evidence += empty;
        self.empty_cusum += empty;
        let body = before - self.filter.update(row, tau, inflated);
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
        self.undecided =
            matches!(rejection, Some((Reason::Uncertain, _))) && evidence > config.payload_evidence;
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

    /// True if the window is over: its evidence is not on the way to that of a promotion before the timeout.
    pub(crate) fn is_over(&self, config: &SupervisorConfig) -> bool {
        let (evidence, _) = self.evidence();
        let part = self.blocks as f32 / config.timeout_blocks as f32;
        self.blocks >= config.timeout_blocks || evidence < part * config.payload_evidence
    }

    /// True if there is evidence for an empty hand, beyond chance.
    pub(crate) fn may_be_empty(&self) -> bool {
        self.empty_cusum > CHANCE
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arm::ur5::{LearnerConfig, Ur5};
    use crate::learning::payload::{MAX_COM_DISTANCE, NO_PAYLOAD};

    fn config() -> SupervisorConfig {
        LearnerConfig::for_arm::<Ur5>(1e-3).supervisor
    }

    fn is_refused_for_residual(decision: PayloadDecision) -> bool {
        matches!(decision, PayloadDecision::Refuse(Reason::Residual, _))
    }

    fn of_mass(mass: f32) -> Payload {
        [mass, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    }

    /// Decision after blocks of a payload `carried`, N·m a unit, under which the arm feels `felt`; one row of every
    /// parameter a block, and two in the directions of the mass, on two joints in turn.
    fn decided(carried: &Payload, felt: &Payload, noise: f32) -> (u32, PayloadDecision) {
        let (block, decision, _) = decided_at::<2>(carried, felt, (noise, 0.1));
        (block, decision)
    }

    /// Likewise on `JOINTS` joints, for rows of the deviation `inflated`, N·m; with the standard deviation of the mass then, kg.
    fn decided_at<const JOINTS: usize>(
        carried: &Payload,
        felt: &Payload,
        (noise, inflated): (f32, f32),
    ) -> (u32, PayloadDecision, f32) {
        let config = config();
        let mut test = PayloadHypothesisTest::<JOINTS>::new(&config, carried);
        for block in 1.. {
            for k in 0..PAYLOAD_PARAMETERS + 2 {
                let mut row = NO_PAYLOAD;
                row[k % PAYLOAD_PARAMETERS] = 10.0;
                let sign = [1.0, -1.0][(block as usize + k) % 2];
                let tau = payload_torque(felt, &row) + sign * noise;
                test.add_row(k % JOINTS, carried, &row, tau, 0.1, inflated);
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
        // A first moment without mass explains much that an empty hand does not.
        let mut pulled = NO_PAYLOAD;
        pulled[1] = 1.5;
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
            // Nearly all of it is gone, and what remains is a body or none.
            (
                two,
                of(1.2 * config.min_payload_mass, [0.0; 3]),
                five,
                PayloadDecision::Release,
            ),
            (two, pulled, five, PayloadDecision::Release),
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
        assert!(is_refused_for_residual(decision), "{decision:?}");
        assert_eq!(block, late);
        // Evidence comes before a mass that is certain enough.
        let (block, decision, sigma) = decided_at::<2>(&NO_PAYLOAD, &two, (0.03, 20.0));
        assert_eq!(decision, PayloadDecision::Promote);
        let certain = sigma < config.max_mass_sigma;
        assert!(block > 60 && certain, "{block}: {sigma} kg");
    }

    #[test]
    fn a_body_that_one_joint_alone_shows_is_none() {
        let body = of_mass(2.0);
        let (_, of_two, _) = decided_at::<2>(&NO_PAYLOAD, &body, (0.03, 0.1));
        assert_eq!(of_two, PayloadDecision::Promote);
        let (_, of_one, _) = decided_at::<1>(&NO_PAYLOAD, &body, (0.03, 0.1));
        assert!(is_refused_for_residual(of_one), "{of_one:?}");
    }

    /// Background test with the payload `felt` by block where `carried` is in the torque: decisions with their blocks until the
    /// payload changes, and the mass of the last hypothesis, kg; `blocks` blocks, with torques of `height` times the noise of one
    /// standard deviation.
    fn background(
        carried: &Payload,
        felt: impl Fn(u32) -> Payload,
        (height, blocks): (f32, u32),
    ) -> (std::vec::Vec<(u32, PayloadDecision)>, f32) {
        let config = config();
        let mut test = PayloadHypothesisTest::<2>::new(&config, carried);
        let mut random = 1u64;
        let mut decisions = std::vec::Vec::new();
        for block in 1..blocks {
            for k in 0..PAYLOAD_PARAMETERS + 2 {
                let mut row = NO_PAYLOAD;
                row[k % PAYLOAD_PARAMETERS] = height;
                random = random
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1);
                // Uniform, of variance 1.
                let noise = 3.0f32.sqrt() * ((random >> 40) as f32 / (1 << 23) as f32 - 1.0);
                let tau = payload_torque(&felt(block), &row) + 0.1 * noise;
                test.add_row(k % 2, carried, &row, tau, 0.1, 0.1);
            }
            let decision = test.decide(&config, *carried != NO_PAYLOAD, false, 1.0);
            decisions.extend(decision.map(|decision| (block, decision)));
            if decision.is_some_and(PayloadDecision::is_change) {
                break;
            }
            if test.is_over(&config) {
                test.next_window(&config, carried);
            }
        }
        (decisions, test.filter.payload()[0])
    }

    /// The change of the payload in such a test.
    fn found(carried: &Payload, felt: &Payload, how: (f32, u32)) -> Option<(u32, PayloadDecision)> {
        let (decisions, _) = background(carried, |_| *felt, how);
        let is_change = |(_, decision): &(u32, PayloadDecision)| decision.is_change();
        decisions.into_iter().find(is_change)
    }

    #[test]
    fn a_payload_below_the_noise_is_found_in_the_background_and_noise_is_none() {
        let light = of_mass(0.3);
        assert_eq!(found(&NO_PAYLOAD, &NO_PAYLOAD, (0.3, 150)), None);
        assert_eq!(found(&light, &light, (0.3, 150)), None);
        for (carried, felt, wanted) in [
            (NO_PAYLOAD, light, PayloadDecision::Promote),
            (light, NO_PAYLOAD, PayloadDecision::Release),
        ] {
            let (block, decision) = found(&carried, &felt, (0.3, 150)).expect("a change");
            assert!(decision == wanted && block > 20, "{block}: {decision:?}");
        }
    }

    #[test]
    fn a_release_is_found_though_no_window_alone_shows_it() {
        let light = of_mass(0.3);
        let window = config().timeout_blocks;
        let (block, decision) = found(&light, &NO_PAYLOAD, (0.08, 3000)).expect("a change");
        assert!(decision == PayloadDecision::Release, "{decision:?}");
        assert!(block > window, "{block}");
        assert_eq!(found(&light, &light, (0.08, 3000)), None);
    }

    #[test]
    fn a_payload_let_go_within_a_window_is_not_half_a_payload() {
        let body = of_mass(1.0);
        for height in [0.1, 0.2, 0.3] {
            for last in [40, 80, 120] {
                let felt = |block| if block > last { NO_PAYLOAD } else { body };
                let (decisions, _) = background(&body, felt, (height, 300));
                let (block, decision) = *decisions.last().expect("a change");
                assert_eq!(decision, PayloadDecision::Release, "{height} {block}");
                assert!(block > last, "{block}");
            }
        }
    }

    #[test]
    fn what_a_body_explains_is_no_transient_though_it_is_quiet() {
        let light = of_mass(0.3);
        for (felt, transient) in [(NO_PAYLOAD, true), (light, false)] {
            let (decisions, _) = background(&NO_PAYLOAD, |_| felt, (1.0, 150));
            let is_over = |(_, decision): &&_| *decision == PayloadDecision::Transient;
            let over = decisions.iter().find(is_over);
            assert_eq!(over.is_some(), transient, "{decisions:?}");
            assert!(over.is_none_or(|(block, _)| *block < 10), "{decisions:?}");
        }
    }

    /// Windows without evidence are short: few rows from before a body is picked up delay it, or make it lighter.
    #[test]
    fn a_body_is_found_soon_and_nearly_whole_whenever_it_is_picked_up() {
        let body = of_mass(1.0);
        for (height, soon, whole) in [(0.05, 250, 0.95), (0.2, 50, 0.75)] {
            let mut sum = 0.0;
            let picks = (0..300).step_by(30);
            for first in picks.clone() {
                let felt = |block| if block < first { NO_PAYLOAD } else { body };
                let (decisions, mass) = background(&NO_PAYLOAD, felt, (height, first + soon));
                let last = decisions.last().map(|(_, decision)| *decision);
                assert_eq!(last, Some(PayloadDecision::Promote), "{height} {first}");
                sum += mass;
            }
            let mean = sum / picks.count() as f32;
            assert!(mean > whole, "{height}: {mean} kg");
        }
    }

    #[test]
    fn a_joint_at_rest_shows_an_empty_hand_where_no_friction_and_no_brake_can_hide_it() {
        let config = config();
        let body = of_mass(1.0);
        // Payload of 10 N·m; residual without it and deviation, N·m; blocks between two such blocks.
        for (residual, deviation, every, released) in [
            (0.0, 1.0, 1, true),
            (1.0, 1.0, 1, true),
            (10.0, 1.0, 1, false),
            (5.0, 1.0, 1, false),
            // Friction of a quarter of its torque, or more.
            (0.0, 1.6, 1, false),
            // A brake carries the arm as well.
            (-40.0, 1.0, 1, false),
            // Not in consecutive blocks.
            (0.0, 1.0, config.decision_blocks - 1, false),
        ] {
            let mut test = PayloadHypothesisTest::<2>::new(&config, &body);
            let after = (0..1000).find(|block| {
                let residual = if block % every == 0 { residual } else { 10.0 };
                test.add_rest(10.0, residual, deviation * deviation);
                test.decide(&config, true, false, 1.0) == Some(PayloadDecision::Release)
            });
            let expected = released.then_some(config.decision_blocks - 1);
            assert_eq!(after, expected, "{residual} {deviation} {every}");
        }
    }

    #[test]
    fn a_torque_at_rest_that_is_that_of_an_empty_hand_for_a_moment_is_forgotten_in_motion() {
        let config = config();
        let body = of_mass(1.0);
        let mut test = PayloadHypothesisTest::<2>::new(&config, &body);
        test.add_rest(100.0, 0.0, 1.0);
        assert_eq!(test.decide(&config, true, false, 1.0), None);
        assert!(test.may_be_empty());
        for k in 0..10 {
            test.add_row(k % 2, &body, &body, 1.0, 0.2, 0.2);
        }
        assert_eq!(test.decide(&config, true, false, 1.0), None);
        assert!(!test.may_be_empty());
    }

    #[test]
    fn a_payload_costs_when_the_torques_want_less_than_half_of_it() {
        let after = |shares: &[f32]| {
            let mut benefit = PayloadBenefit::NONE;
            for share in shares {
                for row in 0..1000 {
                    let payload = (0.05 * row as f32).sin();
                    benefit.add_row(payload, share * payload);
                    benefit.end_block(500);
                }
            }
            benefit.is_cost()
        };
        assert!(!PayloadBenefit::NONE.is_cost() && !after(&[0.6]) && after(&[0.4]));
        // What was long ago does not count.
        assert!(after(&[1.0, 1.0, 0.2]) && !after(&[0.0, 0.0, 0.8]));
    }
}
