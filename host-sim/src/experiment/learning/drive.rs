//! One arm, one board, one scenario: the one loop that all of them go through.

use super::bound::WeighingBound;
use super::controller::Controller;
use super::identified::Starts;
use super::scenario::{Scenario, Start};
use super::world::{N, PERIOD_S, Set, World};
use crate::dynamics::Joints;
use crate::experiment::closed_loop::{Answer, ClosedLoop, motion_f32};
use crate::metrics::{MOVING_RAD_S, TrackingError};
use crate::plant::{Events, Payload, Plant};
use crate::trajectory::Trajectory;
use foretorque::edge::safety::SafetyStatus;
use foretorque::joint::{JointMotion, JointSample};
use foretorque::learning::{Decision, LearnerStatistics, PayloadEstimate, Stacked};
use foretorque::limits::Flags;
use std::convert::Infallible;
use std::error::Error;

/// What is at the other end of the loop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Board {
    /// Nothing: PD control alone.
    None,
    /// A board that never learns.
    Frozen,
    /// A board with the firmware's configuration, everything switched on.
    Learning,
    /// The same, but its networks are not trained.
    NoNetwork,
}

/// Feed-forward error and tracking error of one second.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Second {
    /// Sums over the moving rows of each joint: squared error and squared torque, (N·m)².
    pub(super) error: [f64; N],
    pub(super) torque: [f64; N],
    pub(super) tracking: TrackingError<N>,
}

/// A look at the active set on the unseen path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Look {
    pub(super) t_s: f64,
    /// NRMSE of moving rows, ratio.
    pub(super) nrmse: f64,
    /// The error, in torque limits, over what the payload in the hand, or last in it, adds.
    pub(super) of_step: Option<f64>,
}

/// All that is kept of one run.
#[derive(Clone, Debug, Default)]
pub(super) struct Trace {
    pub(super) ticks: usize,
    pub(super) seconds: Vec<Second>,
    pub(super) looks: Vec<Look>,
    /// Change of the torque on the unseen path from before each pick to after the release, RMS ratio.
    pub(super) restored: Vec<f64>,
    /// Largest change of any parameter from one second after the stop to the end, in prior standard deviations.
    pub(super) drift: f64,
    pub(super) statistics: LearnerStatistics,
    /// What the guard decided: time, s, and the decision.
    pub(super) decisions: Vec<(f64, Decision)>,
    /// Of every payload, one second after it was picked: what the board believes, and the truth.
    pub(super) weighed: Vec<(PayloadEstimate, Payload)>,
    /// Standard deviations of mass, kg, and centre of mass, m, that the torque noise alone leaves then, and the truth.
    pub(super) weighable: Vec<(f64, f64, Payload)>,
    /// Lowest trust figure.
    pub(super) least_trust: f32,
    /// Ticks with each of these flags.
    pub(super) flags: Vec<(&'static str, u32)>,
    pub(super) late_sets: u32,
    /// Checksum (FNV-1a) of all torques, bit for bit.
    pub(super) checksum: u64,
    /// Whether torque left the board at the end.
    pub(super) safety: SafetyStatus,
    /// The sample that the board was armed with.
    pub(super) arming: Option<JointSample<N>>,
    /// The samples that went in and the torques that came out, where they were asked for.
    pub(super) tape: Vec<(Option<JointSample<N>>, [u32; N])>,
}

/// Flags that are counted.
const COUNTED: [(&str, Flags); 8] = [
    ("saturated", Flags::SATURATED),
    ("network_clipped", Flags::NETWORK_CLIPPED),
    ("learned_clipped", Flags::LEARNED_CLIPPED),
    ("stale", Flags::STALE_SAMPLE),
    ("share_fallback", Flags::SHARE_FALLBACK),
    ("not_finite", Flags::NOT_FINITE),
    ("set_late", Flags::SET_LATE),
    ("withdrawn", Flags::WITHDRAWN),
];

/// Time between two looks: at first, later on, and close to events, ticks.
const LOOK_FIRST: usize = 100;
const LOOK: usize = 500;
const LOOK_CLOSE: usize = 20;
/// The first part, and how long after an event it is still close, s.
const FIRST_S: f64 = 5.0;
const CLOSE_S: f64 = 2.6;
/// Rows this soon after a payload has changed are no row of a window, s.
pub(super) const PAYLOAD_GRACE_S: f64 = 2.5;
/// When a payload is weighed, after it was picked, s.
const WEIGHED_AFTER_S: f64 = 1.0;
/// When the torque is compared after a release, s.
const RESTORED_AFTER_S: f64 = 0.5;

/// What to run.
#[derive(Clone, Copy)]
pub(super) struct Run<'w> {
    pub(super) world: &'w World,
    pub(super) starts: &'w Starts,
    pub(super) scenario: &'w Scenario,
    pub(super) bandwidth_hz: f64,
    pub(super) board: Board,
    pub(super) quick: bool,
    /// Keep samples and torques.
    pub(super) tape: bool,
}

