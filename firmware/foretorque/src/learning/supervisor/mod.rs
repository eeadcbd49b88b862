//! State of the learning supervisor. Its transitions are in `learner/transitions.rs`, its state diagram in
//! `docs/learning.md`.

pub(super) mod config;
pub(super) mod payload_test;
pub(super) mod step;

use super::change_detection::{Block, BlockAverage, ChangeDetector};
use super::config::LearnerConfig;
use super::parameters::LinearParameters;
use super::payload::{NO_PAYLOAD, Payload, PayloadFilter, payload_base, payload_sigma};
use super::quality::Phase;
use super::shares::{LearntShare, ShareEvidence};
use crate::arm::Arm;
use crate::dynamics::BaseParameters;
use crate::joint::zero_vector;
use config::SupervisorConfig;
use payload_test::{PayloadBenefit, PayloadHypothesisTest};
use step::SupervisorState;

/// Linear parameters and payload of one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Checkpoint<const N: usize, const P: usize> {
    pub(super) estimate: LinearParameters<N, P>,
    pub(super) learnt: Learnt<N, P>,
    pub(super) payload: Payload,
}

/// Learnt linear parameters in the torque, their share, and the evidence for it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Learnt<const N: usize, const P: usize> {
    /// Set that moves to the estimate in bounded steps.
    pub(super) set: LinearParameters<N, P>,
    pub(super) share: LearntShare<N>,
    pub(super) evidence: ShareEvidence<N>,
}

