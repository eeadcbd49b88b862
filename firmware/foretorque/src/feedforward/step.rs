use super::model::{AtSpeed, TickMotion};
use super::shares::{Shares, select};
use super::state::{Committing, FeedForwardState};
use super::{FeedForwardConfig, Torque};
use crate::arm::Arm;
use crate::dynamics::{Pose, cogging, rnea_of};
use crate::joint::{JointSample, JointVector};
use crate::learning::{Exchange, LearningSample};
use crate::limits::{Flags, cut, limit};

/// Working memory of one tick: the motion, and what rigid bodies need for it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FeedForwardScratch<const N: usize> {
    motion: TickMotion<N>,
    pose: Pose<N>,
    /// Torques of the loaded set and of the payload for the motion as it is wanted, N × N·m each.
    wanted: [JointVector<N>; 2],
    /// Torques of what the active and the committed set have learnt, for the motion that was learnt, N × N·m each.
    learnt: [JointVector<N>; 2],
    /// Torque before saturation and slew, N × N·m.
    sum: JointVector<N>,
}

impl<const N: usize> FeedForwardScratch<N> {
    /// Working memory of one tick.
    pub fn new() -> Self {
        Self {
            motion: TickMotion::zero(),
            pose: Pose::UPRIGHT,
            wanted: [JointVector::zeros(); 2],
            learnt: [JointVector::zeros(); 2],
            sum: JointVector::zeros(),
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
/// committed set's if not, and none if that is bad too. What was learnt since the set was loaded is evaluated for the
/// motion it was learnt on: beyond, it stays what it was at the edge. The sum may differ from the committed set's by
/// `LEARNED_BOUND`, the payload by a bound of its own comes on top, and both together change by no more than
/// `learned_slew_per_tick`, whatever is adopted and whatever the motion. After a commit the torque goes over to the new set by
/// these steps. The rest is saturation and slew.
///
/// * returns N × N·m; finite for any bits in `sample` and in the parameter sets
///
/// Cost: all sets are evaluated in every tick, so that a fallback costs no more than its absence: the motion of the links
/// and the gravity torques twice, the wrenches four times, all networks twice.
#[inline(never)]
pub fn step<'a, A: Arm<N, P>, const N: usize, const P: usize>(
    config: &FeedForwardConfig<N>,
    state: &'a mut FeedForwardState<N, P>,
    scratch: &mut FeedForwardScratch<N>,
    sample: &JointSample<N>,
) -> &'a Torque<N> {
    if state.committing == Committing::Copy {
        state.commit();
    }
    let mut flags = Flags::when(sample.measured.is_none(), Flags::NO_MEASUREMENT);
    let motion = &mut scratch.motion;
    if !motion.take(config, &state.range, &sample.desired, &mut flags) {
        return hold(config, state, flags | Flags::NOT_FINITE);
    }
    let pose = &mut scratch.pose;
    if !pose.take::<A, P>(&motion.desired.q) {
        return hold(config, state, flags | Flags::NOT_FINITE);
    }
    let loaded = [&state.loaded.rigid, &state.payload];
    rnea_of::<A, N, P, 2>(loaded, &pose.angles, &motion.desired, &mut scratch.wanted);
    let learnt = [
        &state.active_difference.rigid,
        &state.committed_difference.rigid,
    ];
    rnea_of::<A, N, P, 2>(learnt, &pose.angles, &motion.bounded, &mut scratch.learnt);
    let fresh = core::mem::take(&mut state.fresh);
    let mut ignored = Flags::NONE;
    for joint in 0..N {
        let [loaded, payload] = [scratch.wanted[0][joint], scratch.wanted[1][joint]];
        let [active, committed] = [scratch.learnt[0][joint], scratch.learnt[1][joint]];
        let (limit, arm_limit) = (config.limits[joint].torque, A::limits()[joint].torque);
        let (q, qd) = (motion.desired.q[joint], motion.desired.qd[joint]);
        let cogging = cogging(A::cogging_cycles()[joint], q);
        let load = pose.load[joint];
        let desired = AtSpeed::new(qd, cogging, load);
        let bounded = state.range.cut(joint, qd, load, &desired);
        let speeds = [&desired, &bounded];
        let friction = desired.friction(&state.loaded.friction[joint]);
        let active = state.active_difference.shares(
            joint,
            [loaded, friction, active],
            &state.active.network[joint],
            speeds,
            arm_limit,
            &mut flags,
        );
        let committed = state.committed_difference.shares(
            joint,
            [loaded, friction, committed],
            &state.committed.network[joint],
            speeds,
            arm_limit,
            &mut ignored,
        );
        let selected = select(&active, &committed, [arm_limit, limit], &mut flags);

        let (mut carried, was_cut) = cut(payload, config.payload_bound[joint]);
        if was_cut || payload.is_nan() {
            flags |= Flags::PAYLOAD_CLIPPED;
            carried = if payload.is_finite() { carried } else { 0.0 };
        }
        state.payload_torque[joint] = carried;
        let wanted = selected.learned + carried;
        let before = if fresh { wanted } else { state.learned[joint] };
        let (step, slewed) = cut(wanted - before, config.learned_slew_per_tick[joint]);
        let learned = if slewed { before + step } else { wanted };
        state.learned[joint] = learned;
        scratch.sum[joint] = selected.reference + learned;
        let shares = &mut state.last.shares;
        shares.rigid[joint] = selected.shares.rigid + carried;
        shares.friction[joint] = selected.shares.friction;
        shares.network[joint] = selected.shares.network;
    }
    if state.committing == Committing::Compare && flags.contains(Flags::SHARE_FALLBACK) {
        // The active set needs the committed one.
        state.committing = Committing::No;
    } else if state.committing == Committing::Compare {
        // The next tick measures from the active set, and the torque goes on from where it is: both of one motion.
        let active = state.last.shares.total() - state.payload_torque;
        state.learned = scratch.sum - active;
        state.committing = Committing::Copy;
    }
    state.stale_ticks = 0;
    flags |= output(config, &mut state.last, &scratch.sum);
    finish(state, flags)
}

/// A tick without a sample: the torque is held for `hold_ticks`, then goes to zero at the slew limit.
pub fn step_stale<'a, const N: usize, const P: usize>(
    config: &FeedForwardConfig<N>,
    state: &'a mut FeedForwardState<N, P>,
) -> &'a Torque<N> {
    hold(config, state, Flags::NO_MEASUREMENT)
}

