//! The one room where dynamics, network and learning meet.
//!
//! `tau = rigid(β) + friction(φ) + network(w)` of the *active* set for the *desired* motion, each share checked and
//! bounded on its own, then limits.

use crate::arm::{Arm, JointLimits};
use crate::dynamics::{friction, rnea};
use crate::joint::{JointMeasurement, JointMotion, JointSample, JointVector};
use crate::learning::{ConfigError, Exchange, Lesson, network_inputs};
use crate::limits::{Flags, cut, limit};
use core::marker::PhantomData;

pub use crate::learning::{JointNetwork, NETWORK_HIDDEN, NETWORK_INPUTS, ParameterSet};

/// Bound of the network share, in units of the joint's torque limit. Never optional.
pub const NETWORK_BOUND: f32 = 0.10;
/// Bound of all that was learnt since the committed set, in units of the joint's torque limit. Never optional.
pub const LEARNED_BOUND: f32 = 0.20;
/// A rigid-body share beyond this many torque limits is a fault of the parameters, not a demanding motion.
const RIGID_PLAUSIBLE: f32 = 10.0;
/// A friction share beyond this many torque limits is a fault of the parameters.
const FRICTION_PLAUSIBLE: f32 = 2.0;

/// The shares whose sum is the feed-forward torque, before limits. N × N·m each.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shares<const N: usize> {
    /// Rigid-body torque.
    pub rigid: JointVector<N>,
    /// Friction torque.
    pub friction: JointVector<N>,
    /// What the network adds, clipped.
    pub network: JointVector<N>,
}

impl<const N: usize> Shares<N> {
    /// No torque.
    pub fn zero() -> Self {
        Self {
            rigid: JointVector::zeros(),
            friction: JointVector::zeros(),
            network: JointVector::zeros(),
        }
    }

    /// Sum of the shares, N × N·m.
    pub fn total(&self) -> JointVector<N> {
        self.rigid + self.friction + self.network
    }
}

/// Output of one tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Torque<const N: usize> {
    /// The torque to add to the drives' set-points, after limits, N × N·m.
    pub total: JointVector<N>,
    /// Its shares, before limits.
    pub shares: Shares<N>,
    /// What happened.
    pub flags: Flags,
    /// Counter of the tick.
    pub tick: u32,
}

/// How the tick behaves; derived from the arm's limits and the period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FeedForwardConfig<const N: usize> {
    /// Limits of the joints; a desired motion outside them is cut to them, a torque too.
    pub limits: [JointLimits; N],
    /// Largest desired acceleration that is believed, rad/s²; beyond it the motion is cut.
    pub acceleration_limit: f32,
    /// Largest change of the torque in one tick, N × N·m.
    pub slew_per_tick: [f32; N],
    /// Ticks for which the torque is held when no usable sample comes; then it goes to zero at the slew limit.
    pub hold_ticks: u32,
}

/// Defaults of the tick: from zero to the torque limit in 20 ms, torque held for 10 ms without samples.
const SLEW_TIME_S: f32 = 0.02;
const HOLD_TIME_S: f32 = 0.01;
const ACCELERATION_LIMIT: f32 = 100.0;

impl<const N: usize> FeedForwardConfig<N> {
    /// Defaults for an arm: its data-sheet limits, the full torque in 20 ms, 10 ms of holding.
    ///
    /// * `period_s` period of the tick, s
    pub const fn for_arm<A: Arm<N, P>, const P: usize>(period_s: f32) -> Self {
        let mut slew_per_tick = [0.0; N];
        let mut joint = 0;
        while joint < N {
            slew_per_tick[joint] = A::LIMITS[joint].torque * period_s / SLEW_TIME_S;
            joint += 1;
        }
        Self {
            limits: A::LIMITS,
            acceleration_limit: ACCELERATION_LIMIT,
            slew_per_tick,
            // At least one tick: a single lost sample must not make the torque dip.
            hold_ticks: (HOLD_TIME_S / period_s) as u32 + 1,
        }
    }

    /// Every field is usable.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let limits = self.limits.iter();
        let torque = limits.clone().map(|l| ("limits.torque", l.torque));
        let velocity = limits.clone().map(|l| ("limits.velocity", l.velocity));
        let range = limits.map(|l| ("limits.position", l.position.1 - l.position.0));
        let slew = self.slew_per_tick.iter().map(|&s| ("slew_per_tick", s));
        let acceleration = [("acceleration_limit", self.acceleration_limit)];
        for (field, value) in torque
            .chain(velocity)
            .chain(range)
            .chain(slew)
            .chain(acceleration)
        {
            if !(value > 0.0 && value.is_finite()) {
                return Err(ConfigError::NotPositive(field));
            }
        }
        Ok(())
    }
}

