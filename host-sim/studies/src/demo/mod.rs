//! The main job: start from a wrong prior, learn on the board in closed loop, freeze, play a path nobody has seen.

mod long_run;
mod page;
mod record;
mod setup;

pub use record::{
    BeforeAfter, DemoReport, LearningPoint, LinkFigures, TickPhases, Tracking, UsartFigures,
};
pub use setup::DemoConfig;

use crate::{Outcome, Progress, StudyError};
use foretorque::arm::Arm;
use foretorque_workbench::board::Client;
use foretorque_workbench::robot::Robot;
use record::DemoCurves;
use setup::Setup;

/// Runs the job on the first board, and its shorter part on the flashable firmware that the second connects to.
///
/// * `board`, `toolchain` names of the board and of the compiler of its code
///
/// Errors: the boards', and those of an excitation that the limits do not allow.
pub fn run<A: Arm<N, P>, const N: usize, const P: usize>(
    robot: &Robot,
    config: &DemoConfig,
    (board, toolchain): (String, String),
    (bulk, usart): (&mut Client<N>, Option<&mut Client<N>>),
    progress: Progress<'_>,
) -> Result<Outcome<DemoReport>, StudyError> {
    let setup = Setup::<N>::new::<A, P>(robot, config, progress)?;
    let long = long_run::long_run(bulk, &setup, config, progress)?;
    let usart = usart
        .map(|board| long_run::usart_run(board, &setup, config, &long.replies, progress))
        .transpose()?;
    let [frozen, statistics] = &long.statistics;
    let report = DemoReport {
        robot: robot.name.clone(),
        board,
        seed: config.seed,
        ticks: config.ticks(config.learning_s),
        period_s: config.period_s,
        toolchain,
        torque_nrmse_before: long.before.nrmse(),
        torque_nrmse_after: long.after.nrmse(),
        torque_nrmse_moving_before: long.before.nrmse_moving(),
        torque_nrmse_moving_after: long.after.nrmse_moving(),
        torque_rmse_nm: BeforeAfter {
            before: long.before.rmse_nm(),
            after: long.after.rmse_nm(),
        },
        tracking_rms_mrad: long.tracking.map(|error| error.mean_rms_mrad()),
        tracking_rms_joint_mrad: long.tracking.map(|error| error.rms_mrad()),
        pd_bandwidth_hz: config.pd_bandwidth_hz,
        learning_curve: long.learning_curve,
        tick_instructions: statistics.tick_cost.into(),
        tick_instructions_by_phase: TickPhases {
            frozen: frozen.tick_cost.into(),
            learning: long.learnt.tick_cost.into(),
        },
        learning_instructions: statistics.learn_cost.into(),
        link: LinkFigures::of(&long.statistics),
        usart,
    };
    let curves = DemoCurves {
        validation_samples: config.ticks(config.validation_s),
        validation: long.validation,
        tracking: long.tracking_curves,
    };
    Ok(Outcome {
        page: page::page(&report, &curves, &setup.series),
        text: report.summary(),
        report,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use foretorque::arm::ur5::{JOINTS, PARAMETERS, Ur5};
    use foretorque_workbench::board::Native;
    use std::time::Duration;

    fn board() -> Client<JOINTS> {
        let native = Native::<Ur5, JOINTS, PARAMETERS>::new().expect("boots");
        Client::connect::<Ur5, PARAMETERS>(Box::new(native), Duration::from_secs(1)).expect("hello")
    }

    fn in_small() -> Outcome<DemoReport> {
        let config = DemoConfig {
            learning_s: 6.0,
            usart_learning_s: 1.0,
            validation_s: 10.0,
            excitation_candidates: 5,
            ..DemoConfig::default()
        };
        let robot = Robot::load("ur5").expect("built in");
        run::<Ur5, JOINTS, PARAMETERS>(
            &robot,
            &config,
            ("native".to_owned(), "test".to_owned()),
            (&mut board(), Some(&mut board())),
            &|_, _, _| {},
        )
        .expect("runs")
    }

    #[test]
    fn six_seconds_of_learning_halve_the_torque_error_and_runs_repeat() {
        let outcome = in_small();
        let report = &outcome.report;
        assert!(
            report.torque_nrmse_before > 0.2,
            "{}",
            report.torque_nrmse_before
        );
        assert!(report.torque_nrmse_after < 0.5 * report.torque_nrmse_before);
        let tracking = &report.tracking_rms_mrad;
        assert!(tracking.after < tracking.before && tracking.before < tracking.pd_only);
        assert_eq!(report.link.errors, 0);
        let usart = report.usart.as_ref().expect("a second board was given");
        assert_eq!(usart.ticks_with_equal_bits, usart.ticks);
        assert!(usart.torque_nrmse_after < usart.torque_nrmse_before);
        assert!(outcome.page.html().expect("plots").len() < 3_000_000);
        assert_eq!(outcome, in_small());
    }
}
