//! The recorder of a run, tick by tick.

use super::controller::Controller;
use super::cramer_rao::CramerRao;
use super::scenario::{Scenario, Start};
use super::setup::{N, PERIOD_S, Set, Setup};
use super::trace::{Evaluation, Second, Trace};
use foretorque::joint::JointMotion;
use foretorque::learning::LinearParameters;
use foretorque::limits::Flags;
use foretorque_workbench::dynamics::Joints;
use foretorque_workbench::metrics::MOVING_RAD_S;
use foretorque_workbench::plant::{Events, Plant};
use foretorque_workbench::trajectory::Trajectory;

/// Flags that are counted.
const COUNTED: [Flags; 8] = [
    Flags::SATURATED,
    Flags::NETWORK_CLIPPED,
    Flags::LEARNED_CLIPPED,
    Flags::STALE_SAMPLE,
    Flags::SHARE_FALLBACK,
    Flags::NOT_FINITE,
    Flags::SET_LATE,
    Flags::WITHDRAWN,
];

/// Time between two evaluations: at first, later on, and close to events, ticks.
const EVALUATE_FIRST: usize = 100;
const EVALUATE: usize = 500;
const EVALUATE_CLOSE: usize = 20;
/// The first part, and how long after an event it is still close, s.
const FIRST_S: f64 = 5.0;
const CLOSE_S: f64 = 2.6;
/// Rows this soon after a payload has changed are no row of a window, s.
pub(super) const PAYLOAD_GRACE_S: f64 = 2.5;
/// Time from the pick of a payload to its weighing, s.
const WEIGHED_AFTER_S: f64 = 1.0;
/// Time from a release to the comparison of torques, s.
const RESTORED_AFTER_S: f64 = 0.5;

/// The recorder of a run.
pub(super) struct Recorder<'w> {
    setup: &'w Setup,
    start: Start,
    events: Events<N>,
    still_s: f64,
    needed: Needed,
    /// Active set one second after the arm has come to rest.
    settled: Option<Set>,
    /// The second after the last pick, and the noise of a torque in units of its limit.
    bound: CramerRao,
    noise: f64,
    /// Torques of the set before the last pick along the unseen path.
    before_pick: Option<Vec<Joints<N>>>,
    /// Decisions of the supervisor already recorded.
    decided: u32,
    pub(super) trace: Trace,
}

/// True torques along the unseen path, with and without the payload in the hand.
struct Needed {
    torques: Vec<Joints<N>>,
    bare: Vec<Joints<N>>,
    valid_until_s: f64,
    carried: bool,
    step: Option<f64>,
}

impl<'w> Recorder<'w> {
    pub(super) fn new(
        setup: &'w Setup,
        scenario: &Scenario,
        events: Events<N>,
        ticks: usize,
        path: &Trajectory<N>,
        plant: &Plant<N>,
    ) -> Self {
        let seconds = (ticks as f64 * PERIOD_S).ceil() as usize;
        let bare = setup.needed(plant);
        Self {
            setup,
            start: scenario.start,
            events,
            still_s: path.duration_s(),
            needed: Needed {
                torques: bare.clone(),
                bare,
                valid_until_s: 0.0,
                carried: false,
                step: None,
            },
            settled: None,
            bound: CramerRao::new(),
            noise: scenario.plant.torque_noise,
            before_pick: None,
            decided: 0,
            trace: Trace {
                seconds: vec![Second::default(); seconds],
                flags: COUNTED.map(|flag| (flag.name(), 0)).to_vec(),
                least_trust: 1.0,
                checksum: 0xcbf2_9ce4_8422_2325,
                ..Trace::default()
            },
        }
    }

    /// Records the decisions of the supervisor since the last tick.
    pub(super) fn decisions(&mut self, tick: usize, board: &Controller) {
        let report = board.report();
        let trust = report.quality.trust;
        self.trace.least_trust = self.trace.least_trust.min(trust);
        let count = report.decisions.count();
        for index in self.decided..count {
            if let Some(decision) = report.decisions.get(index) {
                self.trace
                    .decisions
                    .push((tick as f64 * PERIOD_S, decision));
            }
        }
        self.decided = count;
    }

    /// Evaluates the active set when it is due.
    pub(super) fn evaluate(&mut self, tick: usize, board: &Controller, plant: &Plant<N>) {
        let t_s = tick as f64 * PERIOD_S;
        let at = |time_s: f64| (time_s / PERIOD_S).round() as usize == tick;
        if at(self.still_s + 1.0) {
            self.settled = Some(board.active());
        }
        for payload in &self.events.payloads {
            if at(payload.from_s) {
                self.before_pick = Some(self.setup.predicted(&board.active()));
            }
            if at(payload.from_s + WEIGHED_AFTER_S) {
                let estimate = board.report().quality.payload;
                self.trace.weighed.push((estimate, *payload));
            }
            if let Some(before) = &self.before_pick
                && at(payload.to_s + RESTORED_AFTER_S)
            {
                let now = self.setup.predicted(&board.active());
                self.trace.restored.push(relative_change(before, &now));
            }
        }
        let close = self.close_to_event(t_s);
        let every = if close {
            EVALUATE_CLOSE
        } else if t_s < FIRST_S {
            EVALUATE_FIRST
        } else {
            EVALUATE
        };
        if tick.is_multiple_of(every) {
            self.needed.update(self.setup, plant);
            let predicted = self.setup.predicted(&board.active());
            let error = self.setup.error(&predicted, &self.needed.torques);
            let of_step = self.needed.step.map(|step| {
                let missed = self.setup.in_limits(&predicted, &self.needed.torques);
                missed / step
            });
            self.trace.evaluations.push(Evaluation {
                t_s,
                nrmse: error.nrmse_moving(),
                of_step,
            });
        }
    }

