//! Friction of the simulated drives, and elastic gears with backlash.

use super::{PlantConfig, PlantEffects};
use crate::dynamics::Joints;
use crate::robot::{Friction, Robot};
use nalgebra::SMatrix;

/// Speed at which the smoothed sign of the Coulomb torque has reached 76 %, rad/s. Ten times below the speed that counts
/// as moving, so that the truth is a true Coulomb torque there; the integrator takes its slope implicitly.
const SIGN_WIDTH_RAD_S: f64 = 0.005;

/// Friction power that warms a drive half way, share of torque limit times speed limit.
const HALF_WARM_SHARE: f64 = 0.05;

/// Friction of all joints: viscous with drift, Coulomb with a part under load, Stribeck peak, cogging.
///
/// ```text
/// tau = d(t) w v qd + g(qd) tanh(qd / 0.005) + c_g sin(z q),   g(qd) = c (1 + s exp(−(qd / v_s)²)) + l |load|
/// ```
/// with d(t) the drift, w the fall of viscous friction in a warm drive, and load the torque against gravity and velocity
/// products. At qd = 0 the speed-dependent part is zero: a joint at rest has no friction and creeps under load.
///
/// With a presliding displacement x the Coulomb part is that of the LuGre model [Canudas de Wit 1995, eqs. 1–3]:
/// `σ0 z + σ1 dz/dt`, `dz/dt = qd − σ0 |qd| / g(qd) z`, `σ0 = c / x`, `σ1 = sqrt(σ0 J)`: the joint sticks.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct DriveFriction<const N: usize> {
    joints: [Friction; N],
    /// Relative growth of the viscous coefficient, 1/s.
    pub(super) viscous_drift: f64,
    /// Coulomb torque for each N·m of load.
    load: f64,
    /// Stiffness σ0, N·m/rad, and damping σ1, N·m·s/rad, before a joint slides; `None` without presliding.
    bristles: [Option<(f64, f64)>; N],
    /// Fall of viscous friction in a warm drive, share; time constant, s; friction power of half of it, W.
    warm_fall: f64,
    warm_up_s: f64,
    half_warm: [f64; N],
    /// Deflection z of the bristles, rad, and divisor of its implicit step.
    deflection: Joints<N>,
    divisor: Joints<N>,
    /// Warmth of every drive, 0 to 1.
    warmth: Joints<N>,
}

impl<const N: usize> DriveFriction<N> {
    /// Cold drives without deflection; `None` when the robot has not `N` joints.
    pub(super) fn new(robot: &Robot, config: &PlantConfig) -> Option<Self> {
        let effects = &config.effects;
        let bristles = robot.each(|joint| {
            let stiffness = joint.friction.coulomb / (1e-3 * effects.presliding_mrad);
            // Without Coulomb friction there are no bristles.
            (effects.presliding_mrad > 0.0 && joint.friction.coulomb > 0.0)
                .then_some((stiffness, (stiffness * joint.drive.rotor_inertia).sqrt()))
        })?;
        Some(Self {
            joints: robot.each(|joint| joint.friction)?,
            viscous_drift: config.viscous_drift,
            load: config.load_friction,
            bristles,
            warm_fall: effects.warm_viscous_fall,
            warm_up_s: effects.warm_up_s,
            half_warm: robot
                .each(|joint| HALF_WARM_SHARE * joint.limits.torque * joint.limits.velocity)?,
            deflection: Joints::zeros(),
            divisor: Joints::repeat(1.0),
            warmth: Joints::zeros(),
        })
    }

    /// Ends a step of `h` s that has left the velocity at `qd`.
    pub(super) fn advance(&mut self, qd: &Joints<N>, h: f64) {
        self.deflection = (self.deflection + qd * h).component_div(&self.divisor);
    }

    /// Torque the drives must supply against steady friction, N·m, and its slope over the velocity, N·m·s/rad.
    pub(super) fn torque_and_slope(
        &self,
        q: &Joints<N>,
        qd: &Joints<N>,
        load: &Joints<N>,
        t_s: f64,
    ) -> (Joints<N>, Joints<N>) {
        let (mut torque, mut slope) = (Joints::zeros(), Joints::zeros());
        for j in 0..N {
            let (viscous, coulomb, cogging) = self.parts(j, q[j], qd[j], load[j], t_s);
            let sign = (qd[j] / SIGN_WIDTH_RAD_S).tanh();
            torque[j] = viscous * qd[j] + coulomb * sign + cogging;
            // The falling flank of the Stribeck peak is left out of the slope: only what damps is taken implicitly.
            slope[j] = viscous + coulomb * (1.0 - sign * sign) / SIGN_WIDTH_RAD_S;
        }
        (torque, slope)
    }

