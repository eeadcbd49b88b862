//! Friction, offset and cogging of the drives, linear in their parameters. Their columns belong to the torque regressor of
//! that joint alone.

mod columns;

pub use columns::{
    COGGING_COLUMNS, DISSIPATION_BOUNDS, FRICTION_COLUMNS, FrictionBound, FrictionColumn,
    FrictionParameters, FrictionPoint, FrictionPrior, FrictionProperties, RANDOM_WALK_COLUMNS,
    SHEAR_WIDTH, STRIBECK_WIDTH, friction_prior,
};

use super::{Angles, gravity_torque, gravity_torque_at};
use crate::arm::Arm;
use crate::joint::{JointVector, zero_vector};
use crate::math::{SinCos, gaussian, sin_cos_quarters, tanh_1_5_15};
use core::ops::{Add, Div, Mul};

/// Velocity over which Coulomb friction changes sign, rad/s: `sign(qd)` is smoothed to `tanh(qd / SIGN_WIDTH)`.
///
/// 0.01 rad/s is a tenth of the Stribeck velocity of the drives modelled here (0.10 rad/s). It is a fifth of the 0.05 rad/s
/// below which the learner skips a joint; there the smoothed sign has reached 0.9999. The sign is that of the desired
/// velocity: it closes no loop that could chatter.
pub const SIGN_WIDTH: f32 = 0.01;
const INV_WIDEST_SIGN: f32 = 1.0 / (15.0 * SIGN_WIDTH);

/// Sign of a joint velocity smoothed over three widths: `tanh(qd / width)`.
///
/// Friction uses the sharp one, the residual networks the other two. Their widths are multiples of each other, so that
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
    /// Smoothed signs of the velocity `qd`, rad/s.
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

/// Sine and cosine of the cogging phase z q of a joint at `q`, rad; both 0 without cogging.
///
/// * `cycles` z, cogging periods in one turn of the joint
///
/// The phase reaches 1269 rad on a UR5, beyond [`sin_cos`](crate::math::sin_cos): it is taken in quarter turns, which
/// are reduced exactly. What is left is the rounding of z 2/π q: phase within 1.6e-7 z |q| (2e-4 rad at one turn and
/// z = 202, 1e-4 N·m of the 0.5 N·m of a large joint).
///
/// Limits: NaN where z |q| exceeds 4.1e5 rad or `q` is not finite.
/// Cost: one [`sin_cos_quarters`].
#[inline(always)]
pub fn cogging(cycles: f32, q: f32) -> SinCos {
    if cycles > 0.0 {
        sin_cos_quarters(cycles * core::f32::consts::FRAC_2_PI * q)
    } else {
        SinCos { sin: 0.0, cos: 0.0 }
    }
}

impl FrictionPoint<f32> {
    /// Joint velocity `qd`, rad/s, its smoothed `sign`, [`cogging`], and `load` of the gear, N·m.
    #[inline(always)]
    pub fn new(qd: f32, sign: &SmoothedSign, cogging: SinCos, load: f32) -> Self {
        Self {
            qd,
            sign: sign.sharp,
            load,
            cogging_sin: cogging.sin,
            cogging_cos: cogging.cos,
        }
    }
}

/// Arithmetic of the basis functions: f32 with the kernels of [`math`](crate::math) in the tick, f64 with libm in identification.
pub trait Real: Copy + Add<Output = Self> + Mul<Output = Self> + Div<Output = Self> {
    /// 1.
    const ONE: Self;
    /// `self / width`.
    fn over(self, width: f64) -> Self;
    /// `exp(−self²)`.
    fn gaussian(self) -> Self;
    /// Absolute value.
    fn abs(self) -> Self;
}

impl Real for f32 {
    const ONE: Self = 1.0;

    #[inline(always)]
    fn over(self, width: f64) -> Self {
        // The reciprocal is a constant after inlining: no division in the tick.
        self * (1.0 / width as f32)
    }

    #[inline(always)]
    fn gaussian(self) -> Self {
        gaussian(self)
    }

    #[inline(always)]
    fn abs(self) -> Self {
        f32::abs(self)
    }
}

