//! One link: how it moves, and the wrench that takes.

use super::term::{Matrix, Term, Vector};
use crate::arm::Arm;
use crate::joint::{JointMotion, JointVector};
use crate::math::{LARGEST_ANGLE, SinCos, sin_cos};

/// Motion of a link frame, expressed in that frame.
#[derive(Clone, Copy)]
pub(super) struct LinkMotion {
    /// Angular velocity ω, rad/s.
    pub(super) omega: Vector,
    /// Angular acceleration ω̇, rad/s².
    pub(super) alpha: Vector,
    /// Acceleration of the origin v̇ less gravity, m/s².
    pub(super) a: Vector,
    /// `U = [ω̇]× + [ω]×[ω]×`: a point at r in this link accelerates with `v̇ + U r`.
    pub(super) u: Matrix,
}

impl LinkMotion {
    /// The base: at rest, accelerating with −g, which gives every link its gravity (Craig 2005, section 6.5).
    #[inline(always)]
    pub(super) fn base<A: Arm<N, P>, const N: usize, const P: usize>() -> Self {
        let [x, y, z] = *A::gravity();
        Self {
            omega: Vector::ZERO,
            alpha: Vector::ZERO,
            a: Vector::constant([-x, -y, -z]),
            u: Matrix::ZERO,
        }
    }

    /// Motion of link `joint`, from that of the link before it: its frame sits at p and is turned by `rot` = R, which
    /// maps its coordinates into those of the link before.
    ///
    /// ```text
    /// ω'  = Rᵀ ω + q̇ z                        eq. 2
    /// ω̇'  = Rᵀ ω̇ + (Rᵀ ω) × q̇ z + q̈ z         eq. 3
    /// v̇'  = Rᵀ (v̇ + ω̇ × p + ω × (ω × p))      eq. 5
    /// ```
    /// Craig 2005, eq. 6.45, 6.46, 6.47. The paper prints the transposed frames in eq. 2–5 and exchanges ω and ω̇ in eq. 5.
    #[inline(always)]
    pub(super) fn next<A: Arm<N, P>, const N: usize, const P: usize>(
        &self,
        joint: usize,
        rot: &Matrix,
        motion: &JointMotion<N>,
    ) -> Self {
        let p = origin::<A, N, P>(joint);
        let qd = Term::variable(motion.qd[joint]);
        let qdd = Term::variable(motion.qdd[joint]);
        let carried = rot.transposed_times(self.omega);
        let rate = Vector::Z.scale(qd);
        let omega = carried + rate;
        let alpha = rot.transposed_times(self.alpha) + carried.cross(rate) + Vector::Z.scale(qdd);
        let a = rot.transposed_times(self.a + self.u.times(p));
        Self {
            omega,
            alpha,
            a,
            u: acceleration_field(omega, alpha),
        }
    }
}

/// `U = [ω̇]× + [ω]×[ω]× = [ω̇]× + ω ωᵀ − (ω·ω) 1`.
#[inline(always)]
fn acceleration_field(omega: Vector, alpha: Vector) -> Matrix {
    let [wx, wy, wz] = omega.0;
    let [ax, ay, az] = alpha.0;
    let (xx, yy, zz) = (wx * wx, wy * wy, wz * wz);
    let (xy, xz, yz) = (wx * wy, wx * wz, wy * wz);
    Matrix([
        Vector([-(yy + zz), xy - az, xz + ay]),
        Vector([xy + az, -(xx + zz), yz - ax]),
        Vector([xz - ay, yz + ax, -(xx + yy)]),
    ])
}

/// The angle, rad, is a number whose sine and cosine are exact enough: within ±1000 rad.
#[inline(always)]
pub fn is_angle(q: f32) -> bool {
    q.abs() <= LARGEST_ANGLE
}

/// Sines and cosines of the joint angles of one pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Angles<const N: usize>(pub(super) [SinCos; N]);

impl<const N: usize> Angles<N> {
    pub(super) const ZERO: Self = Self([SinCos { sin: 0.0, cos: 1.0 }; N]);

    /// Takes the angles `q`, N × rad; false, and of no meaning, if one is not a number or beyond ±1000 rad.
    ///
    /// Cost: one `sin_cos` a joint.
    #[inline(always)]
    pub(super) fn take(&mut self, q: &JointVector<N>) -> bool {
        for (pair, &q) in self.0.iter_mut().zip(q.as_slice()) {
            if !is_angle(q) {
                return false;
            }
            *pair = sin_cos(q);
        }
        true
    }
}

/// Angles of the joints, from their positions or known.
///
/// Beside its meaning the branch on [`is_angle`](Self::is_angle) ends a basic block at each joint. In one block for the whole
/// arm the compiler's scheduler mixes the joints and spills registers.
pub(super) trait JointAngles {
    /// The angle of `joint` is one.
    fn is_angle(&self, joint: usize) -> bool;
    fn pair(&self, joint: usize) -> SinCos;
}

impl<const N: usize> JointAngles for JointVector<N> {
    #[inline(always)]
    fn is_angle(&self, joint: usize) -> bool {
        is_angle(self[joint])
    }

    #[inline(always)]
    fn pair(&self, joint: usize) -> SinCos {
        sin_cos(self[joint])
    }
}

impl<const N: usize> JointAngles for Angles<N> {
    /// Always true, unknown to the compiler.
    #[inline(always)]
    fn is_angle(&self, joint: usize) -> bool {
        self.0[joint].cos <= 2.0
    }

    #[inline(always)]
    fn pair(&self, joint: usize) -> SinCos {
        self.0[joint]
    }
}

/// Rotation of joint `joint`'s frame into its parent's: constant placement, then `Rz(q)` of the angle with sine and cosine
/// `pair`.
#[inline(always)]
pub(super) fn rotation<A: Arm<N, P>, const N: usize, const P: usize>(
    joint: usize,
    pair: SinCos,
) -> Matrix {
    let (s, c) = (Term::variable(pair.sin), Term::variable(pair.cos));
    let [first, second, third] = A::placements()[joint].rot_parent_child;
    Matrix([
        turned(first, s, c),
        turned(second, s, c),
        turned(third, s, c),
    ])
}

/// A row of a constant rotation, times `Rz` of the angle with sine `s` and cosine `c`.
#[inline(always)]
fn turned(row: [f32; 3], s: Term, c: Term) -> Vector {
    let [x, y, z] = Vector::constant(row).0;
    Vector([x * c + y * s, y * c - x * s, z])
}

/// Origin of joint `joint`'s frame in its parent's.
#[inline(always)]
pub(super) fn origin<A: Arm<N, P>, const N: usize, const P: usize>(joint: usize) -> Vector {
    Vector::constant(A::placements()[joint].origin)
}
