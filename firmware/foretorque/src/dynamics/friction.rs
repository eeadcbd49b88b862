//! What a joint's drive takes for itself: friction, offset and cogging, linear in their parameters. Their columns belong
//! to the torque regressor of that joint alone.

use super::{BaseParameters, gravity_torque};
use crate::arm::Arm;
use crate::joint::JointVector;
use crate::math::{SinCos, bell, sin_cos_quarters, tanh_1_5_15};
use nalgebra::ArrayStorage;

/// Number of friction columns of one joint.
pub const FRICTION_COLUMNS: usize = 8;

/// Velocity over which Coulomb friction changes sign, rad/s: `sign(qd)` is smoothed to `tanh(qd / SIGN_WIDTH)`.
///
/// 0.01 rad/s is a tenth of the Stribeck velocity of the drives modelled here (0.10 rad/s) and a fifth of the 0.05 rad/s
/// under which learning ignores a joint, where the smoothed sign has reached 0.9999. The sign is that of the desired
/// velocity: it closes no loop that could chatter.
pub const SIGN_WIDTH: f32 = 0.01;
const INV_WIDEST_SIGN: f32 = 1.0 / (15.0 * SIGN_WIDTH);

/// Reciprocal of the Stribeck velocity, s/rad: 0.09 rad/s. With viscous friction, Coulomb friction and the bend beside it,
/// a peak of 0.08 to 0.10 rad/s is met to within 6 % of its height from 0.05 rad/s on, one of 0.07 or 0.12 to within 14 %.
const INV_STRIBECK: f32 = 1.0 / 0.09;
/// Reciprocal of the speed over which the friction of lubricated drives bends, s/rad: 0.6 rad/s.
///
/// Grease thins as it is sheared: friction grows ever less with speed, and a line through fast rows is wrong for slow ones.
/// The bend of a real UR5 reaches from tenths of a rad/s to more than one; how wide the column is matters little there.
const INV_BEND: f32 = 1.0 / 0.6;

/// Friction of one joint, linear in its parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrictionParameters {
    /// Viscous coefficient, N·m·s/rad.
    pub viscous: f32,
    /// Coulomb torque, N·m.
    pub coulomb: f32,
    /// Height of the Stribeck peak of width 0.09 rad/s, N·m.
    pub stribeck: f32,
    /// What slow motion has on top of Coulomb and viscous friction, gone to a half at 0.6 rad/s, N·m: negative where
    /// friction grows ever less with speed.
    pub bend: f32,
    /// Friction for each unit of the torque that the gear carries ([`friction_load`]): teeth and bearings are pressed
    /// together.
    pub load: f32,
    /// Torque that is always there, N·m.
    pub offset: f32,
    /// Amplitude of the cogging torque in phase with the sine, N·m.
    pub cogging_sin: f32,
    /// Amplitude of the cogging torque in phase with the cosine, N·m.
    pub cogging_cos: f32,
}

impl FrictionParameters {
    /// No friction.
    pub const NONE: Self = Self::from_columns([0.0; FRICTION_COLUMNS]);

    /// The parameters in the order of [`friction_row`].
    pub const fn columns(self) -> [f32; FRICTION_COLUMNS] {
        [
            self.viscous,
            self.coulomb,
            self.stribeck,
            self.bend,
            self.load,
            self.offset,
            self.cogging_sin,
            self.cogging_cos,
        ]
    }

    /// Parameters from the order of [`friction_row`].
    pub const fn from_columns(
        [
            viscous,
            coulomb,
            stribeck,
            bend,
            load,
            offset,
            cogging_sin,
            cogging_cos,
        ]: [f32; FRICTION_COLUMNS],
    ) -> Self {
        Self {
            viscous,
            coulomb,
            stribeck,
            bend,
            load,
            offset,
            cogging_sin,
            cogging_cos,
        }
    }
}

