//! Elastic gears with backlash.

use super::PlantEffects;
use crate::dynamics::Joints;
use crate::robot::Robot;
use nalgebra::SMatrix;

/// Elastic gears between the rotors, where the encoders are, and the links.
#[derive(Clone, Debug)]
pub(super) struct Gear<const N: usize> {
    pub(super) stiffness: Joints<N>,
    damping: Joints<N>,
    pub(super) rotor: Joints<N>,
    half_backlash: f64,
    /// Factor of the torque loop on rotor inertia and friction.
    pub(super) loop_factor: f64,
    /// Positions, rad, and velocities, rad/s, of the links.
    pub(super) q: Joints<N>,
    pub(super) qd: Joints<N>,
    /// Torque of the gears on the links, N·m.
    pub(super) torque: Joints<N>,
}

impl<const N: usize> Gear<N> {
    /// Gears of `robot`, untwisted in q = 0; `None` when it has not `N` joints.
    pub(super) fn new(
        robot: &Robot,
        effects: &PlantEffects,
        torque_limit: &Joints<N>,
    ) -> Option<Self> {
        let rotor = Joints::from(robot.each(|joint| joint.drive.rotor_inertia)?);
        let stiffness: Joints<N> = torque_limit / (1e-3 * effects.twist_mrad);
        let critical = |k: f64, j: f64| 2.0 * effects.twist_damping * (k * j).sqrt();
        Some(Self {
            damping: stiffness.zip_map(&rotor, critical),
            stiffness,
            rotor,
            half_backlash: 0.5e-3 * effects.backlash_mrad,
            loop_factor: 1.0 / (1.0 + effects.torque_loop_gain),
            q: Joints::zeros(),
            qd: Joints::zeros(),
            torque: Joints::zeros(),
        })
    }

    /// Moves the links by a step of `h` s and returns the accelerations of the rotors, rad/s².
    ///
    /// Link and rotor accelerations a, b under the gear torque `s = K e + D ė` [Spong 1987, eqs. 2.10, 2.11], with
    /// `e = θ − q` outside the backlash. Spring, damper and friction act at the end of the step, so any stiffness is stable:
    ///
    /// ```text
    /// s = s0 + G (b − a),  s0 = K e + (h K + D) ė,  G = h (h K + D)
    /// M a = s + load,  (J + h F) b = made − f − s
    /// ```
    /// The rotor equation is diagonal and is eliminated: `(M + G − G²/A) a = s0 + load + G r / A`, `A = J + h F + G`,
    /// `r = made − f − s0`.
    ///
    /// * `rotors` positions θ, rad, and velocities, rad/s
    /// * `mass` mass matrix at the links' positions, rotors included
    /// * `made`, `load` torque of the drives; torque on the links without the gears', N·m
    /// * `friction` torque f and slope F
    pub(super) fn step(
        &mut self,
        rotors: (&Joints<N>, &Joints<N>),
        mut mass: SMatrix<f64, N, N>,
        (made, load): (Joints<N>, Joints<N>),
        friction: (&Joints<N>, &Joints<N>),
        h: f64,
    ) -> Joints<N> {
        let (mut s0, mut g, mut a, mut r) = (load, load, load, load);
        for j in 0..N {
            let (twist, rate) = (rotors.0[j] - self.q[j], rotors.1[j] - self.qd[j]);
            let play = twist + h * rate;
            let contact = if play.abs() <= self.half_backlash && self.half_backlash > 0.0 {
                0.0
            } else {
                1.0
            };
            let (k, d) = (contact * self.stiffness[j], contact * self.damping[j]);
            s0[j] = k * (twist - self.half_backlash.copysign(play)) + (h * k + d) * rate;
            g[j] = h * (h * k + d);
            a[j] = (self.loop_factor * (self.rotor[j] + h * friction.1[j]) + g[j]).max(1e-9);
            r[j] = made[j] - self.loop_factor * friction.0[j] - s0[j];
            mass[(j, j)] -= self.rotor[j];
        }
        let coupled = g - g.component_mul(&g).component_div(&a);
        let link = solved(
            mass,
            &coupled,
            &(s0 + load + g.component_mul(&r).component_div(&a)),
        );
        let rotor = (r + g.component_mul(&link)).component_div(&a);
        self.torque = s0 + g.component_mul(&(rotor - link));
        self.qd += link * h;
        self.q += self.qd * h;
        rotor
    }
}

/// Solution of `(M + diag) a = force`.
pub(super) fn solved<const N: usize>(
    mut mass: SMatrix<f64, N, N>,
    diagonal: &Joints<N>,
    force: &Joints<N>,
) -> Joints<N> {
    for j in 0..N {
        mass[(j, j)] += diagonal[j];
    }
    // The mass matrix of a physical arm is positive definite; rotor inertias keep it well so.
    mass.cholesky().map_or(Joints::zeros(), |m| m.solve(force))
}