impl Run<'_> {
    /// Ticks it takes.
    pub(super) fn ticks(&self) -> usize {
        (self.scenario.length_s(self.quick) / PERIOD_S).round() as usize
    }

    /// Runs it.
    pub(super) fn trace(&self, progress: &dyn Fn(usize)) -> Result<Trace, Box<dyn Error>> {
        let Self {
            world, scenario, ..
        } = *self;
        let pd = world.pd(self.bandwidth_hz);
        let path = scenario.trajectory(world, self.quick);
        let events = scenario.events(world, self.quick);
        let plant = world.plant(scenario.plant, scenario.viscous, scenario.noise_stream())?;
        let mut plant = plant
            .with_events(events.clone())
            .with_faults(scenario.faults);
        let start = self.starts.set(scenario.start);
        let learning = matches!(self.board, Board::Learning | Board::NoNetwork);
        let mut config = scenario.start.config();
        if self.board == Board::NoNetwork {
            config.network.rate = 0.0;
        }
        let mut board = Controller::new(start, config, learning)?;
        let mut run = ClosedLoop::new(&mut plant, &pd, &path, PERIOD_S, None)?;
        let arming = board.arming_sample(motion_f32(&path.at(0.0)));
        board.arm(&arming).map_err(|reason| format!("{reason:?}"))?;
        let mut watch = Watch::new(self, events, &path, &plant);
        let mut acting = Joints::zeros();
        for tick in 0..self.ticks() {
            watch.look(tick, &board, &plant);
            watch.decisions(tick, &board);
            let (mut asked, mut torque) = (None, None);
            let Ok(record) = run.tick_with::<Infallible>(&mut plant, |sample| {
                asked = sample.copied();
                if self.board == Board::None {
                    return Ok(None);
                }
                torque = Some(board.tick(sample));
                Ok(torque.map(|torque| Answer {
                    total: torque.total,
                    shares: None,
                    flags: torque.flags.0,
                }))
            });
            let needed = plant.true_torque(&record.desired);
            watch.add(record.t_s, &record.desired.qd, &needed, &acting);
            watch.weigh(tick, &motion_f32(&record.desired));
            watch.track(record.t_s, &(record.desired.q - record.q));
            if let Some(torque) = torque {
                watch.count(torque.flags, &torque.total.into());
                if self.tape {
                    let bits = <[f32; N]>::from(torque.total).map(f32::to_bits);
                    watch.trace.tape.push((asked, bits));
                }
            }
            acting = record.feed_forward.cast();
            if tick % 1000 == 999 {
                progress(1000);
            }
        }
        watch.trace.arming = Some(arming);
        watch.trace.safety = board.safety();
        Ok(watch.finish(&board, &plant, self.ticks()))
    }
}

/// What watches a run.
struct Watch<'w> {
    world: &'w World,
    start: Start,
    events: Events<N>,
    still_s: f64,
    needed: Needed,
    /// Active set one second after the arm has come to rest.
    settled: Option<Set>,
    /// The second after the last pick, and the noise of a torque in units of its limit.
    bound: WeighingBound,
    noise: f64,
    /// What the set before the last pick says along the unseen path.
    before_pick: Option<Vec<Joints<N>>>,
    /// Decisions of the guard already written down.
    decided: u32,
    trace: Trace,
}

/// True torques along the unseen path, and what is in the hand adds to them.
struct Needed {
    torques: Vec<Joints<N>>,
    bare: Vec<Joints<N>>,
    valid_until_s: f64,
    carried: bool,
    step: Option<f64>,
}

