//! The tick, without learning: shares, limits, fallbacks, adoption.

use super::*;
use crate::arm::ur5::Ur5;
use crate::dynamics::{
    BaseParameters, FrictionColumn, FrictionParameters, friction_load, friction_row,
};
use crate::joint::JointMotion;
use crate::learning::{LearnerReport, LearntShare, MotionRange, Publication};
use crate::sines;

mod adoption;
mod limits;

const N: usize = 6;
const P: usize = 40;
type Tick = FeedForward<Ur5, N, P>;
type Set = ParameterSet<N, P>;

/// Everything the arm can do has been learnt.
const WIDE: MotionRange<N> = MotionRange {
    velocity: [1e3; N],
    acceleration: [1e3; N],
};

fn set() -> Set {
    let mut set = Set::nominal::<Ur5>(3);
    for (joint, friction) in set.friction.iter_mut().enumerate() {
        *friction = FrictionParameters::NONE
            .with(FrictionColumn::Viscous, 1.0 + joint as f32)
            .with(FrictionColumn::Coulomb, 0.5)
            .with(FrictionColumn::Load, 0.05);
    }
    set
}

fn finished(closed: u32, set: Set) -> Publication<N, P> {
    Publication {
        closed,
        generation: 0,
        set,
        share: LearntShare::FULL,
        payload: BaseParameters::zeros(),
        range: MotionRange::NONE,
        commit: false,
        report: LearnerReport::new(),
    }
}

fn tick(set: Set) -> Tick {
    Tick::new(FeedForwardConfig::for_arm::<Ur5, P>(1e-3), set).unwrap()
}

fn motion(phase: f32) -> JointMotion<N> {
    sines(f64::from(phase), |j| [1.0, 1.0, j as f64])
}

fn sample(desired: JointMotion<N>) -> JointSample<N> {
    JointSample {
        desired,
        measured: None,
    }
}

/// A tick with `learnt` in the torque, whose loaded set is [`set`].
fn learnt_tick(learnt: &Set) -> Tick {
    let mut tick = tick(set());
    tick.state.set_active(learnt, &LearntShare::FULL);
    tick.state.range.set(&WIDE);
    tick
}

/// The torque of `tick` for a motion that has been asked for long enough to be past the slew limit.
fn settled(tick: &mut Tick, motion: &JointMotion<N>) -> Torque<N> {
    for _ in 0..40 {
        tick.step(&sample(*motion));
    }
    tick.step(&sample(*motion))
}

#[test]
fn a_configuration_that_cannot_work_is_refused() {
    let checked = |change: fn(&mut FeedForwardConfig<N>)| {
        let mut config = FeedForwardConfig::for_arm::<Ur5, P>(1e-3);
        change(&mut config);
        assert_eq!(Tick::new(config, set()).is_ok(), config.validate().is_ok());
        config.validate()
    };
    let refused = |field| Err(ConfigError::NotPositive(field));
    assert_eq!(checked(|_| ()), Ok(()));
    let slew = checked(|config| config.slew_per_tick[3] = f32::NAN);
    assert_eq!(slew, refused("slew_per_tick"));
    let range = checked(|config| config.limits[0].position = (1.0, -1.0));
    assert_eq!(range, refused("limits.position"));
    let torque = checked(|config| config.limits[2].torque = f32::MAX);
    assert_eq!(torque, Err(ConfigError::TooLarge("limits.torque")));
}

#[test]
fn the_settled_torque_is_the_sum_of_the_evaluated_shares() {
    let motion = motion(0.3);
    let mut set = set();
    set.network[2].output_bias[0] = 0.05;
    let torque = settled(&mut tick(set), &motion);
    let evaluated = evaluate::<Ur5, N, P>(&set, &motion);
    assert!(evaluated.shares.network[2].abs() > 1.0);
    assert_eq!(torque.shares, evaluated.shares);
    assert_eq!(torque.total, evaluated.total);
    assert_eq!(torque.flags, Flags::NO_MEASUREMENT);
    assert!(torque.shares.rigid.amax() > 10.0 && torque.shares.friction.amax() > 1.0);
}