    /// Adds to the Cramér–Rao bound of the payload in the first second after a pick.
    pub(super) fn weigh(&mut self, tick: usize, motion: &JointMotion<N>) {
        let tick_of = |time_s: f64| (time_s / PERIOD_S).round() as usize;
        for payload in &self.events.payloads {
            let from = tick_of(payload.from_s);
            let to = tick_of(payload.from_s + WEIGHED_AFTER_S);
            if tick == from {
                self.bound = CramerRao::new();
            }
            if (from..to).contains(&tick) {
                self.bound.add(motion, self.noise);
            }
            if tick == to
                && let Some((mass, com)) = self.bound.sigmas(payload.body.mass, &payload.body.com)
            {
                self.trace.weighable.push((mass, com, *payload));
            }
        }
    }

    fn close_to_event(&self, t_s: f64) -> bool {
        let after = |from_s: f64, to_s: f64| (from_s - 0.001..to_s + CLOSE_S).contains(&t_s);
        let payloads = self.events.payloads.iter();
        let mut changes = payloads.flat_map(|p| [p.from_s, p.to_s]);
        let mut pushes = self.events.pushes.iter();
        changes.any(|change_s| after(change_s, change_s))
            || pushes.any(|push| after(push.from_s, push.to_s))
    }

    /// Error of the feed-forward in effect, against what the wanted motion takes.
    pub(super) fn add(&mut self, t_s: f64, qd: &Joints<N>, needed: &Joints<N>, acting: &Joints<N>) {
        let payloads = self.events.payloads.iter();
        let mut changes = payloads.flat_map(|p| [p.from_s, p.to_s]);
        let changing =
            changes.any(|change_s| (change_s..change_s + PAYLOAD_GRACE_S).contains(&t_s));
        let Some(second) = self.trace.seconds.get_mut(t_s as usize) else {
            return;
        };
        for j in (0..N).filter(|&j| !changing && qd[j].abs() > MOVING_RAD_S) {
            second.error[j] += (acting[j] - needed[j]).powi(2);
            second.torque[j] += needed[j].powi(2);
        }
    }

    pub(super) fn track(&mut self, t_s: f64, distance: &Joints<N>) {
        if let Some(second) = self.trace.seconds.get_mut(t_s as usize) {
            second.tracking.add(distance);
        }
    }

    pub(super) fn count(&mut self, flags: Flags, torque: &[f32; N]) {
        for ((_, count), flag) in self.trace.flags.iter_mut().zip(COUNTED) {
            *count += u32::from(flags.contains(flag));
        }
        for byte in torque.iter().flat_map(|tau| tau.to_bits().to_le_bytes()) {
            self.trace.checksum ^= u64::from(byte);
            self.trace.checksum = self.trace.checksum.wrapping_mul(0x100_0000_01b3);
        }
    }

    pub(super) fn finish(mut self, board: &Controller, plant: &Plant<N>, ticks: usize) -> Trace {
        self.evaluate(ticks, board, plant);
        if let Some(settled) = &self.settled {
            let sigma = self.start.config().sigma();
            let (before, after) = (
                LinearParameters::of(settled),
                LinearParameters::of(&board.active()),
            );
            let columns = before.iter().zip(after.iter()).zip(sigma.iter());
            self.trace.drift = columns
                .map(|((before, after), sigma)| f64::from((after - before).abs() / sigma))
                .fold(0.0, f64::max);
        }
        self.trace.statistics = board.learner().statistics;
        self.trace.late_sets = board.late_sets();
        self.trace.ticks = ticks;
        self.trace
    }
}

impl Needed {
    /// Renews the torques when a second has passed or the hand has picked or let go.
    fn update(&mut self, setup: &Setup, plant: &Plant<N>) {
        let carried = plant.carried().is_some();
        let changed = carried != self.carried;
        if !changed && plant.t_s() < self.valid_until_s {
            return;
        }
        self.torques = setup.needed(plant);
        if carried && changed {
            self.step = Some(setup.in_limits(&self.torques, &self.bare));
        }
        if !carried {
            self.bare.clone_from(&self.torques);
        }
        self.carried = carried;
        self.valid_until_s = plant.t_s() + 1.0;
    }
}

/// RMS of the change over RMS of the torque, root mean square of the joints.
fn relative_change(before: &[Joints<N>], after: &[Joints<N>]) -> f64 {
    let (mut change, mut torque) = (Joints::<N>::zeros(), Joints::<N>::zeros());
    for (before, after) in before.iter().zip(after) {
        change += (after - before).component_mul(&(after - before));
        torque += before.component_mul(before);
    }
    (change.component_div(&torque).mean()).sqrt()
}
