//! Orientations as rotation vectors, and what their rates mean for the tool.

use nalgebra::{Matrix3, Rotation3, Vector3};

/// Below this angle, rad, the coefficients come from their series.
const SMALL: f64 = 1e-2;

/// Rotation matrix of axis × angle, rad.
pub(super) fn rotation(phi: &Vector3<f64>) -> Matrix3<f64> {
    Rotation3::from_scaled_axis(*phi).into_inner()
}

/// Angular velocity and acceleration of `exp([φ]×)` in the frame in which φ is expressed, rad/s and rad/s².
///
/// `ω = A φ̇`, `ω̇ = A φ̈ + Ȧ φ̇` with `A = 1 + b [φ]× + c [φ]×²`, `b = (1 − cos θ)/θ²`, `c = (θ − sin θ)/θ³`, θ = |φ|; and
/// `db/dθ = ((1 − c θ²) − 2 b)/θ`, `dc/dθ = (b − 3 c)/θ`                              [Bullo and Murray 1995, eq. 2.8]
pub(super) fn rates(
    phi: &Vector3<f64>,
    phid: &Vector3<f64>,
    phidd: &Vector3<f64>,
) -> (Vector3<f64>, Vector3<f64>) {
    let square = phi.norm_squared();
    let theta = square.sqrt();
    // (db/dθ)/θ and (dc/dθ)/θ: times φ·φ̇ they are ḃ and ċ.
    let (b, c, db, dc) = if theta < SMALL {
        (
            0.5 - square / 24.0,
            1.0 / 6.0 - square / 120.0,
            -1.0 / 12.0 + square / 180.0,
            -1.0 / 60.0 + square / 1260.0,
        )
    } else {
        let b = (1.0 - theta.cos()) / square;
        let c = (theta - theta.sin()) / (square * theta);
        (
            b,
            c,
            (1.0 - c * square - 2.0 * b) / square,
            (b - 3.0 * c) / square,
        )
    };
    let turn = phi.dot(phid);
    let apply = |x: &Vector3<f64>| x + phi.cross(x) * b + phi.cross(&phi.cross(x)) * c;
    let omega = apply(phid);
    // Ȧ φ̇; [φ̇]× φ̇ = 0 drops two of its terms.
    let drift = phi.cross(phid) * (db * turn)
        + phi.cross(&phi.cross(phid)) * (dc * turn)
        + phid.cross(&phi.cross(phid)) * c;
    (omega, apply(phidd) + drift)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinematics::rotation_vector;

    #[test]
    fn rates_are_derivatives_of_the_rotation() {
        for size in [0.0, 1e-3, 9e-3, 1.1e-2, 0.5, 2.0, 3.0] {
            let axis = Vector3::new(0.6, -0.64, 0.48);
            let (phid, phidd) = (Vector3::new(0.3, 0.7, -0.2), Vector3::new(-0.5, 0.1, 0.9));
            let at = |t: f64| axis * size + phid * t + phidd * (0.5 * t * t);
            let h = 1e-5;
            let step = rotation(&at(h)) * rotation(&at(-h)).transpose();
            let (omega, alpha) = rates(&at(0.0), &phid, &phidd);
            assert!(
                (rotation_vector(&step) / (2.0 * h) - omega).amax() < 1e-8,
                "{size}"
            );
            let omega_at = |t: f64| rates(&at(t), &(phid + phidd * t), &phidd).0;
            let slope = (omega_at(h) - omega_at(-h)) / (2.0 * h);
            assert!((slope - alpha).amax() < 1e-7, "{size}: {slope} {alpha}");
        }
    }
}
