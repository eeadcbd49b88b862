//! Inverse dynamics by the recursive Newton–Euler algorithm, and the closed form of the dynamics that follows from it.

use super::BaseParameters;
use super::link::{Angles, JointAngles, LinkMotion, origin, rotation};
use super::term::{Matrix, Term, Vector};
use crate::arm::Arm;
use crate::joint::{JointMotion, JointVector};
use nalgebra::SMatrix;

/// Joint torques of the rigid body, N × N·m, rotor inertias and gravity included; positive accelerates +q.
///
/// Recursive Newton–Euler (Craig 2005, section 6.5; eq. 1–11), outward for motion, inward for wrenches, on parameters
/// that are linear in the torque: m, m·c and the inertia about the link origin. Taken about the origin, eq. 6–8 become
///
/// ```text
/// F = m v̇ + U (m c)                            for eq. 7
/// n = (m c) × v̇ + I ω̇ + ω × (I ω)              for eq. 8 and P_c × F of eq. 10
/// ```
/// The torque depends on the base parameters only (eq. 16), so the base set stands at its independent entries and all
/// other parameters are zero: the same torque for fewer operations.
///
/// * `beta` base parameters, order of [`Arm::COLUMNS`]
/// * `motion` q, qd, qdd of all joints, rad, rad/s, rad/s²
///
/// Limits: an angle beyond ±1000 rad or NaN makes every torque NaN.
/// Cost: about 100 multiply-adds a joint at right angles, and one `sin_cos` a joint.
pub fn rnea<A: Arm<N, P>, const N: usize, const P: usize>(
    beta: &BaseParameters<P>,
    motion: &JointMotion<N>,
) -> JointVector<N> {
    let mut tau = [JointVector::zeros()];
    recursion::<A, N, P, 1>([beta], &motion.q, motion, &mut tau);
    let [tau] = tau;
    tau
}

/// [`rnea`] of one or two parameter vectors at known angles: the motion of the links is computed once.
///
/// * `betas` base parameters, order of [`Arm::COLUMNS`]      * `angles` those of `motion.q`
/// * `tau` becomes the torques of each vector, N × N·m
///
/// Cost: that of [`rnea`] without `sin_cos`; for the second vector about two thirds of it.
#[inline(never)]
pub fn rnea_of<A: Arm<N, P>, const N: usize, const P: usize, const S: usize>(
    betas: [&BaseParameters<P>; S],
    angles: &Angles<N>,
    motion: &JointMotion<N>,
    tau: &mut [JointVector<N>; S],
) {
    recursion::<A, N, P, S>(betas, angles, motion, tau);
}

/// The recursion in a `pose`; NaN where it has an angle that is none.
#[inline(always)]
fn recursion<A: Arm<N, P>, const N: usize, const P: usize, const S: usize>(
    betas: [&BaseParameters<P>; S],
    pose: &impl JointAngles,
    motion: &JointMotion<N>,
    tau: &mut [JointVector<N>; S],
) {
    const { assert!(S <= 2, "written out for two parameter vectors") };
    let mut link = LinkMotion::base::<A, N, P>();
    let mut rot = [Matrix::ZERO; N];
    // First what each link needs for its own motion, then what it takes from the link before it: expressed in frame I,
    // about its origin.
    let mut wrench = [[Wrench::ZERO; N]; S];
    outward!(A: I < N {
        if !pose.is_angle(I) {
            *tau = [JointVector::repeat(f32::NAN); S];
            return;
        }
        rot[I] = rotation::<A, N, P>(I, pose.pair(I));
        link = link.next::<A, N, P>(I, &rot[I], motion);
        each!(K < S {
            wrench[K][I] = LinkParameters::of::<A, N, P>(betas[K], I).wrench(&link);
        }, 0 1);
    });
    each!(K < S {
        inward!(A: I < N {
            if I + 1 < N {
                let outer = (I + 1) % N;
                wrench[K][I] = wrench[K][I].and(wrench[K][outer], &rot[outer], origin::<A, N, P>(outer));
            }
            // eq. 11, and the rotor, which turns with the joint alone.
            let rotor = parameter(betas[K], A::index().rotor[I]);
            tau[K][I] = (wrench[K][I].n.dot(Vector::Z) + rotor * Term::variable(motion.qdd[I])).value();
        });
    }, 0 1);
}