impl Real for f64 {
    const ONE: Self = 1.0;

    fn over(self, width: f64) -> Self {
        self / width
    }

    fn gaussian(self) -> Self {
        libm::exp(-(self * self))
    }

    fn abs(self) -> Self {
        f64::abs(self)
    }
}

/// Friction columns of one joint at position `q`, rad, velocity `qd`, rad/s, and gear torque `load`, N·m, in the order of
/// [`FrictionColumn::ALL`].
///
/// ```text
/// viscous qd,   Coulomb s = tanh(qd / 0.01),   Stribeck s exp(−(qd / 0.09)²),   shear thinning s / (1 + (qd / 0.6)²),
/// load s |load|,   offset 1,   cogging sin(z q) and cos(z q)
/// ```
///
/// * `cycles` z, cogging periods in one turn of the joint; 0 makes both cogging columns 0
///
/// Limits: those of [`cogging`].
/// Cost: one [`SmoothedSign`], one [`cogging`], one [`FrictionPoint::columns`].
#[inline(always)]
pub fn friction_row(cycles: f32, q: f32, qd: f32, load: f32) -> [f32; FRICTION_COLUMNS] {
    FrictionPoint::new(qd, &SmoothedSign::of(qd), cogging(cycles, q), load).columns()
}

/// Torque that the gears carry at joint positions `q`, rad, as the load column counts it: gravity torques of the nominal
/// model, N × N·m.
///
/// The nominal model and not the learned one: friction stays linear in all learned parameters, and the column means the
/// same in every parameter set of one description. Gravity alone: accelerations beyond the learned range do not reach
/// the learned friction.
///
/// Cost: one [`gravity_torque`].
#[inline]
pub fn friction_load<A: Arm<N, P>, const N: usize, const P: usize>(
    q: &JointVector<N>,
) -> JointVector<N> {
    gravity_torque::<A, N, P>(A::nominal(), q)
}

/// Pose of an arm: its joint angles, and the torques that the gears carry there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose<const N: usize> {
    /// Sines and cosines of the angles.
    pub angles: Angles<N>,
    /// [`friction_load`], N × N·m.
    pub load: JointVector<N>,
}

impl<const N: usize> Pose<N> {
    /// All angles zero, without load.
    pub(crate) const UPRIGHT: Self = Self {
        angles: Angles::ZERO,
        load: zero_vector(),
    };

    /// Pose at the joint positions `q`, N × rad; `None` if one is not a number or beyond ±1000 rad.
    #[inline]
    pub fn of<A: Arm<N, P>, const P: usize>(q: &JointVector<N>) -> Option<Self> {
        let mut pose = Self::UPRIGHT;
        pose.take::<A, P>(q).then_some(pose)
    }

    /// [`of`](Self::of) in place; false, and of no meaning, if there is no such pose.
    #[inline(never)]
    pub(crate) fn take<A: Arm<N, P>, const P: usize>(&mut self, q: &JointVector<N>) -> bool {
        if !self.angles.take(q) {
            return false;
        }
        self.load = gravity_torque_at::<A, N, P>(A::nominal(), &self.angles);
        true
    }
}

/// Friction torques at joint positions `q` and velocities `qd`, N × N·m: the drives must supply them, so they are positive
/// along +qd.
///
/// * `parameters` friction of every joint      * `q` rad      * `qd` rad/s
///
/// Limits: those of [`friction_load`] and [`cogging`].
/// Cost: one [`friction_load`]; one [`friction_row`] and one [`FrictionParameters::torque`] a joint.
pub fn friction<A: Arm<N, P>, const N: usize, const P: usize>(
    parameters: &[FrictionParameters; N],
    q: &JointVector<N>,
    qd: &JointVector<N>,
) -> JointVector<N> {
    friction_under::<A, N, P>(parameters, q, qd, &friction_load::<A, N, P>(q))
}

