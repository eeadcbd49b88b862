//! The studies as their commands run them, in small.

use foretorque::arm::Arm;
use foretorque::arm::ur5::{JOINTS, PARAMETERS, Ur5};
use foretorque::dynamics::FrictionColumn;
use foretorque_studies::demo::{self, DemoConfig};
use foretorque_studies::learning::soak::{self, SoakConfig, SoakReport};
use foretorque_studies::learning::{self, LearningConfig, LearningReport};
use foretorque_studies::{Outcome, bank_of};
use foretorque_workbench::robot::Robot;

use crate::native;

fn learnt() -> LearningReport {
    let config = LearningConfig {
        seeds: (1, 1),
        only: Some("ur5/rigid".to_owned()),
        quick: true,
        robot: None,
    };
    learning::run(&config, &|_, _, _| {}).expect("runs").report
}

#[test]
fn a_rigid_arm_is_learnt_from_its_description_and_the_same_seed_gives_the_same_digits() {
    let first = learnt();
    let [scenario] = first.scenarios.as_slice() else {
        panic!("one run: {first:?}");
    };
    let figures = &scenario.figures;
    assert!(figures["unseen_over_start_ratio"] < 0.2, "{figures:?}");
    assert!(
        first.outcomes.iter().all(|own| own.met),
        "{:?}",
        first.outcomes
    );
    assert_eq!(first, learnt());
}

#[test]
fn a_short_soak_stays_finite_positive_and_where_exact_arithmetic_is() {
    let mut board = native::<Ur5, JOINTS, PARAMETERS>();
    let config = SoakConfig {
        seed: 1,
        ticks: 100_000,
        board_ticks: 5000,
    };
    let outcome = soak::run(&config, Some(&mut board), &|_, _, _| {});
    let report = outcome.expect("runs").report;
    assert_eq!(report.failure(), None);
    assert!(report.least_diagonal_ratio > 0.0, "{report:?}");
    // Rounding adds up: with a diagonal that leaks, 1.1e-3 by now and four times the bar in ten million ticks.
    assert!(report.twin_distance_worst_prior_sigmas < 4e-4, "{report:?}");
    assert!(report.twin_rows_count > 80_000, "{report:?}");
    assert_eq!(report.late_sets_count, 0);
    assert!(report.last_nrmse_moving_percent < 10.0, "{report:?}");
    for (not_finite, other_bits) in [(1, 0), (0, 1)] {
        let failed = SoakReport {
            not_finite_ticks_count: not_finite,
            board_ticks_with_other_bits_count: other_bits,
            ..report.clone()
        };
        assert!(failed.failure().is_some(), "{failed:?}");
    }
}

fn demonstrated() -> Outcome<demo::DemoReport> {
    let config = DemoConfig {
        learning_s: 6.0,
        usart_learning_s: 1.0,
        validation_s: 10.0,
        excitation_candidates: 5,
        ..DemoConfig::default()
    };
    let names = ("native".to_owned(), "test".to_owned());
    let [mut board, mut on_usart] = [(); 2].map(|()| native::<Ur5, JOINTS, PARAMETERS>());
    let boards = (&mut board, Some(&mut on_usart));
    demo::run(&config, names, boards, &|_, _, _| {}).expect("runs")
}

#[test]
fn six_seconds_of_learning_halve_the_torque_error_and_runs_repeat() {
    let outcome = demonstrated();
    let report = &outcome.report;
    let (before, after) = (report.torque_nrmse_before, report.torque_nrmse_after);
    assert!(before > 0.2 && after < 0.5 * before, "{before} {after}");
    let tracking = &report.tracking_rms_mrad;
    assert!(tracking.after < tracking.before && tracking.before < tracking.pd_only);
    assert_eq!(report.link.errors, 0);
    assert_eq!(outcome.broken, None);
    let usart = report.usart.as_ref().expect("a second board was given");
    assert_eq!(usart.ticks_with_equal_bits, usart.ticks);
    assert!(usart.torque_nrmse_after < usart.torque_nrmse_before);
    assert!(outcome.page.html().expect("plots").len() < 3_000_000);
    assert_eq!(outcome, demonstrated());
}

#[test]
fn the_bank_of_the_description_holds_the_nominal_parameters_of_the_firmware() {
    let bank = bank_of::<Ur5, JOINTS, PARAMETERS>(&Robot::load("ur5").expect("built in"));
    let set = bank
        .set::<Ur5, JOINTS, PARAMETERS>()
        .expect("a bank for this arm");
    for (found, nominal) in set.rigid.iter().zip(Ur5::NOMINAL) {
        assert!((found - nominal).abs() <= 1e-6 * nominal.abs().max(1.0));
    }
    assert_eq!(set.friction[0][FrictionColumn::Coulomb], 7.0);
}