/// Bounds of friction that resists at every velocity and load: `Σ a_k c_k >= 0` over the columns c for each row a.
///
/// Viscous, Coulomb and load friction are not negative. Peak and bend may be, by half of the Coulomb torque each, so that
/// both together leave some. Offset and cogging do not resist and have no bound.
#[rustfmt::skip]
pub const RESISTING: [[f32; FRICTION_COLUMNS]; 5] = [
    [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    [0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    [0.0, 0.5, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    [0.0, 0.5, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0],
    [0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0],
];

/// The sign of a joint speed smoothed over three widths: `tanh(qd / width)`.
///
/// Friction takes the sharp one, the residual networks the other two. Their widths are multiples of each other, so that
/// one exponential serves all three.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SmoothedSign {
    /// Over 0.15 rad/s.
    pub wide: f32,
    /// Over 0.03 rad/s.
    pub narrow: f32,
    /// Over [`SIGN_WIDTH`].
    pub sharp: f32,
}

impl SmoothedSign {
    /// Of the speed `qd`, rad/s.
    ///
    /// Cost: one [`tanh_1_5_15`].
    #[inline(always)]
    pub fn of(qd: f32) -> Self {
        let [wide, narrow, sharp] = tanh_1_5_15(qd * INV_WIDEST_SIGN);
        Self {
            wide,
            narrow,
            sharp,
        }
    }
}

/// Sine and cosine of the cogging phase z q of a joint at `q`, rad; both 0 where there is no cogging.
///
/// * `cycles` z, cogging periods in one turn of the joint
///
/// The phase reaches 1269 rad on a UR5, beyond [`sin_cos`](crate::math::sin_cos): it is taken in quarter turns, which
/// are reduced exactly. What is left is the rounding of z 2/π q: phase within 1.6e-7 z |q| (2e-4 rad at one turn and
/// z = 202, 1e-4 N·m of the 0.5 N·m of a large joint).
///
/// Limits: NaN where z |q| exceeds 4.1e5 rad or `q` is no number.
/// Cost: one [`sin_cos_quarters`].
#[inline(always)]
pub fn cogging(cycles: f32, q: f32) -> SinCos {
    if cycles > 0.0 {
        sin_cos_quarters(cycles * core::f32::consts::FRAC_2_PI * q)
    } else {
        SinCos { sin: 0.0, cos: 0.0 }
    }
}

/// The friction columns of one joint at position `q`, rad, and velocity `qd`, rad/s, where its gear carries `load`, N·m.
///
/// ```text
/// viscous qd,   Coulomb s = tanh(qd / 0.01),   Stribeck s exp(−(qd / 0.09)²),   bend s / (1 + (qd / 0.6)²),
/// load s |load|,   offset 1,     cogging sin(z q) and cos(z q)
/// ```
///
/// * `cycles` z, cogging periods in one turn of the joint; 0 makes both cogging columns 0
///
/// Limits: those of [`cogging`].
/// Cost: one [`SmoothedSign`], one [`bell`], one [`cogging`], 8 multiplications.
#[inline(always)]
pub fn friction_row(cycles: f32, q: f32, qd: f32, load: f32) -> [f32; FRICTION_COLUMNS] {
    friction_columns(qd, SmoothedSign::of(qd).sharp, cogging(cycles, q), load)
}

/// [`friction_row`] where the smoothed sign and the cogging are known.
///
/// Cost: one [`bell`], one division, 6 multiplications.
#[inline(always)]
pub fn friction_columns(qd: f32, sign: f32, cogging: SinCos, load: f32) -> [f32; FRICTION_COLUMNS] {
    let bent = qd * INV_BEND;
    [
        qd,
        sign,
        sign * bell(qd * INV_STRIBECK),
        sign / (1.0 + bent * bent),
        sign * load.abs(),
        1.0,
        cogging.sin,
        cogging.cos,
    ]
}

/// What the gears carry at joint positions `q`, rad, as far as friction is reckoned with it: the gravity torques of the arm
/// as described, N × N·m.
///
/// Not of the arm as it has been learnt: friction stays linear in all that is learnt, and the column means the same in
/// every parameter set of one description. Not of the arm in motion: accelerations beyond what was learnt do not reach what
/// was learnt.
///
/// Cost: one [`gravity_torque`].
#[inline]
pub fn friction_load<A: Arm<N, P>, const N: usize, const P: usize>(
    q: &JointVector<N>,
) -> JointVector<N> {
    let described = const { &BaseParameters::from_array_storage(ArrayStorage([A::NOMINAL])) };
    gravity_torque::<A, N, P>(described, q)
}

/// Friction torques at joint positions `q` and velocities `qd`, N × N·m: what the drives must supply, so positive along
/// +qd.
///
/// Cost: one [`friction_load`]; one [`friction_row`], 7 multiply-adds a joint.
pub fn friction<A: Arm<N, P>, const N: usize, const P: usize>(
    parameters: &[FrictionParameters; N],
    q: &JointVector<N>,
    qd: &JointVector<N>,
) -> JointVector<N> {
    let load = friction_load::<A, N, P>(q);
    JointVector::from_fn(|joint, _| {
        let row = friction_row(A::COGGING_CYCLES[joint], q[joint], qd[joint], load[joint]);
        let [viscous, coulomb, stribeck, bend, load, _, sin, cos] = row;
        let p = &parameters[joint];
        p.viscous * viscous
            + p.coulomb * coulomb
            + p.stribeck * stribeck
            + p.bend * bend
            + p.load * load
            + p.offset
            + p.cogging_sin * sin
            + p.cogging_cos * cos
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arm::ur5::{JOINTS, PARAMETERS, Ur5};
    use crate::dynamics::rnea;
    use crate::joint::JointMotion;

    /// Torque of one such joint; it has no cogging of its own.
    fn torque(joint: FrictionParameters, qd: f32, load: f32) -> f32 {
        let row = friction_row(0.0, 0.0, qd, load);
        row.iter().zip(joint.columns()).map(|(x, p)| x * p).sum()
    }

    #[test]
    fn friction_opposes_motion_and_is_coulomb_plus_viscous_away_from_rest() {
        let joint = FrictionParameters {
            viscous: 12.0,
            coulomb: 7.0,
            stribeck: 1.0,
            load: 0.1,
            ..FrictionParameters::NONE
        };
        assert_eq!(torque(joint, 0.0, 50.0), 0.0);
        assert!((torque(joint, 1.5, 0.0) - 25.0).abs() < 1e-5);
        assert_eq!(torque(joint, -1.5, 0.0), -torque(joint, 1.5, 0.0));
        // The load presses the gear, whichever way it pulls.
        for load in [-50.0, 50.0] {
            assert!((torque(joint, 1.5, load) - 30.0).abs() < 1e-5);
            assert!((torque(joint, -1.5, load) + 30.0).abs() < 1e-5);
        }
    }

    #[test]
    fn cogging_keeps_its_phase_over_many_turns() {
        for cycles in [1.0f32, 36.0, 202.0, 411.0] {
            let mut worst = 0.0f64;
            for bits in (1e-3f32.to_bits()..=1000.0f32.to_bits()).step_by(997) {
                for q in [f32::from_bits(bits), -f32::from_bits(bits)] {
                    let [.., sin, cos] = friction_row(cycles, q, 0.0, 0.0);
                    let phase = f64::from(cycles) * f64::from(q);
                    let (true_sin, true_cos) = phase.sin_cos();
                    let error = (f64::from(sin) - true_sin).hypot(f64::from(cos) - true_cos);
                    worst = worst.max((error - 2e-7) / phase.abs());
                }
            }
            assert!(worst < 1.6e-7, "{worst:e} of the phase at {cycles}");
        }
    }

    #[test]
    fn a_joint_without_cogging_has_none_wherever_it_stands() {
        for q in [0.0, 1.0, f32::NAN, f32::INFINITY] {
            assert_eq!(friction_row(0.0, q, 0.0, 0.0)[5..], [1.0, 0.0, 0.0]);
        }
        assert!(friction_row(202.0, f32::INFINITY, 0.0, 0.0)[6].is_nan());
    }

    #[test]
    fn a_peak_of_another_width_and_friction_that_bends_are_met_by_the_columns() {
        let speeds = || (10..500).map(|step| step as f32 * 5e-3);
        let worst = |columns: [f32; 4], friction: &dyn Fn(f32) -> f32| {
            let errors = speeds().map(|qd| {
                let row = friction_row(0.0, 0.0, qd, 0.0);
                let said: f32 = row.iter().zip(columns).map(|(x, p)| x * p).sum();
                (said - friction(qd)).abs()
            });
            errors.fold(0.0f32, f32::max)
        };
        // Least squares over 0.05 … 2.5 rad/s.
        for (width, columns, bound) in [
            (0.07, [-0.0072, 0.0171, 0.701, -0.0320], 0.106),
            (0.08, [-0.0046, 0.0111, 0.864, -0.0207], 0.057),
            (0.1, [0.0065, -0.0155, 1.109, 0.0291], 0.054),
            (0.12, [0.0238, -0.0568, 1.253, 0.1072], 0.135),
        ] {
            let error = worst(columns, &|qd| (-(qd / width).powi(2)).exp());
            assert!(error < bound, "{error} for {width}");
        }
        // Grease that thins: 2 |qd|^0.7, which a line misses by 0.35.
        let error = worst([1.100, 1.104, -0.282, -0.736], &|qd| 2.0 * qd.powf(0.7));
        assert!(error < 0.05, "{error}");
    }

    #[test]
    fn the_load_is_what_gravity_asks_of_the_arm_as_described() {
        let described = BaseParameters::<PARAMETERS>::from(Ur5::NOMINAL);
        for step in 0..50 {
            let q = JointVector::from_fn(|joint, _| 3.0 * (step as f32 + 1.7 * joint as f32).sin());
            let still = JointMotion {
                q,
                ..JointMotion::zero()
            };
            let load = friction_load::<Ur5, JOINTS, PARAMETERS>(&q);
            let rigid = rnea::<Ur5, JOINTS, PARAMETERS>(&described, &still);
            assert!((load - rigid).amax() < 1e-4, "{load} {rigid}");
            // The first axis stands upright, the last one carries its link in the middle.
            assert!(load[0].abs() < 1e-4 && load[5].abs() < 1e-4, "{load}");
            let mut drives = [FrictionParameters::NONE; JOINTS];
            drives[1].load = 0.1;
            let qd = JointVector::repeat(-1.0);
            let friction = friction::<Ur5, JOINTS, PARAMETERS>(&drives, &q, &qd);
            assert!((friction[1] + 0.1 * rigid[1].abs()).abs() < 1e-5);
        }
        let nowhere = JointVector::repeat(f32::NAN);
        assert!(friction_load::<Ur5, JOINTS, PARAMETERS>(&nowhere)[1].is_nan());
    }

    #[test]
    fn friction_within_its_bounds_resists_at_every_velocity_and_load() {
        for columns in [
            [0.0, 3.0, -1.5, -1.5, 0.0, 0.0, 0.0, 0.0],
            [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            [0.5, 4.0, -2.0, 1.0, 0.1, 0.0, 0.0, 0.0],
        ] {
            for bound in &RESISTING {
                let value: f32 = bound.iter().zip(&columns).map(|(a, c)| a * c).sum();
                assert!(value >= 0.0, "{columns:?} violates {bound:?}");
            }
            let friction = FrictionParameters::from_columns(columns);
            for step in 1..400 {
                let tau = torque(friction, step as f32 * 5e-3, 20.0);
                assert!(tau >= 0.0, "{tau} of {columns:?}");
            }
        }
    }
}
