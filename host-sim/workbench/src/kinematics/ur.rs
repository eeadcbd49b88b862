//! Closed-form inverse kinematics of arms built like Universal Robots': axes 2, 3, 4 parallel, 1 ⟂ 2, 4 ⟂ 5 ⟂ 6, where
//! perpendicular neighbours meet.
//!
//! The derivation is that of K. P. Hawkins, "Analytic Inverse Kinematics for the Universal Robots UR-5/UR-10 Arms"
//! (Georgia Tech, 2013) and R. Keating, "UR5 Inverse Kinematics" (Johns Hopkins, 2014), with three departures: the DH
//! parameters and joint offsets are found from the description's own frames, so that a URDF of the same arm works; θ5
//! comes from sine and cosine, because the arc cosine loses half the digits near the wrist's singularity; the offsets
//! d2, d3, d4 along the parallel axes count as their sum D.
//!
//! ```text
//! T06 = Rz(θ1) Tz(d1) Rx(90°) · Rz(θ2) Tx(a2) Rz(θ3) Tx(a3) Rz(θ4) Tz(D) Rx(90°) · Rz(θ5) Tz(d5) Rx(−90°) · Rz(θ6)
//! ```

use crate::Refusal;
use crate::robot::Placement;
use nalgebra::{Matrix3, Rotation3, Vector3};
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Directions and lengths (m) this close are meant to be equal.
const EXACT: f64 = 1e-9;
/// Sines this small leave an angle undetermined.
const UNDETERMINED: f64 = 1e-9;
/// A cosine may exceed 1 by this much: rounding of a target at the very end of the reach.
const ROUNDING: f64 = 1e-12;

/// The parameters of such an arm, and where its description's zeros are.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct UrArm {
    base: Placement,
    /// From the tip back to frame 6.
    wrist: Placement,
    /// θ_i = q_i + offset_i.
    offset: [f64; 6],
    d1: f64,
    a2: f64,
    a3: f64,
    across: f64,
    d5: f64,
}

/// A placement of the next axis, taken apart: `Rz(before) Tz(lift) Tx(a) Rx(twist) Tz(slide) Rz(after)`.
struct Step {
    before: f64,
    lift: f64,
    a: f64,
    slide: f64,
    after: f64,
}

impl Step {
    /// The next axis is parallel and elsewhere.
    fn parallel(placement: &Placement) -> Option<Self> {
        let (rot, o) = (&placement.rot_parent_child, &placement.origin);
        let a = o.x.hypot(o.y);
        if rot.m33 < 1.0 - EXACT || a < EXACT {
            return None;
        }
        let before = o.y.atan2(o.x);
        Some(Self {
            before,
            lift: o.z,
            a,
            slide: 0.0,
            after: rot.m21.atan2(rot.m11) - before,
        })
    }

    /// The next axis meets this one at a right angle; `twist` is ±90°, and both signs can be had by turning x round.
    fn crossing(placement: &Placement, twist: f64) -> Option<Self> {
        let (rot, o) = (&placement.rot_parent_child, &placement.origin);
        let z: Vector3<f64> = rot.column(2).into_owned();
        let x = Vector3::z().cross(&z) * twist.signum();
        if z.z.abs() > EXACT || o.dot(&x).abs() > EXACT {
            return None;
        }
        let before = x.y.atan2(x.x);
        let left = Rotation3::from_euler_angles(twist, 0.0, 0.0).inverse()
            * Rotation3::from_euler_angles(0.0, 0.0, -before);
        let after = left.matrix() * rot;
        Some(Self {
            before,
            lift: o.z,
            a: 0.0,
            slide: o.dot(&z),
            after: after.m21.atan2(after.m11),
        })
    }
}

impl UrArm {
    /// The arm, if these placements and tip make one.
    pub(super) fn of(placements: &[Placement], tip: &Placement) -> Option<Self> {
        let [base, p2, p3, p4, p5, p6] = placements else {
            return None;
        };
        let s2 = Step::crossing(p2, FRAC_PI_2)?;
        let s3 = Step::parallel(p3)?;
        let s4 = Step::parallel(p4)?;
        let s5 = Step::crossing(p5, FRAC_PI_2)?;
        let s6 = Step::crossing(p6, -FRAC_PI_2)?;
        let slide = Placement {
            rot_parent_child: Matrix3::identity(),
            origin: Vector3::new(0.0, 0.0, s6.slide),
        };
        Some(Self {
            base: *base,
            wrist: slide.then(tip).inverse(),
            offset: [
                s2.before,
                s2.after + s3.before,
                s3.after + s4.before,
                s4.after + s5.before,
                s5.after + s6.before,
                s6.after,
            ],
            d1: s2.lift,
            a2: s3.a,
            a3: s4.a,
            across: s2.slide + s3.lift + s4.lift + s5.lift,
            d5: s5.slide + s6.lift,
        })
    }