impl<'w> Watch<'w> {
    fn new(run: &Run<'w>, events: Events<N>, path: &Trajectory<N>, plant: &Plant<N>) -> Self {
        let seconds = run.scenario.length_s(run.quick).ceil() as usize;
        let bare = run.world.needed(plant);
        Self {
            world: run.world,
            start: run.scenario.start,
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
            bound: WeighingBound::new(),
            noise: run.scenario.plant.torque_noise,
            before_pick: None,
            decided: 0,
            trace: Trace {
                seconds: vec![Second::default(); seconds],
                flags: COUNTED.iter().map(|(name, _)| (*name, 0)).collect(),
                least_trust: 1.0,
                checksum: 0xcbf2_9ce4_8422_2325,
                ..Trace::default()
            },
        }
    }

    /// Writes down what the guard has decided since the last tick.
    fn decisions(&mut self, tick: usize, board: &Controller) {
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

    /// Looks at the active set when it is time.
    fn look(&mut self, tick: usize, board: &Controller, plant: &Plant<N>) {
        let t_s = tick as f64 * PERIOD_S;
        let at = |time_s: f64| (time_s / PERIOD_S).round() as usize == tick;
        if at(self.still_s + 1.0) {
            self.settled = Some(board.active());
        }
        for payload in &self.events.payloads {
            if at(payload.from_s) {
                self.before_pick = Some(self.world.said(&board.active()));
            }
            if at(payload.from_s + WEIGHED_AFTER_S) {
                let believed = board.report().quality.payload;
                self.trace.weighed.push((believed, *payload));
            }
            if let Some(before) = &self.before_pick
                && at(payload.to_s + RESTORED_AFTER_S)
            {
                let now = self.world.said(&board.active());
                self.trace.restored.push(relative_change(before, &now));
            }
        }
        let close = self.close_to_event(t_s);
        let every = if close {
            LOOK_CLOSE
        } else if t_s < FIRST_S {
            LOOK_FIRST
        } else {
            LOOK
        };
        if tick.is_multiple_of(every) {
            self.needed.update(self.world, plant);
            let said = self.world.said(&board.active());
            let error = self.world.error(&said, &self.needed.torques);
            let of_step = self.needed.step.map(|step| {
                let missed = self.world.in_limits(&said, &self.needed.torques);
                missed / step
            });
            self.trace.looks.push(Look {
                t_s,
                nrmse: error.nrmse_moving(),
                of_step,
            });
        }
    }

    /// Follows what can be known of the payload in the first second after a pick.
    fn weigh(&mut self, tick: usize, motion: &JointMotion<N>) {
        let tick_of = |time_s: f64| (time_s / PERIOD_S).round() as usize;
        for payload in &self.events.payloads {
            let from = tick_of(payload.from_s);
            let to = tick_of(payload.from_s + WEIGHED_AFTER_S);
            if tick == from {
                self.bound = WeighingBound::new();
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
    fn add(&mut self, t_s: f64, qd: &Joints<N>, needed: &Joints<N>, acting: &Joints<N>) {
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

    fn track(&mut self, t_s: f64, distance: &Joints<N>) {
        if let Some(second) = self.trace.seconds.get_mut(t_s as usize) {
            second.tracking.add(distance);
        }
    }

    fn count(&mut self, flags: Flags, torque: &[f32; N]) {
        for ((_, count), (_, flag)) in self.trace.flags.iter_mut().zip(COUNTED) {
            *count += u32::from(flags.contains(flag));
        }
        for byte in torque.iter().flat_map(|tau| tau.to_bits().to_le_bytes()) {
            self.trace.checksum ^= u64::from(byte);
            self.trace.checksum = self.trace.checksum.wrapping_mul(0x100_0000_01b3);
        }
    }

    fn finish(mut self, board: &Controller, plant: &Plant<N>, ticks: usize) -> Trace {
        self.look(ticks, board, plant);
        if let Some(settled) = &self.settled {
            let sigma = Stacked::sigma(&self.start.config());
            let (before, after) = (Stacked::of(settled), Stacked::of(&board.active()));
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
    /// Takes the torques anew when a second has passed or the hand has picked or let go.
    fn update(&mut self, world: &World, plant: &Plant<N>) {
        let carried = plant.carried().is_some();
        let changed = carried != self.carried;
        if !changed && plant.t_s() < self.valid_until_s {
            return;
        }
        self.torques = world.needed(plant);
        if carried && changed {
            self.step = Some(world.in_limits(&self.torques, &self.bare));
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