/// A period without a tick, because samples pace the board and none came: torque and flags as those of [`step_stale`]. The
/// counter stays where it is.
pub fn pause<'a, const N: usize, const P: usize>(
    config: &FeedForwardConfig<N>,
    state: &'a mut FeedForwardState<N, P>,
) -> &'a Torque<N> {
    let kept = (state.tick, state.adoption, state.off_ticks);
    hold(config, state, Flags::NO_MEASUREMENT);
    (state.tick, state.adoption, state.off_ticks) = kept;
    &state.last
}

fn hold<'a, const N: usize, const P: usize>(
    config: &FeedForwardConfig<N>,
    state: &'a mut FeedForwardState<N, P>,
    flags: Flags,
) -> &'a Torque<N> {
    let flags = flags | Flags::STALE_SAMPLE;
    let (target, withdrawn) = if state.stale_ticks < config.hold_ticks {
        state.stale_ticks += 1;
        (state.last.total, Flags::NONE)
    } else {
        state.last.shares = Shares::zero();
        state.fresh = true;
        (JointVector::zeros(), Flags::WITHDRAWN)
    };
    let limited = output(config, &mut state.last, &target);
    finish(state, flags | withdrawn | limited)
}

/// Moves the torque that was `last` to `target`, N × N·m, within its limits.
#[inline]
fn output<const N: usize>(
    config: &FeedForwardConfig<N>,
    last: &mut Torque<N>,
    target: &JointVector<N>,
) -> Flags {
    let mut flags = Flags::NONE;
    for joint in 0..N {
        let (torque, limited) = limit(
            target[joint],
            last.total[joint],
            config.limits[joint].torque,
            config.slew_per_tick[joint],
        );
        last.total[joint] = torque;
        flags |= limited;
    }
    flags
}

/// Flags of the state, and the step of the counter.
#[inline]
fn finish<const N: usize, const P: usize>(
    state: &mut FeedForwardState<N, P>,
    flags: Flags,
) -> &Torque<N> {
    state.last.flags = flags | state.adoption | Flags::when(state.learning, Flags::LEARNING_ON);
    state.last.tick = state.tick;
    state.adoption = Flags::NONE;
    state.off_ticks = state.off_ticks.saturating_sub(1);
    state.tick = LearningSample::<N>::tick_after(state.tick);
    &state.last
}

/// Adopts a published set if the tick to come is one at which sets are adopted: `tick % N == N / 2`.
///
/// The round of `N` ticks that ended `N / 2 + 1` ticks before is due then. A set of an earlier round, or none while
/// learning is on, counts as late; what was learnt from another set than the one loaded last is dropped.
#[inline(never)]
pub fn adopt<const N: usize, const P: usize>(
    state: &mut FeedForwardState<N, P>,
    exchange: &mut Exchange<N, P>,
) {
    if state.committing == Committing::Copy {
        state.commit();
    }
    let rounds = N as u32;
    if state.tick % rounds != rounds / 2 {
        return;
    }
    let due = state.tick.checked_sub(rounds / 2 + 1);
    let due = due.unwrap_or(LearningSample::<N>::LAST_TICK);
    // Nothing is due from a round that was cut short by a start or a load.
    let whole = state.rounds_without_set == 0 && due % rounds == rounds - 1;
    state.rounds_without_set = state.rounds_without_set.saturating_sub(1);
    let expected = state.learning && whole;
    match &exchange.published {
        // Equal, not later: ticks half the range of their counter apart have no order.
        Some(finished) if finished.generation == state.generation => {
            if state.committing == Committing::Compare {
                // A round without a usable sample: nothing goes on from the tick before it.
                state.commit();
                state.fresh = true;
            }
            state.set_active(&finished.set, &finished.share);
            state.committing = match finished.commit {
                true => Committing::Compare,
                false => Committing::No,
            };
            state.payload = finished.payload;
            state.range.set(&finished.range);
            state.report = finished.report;
            state.adoption |= Flags::SET_ADOPTED;
            if finished.closed != due {
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
    exchange.published = None;
}