impl<const N: usize, const P: usize> Learnt<N, P> {
    /// Learnt set `set` without evidence.
    const fn new(set: &LinearParameters<N, P>) -> Self {
        Self {
            set: *set,
            share: LearntShare::NONE,
            evidence: ShareEvidence::NONE,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Supervisor<const N: usize, const P: usize> {
    pub(super) detector: ChangeDetector<N>,
    pub(super) block_average: BlockAverage<N>,
    /// Block in progress, one joint a tick, and its next joint.
    pub(super) pending_block: Option<(Block<N>, usize)>,
    /// Payload in the torque, and its base parameters.
    pub(super) payload: Payload,
    pub(super) payload_base: BaseParameters<P>,
    /// Payload filter after promotion.
    pub(super) payload_filter: PayloadFilter,
    pub(super) blocks_carried: u32,
    pub(super) payload_benefit: PayloadBenefit,
    pub(super) payload_test: PayloadHypothesisTest<N>,
    /// Usual mean square of each joint's blocks, in units of the configured noise, and the number of blocks behind it.
    pub(super) block_variance: [(f32, u32); N],
    /// Rows used since the load.
    pub(super) rows: u32,
    /// Rows in the covariance before the payload in the torque.
    pub(super) rows_before: u32,
    pub(super) carries_payload: bool,
    /// Checkpoint of before the payload in the torque; without one, of before the window of the payload test.
    pub(super) before_payload: Checkpoint<N, P>,
    /// Newer and older checkpoint; an alarm returns to the older one, because it comes after the change.
    pub(super) checkpoints: [Checkpoint<N, P>; 2],
    /// Set of the last load: the rival of the learnt one.
    pub(super) loaded: LinearParameters<N, P>,
    pub(super) learnt: Learnt<N, P>,
    pub(super) state: SupervisorState,
    /// Next friction column whose variance is raised in relearning.
    pub(super) next_raised: usize,
}

impl<const N: usize, const P: usize> Supervisor<N, P> {
    /// State without payload, with parameters of zero; inlined, it is built in its place and not on the stack.
    #[inline(always)]
    pub(super) const fn new(config: &SupervisorConfig) -> Self {
        let zero = LinearParameters::filled(0.0);
        let checkpoint = Checkpoint {
            estimate: zero,
            learnt: Learnt::new(&zero),
            payload: NO_PAYLOAD,
        };
        Self {
            detector: ChangeDetector::new(),
            block_average: BlockAverage::new(),
            pending_block: None,
            payload: NO_PAYLOAD,
            payload_base: zero_vector(),
            payload_filter: PayloadFilter::new(
                &NO_PAYLOAD,
                &payload_sigma(config.max_payload_mass),
            ),
            blocks_carried: 0,
            payload_benefit: PayloadBenefit::NONE,
            payload_test: PayloadHypothesisTest::new(config, &NO_PAYLOAD),
            block_variance: [(1.0, 0); N],
            rows: 0,
            rows_before: 0,
            carries_payload: false,
            before_payload: checkpoint,
            checkpoints: [checkpoint; 2],
            loaded: zero,
            learnt: Learnt::new(&zero),
            state: SupervisorState::START,
            next_raised: 0,
        }
    }

    /// Restart with `set` loaded, learnt and estimated, and without payload; in place, to spare the stack.
    pub(super) fn restart(&mut self, config: &SupervisorConfig, set: &LinearParameters<N, P>) {
        *self = Self::new(config);
        self.loaded = *set;
        self.learnt.set = *set;
        let before = [&mut self.before_payload];
        for checkpoint in self.checkpoints.iter_mut().chain(before) {
            checkpoint.estimate = *set;
            checkpoint.learnt.set = *set;
        }
    }

    #[inline(never)]
    pub(super) fn set_payload<A: Arm<N, P>>(&mut self, payload: &Payload) {
        self.payload = *payload;
        self.payload_base = payload_base::<A, N, P>(payload);
    }

    /// Make the older checkpoint that of before a payload, unless there is one in the torque.
    #[inline(never)]
    pub(super) fn keep_checkpoint(&mut self) {
        if !self.carries_payload {
            self.before_payload = self.checkpoints[1];
        }
    }

    /// True if the residual of the active set may train the network of `joint`.
    pub(super) fn trains_network(&self, config: &SupervisorConfig, joint: usize) -> bool {
        let share = self.learnt.share.joint.get(joint);
        let settled = share.is_some_and(|share| *share > 0.5);
        let settled = settled || self.rows >= config.training_rows;
        settled && !self.state.reversed && self.state.phase == Phase::Healthy
    }

    /// True if the payload in the torque is still updated. With evidence for an empty hand it is not: rows of an empty hand
    /// would make it lighter, and harder to tell from none.
    #[inline(never)]
    pub(super) fn updates_payload(&self, config: &SupervisorConfig) -> bool {
        self.carries_payload
            && self.blocks_carried < config.payload_update_blocks
            && !self.payload_test.may_be_empty()
    }

    /// True if the payload makes the torque worse, after as many blocks of motion as an error of the estimate lasts.
    pub(super) fn payload_costs(&self, config: &SupervisorConfig) -> bool {
        self.carries_payload && self.payload_benefit.is_cost(config.lasting_blocks)
    }

    /// Fade the evidence of before the payload if friction was learnt under it: the evidence is that for the friction of before.
    pub(super) fn fade_evidence_of_before(&mut self, config: &LearnerConfig<N, P>) {
        if self.blocks_carried >= config.supervisor.pause_blocks {
            let evidence = &mut self.before_payload.learnt.evidence;
            evidence.fade(config.lasting_part());
        }
    }

    /// True if the estimate pauses under a payload, or with evidence for one.
    ///
    /// A release restores the parameters of before the payload. Rows learnt meanwhile would be lost, but the covariance
    /// would keep their information.
    pub(super) fn pauses_estimate(&self, config: &SupervisorConfig) -> bool {
        self.carries_payload && self.blocks_carried < config.pause_blocks
            || self.payload_test.undecided
    }

    #[inline(never)]
    pub(super) fn reset_blocks(&mut self) {
        self.block_average.reset();
        self.pending_block = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arm::ur5::{LearnerConfig, Ur5};
    use crate::joint::{JointMotion, JointVector};
    use payload_test::PayloadDecision;
    use payload_test::tests::{add_block, of_mass};

    type Tested = Supervisor<6, 40>;

    fn config() -> SupervisorConfig {
        LearnerConfig::for_arm::<Ur5>(1e-3).supervisor
    }

    /// Block with `carried` in the torque where the arm has `actual`; standard deviations of a measurement and of a block, N·m.
    fn add_rows(supervisor: &mut Tested, payloads: [&Payload; 2], deviations: [f32; 2]) {
        let test = &mut supervisor.payload_test;
        add_block(test, payloads, 10.0, |_| 0.0, deviations);
    }

    #[test]
    fn a_restart_makes_the_loaded_set_that_of_every_checkpoint() {
        let mut supervisor = Tested::new(&config());
        let set = LinearParameters::filled(3.0);
        supervisor.restart(&config(), &set);
        let [newer, older] = supervisor.checkpoints;
        for (name, of) in [
            ("loaded", supervisor.loaded),
            ("learnt", supervisor.learnt.set),
            ("newer", newer.learnt.set),
            ("older", older.learnt.set),
            ("before", supervisor.before_payload.learnt.set),
            ("estimate", older.estimate),
        ] {
            assert!(of == set, "{name}");
        }
    }

    #[test]
    fn evidence_for_a_body_pauses_the_estimate_until_its_mass_is_certain() {
        let config = config();
        let mut supervisor = Tested::new(&config);
        let body = of_mass(2.0);
        // Torques whose error is ten times what they show.
        let mut paused = 0;
        let decision = (0..config.timeout_blocks).find_map(|_| {
            add_rows(&mut supervisor, [&NO_PAYLOAD, &body], [0.1, 20.0]);
            let decision = supervisor.payload_test.decide(&config, false, false, 0.0);
            paused += u32::from(supervisor.pauses_estimate(&config));
            decision.filter(|decision| decision.is_change())
        });
        assert_eq!(decision, Some(PayloadDecision::Promote));
        assert!(
            paused > 10 && !supervisor.pauses_estimate(&config),
            "{paused}"
        );
        supervisor.restart(&config, &LinearParameters::filled(0.0));
        assert!(!supervisor.pauses_estimate(&config));
        // Rows of one joint alone never promote.
        for _ in 0..config.timeout_blocks {
            add_rows(&mut supervisor, [&NO_PAYLOAD, &body], [0.1, 20.0]);
            let _ = supervisor.payload_test.decide(&config, false, true, 0.0);
            assert!(!supervisor.pauses_estimate(&config));
        }
        supervisor.restart(&config, &LinearParameters::filled(0.0));
        for _ in 0..config.timeout_blocks {
            let mut row = NO_PAYLOAD;
            row[0] = 10.0;
            let (test, torques) = (&mut supervisor.payload_test, [20.0; 2]);
            (0..9).for_each(|_| test.add_row(1, &NO_PAYLOAD, &row, torques, [0.1, 20.0]));
            let _ = test.decide(&config, false, false, 0.0);
            assert!(!supervisor.pauses_estimate(&config), "rows of one joint");
        }
    }

    #[test]
    fn a_payload_is_not_updated_while_the_hand_may_be_empty() {
        let config = config();
        let mut supervisor = Tested::new(&config);
        let body = of_mass(2.0);
        supervisor.carries_payload = true;
        for (actual, updates) in [(body, true), (NO_PAYLOAD, false)] {
            add_rows(&mut supervisor, [&body, &actual], [1.0; 2]);
            supervisor.payload_test.decide(&config, true, false, 0.0);
            assert_eq!(supervisor.updates_payload(&config), updates, "{actual:?}");
        }
        supervisor.carries_payload = false;
        assert!(!supervisor.updates_payload(&config));
    }

    #[test]
    fn a_discarded_block_leaves_nothing_for_the_next_one() {
        let mut supervisor = Tested::new(&config());
        let residual = JointVector::repeat(1.0);
        let average = &mut supervisor.block_average;
        average.push(&JointMotion::zero(), &residual, 0.05, 2);
        let block = average.push(&JointMotion::zero(), &residual, 0.05, 2);
        supervisor.pending_block = block.map(|block| (block, 0));
        assert!(supervisor.pending_block.is_some());
        let average = &mut supervisor.block_average;
        average.push(&JointMotion::zero(), &residual, 0.05, 2);
        supervisor.reset_blocks();
        assert!(supervisor == Tested::new(&config()));
    }

    /// Networks train on what the linear parameters leave: when the share of a joint is settled, or after many rows.
    #[test]
    fn networks_train_on_settled_residuals_of_a_healthy_learner() {
        let config = SupervisorConfig {
            training_rows: 2,
            ..config()
        };
        for (share, rows, reversed, phase, trains) in [
            (0.6, 0, false, Phase::Healthy, true),
            (0.4, 0, false, Phase::Healthy, false),
            (0.4, 1, false, Phase::Healthy, false),
            (0.4, 2, false, Phase::Healthy, true),
            (0.6, 2, true, Phase::Healthy, false),
            (0.6, 2, false, Phase::PayloadTest, false),
            (0.6, 2, false, Phase::Relearning, false),
        ] {
            let mut supervisor = Tested::new(&config);
            supervisor.learnt.share.joint[1] = share;
            supervisor.rows = rows;
            supervisor.state.reversed = reversed;
            supervisor.state.phase = phase;
            let context = std::format!("{share} {rows} {reversed} {phase:?}");
            assert_eq!(supervisor.trains_network(&config, 1), trains, "{context}");
            assert!(!supervisor.trains_network(&config, 0) || rows == 2);
        }
    }
}