/// What survives from tick to tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FeedForwardState<const N: usize, const P: usize> {
    /// The set the torque is computed from.
    pub active: ParameterSet<N, P>,
    /// The set that stands in for it: the one that was last loaded.
    pub committed: ParameterSet<N, P>,
    /// Counter of the tick to come.
    pub tick: u32,
    /// Learning is switched on.
    pub learning: bool,
    /// How often a set was not there when it was to be adopted.
    pub late_sets: u32,
    last: Torque<N>,
    stale_ticks: u32,
    loaded_at: u32,
    adoption: Flags,
}

impl<const N: usize, const P: usize> FeedForwardState<N, P> {
    /// At tick 0, torque zero, learning frozen, with `set` both active and committed.
    pub fn new(set: ParameterSet<N, P>) -> Self {
        Self {
            active: set,
            committed: set,
            tick: 0,
            learning: false,
            late_sets: 0,
            last: Torque {
                total: JointVector::zeros(),
                shares: Shares::zero(),
                flags: Flags::NONE,
                tick: 0,
            },
            stale_ticks: 0,
            loaded_at: 0,
            adoption: Flags::NONE,
        }
    }
}

/// Working memory of one tick: the shares by the active and by the committed set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FeedForwardScratch<const N: usize> {
    active: Shares<N>,
    committed: Shares<N>,
}

impl<const N: usize> FeedForwardScratch<N> {
    /// Room for one tick.
    pub fn new() -> Self {
        Self {
            active: Shares::zero(),
            committed: Shares::zero(),
        }
    }
}

impl<const N: usize> Default for FeedForwardScratch<N> {
    fn default() -> Self {
        Self::new()
    }
}

/// The feed-forward torque of one tick.
///
/// The desired motion is cut to the limits first. A desired motion that is not finite is no motion: the tick is then as
/// good as [`step_stale`]. Of each share of each joint the active set's value counts if it is finite and plausible, the
/// committed set's if not, and none if that is bad too. The sum may differ from the committed set's by `LEARNED_BOUND`,
/// and leaves through saturation and slew.
///
/// * returns N × N·m; finite for any bits in `sample` and in the parameter sets
///
/// Cost: both sets are evaluated in every tick, so that a fallback costs no more than its absence.
pub fn step<A: Arm<N, P>, const N: usize, const P: usize>(
    config: &FeedForwardConfig<N>,
    state: &mut FeedForwardState<N, P>,
    scratch: &mut FeedForwardScratch<N>,
    sample: &JointSample<N>,
) -> Torque<N> {
    let mut flags = Flags::when(sample.measured.is_none(), Flags::NO_MEASUREMENT);
    let Some(desired) = within_limits(config, &sample.desired, &mut flags) else {
        return hold(config, state, flags | Flags::NOT_FINITE);
    };
    let mut ignored = Flags::NONE;
    scratch.active = shares::<A, N, P>(&state.active, &desired, &mut flags);
    scratch.committed = shares::<A, N, P>(&state.committed, &desired, &mut ignored);
    let mut target = JointVector::<N>::zeros();
    let joints = config.limits.iter().zip(target.iter_mut());
    for (joint, (limits, target)) in joints.enumerate() {
        let bound = limits.torque;
        *target = select_joint(
            &mut scratch.active,
            &scratch.committed,
            joint,
            bound,
            &mut flags,
        );
    }
    state.stale_ticks = 0;
    finish(config, state, target, scratch.active, flags)
}

/// A tick without a sample: the torque is held for `hold_ticks`, then goes to zero at the slew limit.
pub fn step_stale<const N: usize, const P: usize>(
    config: &FeedForwardConfig<N>,
    state: &mut FeedForwardState<N, P>,
) -> Torque<N> {
    hold(config, state, Flags::NO_MEASUREMENT)
}

/// Shares and total of `set` for `motion`, without limits other than the network's bound, without state.
pub fn evaluate<A: Arm<N, P>, const N: usize, const P: usize>(
    set: &ParameterSet<N, P>,
    motion: &JointMotion<N>,
) -> Torque<N> {
    let mut flags = Flags::NONE;
    let shares = shares::<A, N, P>(set, motion, &mut flags);
    let total = shares.total();
    flags |= Flags::when(!total.iter().all(|tau| tau.is_finite()), Flags::NOT_FINITE);
    Torque {
        total,
        shares,
        flags,
        tick: 0,
    }
}