/// [`friction`] where the gears carry `load`, N × N·m; N × N·m.
///
/// Cost: that of [`friction`] without [`friction_load`].
#[inline(never)]
pub fn friction_under<A: Arm<N, P>, const N: usize, const P: usize>(
    parameters: &[FrictionParameters; N],
    q: &JointVector<N>,
    qd: &JointVector<N>,
    load: &JointVector<N>,
) -> JointVector<N> {
    JointVector::from_fn(|joint, _| {
        let row = friction_row(A::cogging_cycles()[joint], q[joint], qd[joint], load[joint]);
        parameters[joint].torque(&row)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arm::ur5::{JOINTS, PARAMETERS, Ur5};
    use crate::dynamics::{BaseParameters, rnea};
    use crate::joint::JointMotion;

    #[test]
    fn cogging_keeps_its_phase_over_many_turns() {
        for cycles in [1.0f32, 36.0, 202.0, 411.0] {
            let mut worst = 0.0f64;
            for bits in (1e-3f32.to_bits()..=1000.0f32.to_bits()).step_by(997) {
                for q in [f32::from_bits(bits), -f32::from_bits(bits)] {
                    let row = friction_row(cycles, q, 0.0, 0.0);
                    let [sin, cos] = COGGING_COLUMNS.map(|column| row[column as usize]);
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
    fn without_cogging_cycles_both_cogging_columns_are_zero() {
        for q in [0.0, 1.0, f32::NAN, f32::INFINITY] {
            let row = friction_row(0.0, q, 0.0, 0.0);
            assert!(COGGING_COLUMNS.map(|column| row[column as usize]) == [0.0, 0.0]);
            assert!(row.iter().sum::<f32>() == 1.0, "only the offset is left");
        }
        let row = friction_row(202.0, f32::INFINITY, 0.0, 0.0);
        assert!(row[FrictionColumn::CoggingSine as usize].is_nan());
    }

    #[test]
    fn the_columns_fit_other_peak_widths_and_shear_thinning() {
        let speeds = || (10..500).map(|step| step as f32 * 5e-3);
        let worst = |columns: [f32; 4], friction: &dyn Fn(f32) -> f32| {
            let errors = speeds().map(|qd| {
                let row = friction_row(0.0, 0.0, qd, 0.0);
                let fitted: f32 = row.iter().zip(columns).map(|(x, p)| x * p).sum();
                (fitted - friction(qd)).abs()
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
    fn the_load_is_the_gravity_torque_of_the_nominal_model() {
        let nominal = BaseParameters::<PARAMETERS>::from(Ur5::NOMINAL);
        for step in 0..50 {
            let q = JointVector::from_fn(|joint, _| 3.0 * (step as f32 + 1.7 * joint as f32).sin());
            let still = JointMotion {
                q,
                ..JointMotion::zero()
            };
            let load = friction_load::<Ur5, JOINTS, PARAMETERS>(&q);
            let rigid = rnea::<Ur5, JOINTS, PARAMETERS>(&nominal, &still);
            assert!((load - rigid).amax() < 1e-4, "{load} {rigid}");
            // The first axis stands upright, the last one carries its link in the middle.
            assert!(load[0].abs() < 1e-4 && load[5].abs() < 1e-4, "{load}");
            let mut drives = [FrictionParameters::NONE; JOINTS];
            drives[1][FrictionColumn::Load] = 0.1;
            let qd = JointVector::repeat(-1.0);
            let friction = friction::<Ur5, JOINTS, PARAMETERS>(&drives, &q, &qd);
            assert!((friction[1] + 0.1 * rigid[1].abs()).abs() < 1e-5);
        }
        let nowhere = JointVector::repeat(f32::NAN);
        assert!(friction_load::<Ur5, JOINTS, PARAMETERS>(&nowhere)[1].is_nan());
    }

    /// Drives with a parameter of its own in every column of every joint.
    fn every_column() -> [FrictionParameters; JOINTS] {
        core::array::from_fn(|joint| {
            FrictionParameters(core::array::from_fn(|k| {
                (0.3 + 0.2 * k as f32) * if (k + joint) % 3 == 0 { -1.0 } else { 1.0 }
            }))
        })
    }

    #[test]
    fn friction_is_the_sum_of_all_columns_written_out_in_f64() {
        let drives = every_column();
        for step in 0..60 {
            let q = JointVector::from_fn(|j, _| 2.5 * (step as f32 + 1.3 * j as f32).sin());
            let qd = JointVector::from_fn(|j, _| 0.4 * (1.9 * step as f32 + j as f32).sin());
            let load = friction_load::<Ur5, JOINTS, PARAMETERS>(&q);
            let tau = friction::<Ur5, JOINTS, PARAMETERS>(&drives, &q, &qd);
            for j in 0..JOINTS {
                let p = |column| f64::from(drives[j][column]);
                let (v, z) = (f64::from(qd[j]), 202.0 * f64::from(q[j]));
                let sign = (v / 0.01).tanh();
                let sum = p(FrictionColumn::Viscous) * v
                    + p(FrictionColumn::Coulomb) * sign
                    + p(FrictionColumn::Stribeck) * sign * (-(v / 0.09).powi(2)).exp()
                    + p(FrictionColumn::ShearThinning) * sign / (1.0 + (v / 0.6).powi(2))
                    + p(FrictionColumn::Load) * sign * f64::from(load[j]).abs()
                    + p(FrictionColumn::Offset)
                    + p(FrictionColumn::CoggingSine) * z.sin()
                    + p(FrictionColumn::CoggingCosine) * z.cos();
                assert!((f64::from(tau[j]) - sum).abs() < 3e-4, "joint {j}: {sum}");
            }
        }
    }

    #[test]
    fn the_columns_in_f32_and_f64_are_the_same_functions() {
        for step in -300..=300 {
            let qd = 0.01 * step as f32;
            let sign = SmoothedSign::of(qd);
            let cogging = cogging(202.0, 0.013 * step as f32);
            let single = FrictionPoint::new(qd, &sign, cogging, -7.0 * sign.sharp);
            let double = FrictionPoint {
                qd: f64::from(single.qd),
                sign: f64::from(single.sign),
                load: f64::from(single.load),
                cogging_sin: f64::from(single.cogging_sin),
                cogging_cos: f64::from(single.cogging_cos),
            };
            for (single, double) in single.columns().into_iter().zip(double.columns()) {
                let error = (f64::from(single) - double).abs();
                assert!(error < 1e-6, "{error:e} at {qd}");
            }
        }
    }

    #[test]
    fn the_table_gives_each_column_a_symbol_and_a_bank_kind_of_its_own() {
        let table = FrictionColumn::ALL.map(FrictionColumn::properties);
        for (k, column) in table.iter().enumerate() {
            assert_eq!(FrictionColumn::ALL[k] as usize, k);
            for other in &table[..k] {
                assert_ne!(column.symbol, other.symbol);
                assert_ne!(column.bank_kind, other.bank_kind);
            }
        }
    }

    #[test]
    fn friction_within_its_bounds_dissipates() {
        use FrictionColumn::{Coulomb, Load, ShearThinning, Stribeck, Viscous};
        let value = |friction: &FrictionParameters, bound: &[f32; FRICTION_COLUMNS]| -> f32 {
            bound.iter().zip(&friction.0).map(|(a, p)| a * p).sum()
        };
        let none = FrictionParameters::NONE;
        let coulomb = none.with(Coulomb, 4.0);
        for violated in [
            none.with(Viscous, -0.1),
            none.with(Coulomb, -0.1),
            coulomb.with(Stribeck, -2.1),
            coulomb.with(ShearThinning, -2.1),
            coulomb.with(Load, -0.1),
        ] {
            let below = DISSIPATION_BOUNDS
                .iter()
                .any(|bound| value(&violated, bound) < 0.0);
            assert!(below, "{violated:?}");
        }
        for friction in [
            none,
            coulomb.with(Stribeck, -2.0).with(ShearThinning, -2.0),
            coulomb
                .with(Viscous, 0.5)
                .with(Stribeck, -2.0)
                .with(Load, 0.1),
        ] {
            for bound in &DISSIPATION_BOUNDS {
                assert!(value(&friction, bound) >= 0.0, "{friction:?}, {bound:?}");
            }
            for step in 1..400 {
                let tau = friction.torque(&friction_row(0.0, 0.0, step as f32 * 5e-3, 20.0));
                assert!(tau >= 0.0, "{tau} of {friction:?}");
            }
        }
    }
}
