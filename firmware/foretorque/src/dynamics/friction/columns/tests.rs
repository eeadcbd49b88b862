use super::super::{SmoothedSign, cogging, friction, friction_load, friction_row};
use super::*;
use crate::arm::ur5::{JOINTS, PARAMETERS, Ur5};
use crate::joint::JointVector;

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
        let sign = SmoothedSign::of(qd).sharp;
        let cogging = cogging(202.0, 0.013 * step as f32);
        let single = FrictionPoint {
            qd,
            sign,
            load: -7.0 * sign,
            cogging_sin: cogging.sin,
            cogging_cos: cogging.cos,
        };
        let double = FrictionPoint {
            qd: f64::from(qd),
            sign: f64::from(sign),
            load: -7.0 * f64::from(sign),
            cogging_sin: f64::from(cogging.sin),
            cogging_cos: f64::from(cogging.cos),
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