#[inline]
fn shares<A: Arm<N, P>, const N: usize, const P: usize>(
    set: &ParameterSet<N, P>,
    motion: &JointMotion<N>,
    flags: &mut Flags,
) -> Shares<N> {
    let mut network = JointVector::<N>::zeros();
    let joints = set.network.iter().zip(&A::LIMITS).zip(motion.qd.iter());
    for (share, ((net, limits), &qd)) in network.iter_mut().zip(joints) {
        let [[output]] = net.forward(&network_inputs(qd)).data.0;
        let (bounded, was_cut) = cut(output, NETWORK_BOUND);
        *share = bounded * limits.torque;
        *flags |= Flags::when(was_cut, Flags::NETWORK_CLIPPED);
    }
    Shares {
        rigid: rnea::<A, N, P>(&set.rigid, motion),
        friction: friction(&set.friction, &motion.qd),
        network,
    }
}

/// Makes every share of `joint` in `active` sound and returns their sum, bounded around the committed set's.
#[inline]
fn select_joint<const N: usize>(
    active: &mut Shares<N>,
    committed: &Shares<N>,
    joint: usize,
    torque_limit: f32,
    flags: &mut Flags,
) -> f32 {
    let shares = [
        (&mut active.rigid, &committed.rigid, RIGID_PLAUSIBLE),
        (
            &mut active.friction,
            &committed.friction,
            FRICTION_PLAUSIBLE,
        ),
        (&mut active.network, &committed.network, NETWORK_BOUND),
    ];
    let mut sum = 0.0;
    let mut reference = 0.0;
    for (active, committed, plausible) in shares {
        let (Some(active), Some(&committed)) = (active.get_mut(joint), committed.get(joint)) else {
            continue;
        };
        let bound = plausible * torque_limit;
        // A comparison with a not-a-number is false: it counts as implausible.
        let committed_sound = committed.abs() <= bound;
        let stand_in = if committed_sound { committed } else { 0.0 };
        let sound = active.abs() <= bound;
        if !sound {
            *flags |= Flags::when(!active.is_finite(), Flags::NOT_FINITE);
            *flags |= if committed_sound {
                Flags::SHARE_FALLBACK
            } else {
                Flags::WITHDRAWN
            };
            *active = stand_in;
        }
        sum += *active;
        // Without a sound committed share there is nothing to measure the learnt change against.
        reference += if committed_sound { committed } else { *active };
    }
    let (learned, was_cut) = cut(sum - reference, LEARNED_BOUND * torque_limit);
    *flags |= Flags::when(was_cut, Flags::LEARNED_CLIPPED);
    if was_cut { reference + learned } else { sum }
}

/// `motion` cut to the limits; `None` if a number in it is not finite.
#[inline]
fn within_limits<const N: usize>(
    config: &FeedForwardConfig<N>,
    motion: &JointMotion<N>,
    flags: &mut Flags,
) -> Option<JointMotion<N>> {
    let mut bounded = *motion;
    let joints = bounded
        .q
        .iter_mut()
        .zip(bounded.qd.iter_mut())
        .zip(bounded.qdd.iter_mut());
    for (limits, ((q, qd), qdd)) in config.limits.iter().zip(joints) {
        if !(q.is_finite() && qd.is_finite() && qdd.is_finite()) {
            return None;
        }
        let (lower, upper) = limits.position;
        let inside = if *q > upper {
            upper
        } else if *q < lower {
            lower
        } else {
            *q
        };
        let (velocity, fast) = cut(*qd, limits.velocity);
        let (acceleration, abrupt) = cut(*qdd, config.acceleration_limit);
        *flags |= Flags::when(inside != *q || fast || abrupt, Flags::DESIRED_CLAMPED);
        (*q, *qd, *qdd) = (inside, velocity, acceleration);
    }
    Some(bounded)
}

fn hold<const N: usize, const P: usize>(
    config: &FeedForwardConfig<N>,
    state: &mut FeedForwardState<N, P>,
    flags: Flags,
) -> Torque<N> {
    let flags = flags | Flags::STALE_SAMPLE;
    let last = state.last;
    if state.stale_ticks < config.hold_ticks {
        state.stale_ticks += 1;
        return finish(config, state, last.total, last.shares, flags);
    }
    finish(
        config,
        state,
        JointVector::zeros(),
        Shares::zero(),
        flags | Flags::WITHDRAWN,
    )
}