/// Gravity torques G(q), N × N·m: [`rnea`] of an arm at rest. Craig 2005, section 6.5, with v̇ = −g of the base
/// carried outward: F = m v̇, n = (m c) × v̇.
///
/// * `beta` base parameters, order of [`Arm::COLUMNS`]
/// * `q` joint angles, rad
///
/// Limits: those of [`rnea`].
/// Cost: about 20 multiply-adds a joint at right angles, and one `sin_cos` a joint.
pub fn gravity_torque<A: Arm<N, P>, const N: usize, const P: usize>(
    beta: &BaseParameters<P>,
    q: &JointVector<N>,
) -> JointVector<N> {
    gravity_recursion::<A, N, P>(beta, q)
}

/// [`gravity_torque`] at `angles`.
#[inline(never)]
pub(crate) fn gravity_torque_at<A: Arm<N, P>, const N: usize, const P: usize>(
    beta: &BaseParameters<P>,
    angles: &Angles<N>,
) -> JointVector<N> {
    gravity_recursion::<A, N, P>(beta, angles)
}

/// The recursion of an arm at rest, as [`recursion`].
#[inline(always)]
fn gravity_recursion<A: Arm<N, P>, const N: usize, const P: usize>(
    beta: &BaseParameters<P>,
    pose: &impl JointAngles,
) -> JointVector<N> {
    let mut a = LinkMotion::base::<A, N, P>().a;
    let mut rot = [Matrix::ZERO; N];
    let mut wrench = [Wrench::ZERO; N];
    outward!(A: I < N {
        if !pose.is_angle(I) {
            return JointVector::repeat(f32::NAN);
        }
        rot[I] = rotation::<A, N, P>(I, pose.pair(I));
        a = rot[I].transposed_times(a);
        let LinkParameters { mass, first_moment, .. } = LinkParameters::of::<A, N, P>(beta, I);
        wrench[I] = Wrench { f: a.scale(mass), n: first_moment.cross(a) };
    });
    let mut tau = JointVector::zeros();
    inward!(A: I < N {
        if I + 1 < N {
            let outer = (I + 1) % N;
            wrench[I] = wrench[I].and(wrench[outer], &rot[outer], origin::<A, N, P>(outer));
        }
        tau[I] = wrench[I].n.dot(Vector::Z).value();
    });
    tau
}

/// Mass matrix M(q), N × N, kg·m²: column j is what a unit acceleration of joint j adds to the torque at rest
/// (Walker and Orin 1982, method 1).
///
/// In the closed form `tau = M(q) qdd + V(q, qd) + G(q)` (eq. 12) the paper prints θ̇ where M multiplies θ̈; Craig 2005, eq. 6.59,
/// has it right. The tick does not need the sum. M and V are for whoever designs or checks a controller.
///
/// Limits: an angle beyond ±1000 rad or NaN makes every entry NaN.
/// Cost: N passes of [`rnea`] and one of [`gravity_torque`].
pub fn mass_matrix<A: Arm<N, P>, const N: usize, const P: usize>(
    beta: &BaseParameters<P>,
    q: &JointVector<N>,
) -> SMatrix<f32, N, N> {
    let mut motion = at_rest(q);
    let gravity = gravity_torque::<A, N, P>(beta, q);
    let mut mass = SMatrix::<f32, N, N>::zeros();
    for (joint, mut column) in mass.column_iter_mut().enumerate() {
        motion.qdd = JointVector::from_fn(|k, _| if k == joint { 1.0 } else { 0.0 });
        column.copy_from(&(rnea::<A, N, P>(beta, &motion) - gravity));
    }
    mass
}

/// Centrifugal and Coriolis torques V(q, qd), N × N·m.
///
/// Cost: one pass of [`rnea`] and one of [`gravity_torque`].
pub fn velocity_torque<A: Arm<N, P>, const N: usize, const P: usize>(
    beta: &BaseParameters<P>,
    q: &JointVector<N>,
    qd: &JointVector<N>,
) -> JointVector<N> {
    let moving = JointMotion {
        qd: *qd,
        ..at_rest(q)
    };
    rnea::<A, N, P>(beta, &moving) - gravity_torque::<A, N, P>(beta, q)
}

fn at_rest<const N: usize>(q: &JointVector<N>) -> JointMotion<N> {
    JointMotion {
        q: *q,
        ..JointMotion::zero()
    }
}