    /// Torque and slope at the begin of a step of `h` s; with presliding that of the deflected bristles.
    ///
    /// `z' = (z + h qd') / (1 + h σ0 |qd| / g)`: the new velocity qd' enters linearly, so the slope is exact.
    pub(super) fn begin_step(
        &mut self,
        q: &Joints<N>,
        qd: &Joints<N>,
        load: &Joints<N>,
        (t_s, h): (f64, f64),
    ) -> (Joints<N>, Joints<N>) {
        let (mut torque, mut slope) = self.torque_and_slope(q, qd, load, t_s);
        for j in 0..N {
            let Some((stiffness, damping)) = self.bristles[j] else {
                continue;
            };
            let (viscous, coulomb, cogging) = self.parts(j, q[j], qd[j], load[j], t_s);
            let divisor = 1.0 + h * stiffness * qd[j].abs() / coulomb;
            let z = self.deflection[j];
            let next = (z + h * qd[j]) / divisor;
            let bristles = stiffness * next + damping * (next - z) / h;
            torque[j] = viscous * qd[j] + bristles + cogging;
            slope[j] = viscous + (stiffness * h + damping) / divisor;
            self.divisor[j] = divisor;
        }
        (torque, slope)
    }

    /// Warms the drives by the power of friction over `period_s`: `dw/dt = (p / (1 + p) − w) / T`.
    pub(super) fn warm(&mut self, friction: &Joints<N>, qd: &Joints<N>, period_s: f64) {
        if self.warm_up_s > 0.0 {
            for j in 0..N {
                let power = (friction[j] * qd[j]).abs() / self.half_warm[j];
                let step = (period_s / self.warm_up_s).min(1.0);
                self.warmth[j] += step * (power / (1.0 + power) - self.warmth[j]);
            }
        }
    }

    /// Viscous coefficient, Coulomb torque of a sliding joint and cogging torque of joint `j`.
    fn parts(&self, j: usize, q: f64, qd: f64, load: f64, t_s: f64) -> (f64, f64, f64) {
        let friction = &self.joints[j];
        let warm = 1.0 - self.warm_fall * self.warmth[j];
        let viscous = friction.viscous * (1.0 + self.viscous_drift * t_s).max(0.0) * warm;
        let ratio = qd / friction.stribeck_velocity;
        let peak = friction.stribeck_ratio * (-ratio * ratio).exp();
        let cogging = friction.cogging * (friction.cogging_cycles_rev * q).sin();
        let coulomb = friction.coulomb * (1.0 + peak) + self.load * load.abs();
        (viscous, coulomb, cogging)
    }
}

