//! Loaded and learnt set as rivals: the shares follow what the measured torques show.

use super::*;
use crate::learning::Reason;

/// Number of decisions [`Reason::Reversed`] in 20 s in which the measured torques have the wrong sign for the first `opposed`
/// ticks; the active set must be the loaded one for as long.
///
/// * `friction` Coulomb friction added to the arm's, torque limits
fn reversals(opposed: u32, friction: f32) -> usize {
    let (mut board, mut plant) = Board::learning();
    let (mut count, mut read) = (0, 0);
    for tick in 0..20_000 {
        let mut sample = plant.sample(tick);
        let sense = if tick < opposed { -1.0 } else { 1.0 };
        if let Some(measured) = &mut sample.measured {
            for (j, limits) in Ur5::LIMITS.iter().enumerate() {
                let resisting = friction * limits.torque * sample.desired.qd[j].signum();
                measured.tau[j] = sense * (measured.tau[j] + resisting);
            }
        }
        board.tick(&sample);
        if tick < opposed {
            assert_eq!(board.active().rigid, wrong_prior(1).rigid);
            assert_eq!(board.active().friction, wrong_prior(1).friction);
        }
        let log = board.learner.state().report.decisions;
        let new = (read..log.count()).filter_map(|index| log.get(index));
        count += new.filter(|new| new.reason == Reason::Reversed).count();
        read = log.count();
    }
    assert!(read < 50, "{read} decisions");
    count
}

#[test]
fn m12_a_torque_sensor_of_the_wrong_sign_changes_no_torque() {
    // It is recorded once, not in every round.
    for friction in [0.0, 0.3] {
        assert_eq!(reversals(u32::MAX, friction), 1, "{friction}");
    }
}

#[test]
fn m12_torques_that_oppose_the_loaded_set_for_a_second_are_not_reversed() {
    assert_eq!(reversals(1000, 0.0), 0);
}

#[test]
fn m12_the_torque_follows_the_estimate_and_returns_to_a_loaded_set_that_is_right() {
    let prior = wrong_prior(1);
    let mut board = Board::new(prior, 0);
    let mut config = LearnerConfig::for_arm::<Ur5>(PERIOD as f32);
    // Without alarms: the shares alone react.
    config.supervisor.detector.threshold = 1e9;
    board.learner = Learner::new(config, prior).unwrap();
    let mut plant = Plant::new(AS_IT_IS);
    board.feedforward.set_learning(true);
    let reasons = |board: &Board| {
        let log = board.learner.state().report.decisions;
        let all = (0..log.count()).filter_map(|index| log.get(index));
        all.map(|decision| decision.reason).collect::<Vec<_>>()
    };
    for tick in 0..3000 {
        board.tick(&plant.sample(tick));
    }
    // Estimates of the first tenths of a second may be followed and left again.
    let following = |reason: &&Reason| [Reason::Followed, Reason::RolledBack].contains(reason);
    let decided = reasons(&board);
    assert_eq!(decided.iter().rfind(following), Some(&Reason::Followed));
    let share = board.learner.state().share().joint;
    assert!(share.iter().all(|share| *share > 0.9), "{share:?}");
    let committed = board.feedforward.state().committed;
    assert_ne!(
        committed.rigid, prior.rigid,
        "what is followed is committed"
    );
    let mut least = 1.0f32;
    for tick in 3000..8000 {
        let mut sample = plant.sample(tick);
        if let Some(measured) = &mut sample.measured {
            measured.tau = evaluate::<Ur5, N, P>(&prior, &sample.desired).total;
        }
        board.tick(&sample);
        least = least.min(board.learner.state().share().rigid);
    }
    // The estimate returns to it as well.
    assert!(least < 0.25, "{least}");
    let left = reasons(&board);
    assert!(left.contains(&Reason::RolledBack), "{left:?}");
}
