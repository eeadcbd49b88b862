//! Torques of single joints as the description explains them.

use super::{CENTRE_M, GRAVITY_SHARE, SOUND_SCALE};
use crate::dynamics::{Motion, PerJoint, RigidBodies};
use crate::identification::columns::SIGN_WIDTH_RAD_S;
use crate::robot::Robot;
use nalgebra::{DMatrix, DVector, Matrix5, Vector5};

/// Fall of the logarithm of the unexplained share that proves a torque of the wrong sign.
pub(super) const SIGN_EVIDENCE: f64 = 1.0;
/// Columns of a joint alone.
pub(super) const COLUMNS: usize = 5;
/// Share of the square of an exact torque that rounding leaves: no evidence.
pub(super) const ROUNDING: f64 = 1e-9;
/// Rounds of the fit within bounds.
const ROUNDS: usize = 300;

/// Regression of one joint's torque on the description's link torque, friction and a rotor.
#[derive(Clone, Copy)]
pub(super) struct Explained {
    /// Share of the variance left.
    pub(super) rest: f64,
    /// Square of what is left, (N·m)², at least that of rounding.
    pub(super) square: f64,
    /// Torque over that of the description's links.
    pub(super) scale: f64,
    /// Likewise, with all errors in the description's torque, as those of noisy accelerations: the regression the other way.
    pub(super) scale_back: f64,
    pub(super) deviation: f64,
    /// Inertia beside that of the description's links, kg·m².
    pub(super) rotor: f64,
    /// Gravity is large enough to decide.
    pub(super) heavy: bool,
    /// Matrix and right side of the normal equations, and square of the torque.
    normal: (Matrix5<f64>, Vector5<f64>, f64),
}

impl Explained {
    /// Square of what a torque of this sign leaves: friction and rotors of an arm are not negative.
    ///
    /// * `scales` range of the torque over that of the description's links
    pub(super) fn left(&self, sign: f64, scales: (f64, f64)) -> f64 {
        let (gram, moment, square) = &self.normal;
        let moment = moment * sign;
        let least = [scales.0, 0.0, 0.0, 0.0, f64::NEG_INFINITY];
        let mut beta = Vector5::zeros();
        for k in (0..ROUNDS).flat_map(|_| 0..least.len()) {
            let own = (moment[k] - (gram.row(k) * beta)[0]) / gram[(k, k)] + beta[k];
            let most = if k == 0 { scales.1 } else { f64::INFINITY };
            beta[k] = own.clamp(least[k], most);
        }
        let left = square - 2.0 * moment.dot(&beta) + beta.dot(&(gram * beta));
        left.max(ROUNDING * square)
    }

    /// The torque is explained by its opposite alone.
    ///
    /// * `certain` gravity is beyond what an error of the described centres of mass makes; else it may have either sign
    pub(super) fn is_turned(&self, certain: bool) -> bool {
        let evidence = |scales: (f64, f64)| {
            let [kept, turned] = [1.0, -1.0].map(|sign| self.left(sign, scales));
            (kept / turned).ln()
        };
        // Where gravity may have either sign, the evidence of friction and rotor counts as much.
        let free = match certain {
            true => 0.0,
            false => evidence((f64::NEG_INFINITY, f64::INFINITY)),
        };
        evidence(SOUND_SCALE) + free > SIGN_EVIDENCE
    }
}

/// Torque of the links of the description and gravity at every row.
pub(super) fn links(model: &RigidBodies, states: &[Motion]) -> Vec<[PerJoint<f64>; 2]> {
    let torques = |state: &Motion| {
        [
            model.inverse_dynamics(state),
            model.gravity_torques(&state.q),
        ]
    };
    states.iter().map(torques).collect()
}

/// Gravity torque of a joint over that of an error of the described centres of mass, in RMS.
pub(super) fn weight(robot: &Robot, of_links: &[[PerJoint<f64>; 2]], joint: usize) -> f64 {
    let mass: f64 = robot.joints[joint..].iter().map(|it| it.link.mass).sum();
    let squares = of_links.iter().map(|links| links[1][joint].powi(2));
    let gravity = (squares.sum::<f64>() / of_links.len() as f64).sqrt();
    gravity / (mass * robot.gravity.norm() * CENTRE_M)
}

/// Columns of a joint alone: a torque of the links, Coulomb and viscous friction, rotor, offset.
pub(super) fn of_drive(state: &Motion, joint: usize, column: usize, links: f64) -> f64 {
    match column {
        0 => links,
        1 => (state.qd[joint] / (5.0 * SIGN_WIDTH_RAD_S)).tanh(),
        2 => state.qd[joint],
        3 => state.qdd[joint],
        _ => 1.0,
    }
}

pub(super) fn explain(
    joint: usize,
    states: &[Motion],
    links: &[[PerJoint<f64>; 2]],
    limit: f64,
    tau: impl Fn(usize) -> f64,
) -> Explained {
    let count = states.len();
    let x = DMatrix::from_fn(count, COLUMNS, |row, column| {
        of_drive(&states[row], joint, column, links[row][0][joint])
    });
    let y = DVector::from_fn(count, |row, _| tau(row));
    let mean = y.mean();
    let variance = y.iter().map(|tau| (tau - mean).powi(2)).sum::<f64>();
    let mut gram: Matrix5<f64> = x.tr_mul(&x).fixed_view::<5, 5>(0, 0).into();
    let moment: Vector5<f64> = x.tr_mul(&y).fixed_rows::<5>(0).into();
    // A joint without link torque, or one that stands still, has a column of zeros.
    for k in 0..COLUMNS {
        gram[(k, k)] += 1e-9 * gram[(k, k)] + 1e-12;
    }
    let normal = (gram, moment, y.norm_squared());
    let Some(inverse) = gram.try_inverse() else {
        return Explained {
            rest: 1.0,
            square: normal.2,
            scale: 1.0,
            scale_back: 1.0,
            deviation: f64::INFINITY,
            rotor: 0.0,
            heavy: false,
            normal,
        };
    };
    let beta = inverse * moment;
    let rest = (&y - &x * beta).norm_squared();
    let noise = rest / (count.max(COLUMNS + 1) - COLUMNS) as f64;
    let gravity = links.iter().map(|link| link[1][joint].powi(2)).sum::<f64>();
    Explained {
        // A torque that never changes follows nothing.
        rest: if variance > 0.0 {
            (rest / variance).min(1.0)
        } else {
            1.0
        },
        square: rest.max(ROUNDING * normal.2),
        scale: beta[0],
        scale_back: beta[0] + rest * inverse[(0, 0)] / beta[0],
        deviation: (noise * inverse[(0, 0)]).sqrt(),
        rotor: beta[3],
        normal,
        heavy: (gravity / count.max(1) as f64).sqrt() > GRAVITY_SHARE * limit,
    }
}
