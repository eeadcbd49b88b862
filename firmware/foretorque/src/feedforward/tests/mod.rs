//! The tick, without learning: shares, limits, fallbacks, adoption.

use super::*;
use crate::arm::ur5::Ur5;
use crate::dynamics::{BaseParameters, FrictionColumn, FrictionParameters};
use crate::joint::JointMotion;
use crate::learning::{LearnerReport, LearntShare, MotionRange, Publication};

mod adoption;
mod flags;
mod limits;
mod shares;

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
    JointMotion {
        q: JointVector::from_fn(|j, _| (phase + j as f32).sin()),
        qd: JointVector::from_fn(|j, _| (phase + j as f32).cos()),
        qdd: JointVector::from_fn(|j, _| -(phase + j as f32).sin()),
    }
}

fn sample(desired: JointMotion<N>) -> JointSample<N> {
    JointSample {
        desired,
        measured: None,
    }
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
    let good = FeedForwardConfig::for_arm::<Ur5, P>(1e-3);
    let mut slew = good;
    slew.slew_per_tick[3] = f32::NAN;
    let mut range = good;
    range.limits[0].position = (1.0, -1.0);
    assert!(good.validate().is_ok());
    assert!(Tick::new(slew, set()).is_err());
    assert_eq!(
        slew.validate(),
        Err(ConfigError::NotPositive("slew_per_tick"))
    );
    assert_eq!(
        range.validate(),
        Err(ConfigError::NotPositive("limits.position"))
    );
}