/// Limits, flags of the state, and the step of the counter.
#[inline]
fn finish<const N: usize, const P: usize>(
    config: &FeedForwardConfig<N>,
    state: &mut FeedForwardState<N, P>,
    target: JointVector<N>,
    shares: Shares<N>,
    flags: Flags,
) -> Torque<N> {
    let mut flags = flags | state.adoption | Flags::when(state.learning, Flags::LEARNING_ON);
    let mut total = state.last.total;
    let bounds = config.limits.iter().zip(&config.slew_per_tick);
    for ((total, &target), (limits, &slew)) in total.iter_mut().zip(target.iter()).zip(bounds) {
        let (torque, limited) = limit(target, *total, limits.torque, slew);
        *total = torque;
        flags |= limited;
    }
    state.last = Torque {
        total,
        shares,
        flags,
        tick: state.tick,
    };
    state.adoption = Flags::NONE;
    state.tick = state.tick.wrapping_add(1);
    state.last
}

/// Takes a finished set from the desk, if the tick to come is one at which sets are taken: `tick % N == N / 2`.
///
/// The round of `N` ticks that ended `N / 2 + 1` ticks before is due then. A set of an earlier round, or none while
/// learning is on, counts as late; what was published before the last [`FeedForward::load`] is dropped.
pub fn adopt<const N: usize, const P: usize>(
    state: &mut FeedForwardState<N, P>,
    exchange: &mut Exchange<N, P>,
) {
    let rounds = N as u32;
    if state.tick % rounds != rounds / 2 {
        return;
    }
    let due = state.tick.wrapping_sub(rounds / 2 + 1);
    // The first round after a start or a load may be cut short, so nothing is due from it.
    let expected = state.learning && state.tick.wrapping_sub(state.loaded_at) >= 2 * rounds;
    match exchange.published.take() {
        Some((closed, set)) if closed.wrapping_sub(state.loaded_at) < u32::MAX / 2 => {
            state.active = set;
            state.adoption |= Flags::SET_ADOPTED;
            if closed != due {
                state.adoption |= Flags::SET_LATE;
                state.late_sets = state.late_sets.saturating_add(1);
            }
        }
        _ if expected => {
            state.adoption |= Flags::SET_LATE;
            state.late_sets = state.late_sets.saturating_add(1);
        }
        _ => {}
    }
}

/// The feed-forward of one arm: configuration, state and scratch in one place.
pub struct FeedForward<A: Arm<N, P>, const N: usize, const P: usize> {
    config: FeedForwardConfig<N>,
    state: FeedForwardState<N, P>,
    scratch: FeedForwardScratch<N>,
    arm: PhantomData<A>,
}

impl<A: Arm<N, P>, const N: usize, const P: usize> FeedForward<A, N, P> {
    /// A feed-forward at tick 0, learning frozen, with `set` active and committed.
    ///
    /// Errors: the first field of `config` that cannot work.
    pub fn new(config: FeedForwardConfig<N>, set: ParameterSet<N, P>) -> Result<Self, ConfigError> {
        config.validate()?;
        Ok(Self {
            config,
            state: FeedForwardState::new(set),
            scratch: FeedForwardScratch::new(),
            arm: PhantomData,
        })
    }

    /// The torque of one tick; see [`step`].
    pub fn step(&mut self, sample: &JointSample<N>) -> Torque<N> {
        step::<A, N, P>(&self.config, &mut self.state, &mut self.scratch, sample)
    }

    /// A tick without a sample; see [`step_stale`].
    pub fn step_stale(&mut self) -> Torque<N> {
        step_stale(&self.config, &mut self.state)
    }

    /// The lesson of the tick that has just run; to be called once after every step.
    pub fn lesson(&self, measured: Option<JointMeasurement<N>>) -> Lesson<N> {
        Lesson {
            tick: self.state.last.tick,
            measured,
            enabled: self.state.learning,
        }
    }

    /// Takes a finished set from the desk; to be called before every step. See [`adopt`].
    pub fn adopt(&mut self, exchange: &mut Exchange<N, P>) {
        adopt(&mut self.state, exchange);
    }

    /// Makes `set` active and committed from the next tick on, and sends it to the learner.
    pub fn load(&mut self, set: ParameterSet<N, P>, exchange: &mut Exchange<N, P>) {
        self.state.active = set;
        self.state.committed = set;
        self.state.loaded_at = self.state.tick;
        exchange.published = None;
        exchange.reload = Some((self.state.tick, set));
    }

    /// Switches learning on or off (frozen) from the next tick on.
    pub fn set_learning(&mut self, enabled: bool) {
        self.state.learning = enabled;
    }

    /// What survives from tick to tick: active and committed set, counters.
    pub fn state(&self) -> &FeedForwardState<N, P> {
        &self.state
    }

    /// How the tick behaves.
    pub fn config(&self) -> &FeedForwardConfig<N> {
        &self.config
    }
}
