//! Rows of the joint torque regressor.

use super::link::{BaseSet, LinkMotion, origin, rotation};
use super::term::{Term, Vector};
use crate::arm::{Arm, LINK_PARAMETERS};
use crate::joint::JointMotion;
use nalgebra::SVector;

/// Row `joint` of the joint torque regressor over the base set: `tau[joint] = row · beta` (eq. 13–16).
///
/// A unit of one link parameter makes a force F and a moment n about the link origin; joint r feels them through its
/// partial velocities at that origin, `s · n + v · F`, where s is the axis of joint r and v the velocity a unit rate of
/// joint r gives the link origin. Both are carried outward from joint r, expressed in the frame of each link:
/// `s' = Rᵀ s`, `v' = Rᵀ (v + s × p)`.
///
/// * `joint` 0 to N − 1; any other gives a row of zeros
///
/// Assumes: angles within ±1000 rad ([`super::rnea`] refuses others).///
/// Cost: the outward recursion of [`super::rnea`] and up to about 55 multiply-adds for each link from `joint` on.
pub fn regressor_row<A: Arm<N, P>, const N: usize, const P: usize>(
    joint: usize,
    motion: &JointMotion<N>,
) -> SVector<f32, P> {
    outward!(J < N {
        if joint == J {
            return row_of::<A, N, P, J>(motion);
        }
    });
    SVector::zeros()
}

/// The row of joint `J`; one instance for each joint, so that what is 0 in its own frame costs nothing.
#[expect(
    clippy::absurd_extreme_comparisons,
    reason = "the loop is written out joint by joint, the first one too"
)]
fn row_of<A: Arm<N, P>, const N: usize, const P: usize, const J: usize>(
    motion: &JointMotion<N>,
) -> SVector<f32, P> {
    let mut row = SVector::zeros();
    let mut link = LinkMotion::base::<A, N, P>();
    let mut s = Vector::Z;
    let mut v = Vector::ZERO;
    outward!(I < N {
        let rot = rotation::<A, N, P>(I, motion.q[I]);
        link = link.next::<A, N, P>(I, &rot, motion);
        if I >= J {
            if I != J {
                v = rot.transposed_times(v + s.cross(origin::<A, N, P>(I)));
                s = rot.transposed_times(s);
            }
            let entries = power_of_unit_parameters(&link, s, v);
            set(&mut row, &BaseSet::<A, N, P>::LINK[I], &entries);
        }
    });
    let rotor = &[BaseSet::<A, N, P>::ROTOR[J]];
    set(&mut row, rotor, &[Term::variable(motion.qdd[J])]);
    row
}

/// `s · n + v · F` for each parameter of a link at value one, in the order of eq. 14.
#[inline(always)]
fn power_of_unit_parameters(motion: &LinkMotion, s: Vector, v: Vector) -> [Term; LINK_PARAMETERS] {
    let [wx, wy, wz] = motion.omega.0;
    let [ax, ay, az] = motion.alpha.0;
    let [u_x, u_y, u_z] = motion.u.0;
    let ([_, uxy, uxz], [uyx, _, uyz], [uzx, uzy, _]) = (u_x.0, u_y.0, u_z.0);
    let [sx, sy, sz] = s.0;
    let (xy, xz, yz) = (wx * wy, wx * wz, wy * wz);
    // F = U c and n = c × v̇, so that v · F + s · n = c · (Uᵀ v + v̇ × s).
    let first = motion.u.transposed_times(v) + motion.a.cross(s);
    [
        v.dot(motion.a),
        first.0[0],
        first.0[1],
        first.0[2],
        sx * ax + sy * xz - sz * xy,
        sy * ay + sz * xy - sx * yz,
        sz * az + sx * yz - sy * xz,
        sy * uzy - sx * uzx + sz * (wx * wx - wy * wy),
        sx * uyx - sz * uyz + sy * (wz * wz - wx * wx),
        sz * uxz - sy * uxy + sx * (wy * wy - wz * wz),
    ]
}

/// Puts entries where the base set has them.
#[inline(always)]
fn set<const P: usize, const K: usize>(
    row: &mut SVector<f32, P>,
    index: &[Option<usize>; K],
    entries: &[Term; K],
) {
    for (index, entry) in index.iter().zip(entries) {
        if let Some(index) = *index {
            row[index] = entry.value();
        }
    }
}