/// Elastic gears between the rotors, where the encoders are, and the links.
#[derive(Clone, Debug)]
pub(super) struct Gear<const N: usize> {
    pub(super) stiffness: Joints<N>,
    damping: Joints<N>,
    pub(super) rotor: Joints<N>,
    pub(super) half_backlash: f64,
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
            let loose = play.abs() <= self.half_backlash && self.half_backlash > 0.0;
            let contact = f64::from(!loose);
            let (k, d) = (contact * self.stiffness[j], contact * self.damping[j]);
            s0[j] = k * (twist - self.half_backlash.copysign(play)) + (h * k + d) * rate;
            g[j] = h * (h * k + d);
            a[j] = (self.loop_factor * (self.rotor[j] + h * friction.1[j]) + g[j]).max(1e-9);
            r[j] = made[j] - self.loop_factor * friction.0[j] - s0[j];
            mass[(j, j)] -= self.rotor[j];
        }
        let coupled = g - g.component_mul(&g).component_div(&a);
        let force = s0 + load + g.component_mul(&r).component_div(&a);
        let link = solved(mass, &coupled, &force);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::PlantEffects;

    fn model(viscous_drift: f64, load_friction: f64, effects: PlantEffects) -> DriveFriction<6> {
        let robot = Robot::load("ur5").expect("built in");
        let config = PlantConfig {
            viscous_drift,
            load_friction,
            effects,
            ..PlantConfig::default()
        };
        DriveFriction::new(&robot, &config).expect("six joints")
    }

    fn steady(model: &DriveFriction<6>, q: &Joints<6>, qd: f64, load: f64, t_s: f64) -> Joints<6> {
        let (qd, load) = (Joints::repeat(qd), Joints::repeat(load));
        model.torque_and_slope(q, &qd, &load, t_s).0
    }

    #[test]
    fn friction_has_its_described_values_far_from_standstill() {
        let robot = Robot::load("ur5").expect("built in");
        let (model, zero) = (model(0.0, 0.0, PlantEffects::default()), Joints::zeros());
        assert_eq!(steady(&model, &zero, 0.0, 0.0, 0.0), zero);
        let fast = steady(&model, &zero, -2.0, 0.0, 0.0);
        let slow = steady(&model, &zero, 0.05, 0.0, 0.0);
        for (j, joint) in robot.joints.iter().enumerate() {
            let f = joint.friction;
            assert!((fast[j] + f.coulomb + 2.0 * f.viscous).abs() < 1e-9);
            // At half the Stribeck velocity the peak has fallen to exp(−1/4).
            let expected = f.viscous * 0.05 + f.coulomb * (1.0 + 0.25 * (-0.25_f64).exp());
            assert!((slow[j] - expected).abs() < 1e-6);
        }
    }

    #[test]
    fn cogging_is_periodic_drift_viscous_and_load_adds_coulomb() {
        let robot = Robot::load("ur5").expect("built in");
        let drifting = model(0.3 / 600.0, 0.0, PlantEffects::default());
        let loaded = model(0.0, 0.1, PlantEffects::default());
        let q = Joints::<6>::repeat(0.3);
        let turn = Joints::repeat(std::f64::consts::TAU / 202.0);
        let here = steady(&drifting, &q, 1.0, 0.0, 0.0);
        let next = steady(&drifting, &(q + turn), 1.0, 0.0, 0.0);
        let half = steady(&drifting, &(q + turn * 0.5), 1.0, 0.0, 0.0);
        let late = steady(&drifting, &q, 1.0, 0.0, 600.0);
        let heavy = steady(&loaded, &q, 1.0, -20.0, 0.0);
        assert!((heavy - here - Joints::repeat(2.0)).amax() < 1e-9);
        assert!((here - next).amax() < 1e-9);
        assert!((here - half).amax() > 0.1);
        for (j, joint) in robot.joints.iter().enumerate() {
            assert!((late[j] - here[j] - 0.3 * joint.friction.viscous).abs() < 1e-9);
        }
        // Friction that falls for long is gone, and drives nothing.
        let falling = model(-0.9 / 600.0, 0.0, PlantEffects::default());
        let gone = [1200.0, 2400.0].map(|t_s| steady(&falling, &q, 1.0, 0.0, t_s));
        assert_eq!(gone[0], gone[1]);
    }

    #[test]
    fn bristles_hold_like_a_spring_and_slide_at_the_steady_torque() {
        let effects = PlantEffects {
            presliding_mrad: 0.5,
            ..PlantEffects::default()
        };
        let (mut model, zero, h) = (model(0.0, 0.0, effects), Joints::<6>::zeros(), 1.25e-4);
        let mut run = |qd: f64, steps: usize| {
            let (qd, mut torque) = (Joints::repeat(qd), Joints::zeros());
            for _ in 0..steps {
                torque = model.begin_step(&zero, &qd, &zero, (0.0, h)).0;
                model.advance(&qd, h);
            }
            torque
        };
        // 20 µrad at 10 mrad/s: far below the displacement of 0.5 mrad it is a spring.
        let stretched = run(0.01, 16);
        let sliding = run(1.0, 800);
        let back = run(-1.0, 800);
        let still = run(0.0, 8);
        for j in 0..6 {
            let friction = model.joints[j];
            let (stiffness, damping) = model.bristles[j].expect("presliding");
            assert!((stiffness - friction.coulomb / 0.5e-3).abs() < 1e-6);
            let spring = stretched[j] - 0.01 * friction.viscous;
            let expected = stiffness * 2e-5 + 0.01 * damping;
            assert!((spring / expected - 1.0).abs() < 0.06, "{spring}");
            assert!((sliding[j] - friction.viscous - friction.coulomb).abs() < 1e-3);
            assert!((sliding[j] + back[j]).abs() < 1e-3);
            // The bristles keep their torque at standstill.
            assert!((still[j] + friction.coulomb).abs() < 1e-3, "{}", still[j]);
        }
    }

    #[test]
    fn a_drive_that_works_becomes_warm_and_loses_viscous_friction() {
        let effects = PlantEffects {
            warm_viscous_fall: 0.4,
            warm_up_s: 100.0,
            ..PlantEffects::default()
        };
        let mut model = model(0.0, 0.0, effects);
        let at_speed = |model: &DriveFriction<6>| steady(model, &Joints::zeros(), 1.0, 0.0, 0.0);
        let cold = at_speed(&model);
        for _ in 0..1000 {
            let now = at_speed(&model);
            model.warm(&now, &Joints::repeat(1.0), 0.5);
        }
        let warm = at_speed(&model);
        for j in 0..6 {
            let fallen = (cold[j] - warm[j]) / model.joints[j].viscous;
            assert!((0.1..0.4).contains(&fallen), "{fallen}");
        }
    }
}
