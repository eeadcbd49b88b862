//! The tick over a long run: whether what it costs depends on what it is fed.

use crate::machine::count;
use crate::rows;
use crate::stage::Stage;

/// Instructions of the calls of a long run.
pub(crate) struct Spread {
    pub(crate) least: u32,
    pub(crate) sum: u64,
    pub(crate) most: u32,
}

/// Instructions of `FeedForward::step` over `ticks` samples, no two alike, with the learner at work between them.
///
/// The arm's smooth motion is broken every third tick by a random state, which leaves the range that was learnt and
/// slews the torque, every eleventh by a missing measurement. Ticks whose desired motion is no number do less and are
/// no part of it.
pub(crate) fn of_step(stage: &mut Stage, ticks: u32) -> Spread {
    let mut spread = Spread {
        least: u32::MAX,
        sum: 0,
        most: 0,
    };
    for tick in 0..ticks {
        stage.vary();
        if tick % 3 == 2 {
            stage.sample.desired = stage.motion;
        }
        if tick % 11 == 10 {
            stage.sample.measured = None;
        }
        stage.feedforward.adopt(&mut stage.exchange);
        let counted = count(rows::feedforward_step, stage);
        spread.least = spread.least.min(counted);
        spread.sum += u64::from(counted);
        spread.most = spread.most.max(counted);
        let lesson = stage.feedforward.learning_sample(stage.sample.measured);
        stage.learner.learn(&lesson, &mut stage.exchange);
    }
    spread
}
