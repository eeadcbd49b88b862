//! The joint torque regressor: one row, or all of them.

use super::link::{Angles, LinkMotion, is_angle, origin, rotation};
use super::term::{Matrix, Term, Vector};
use crate::arm::{Arm, LINK_PARAMETERS};
use crate::joint::{JointMotion, JointVector};
use crate::math::{LARGEST_ANGLE, SinCos, sin_cos};
use nalgebra::{SMatrix, SVector};

/// Row `joint` of the [`regressor`]: `tau[joint] = row · beta`.
///
/// * `joint` 0 to N − 1; any other gives a row of zeros
///
/// Limits: an angle beyond ±1000 rad or NaN makes every entry NaN.
/// Cost: the outward recursion of [`super::rnea`] and up to about 55 multiply-adds for each link from `joint` on.
pub fn regressor_row<A: Arm<N, P>, const N: usize, const P: usize>(
    joint: usize,
    motion: &JointMotion<N>,
) -> SVector<f32, P> {
    if !are_angles(&motion.q) {
        return SVector::repeat(f32::NAN);
    }
    row::<A, N, P>(joint, |joint| sin_cos(motion.q[joint]), motion)
}

/// [`regressor_row`] at the angles of `motion`.
#[inline(never)]
pub(crate) fn regressor_row_at<A: Arm<N, P>, const N: usize, const P: usize>(
    joint: usize,
    angles: &Angles<N>,
    motion: &JointMotion<N>,
) -> SVector<f32, P> {
    row::<A, N, P>(joint, |joint| angles.0[joint], motion)
}

/// One code for every joint: what is 0 in the frame of one is not in another's. Its own link alone, where its axis is
/// known, has a code of its own.
#[inline(always)]
#[expect(
    clippy::absurd_extreme_comparisons,
    reason = "the loop is written out joint by joint, the first one too"
)]
fn row<A: Arm<N, P>, const N: usize, const P: usize>(
    joint: usize,
    pair: impl Fn(usize) -> SinCos,
    motion: &JointMotion<N>,
) -> SVector<f32, P> {
    let mut link = LinkMotion::base::<A, N, P>();
    let mut axis = JointAxis::OWN_AT_RUN_TIME;
    // Not `SVector::zeros()`, which hides the array: it would be copied at the end.
    let mut row = SVector::from([0.0; P]);
    outward!(A: I < N {
        let rot = rotation::<A, N, P>(I, pair(I));
        link = link.next::<A, N, P>(I, &rot, motion);
        if joint < I {
            axis = axis.carried(&rot, origin::<A, N, P>(I));
            axis.write_row::<A, N, P>(I, &link, &mut row);
        } else if joint == I {
            JointAxis::OWN.write_row::<A, N, P>(I, &link, &mut row);
            if let Some(index) = A::index().rotor[I] {
                row[index] = motion.qdd[I];
            }
        }
    });
    row
}

/// The joint torque regressor over the base set: `tau = Y beta` (eq. 13–16), one row for each joint.
///
/// A unit of one link parameter makes a force F and a moment n about the link origin; they act on joint r through its
/// partial velocities at that origin, `s · n + v · F` [Kane and Levinson 1985, section 4.4].
///
/// Limits: those of [`regressor_row`].
/// Cost: the outward recursion of [`super::rnea`] and up to about 55 multiply-adds for each link and joint before it.
#[expect(
    clippy::absurd_extreme_comparisons,
    reason = "the loop is written out joint by joint, the first one too"
)]
pub fn regressor<A: Arm<N, P>, const N: usize, const P: usize>(
    motion: &JointMotion<N>,
) -> SMatrix<f32, N, P> {
    let mut rows = SMatrix::from([[0.0; N]; P]);
    let mut link = LinkMotion::base::<A, N, P>();
    let mut axes = [JointAxis::OWN; N];
    if !are_angles(&motion.q) {
        return SMatrix::repeat(f32::NAN);
    }
    outward!(A: I < N {
        let rot = rotation::<A, N, P>(I, sin_cos(motion.q[I]));
        link = link.next::<A, N, P>(I, &rot, motion);
        outward!(A: J < N {
            if J <= I {
                if J != I {
                    axes[J] = axes[J].carried(&rot, origin::<A, N, P>(I));
                }
                let entries = axes[J].power_of_unit_parameters(&link);
                for (index, entry) in A::index().link[I].iter().zip(entries) {
                    if let Some(index) = *index {
                        rows[(J, index)] = entry.value();
                    }
                }
            }
        });
        if let Some(index) = A::index().rotor[I] {
            rows[(I, index)] = motion.qdd[I];
        }
    });
    rows
}

/// [`is_angle`] of all joints: one comparison where their squares sum to at most 1000² rad².
#[inline(always)]
fn are_angles<const N: usize>(q: &JointVector<N>) -> bool {
    let mut sum = 0.0;
    for q in q.as_slice() {
        sum += q * q;
    }
    sum <= LARGEST_ANGLE * LARGEST_ANGLE || q.as_slice().iter().all(|&q| is_angle(q))
}

/// The partial velocities of one joint at the origin of a link: what a unit rate of the joint gives it, in its frame.
#[derive(Clone, Copy)]
struct JointAxis {
    /// Angular velocity: the axis of the joint.
    s: Vector,
    /// Velocity of the origin.
    v: Vector,
}

impl JointAxis {
    /// At the joint's own link.
    const OWN: Self = Self {
        s: Vector::Z,
        v: Vector::ZERO,
    };
    /// [`OWN`](Self::OWN), its zeros unknown while compiling.
    const OWN_AT_RUN_TIME: Self = Self {
        s: Vector([
            Term::variable(0.0),
            Term::variable(0.0),
            Term::variable(1.0),
        ]),
        v: Vector([Term::variable(0.0); 3]),
    };

    /// At the next link, whose frame sits at p and is turned by `rot` = R: `s' = Rᵀ s`, `v' = Rᵀ (v + s × p)`.
    #[inline(always)]
    fn carried(self, rot: &Matrix, p: Vector) -> Self {
        Self {
            s: rot.transposed_times(self.s),
            v: rot.transposed_times(self.v + self.s.cross(p)),
        }
    }

    /// Writes the entries of link `link`, which moves like `motion`, into `row`.
    #[inline(always)]
    fn write_row<A: Arm<N, P>, const N: usize, const P: usize>(
        self,
        link: usize,
        motion: &LinkMotion,
        row: &mut SVector<f32, P>,
    ) {
        let entries = self.power_of_unit_parameters(motion);
        for (index, entry) in A::index().link[link].iter().zip(entries) {
            if let Some(index) = *index {
                row[index] = entry.value();
            }
        }
    }

    /// `s · n + v · F` for each parameter of a link at value one, in the order of eq. 14.
    #[inline(always)]
    fn power_of_unit_parameters(self, motion: &LinkMotion) -> [Term; LINK_PARAMETERS] {
        let Self { s, v } = self;
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
}