#[test]
fn the_friction_share_sums_every_column_of_the_loaded_and_of_the_learned_set() {
    let motion = motion(0.3);
    let rows = core::array::from_fn::<_, N, _>(|joint| {
        let load = friction_load::<Ur5, N, P>(&motion.q);
        let (q, qd) = (motion.q[joint], motion.qd[joint]);
        friction_row(Ur5::COGGING_CYCLES[joint], q, qd, load[joint])
    });
    let drives = |scale: f32| -> [FrictionParameters; N] {
        core::array::from_fn(|joint| {
            FrictionParameters(core::array::from_fn(|k| {
                scale * (0.1 + 0.05 * k as f32) * if (k + joint) % 3 == 0 { -1.0 } else { 1.0 }
            }))
        })
    };
    let wanted = |drives: &[FrictionParameters; N], joint: usize| -> f64 {
        let terms = rows[joint].iter().zip(&drives[joint].0);
        terms.map(|(&x, &p)| f64::from(x) * f64::from(p)).sum()
    };
    let loaded = Set {
        friction: drives(1.0),
        ..set()
    };
    let learned = Set {
        friction: drives(1.5),
        ..set()
    };
    let mut tick = tick(loaded);
    let share = settled(&mut tick, &motion).shares.friction;
    tick.state.set_active(&learned, &LearntShare::FULL);
    tick.state.range.set(&WIDE);
    let share_learned = settled(&mut tick, &motion).shares.friction;
    for joint in 0..N {
        for (share, drives) in [(share, loaded.friction), (share_learned, learned.friction)] {
            let error = f64::from(share[joint]) - wanted(&drives, joint);
            assert!(error.abs() < 1e-4, "joint {joint}: {error}");
        }
        let learnt = share_learned[joint] - share[joint];
        let error = tick.learnt_torque()[joint] - learnt;
        assert!(
            learnt != 0.0 && error.abs() < 1e-4,
            "joint {joint}: {error}"
        );
    }
}

#[test]
fn the_torque_of_the_state_is_that_of_the_tick_at_different_shares_of_the_joints() {
    let motion = motion(0.3);
    let mut tick = tick(set());
    let mut learnt = set();
    for (joint, friction) in learnt.friction.iter_mut().enumerate() {
        friction[FrictionColumn::Coulomb] += 0.02 * Ur5::LIMITS[joint].torque;
    }
    let share = LearntShare {
        joint: core::array::from_fn(|joint| 0.2 * joint as f32),
        common: 0.5,
    };
    tick.state.range.set(&WIDE);
    tick.state.set_active(&learnt, &share);
    let torque = settled(&mut tick, &motion).total;
    let of_state = tick.state().torque::<Ur5>(&motion);
    assert!((of_state - torque).amax() < 1e-4, "{of_state} {torque}");
}

#[test]
fn the_share_of_cogging_is_that_of_the_desired_place() {
    let mut cogging = set();
    cogging.friction[1][FrictionColumn::CoggingSine] = 0.5;
    let mut desired = motion(0.3);
    for k in 0..100 {
        desired.q[1] = 0.01 * k as f32;
        let mut wanted = evaluate::<Ur5, N, P>(&set(), &desired).shares;
        wanted.friction[1] += 0.5 * (202.0 * desired.q[1]).sin();
        let late = JointMeasurement {
            q: desired.q - 2e-3 * desired.qd,
            tau: JointVector::zeros(),
        };
        let measured = Some(late);
        let mut tick = tick(cogging);
        let share = tick.step(&JointSample { desired, measured }).shares;
        assert!((share.friction - wanted.friction).amax() < 1e-4, "{k}");
        assert_eq!((share.rigid, share.network), (wanted.rigid, wanted.network));
    }
}

#[test]
fn a_broken_share_is_replaced_by_the_committed_one_and_the_others_go_on() {
    let motion = motion(1.1);
    let whole = evaluate::<Ur5, N, P>(&set(), &motion).shares;
    let corrupt: [fn(&mut Set); 3] = [
        |s| s.rigid.fill(f32::NAN),
        |s| s.friction[2][FrictionColumn::Viscous] = f32::INFINITY,
        |s| s.network[4].output_bias[0] = f32::NAN,
    ];
    for corrupt in corrupt {
        let mut broken = set();
        corrupt(&mut broken);
        let torque = settled(&mut learnt_tick(&broken), &motion);
        assert_eq!(torque.shares, whole);
        let flags = Flags::SHARE_FALLBACK | Flags::NOT_FINITE;
        assert!(torque.flags.contains(flags));
        assert!(!torque.flags.contains(Flags::WITHDRAWN));
    }
}

