//! Arms that are read while the program runs.

use crate::robot::Robot;
use foretorque::arm::{
    Arm, ArmModel, BaseIndex, BaseTerm, JointLimits, LINK_PARAMETERS, LinkColumns, Placement,
};
use foretorque::dynamics::BaseParameters;
use std::any::Any;
use std::cell::Cell;

/// The selected arm of `N` joints of this thread, with room for `P` base parameters.
///
/// It runs the code of the board and gives the bits of a compiled arm. Constants of the trait are not there: code that
/// needs one does not compile for this arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Described<const N: usize, const P: usize>;

thread_local! {
    static SELECTED: [Cell<Option<&'static dyn Any>>; foretorque::dynamics::MAX_JOINTS + 1] =
        const { [const { Cell::new(None) }; foretorque::dynamics::MAX_JOINTS + 1] };
}

impl<const N: usize, const P: usize> Described<N, P> {
    /// Make `arm` the arm of `N` joints of this thread.
    pub fn select(arm: &'static ArmModel<N, P>) {
        SELECTED.with(|selected| selected[N].set(Some(arm)));
    }

    /// Read `robot` and [`select`](Self::select) it; `None` when it has not `N` joints. The arm lives as long as the
    /// program.
    pub fn read(robot: &Robot) -> Option<&'static ArmModel<N, P>> {
        let arm: &'static _ = Box::leak(Box::new(crate::generate::arm_model(robot)?));
        Self::select(arm);
        Some(arm)
    }
}

/// A constant of an arm that is known when the program runs.
macro_rules! at_run_time {
    ($($name:ident: $kind:ty),*) => {
        $(const $name: $kind = panic!("this arm has no constants: use the functions of the trait");)*
    };
}

/// Functions that give parts of the selected arm.
macro_rules! of_model {
    ($model:ident: $($name:ident: $kind:ty = $part:expr),*) => {
        $(fn $name() -> $kind {
            let $model = Self::model();
            $part
        })*
    };
}

impl<const N: usize, const P: usize> Arm<N, P> for Described<N, P> {
    at_run_time! {
        NAME: &'static str, HASH: u32, GRAVITY: [f32; 3], PLACEMENTS: [Placement; N], COLUMNS: [LinkColumns; N],
        BASE_MAP: &'static [BaseTerm], LIMITS: [JointLimits; N], COGGING_CYCLES: [f32; N],
        ENCODER_STEP: f32, NOMINAL: [f32; P], LINKS: [[f32; LINK_PARAMETERS]; N], ROTORS: [f32; N]
    }
    const COMPILED: Option<ArmModel<N, P>> = None;

    fn model() -> &'static ArmModel<N, P> {
        let selected = SELECTED.with(|selected| selected[N].get());
        selected
            .and_then(<dyn Any>::downcast_ref)
            .expect("an arm of N joints is selected before it is used")
    }

    of_model! { model:
        name: &'static str = model.name,
        hash: u32 = model.hash(),
        gravity: &'static [f32; 3] = &model.gravity,
        placements: &'static [Placement; N] = &model.placements,
        columns: &'static [LinkColumns; N] = &model.columns,
        index: &'static BaseIndex<N> = &model.index,
        base_map: &'static [BaseTerm] = model.base_map,
        limits: &'static [JointLimits; N] = &model.limits,
        cogging_cycles: &'static [f32; N] = &model.cogging_cycles,
        encoder_step: f32 = model.encoder_step,
        nominal: &'static BaseParameters<P> = &model.nominal
    }
}

/// `joints!(count, N => body, else other)`: `body` with the constant `N = count`; `other` beyond 8 joints.
#[macro_export]
macro_rules! joints {
    ($count:expr, $n:ident => $body:expr, else $other:expr) => {
        $crate::joints!(@ $count, $n, $body, $other, 1 2 3 4 5 6 7 8)
    };
    (@ $count:expr, $n:ident, $body:expr, $other:expr, $($joints:literal)*) => {
        match $count {
            $($joints => {
                const $n: usize = $joints;
                $body
            })*
            _ => $other,
        }
    };
}

/// `arms!(robot, N, P => body, else other)`: `body` with the constants `N`, the robot's joints, and `P`, room for its base
/// parameters; `other` for a robot that has no arm.
///
/// Arms of 6 and 7 joints whose first axis is upright have rooms of their own: sums of the learner have the order, and so
/// the bits, of the compiled arm.
#[macro_export]
macro_rules! arms {
    ($robot:expr, $n:ident, $p:ident => $body:expr, else $other:expr) => {
        $crate::arms!($robot, $n, $p in
            (1, 4) (2, 12) (3, 20) (4, 28) (5, 36) (6, 40) (6, 44) (7, 48) (7, 52) (8, 60) => $body, else $other)
    };
    ($robot:expr, $n:ident, $p:ident in $(($joints:literal, $parameters:literal))* => $body:expr, else $other:expr) => {
        match ($robot.joint_count(), $robot.base_map().rank()) {
            $(($joints, ..=$parameters) => {
                const $n: usize = $joints;
                const $p: usize = $parameters;
                $body
            })*
            _ => $other,
        }
    };
}
