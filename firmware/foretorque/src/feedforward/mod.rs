//! The tick: rigid body, friction and network in one bounded torque.
//!
//! `tau = rigid(β) + friction(φ) + network(w)` of the *active* set for the *desired* motion, each share checked and
//! bounded on its own, then limits.

mod model;
mod shares;
mod state;
mod step;

#[cfg(test)]
mod simulation;
#[cfg(test)]
mod tests;

pub use crate::learning::{
    JointNetwork, NETWORK_BOUND, NETWORK_HIDDEN, NETWORK_INPUTS, ParameterSet,
};
pub use shares::{LEARNED_BOUND, Shares, evaluate};
pub use state::FeedForwardState;
pub use step::{FeedForwardScratch, adopt, pause, step, step_stale};

use crate::arm::{Arm, JointLimits};
use crate::joint::{JointMeasurement, JointSample, JointVector};
use crate::learning::{
    ConfigError, Exchange, LearningSample, MAX_BRIDGED, PAYLOAD_PART, Request, RequestPending,
    StartDeviations, check_positive, payload_bound,
};
use crate::limits::{Flags, cut};
use core::marker::PhantomData;

/// How the tick behaves; derived from the arm's limits and the period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FeedForwardConfig<const N: usize> {
    /// Limits of the joints; a desired motion outside them is cut to them, a torque too. Torques up to 3e36 N·m;
    /// no check here compares them with those of the arm.
    pub limits: [JointLimits; N],
    /// Largest plausible desired acceleration, rad/s²; beyond it the motion is cut.
    pub acceleration_limit: f32,
    /// Largest change of the torque in one tick, N × N·m.
    pub slew_per_tick: [f32; N],
    /// Largest torque of a payload, N × N·m.
    pub payload_bound: [f32; N],
    /// Largest change in one tick of all that was learnt since the committed set, the payload included, N × N·m.
    pub learned_slew_per_tick: [f32; N],
    /// Ticks for which the torque is held when no usable sample comes; then it goes to zero at the slew limit.
    pub hold_ticks: u32,
}

/// Defaults of the tick: from zero to the torque limit in 20 ms, torque held for 10 ms without samples.
const SLEW_TIME_S: f32 = 0.02;
const HOLD_TIME_US: u32 = 10_000;
const ACCELERATION_LIMIT: f32 = 100.0;
/// Fastest change of what was learnt, torque limits a second.
const LEARNED_RATE: f32 = 10.0;

impl<const N: usize> FeedForwardConfig<N> {
    /// Defaults for an arm: its data-sheet limits, the full torque in 20 ms, 10 ms of holding.
    ///
    /// * `period_s` period of the tick, s, up to 20 ms; a longer one has no slew limit. The learner refuses more than 0.1 s
    pub fn for_arm<A: Arm<N, P>, const P: usize>(period_s: f32) -> Self {
        let torques = A::limits().map(|limits| limits.torque);
        Self {
            limits: *A::limits(),
            acceleration_limit: ACCELERATION_LIMIT,
            slew_per_tick: torques.map(|torque| torque * period_s / SLEW_TIME_S),
            payload_bound: payload_bound::<A, N, P>(),
            learned_slew_per_tick: torques.map(|torque| torque * LEARNED_RATE * period_s),
            // At least one tick: a single lost sample must not make the torque dip.
            hold_ticks: HOLD_TIME_US / whole_us(period_s) + 1,
        }
    }

    /// Lower the torque limit of `joint`, counted from 0, to `torque`, N·m, with the bounds of payload and learnt change that
    /// follow from it. A higher limit, or a joint that the arm has not, changes nothing.
    #[inline(never)]
    pub fn limit_torque(&mut self, joint: usize, torque: f32) {
        let limits = self.limits.get_mut(joint);
        let Some(limits) = limits.filter(|limits| torque < limits.torque) else {
            return;
        };
        self.learned_slew_per_tick[joint] *= torque / limits.torque;
        self.payload_bound[joint] = self.payload_bound[joint].min(PAYLOAD_PART * torque);
        limits.torque = torque;
    }

