//! An excitation that the board plays itself: the host uploads it, starts it, and follows.

use super::simulate::{PERIOD_S, Scene};
use super::{Failure, unusable};
use foretorque::arm::Arm;
use foretorque_link::excitation::{ExcitationCommand, ExcitationState};
use foretorque_workbench::board::Client;
use foretorque_workbench::dynamics::{Joints, State};
use foretorque_workbench::excitation::Excitation;
use foretorque_workbench::robot::Robot;
use foretorque_workbench::trajectory::Trajectory;

/// Distance from the start of the series at which the arm waits, rad: the approach has work to do.
const ASIDE_RAD: f64 = 0.1;
/// Longer than check, approach and stop together, s.
const AROUND_S: f64 = 60.0;
/// Ticks after which the check is over.
const CHECK_TICKS: usize = 300;

/// Uploads the excitation that `scene` was to play, and has the arm wait beside its beginning instead.
///
/// Errors: a trajectory that is no excitation; what the board refuses.
pub(super) fn load<A: Arm<N, P>, const N: usize, const P: usize>(
    board: &mut Client<N>,
    scene: &mut Scene<N>,
    robot: &Robot,
    tracking_rad: f32,
) -> Result<(), Failure> {
    let Trajectory::Excitation { series, duration_s } = &scene.trajectory else {
        return Err(unusable(
            "--excite-on-board: --trajectory must be an excitation.json",
        ));
    };
    let periods = (duration_s / series.period_s).ceil().max(1.0);
    if periods > f64::from(u16::MAX) {
        return Err(unusable(format!("--duration-s is {periods} periods")));
    }
    let program = series.program::<N>(A::hash(), periods as u16, tracking_rad)?;
    board.load_excitation(&program)?;
    scene.ticks = ((periods * series.period_s + AROUND_S) / PERIOD_S) as usize;
    let waiting = State {
        q: beside(series, robot),
        qd: Joints::zeros(),
        qdd: Joints::zeros(),
    };
    scene.trajectory = Trajectory::Sampled(vec![(0.0, waiting)]);
    Ok(())
}

/// The beginning of the series, every joint a little nearer to the middle of its range.
fn beside<const N: usize>(series: &Excitation, robot: &Robot) -> Joints<N> {
    let mut q = series.at::<N>(0.0).q;
    for (q, joint) in q.iter_mut().zip(&robot.joints) {
        let (low, high) = joint.limits.position;
        *q += ASIDE_RAD.copysign(0.5 * (low + high) - *q);
    }
    q
}

/// True after tick `tick`, whose reply had `stage` or none, if the excitation has come to its end.
///
/// Errors: a board that broke it off, refused it after its check, or never began.
pub(super) fn has_ended<const N: usize>(
    board: &mut Client<N>,
    tick: usize,
    stage: Option<ExcitationState>,
) -> Result<bool, Failure> {
    match stage {
        Some(ExcitationState::Holding) => Ok(true),
        Some(ExcitationState::Aborted(reason)) => Err(unusable(format!(
            "the board broke the excitation off after {:.3} s: {reason}",
            tick as f64 * PERIOD_S
        ))),
        None if tick == CHECK_TICKS => match board.excitation(ExcitationCommand::Status)? {
            stage if stage.is_active() => Ok(false),
            stage => Err(unusable(format!(
                "the board did not begin the excitation: {stage:?}"
            ))),
        },
        _ => Ok(false),
    }
}