    /// All joint positions that put the tip at `target`, rad within ±π: up to eight.
    ///
    /// * `free` position of joint 6 to take where axes 4 and 6 are parallel and only the sum of both is determined
    ///
    /// Errors: the reason of the branch that misses by least.
    pub(super) fn solutions(
        &self,
        target: &Placement,
        free: f64,
    ) -> Result<Vec<[f64; 6]>, Refusal> {
        let t06 = self.base.inverse().then(target).then(&self.wrist);
        let (rot, p) = (&t06.rot_parent_child, &t06.origin);
        let (distance, heading) = (p.x.hypot(p.y), p.y.atan2(p.x));
        // p · z1 = D with z1 = (sin θ1, −cos θ1, 0): distance · sin(θ1 − heading) = D.
        let lean = arcsine(self.across / distance).ok_or_else(|| {
            out_of_reach(format!(
                "the wrist would be {distance:.3} m from the axis of joint 1, the arm passes it at {:.3} m",
                self.across.abs()
            ))
        })?;
        let mut found = Vec::with_capacity(8);
        let mut missed: Option<(f64, Refusal)> = None;
        for theta1 in [heading + lean, heading + PI - lean] {
            let (s1, c1) = theta1.sin_cos();
            let (x1, z1) = (Vector3::new(c1, s1, 0.0), Vector3::new(s1, -c1, 0.0));
            // z1 in frame 6 is (s5 c6, −s5 s6, c5).
            let v = rot.tr_mul(&z1);
            let s5 = v.x.hypot(v.y);
            for sign in [1.0, -1.0] {
                let theta5 = (sign * s5).atan2(v.z);
                let theta6 = if s5 < UNDETERMINED {
                    free + self.offset[5]
                } else {
                    (-sign * v.y).atan2(sign * v.x)
                };
                let (s6, c6) = theta6.sin_cos();
                let (sin5, cos5) = theta5.sin_cos();
                // Axis of joint 5, and x of frame 4, from frame 6 into the base.
                let z4 = -(rot * Vector3::new(s6, c6, 0.0));
                let x4 = rot * Vector3::new(cos5 * c6, -cos5 * s6, -sin5);
                let theta234 = x4.z.atan2(x4.dot(&x1));
                let wrist = p - z4 * self.d5;
                let (px, py) = (wrist.dot(&x1), wrist.z - self.d1);
                match self.elbow(px, py) {
                    Ok(bend) => {
                        for theta3 in [bend, -bend] {
                            let (s3, c3) = theta3.sin_cos();
                            let theta2 =
                                py.atan2(px) - (self.a3 * s3).atan2(self.a2 + self.a3 * c3);
                            let theta4 = theta234 - theta2 - theta3;
                            let theta = [theta1, theta2, theta3, theta4, theta5, theta6];
                            found.push(std::array::from_fn(|i| {
                                (theta[i] - self.offset[i] + PI).rem_euclid(TAU) - PI
                            }));
                        }
                    }
                    Err((short, error)) => {
                        if missed.as_ref().is_none_or(|(least, _)| short < *least) {
                            missed = Some((short, error));
                        }
                    }
                }
            }
        }
        match missed {
            Some((_, error)) if found.is_empty() => Err(error),
            _ => Ok(found),
        }
    }

    /// θ3 ≥ 0 of the planar arm a2, a3 that reaches (x, y); or by how much it does not, and why.
    fn elbow(&self, x: f64, y: f64) -> Result<f64, (f64, Refusal)> {
        let square = x * x + y * y;
        let cosine = (square - self.a2 * self.a2 - self.a3 * self.a3) / (2.0 * self.a2 * self.a3);
        if cosine.abs() <= 1.0 + ROUNDING {
            return Ok(cosine.clamp(-1.0, 1.0).acos());
        }
        let distance_m = square.sqrt();
        let (reach_m, least_m) = (self.a2 + self.a3, (self.a2 - self.a3).abs());
        let (short_m, limit) = if cosine > 0.0 {
            (
                distance_m - reach_m,
                format!("the arm is {reach_m:.3} m long"),
            )
        } else {
            (least_m - distance_m, format!("folded it is {least_m:.3} m"))
        };
        let wrist = format!("the wrist would be {distance_m:.3} m from the axis of joint 2");
        Err((short_m, out_of_reach(format!("{wrist}, {limit}"))))
    }

    /// Parts that are nearly in line at `q`, if any.
    pub(super) fn posture(&self, q: &[f64; 6]) -> &'static str {
        let sine = |joint: usize| (q[joint] + self.offset[joint]).sin().abs();
        // Sines of the wrist and the elbow compare; what is left is the shoulder.
        if sine(4) < 1e-2 {
            "axes 4 and 6 are parallel (wrist)"
        } else if sine(2) < 1e-2 {
            "the arm is stretched or folded (elbow)"
        } else {
            "the wrist stands over the shoulder"
        }
    }
}

/// The refusal of a pose that no joint positions have.
pub(super) fn out_of_reach(reason: String) -> Refusal {
    Refusal::of("out of reach", reason)
}

fn arcsine(sine: f64) -> Option<f64> {
    (sine.abs() <= 1.0 + ROUNDING).then(|| sine.clamp(-1.0, 1.0).asin())
}