    /// Every field is usable.
    pub fn validate(&self) -> Result<(), ConfigError> {
        check_positive(&[("acceleration_limit", self.acceleration_limit)])?;
        for joint in 0..N {
            let limits = &self.limits[joint];
            check_positive(&[
                ("limits.torque", limits.torque),
                ("limits.velocity", limits.velocity),
                ("limits.position", limits.position.1 - limits.position.0),
                ("slew_per_tick", self.slew_per_tick[joint]),
                ("payload_bound", self.payload_bound[joint]),
                ("learned_slew_per_tick", self.learned_slew_per_tick[joint]),
            ])?;
            if limits.torque > LARGEST_TORQUE {
                return Err(ConfigError::TooLarge("limits.torque"));
            }
        }
        Ok(())
    }
}

/// Largest torque limit, N·m: up to it the sums of plausible shares are finite.
const LARGEST_TORQUE: f32 = f32::MAX / 100.0;

/// `period_s`, s, in whole µs, at least 1: a quotient of seconds in f32 may lack its last tick.
const fn whole_us(period_s: f32) -> u32 {
    let us = (period_s * 1e6 + 0.5) as u32;
    if us == 0 { 1 } else { us }
}

/// Output of one tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Torque<const N: usize> {
    /// The torque to add to the drives' set-points, after limits, N × N·m.
    pub total: JointVector<N>,
    /// Its shares, before limits.
    pub shares: Shares<N>,
    /// Flags of the tick.
    pub flags: Flags,
    /// Counter of the tick.
    pub tick: u32,
}

impl<const N: usize> Torque<N> {
    fn zero() -> Self {
        Self {
            total: JointVector::zeros(),
            shares: Shares::zero(),
            flags: Flags::NONE,
            tick: 0,
        }
    }
}