#[test]
fn a_share_broken_in_both_sets_is_withdrawn_alone_at_the_slew_limit() {
    let motion = motion(1.1);
    let mut tick = tick(set());
    let before = settled(&mut tick, &motion);
    let mut broken = set();
    broken.rigid.fill(f32::NAN);
    tick.state.set_active(&broken, &LearntShare::FULL);
    tick.state.commit();
    let next = tick.step(&sample(motion));
    assert!(next.flags.contains(Flags::WITHDRAWN | Flags::SLEWED));
    for j in 0..N {
        let slew = tick.config().slew_per_tick[j] * 1.001;
        assert!((next.total[j] - before.total[j]).abs() <= slew, "joint {j}");
    }
    assert_eq!(settled(&mut tick, &motion).total, before.shares.friction);
}

#[test]
fn a_share_beyond_its_bound_gives_way_to_the_committed_one_and_without_one_to_zero() {
    use crate::feedforward::shares::{JointShares, select};
    let shares = |joint: usize, share: f32| {
        let mut all = [0.0; 3];
        all[joint] = share;
        let [rigid, friction, network] = all;
        JointShares {
            rigid,
            friction,
            network,
        }
    };
    // Bounds in torque limits: those of rigid body, friction, network.
    for (kind, bound) in [10.0, 2.0, 0.1].into_iter().enumerate() {
        for (factor, sound) in [(0.99, true), (-0.99, true), (1.01, false), (-1.01, false)] {
            let active = shares(kind, factor * bound * 50.0);
            let (mut flags, mut lost) = (Flags::NONE, Flags::NONE);
            let replaced = select(&active, &shares(kind, 1.0), [50.0; 2], &mut flags);
            let withdrawn = select(&active, &active, [50.0; 2], &mut lost);
            let context = std::format!("share {kind}, {factor}");
            let [one, none] = [shares(kind, 1.0), shares(kind, 0.0)];
            let wanted = if sound { [&active; 2] } else { [&one, &none] };
            assert_eq!([&replaced.shares, &withdrawn.shares], wanted, "{context}");
            assert_eq!(flags.contains(Flags::SHARE_FALLBACK), !sound, "{context}");
            assert_eq!(lost.contains(Flags::WITHDRAWN), !sound, "{context}");
            let gravity = lost.contains(Flags::GRAVITY_LOST);
            assert_eq!(gravity, !sound && kind == 0, "{context}");
        }
    }
}

#[test]
fn without_samples_the_torque_is_held_then_slewed_to_zero() {
    let mut tick = tick(set());
    let before = settled(&mut tick, &motion(0.3));
    for _ in 0..tick.config().hold_ticks {
        let held = tick.step_stale();
        assert_eq!(held.total, before.total);
        assert!(held.flags.contains(Flags::STALE_SAMPLE));
    }
    let mut last = before.total;
    for _ in 0..25 {
        let torque = tick.step_stale();
        assert!(torque.flags.contains(Flags::WITHDRAWN));
        for j in 0..N {
            assert!((torque.total[j] - last[j]).abs() <= tick.config().slew_per_tick[j] * 1.001);
        }
        last = torque.total;
    }
    assert_eq!(last.amax(), 0.0);
    let back = settled(&mut tick, &motion(0.3));
    assert_eq!(back.total, before.total);
}

#[test]
fn a_desired_motion_that_is_not_finite_is_no_sample() {
    let changes: [fn(&mut JointMotion<N>) -> &mut f32; 3] =
        [|m| &mut m.q[2], |m| &mut m.qd[2], |m| &mut m.qdd[2]];
    for change in changes {
        for bad in [f32::NAN, f32::INFINITY] {
            let mut broken = motion(0.3);
            *change(&mut broken) = bad;
            let (mut fed, mut starved) = (tick(set()), tick(set()));
            settled(&mut fed, &motion(0.3));
            settled(&mut starved, &motion(0.3));
            for _ in 0..40 {
                let torque = fed.step(&sample(broken));
                let flags = Flags::STALE_SAMPLE | Flags::NOT_FINITE;
                assert!(torque.flags.contains(flags));
                assert_eq!(torque.total, starved.step_stale().total);
            }
        }
    }
}