/// A base parameter as a term: zero, known while compiling, when it is not in the base set.
#[inline(always)]
fn parameter<const P: usize>(beta: &BaseParameters<P>, index: Option<usize>) -> Term {
    match index {
        Some(index) => Term::variable(beta[index]),
        None => Term::ZERO,
    }
}

/// Force f and moment n about the origin of the frame they are expressed in.
#[derive(Clone, Copy)]
struct Wrench {
    f: Vector,
    n: Vector,
}

impl Wrench {
    const ZERO: Self = Self {
        f: Vector::ZERO,
        n: Vector::ZERO,
    };

    /// This and that of the next link, whose frame sits at p and is turned by `rot` (eq. 9 and 10).
    #[inline(always)]
    fn and(self, outer: Self, rot: &Matrix, p: Vector) -> Self {
        let f = rot.times(outer.f);
        let n = rot.times(outer.n) + p.cross(f);
        Self {
            f: self.f + f,
            n: self.n + n,
        }
    }
}

/// Inertial parameters of one link about its origin.
struct LinkParameters {
    mass: Term,
    first_moment: Vector,
    /// Ixx, Iyy, Izz.
    diagonal: [Term; 3],
    /// Ixy, Ixz, Iyz.
    products: [Term; 3],
}

impl LinkParameters {
    #[inline(always)]
    fn of<A: Arm<N, P>, const N: usize, const P: usize>(
        beta: &BaseParameters<P>,
        link: usize,
    ) -> Self {
        let [m, mx, my, mz, xx, yy, zz, xy, xz, yz] = A::index().link[link];
        Self {
            mass: parameter(beta, m),
            first_moment: Vector([
                parameter(beta, mx),
                parameter(beta, my),
                parameter(beta, mz),
            ]),
            diagonal: [
                parameter(beta, xx),
                parameter(beta, yy),
                parameter(beta, zz),
            ],
            products: [
                parameter(beta, xy),
                parameter(beta, xz),
                parameter(beta, yz),
            ],
        }
    }

    /// Force and moment about the link origin that give this link its motion, in the link frame.
    ///
    /// `I ω̇ + ω × (I ω)` written out by parameter: most of what meets Ixy, Ixz and Iyz are entries of U.
    #[inline(always)]
    fn wrench(&self, motion: &LinkMotion) -> Wrench {
        let [wx, wy, wz] = motion.omega.0;
        let [ax, ay, az] = motion.alpha.0;
        let [u_x, u_y, u_z] = motion.u.0;
        let ([_, uxy, uxz], [uyx, _, uyz], [uzx, uzy, _]) = (u_x.0, u_y.0, u_z.0);
        let [xx, yy, zz] = self.diagonal;
        let [xy, xz, yz] = self.products;
        let turning = Vector([
            xx * ax + (zz - yy) * (wy * wz) + yz * (wy * wy - wz * wz) - xy * uzx + xz * uyx,
            yy * ay + (xx - zz) * (wx * wz) + xz * (wz * wz - wx * wx) + xy * uzy - yz * uxy,
            zz * az + (yy - xx) * (wx * wy) + xy * (wx * wx - wy * wy) - xz * uyz + yz * uxz,
        ]);
        Wrench {
            f: motion.a.scale(self.mass) + motion.u.times(self.first_moment),
            n: self.first_moment.cross(motion.a) + turning,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arm::ur5::{JOINTS, PARAMETERS, Ur5};
    use crate::sines;

    #[test]
    fn the_parts_of_the_closed_form_add_up_to_the_torque() {
        let beta = BaseParameters::<PARAMETERS>::from(Ur5::NOMINAL);
        for pose in 0..200 {
            let wave = |j: usize| [2.5, 1.0 + 0.2 * j as f64, 2.3 * j as f64];
            let motion = sines(1.7 * f64::from(pose), wave);
            let JointMotion { q, qd, qdd } = motion;
            let sum = mass_matrix::<Ur5, JOINTS, PARAMETERS>(&beta, &q) * qdd
                + velocity_torque::<Ur5, JOINTS, PARAMETERS>(&beta, &q, &qd)
                + gravity_torque::<Ur5, JOINTS, PARAMETERS>(&beta, &q);
            let tau = rnea::<Ur5, JOINTS, PARAMETERS>(&beta, &motion);
            // A few roundings of torques up to 150 N·m, carried from M by accelerations up to 10 rad/s².
            assert!((sum - tau).amax() < 1e-3, "{}", (sum - tau).amax());
        }
    }
}