/// The feed-forward of one arm: configuration, state and scratch in one place.
///
/// One tick; the example of the [crate] has the learner beside it.
/// ```
/// use foretorque::arm::ur5::{FeedForward, ParameterSet, Ur5};
/// use foretorque::feedforward::FeedForwardConfig;
/// use foretorque::joint::{JointMotion, JointSample};
///
/// let config = FeedForwardConfig::for_arm::<Ur5, _>(1e-3);
/// let mut feedforward = FeedForward::new(config, ParameterSet::nominal::<Ur5>(1))?;
/// let torque = feedforward.step(&JointSample { desired: JointMotion::zero(), measured: None });
///
/// // At q = 0 the arm lies stretched out: the shoulder holds it up, from rest by the slew limit.
/// assert!(torque.shares.rigid[1].abs() > 30.0);
/// assert_eq!(torque.total[1].abs(), feedforward.config().slew_per_tick[1]);
/// # Ok::<(), foretorque::learning::ConfigError>(())
/// ```
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
        *step::<A, N, P>(&self.config, &mut self.state, &mut self.scratch, sample)
    }

    /// Part of the last torque that the committed set does not give, N × N·m: what was learnt since the last commit or load,
    /// and the payload.
    pub fn learnt_torque(&self) -> &JointVector<N> {
        &self.state.learned
    }

    /// Sets the torque that the drives got, N × N·m: the next tick slews from there. A torque that was held back does
    /// not come all at once when it is released. It is cut to the torque limit; one that is not finite counts as 0.
    #[inline(never)]
    pub fn applied(&mut self, total: &JointVector<N>) {
        for joint in 0..N {
            let torque = if total[joint].is_finite() {
                total[joint]
            } else {
                0.0
            };
            self.state.last.total[joint] = cut(torque, self.config.limits[joint].torque).0;
        }
    }

    /// [`applied`](Self::applied) without its check: `total` is finite and within the torque limits of the arm, as that of
    /// the safety state machine is in every tick.
    #[doc(hidden)]
    pub fn applied_within_limits(&mut self, total: &JointVector<N>) {
        self.state.last.total = *total;
    }

    /// A tick without a sample; see [`step_stale`].
    pub fn step_stale(&mut self) -> Torque<N> {
        *step_stale(&self.config, &mut self.state)
    }

    /// A period in which no tick runs; see [`pause`].
    pub fn pause(&mut self) -> Torque<N> {
        *pause(&self.config, &mut self.state)
    }

    /// Takes periods in which neither tick nor pause ran: they count for the time for which a torque without samples is held.
    pub fn miss(&mut self, periods: u32) {
        self.state.stale_ticks = self.state.stale_ticks.saturating_add(periods);
    }

    /// Leaves out the numbers of ticks that did not run, so that the learner sees a gap; of a long one as many as it can
    /// bridge, and one more.
    pub fn skip(&mut self, ticks: u32) {
        let ticks = ticks.min(MAX_BRIDGED as u32 + 1);
        let tick = &mut self.state.tick;
        let left = LearningSample::<N>::LAST_TICK - *tick;
        *tick = match ticks.checked_sub(left) {
            None | Some(0) => *tick + ticks,
            Some(beyond) => beyond - 1,
        };
    }

    /// Learning sample of the tick that has just run; to be called once after every step.
    pub fn learning_sample(&self, measured: Option<JointMeasurement<N>>) -> LearningSample<N> {
        LearningSample {
            tick: self.state.last.tick,
            generation: self.state.generation,
            requests: self.state.requests,
            measured,
            enabled: self.state.learning && self.state.off_ticks == 0,
            flags: self.state.last.flags,
        }
    }

    /// Asks the learner for `request`, from the tick to come on. What came of it is among the decisions of
    /// [`FeedForwardState::report`], two rounds later.
    ///
    /// Errors: the request before has not been taken yet; it stays.
    pub fn request(
        &mut self,
        request: Request,
        exchange: &mut Exchange<N, P>,
    ) -> Result<(), RequestPending> {
        let number = self.state.requests.wrapping_add(1);
        exchange.post_request(number, request)?;
        self.state.requests = number;
        Ok(())
    }

    /// Asks the learner for `request` in place of one that still waits.
    pub fn request_over(&mut self, request: Request, exchange: &mut Exchange<N, P>) {
        self.state.requests = self.state.requests.wrapping_add(1);
        exchange.request = Some((self.state.requests, request));
    }

    /// Adopts a published set; to be called before every step. See [`adopt`].
    pub fn adopt(&mut self, exchange: &mut Exchange<N, P>) {
        adopt(&mut self.state, exchange);
    }

    /// Make `set` active and committed from the next tick on, and send it to the learner with prior deviations.
    pub fn load(&mut self, set: ParameterSet<N, P>, exchange: &mut Exchange<N, P>) {
        self.load_with(set, StartDeviations::PRIOR, exchange);
    }

    /// [`load`](Self::load) with the deviations of the set, from which learning starts.
    pub fn load_with(
        &mut self,
        set: ParameterSet<N, P>,
        start: StartDeviations<N, P>,
        exchange: &mut Exchange<N, P>,
    ) {
        self.state.load(&set);
        exchange.published = None;
        exchange.reload = Some((self.state.generation, set, start));
    }

    /// Replaces the configuration from the next tick on; the state stays. A torque beyond a lower limit goes there at the
    /// slew limit.
    ///
    /// Errors: the first field of `config` that cannot work; then nothing has changed.
    pub fn configure(&mut self, config: FeedForwardConfig<N>) -> Result<(), ConfigError> {
        config.validate()?;
        self.config = config;
        Ok(())
    }

    /// Starts over at tick 0 with `set`, as [`new`](Self::new) does. What the learner learnt before is dropped; it has to
    /// be restarted too.
    ///
    /// Errors: the first field of `config` that cannot work; then nothing has changed.
    #[inline(never)]
    pub fn restart(
        &mut self,
        config: FeedForwardConfig<N>,
        set: &ParameterSet<N, P>,
    ) -> Result<(), ConfigError> {
        self.configure(config)?;
        self.state.restart(set);
        Ok(())
    }

    /// Switches learning on or off (frozen) from the next tick on. The learner receives an end in one sample at least, also if
    /// learning is on again before the next tick.
    pub fn set_learning(&mut self, enabled: bool) {
        if !enabled {
            // The end of the next tick takes one; its sample comes after that and has the other.
            self.state.off_ticks = 2;
        }
        self.state.learning = enabled;
    }

    /// State between ticks: active and committed set, counters.
    pub fn state(&self) -> &FeedForwardState<N, P> {
        &self.state
    }

    /// The active set with what the payload adds to it: the parameters the torque is computed from.
    pub fn in_force(&self) -> ParameterSet<N, P> {
        let mut set = self.state.active;
        set.rigid += self.state.payload;
        set
    }

    /// How the tick behaves.
    pub fn config(&self) -> &FeedForwardConfig<N> {
        &self.config
    }
}
