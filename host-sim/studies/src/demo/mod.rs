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
use foretorque::arm::ur5::{JOINTS as N, PARAMETERS as P, Ur5};
use foretorque_workbench::board::Client;
use setup::Setup;

/// Runs the job on the first board, and its shorter part on the flashable firmware that the second connects to.
///
/// * `names` of the board and of the compiler of its code
///
/// Errors: the boards', and those of an excitation that the limits do not allow.
pub fn run(
    config: &DemoConfig,
    names: (String, String),
    (bulk, usart): (&mut Client<N>, Option<&mut Client<N>>),
    progress: Progress<'_>,
) -> Result<Outcome<DemoReport>, StudyError> {
    let setup = Setup::new(config, progress)?;
    let (mut report, curves, replies) = long_run::long_run(bulk, &setup, config, names, progress)?;
    report.usart = usart
        .map(|board| long_run::usart_run(board, &setup, config, &replies, progress))
        .transpose()?;
    Ok(Outcome {
        page: page::page(&report, &curves, &setup.series),
        text: report.summary(),
        report,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use foretorque_workbench::board::Native;
    use std::time::Duration;

    fn board() -> Client<N> {
        let native = Native::<Ur5, N, P>::new().expect("boots");
        Client::connect::<Ur5, P>(Box::new(native), Duration::from_secs(1)).expect("hello")
    }

    fn in_small() -> Outcome<DemoReport> {
        let config = DemoConfig {
            learning_s: 6.0,
            usart_learning_s: 1.0,
            validation_s: 10.0,
            excitation_candidates: 5,
            ..DemoConfig::default()
        };
        run(
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
