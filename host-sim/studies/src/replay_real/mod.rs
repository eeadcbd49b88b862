//! The board's code learns a real UR5 from its logs, row by row, as if it had been there.

mod logs;
mod page;
mod record;
mod scores;

use crate::real_ur5::{PATHS, geometric_mean};
use crate::{Outcome, Progress, StudyError};
use foretorque::arm::Arm;
use foretorque::arm::ur5::{PARAMETERS, Ur5};
use foretorque::feedforward::{FeedForward, FeedForwardConfig, ParameterSet, evaluate};
use foretorque::joint::{JointMeasurement, JointMotion, JointSample, JointVector};
use foretorque::learning::{Exchange, Learner, LearnerConfig};
use foretorque::limits::Flags;
use foretorque_workbench::closed_loop::motion_f32;
use foretorque_workbench::robot::Robot;
pub use record::{PathScores, ReplayReport};

use logs::Stretch;
use record::{N, Predictions};
use scores::Scores;
use std::collections::{BTreeMap, VecDeque};
use std::path::Path;

const P: usize = PARAMETERS;
/// Period of the logs, s.
const PERIOD_S: f64 = 8e-3;
/// Ticks in which a row is played, on a straight line from the row before. The board's filter is 31 ticks long: a quarter
/// of a second at the pace of the logs, which hides the accelerations of fast paths; 62 ms at four times that pace.
const TICKS_A_ROW: u16 = 4;
/// Age of the parameters that are scored beside the newest, s.
const AGE_S: f64 = 10.0;
/// Length of the window in which the first error is watched, s of motion.
const WINDOW_S: f64 = 2.0;
/// The error of the reference times this is good enough, for the first time.
const CLOSE: f64 = 1.1;

type Set = ParameterSet<N, P>;

/// The board at the pace of the logs.
struct Board {
    feedforward: FeedForward<Ur5, N, P>,
    learner: Learner<Ur5, N, P>,
    exchange: Exchange<N, P>,
    decided: u32,
    decisions: BTreeMap<String, u32>,
    clipped: u32,
    ticks: u32,
}

impl Board {
    fn new() -> Result<Self, StudyError> {
        let period_s = (PERIOD_S / f64::from(TICKS_A_ROW)) as f32;
        let set = Set::nominal::<Ur5>(1);
        let mut feedforward =
            FeedForward::new(FeedForwardConfig::for_arm::<Ur5, P>(period_s), set)?;
        feedforward.set_learning(true);
        Ok(Self {
            feedforward,
            learner: Learner::new(LearnerConfig::for_arm::<Ur5>(period_s), set)?,
            exchange: Exchange::new(),
            decided: 0,
            decisions: BTreeMap::new(),
            clipped: 0,
            ticks: 0,
        })
    }

    fn active(&self) -> &Set {
        &self.feedforward.state().active
    }

    fn tick(&mut self, sample: Option<&JointSample<N>>) -> JointVector<N> {
        self.feedforward.adopt(&mut self.exchange);
        let torque = match sample {
            Some(sample) => self.feedforward.step(sample),
            None => self.feedforward.step_stale(),
        };
        let measured = sample.and_then(|sample| sample.measured);
        let lesson = self.feedforward.learning_sample(measured);
        self.learner.learn(&lesson, &mut self.exchange);
        self.ticks += 1;
        self.clipped += u32::from(torque.flags.contains(Flags::LEARNED_CLIPPED));
        let log = &self.feedforward.state().report.decisions;
        for decision in (self.decided..log.count()).filter_map(|index| log.get(index)) {
            let reason = format!("{:?}", decision.reason);
            *self.decisions.entry(reason).or_default() += 1;
        }
        self.decided = log.count();
        torque.total
    }

    /// Largest torque over its limit when one joint after another is asked for 30 rad/s².
    fn extrapolated(&mut self) -> f64 {
        self.feedforward.set_learning(false);
        let mut largest = 0.0_f64;
        for joint in 0..N {
            for sign in [-30.0, 30.0] {
                let mut desired = JointMotion::<N>::zero();
                desired.qdd[joint] = sign;
                let sample = JointSample {
                    desired,
                    measured: None,
                };
                // Long enough for the slew limit.
                let mut torque = JointVector::zeros();
                for _ in 0..20 {
                    torque = self.tick(Some(&sample));
                }
                let limit = <Ur5 as Arm<N, P>>::LIMITS[joint].torque;
                largest = largest.max(f64::from(torque[joint].abs() / limit));
            }
        }
        largest
    }
}


/// Plays a stretch to the board. `history` holds the sets of the last ten seconds.
fn play(board: &mut Board, history: &mut VecDeque<Set>, stretch: &Stretch) -> Predictions {
    let nominal = Set::nominal::<Ur5>(1);
    let mut predicted = Predictions {
        newest: Vec::new(),
        aged: Vec::new(),
        frozen: Vec::new(),
    };
    let mut before: Option<JointMeasurement<N>> = None;
    // What follows does not join on to what came before.
    board.tick(None);
    for row in &stretch.rows {
        let desired = motion_f32(&row.state);
        let torques = |set: &Set| evaluate::<Ur5, N, P>(set, &desired).total.cast::<f64>();
        predicted.newest.extend(torques(board.active()).iter());
        predicted.frozen.extend(torques(&nominal).iter());
        if history.len() as f64 * PERIOD_S >= AGE_S {
            history.pop_front();
        }
        history.push_back(*board.active());
        predicted
            .aged
            .extend(torques(history.front().unwrap_or(&nominal)).iter());
        let from = before.unwrap_or(row.measured);
        for k in 1..=TICKS_A_ROW {
            let share = f32::from(k) / f32::from(TICKS_A_ROW);
            board.tick(Some(&JointSample {
                desired,
                measured: Some(JointMeasurement {
                    q: from.q + (row.measured.q - from.q) * share,
                    tau: from.tau + (row.measured.tau - from.tau) * share,
                }),
            }));
        }
        before = Some(row.measured);
    }
    for torques in [
        &mut predicted.newest,
        &mut predicted.aged,
        &mut predicted.frozen,
    ] {
        stretch.preparation.smooth_torque(torques, N);
    }
    predicted
}

/// Runs the study on the logs in `directory`. Returns the figures and the page.
///
/// Errors: a log is missing or damaged; an identification fails.
pub fn run(
    directory: &Path,
    seed: u64,
    progress: Progress<'_>,
) -> Result<Outcome<ReplayReport>, StudyError> {
    let robot = Robot::load("ur5")?;
    let stretches = logs::read(directory, &robot, seed, progress)?;
    let mut board = Board::new()?;
    let mut history = VecDeque::new();
    let mut scores: Vec<Scores> = PATHS.iter().map(|_| Scores::default()).collect();
    for (number, stretch) in stretches.iter().enumerate() {
        progress("log replayed", number, stretches.len());
        let fresh = history.is_empty();
        let predicted = play(&mut board, &mut history, stretch);
        let skipped = if fresh {
            (AGE_S / PERIOD_S) as usize
        } else {
            0
        };
        scores[stretch.path].add(stretch, &predicted, skipped);
    }
    let within = within_1_1(&stretches, progress)?;
    let after_others = after_others(&stretches, progress)?;
    let (ticks, clipped) = (board.ticks, board.clipped);
    let rows_accepted = board.learner.state().statistics.accepted;
    let decisions = board.decisions.clone();
    let paths: Vec<PathScores> = PATHS
        .iter()
        .zip(&scores)
        .zip(&within)
        .map(|(((name, _), scores), within)| scores.record(name, *within))
        .collect();
    let mean = |pick: &dyn Fn(&Scores) -> Vec<Option<f64>>| {
        let ratios: Vec<f64> = scores.iter().flat_map(pick).flatten().collect();
        geometric_mean(&ratios)
    };
    let report = ReplayReport {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        reference: format!("wls, {}, other paths", logs::RICH),
        newest_vs_rich_wls_ratio: mean(&|s| s.newest.over(&s.rich)),
        aged_10_s_vs_rich_wls_ratio: mean(&|s| s.aged.over(&s.rich_aged)),
        aged_10_s_after_other_paths_vs_rich_wls_ratio: after_others,
        frozen_vs_rich_wls_ratio: mean(&|s| s.frozen.over(&s.rich)),
        plain_wls_vs_rich_wls_ratio: mean(&|s| s.plain.over(&s.rich)),
        aged_10_s_vs_plain_wls_ratio: mean(&|s| s.aged.over(&s.plain_aged)),
        within_1_1_worst_s: within
            .iter()
            .copied()
            .reduce(|a, b| Some(a?.max(b?)))
            .flatten(),
        decisions_count: decisions,
        learned_clipped_ticks_count: clipped,
        torque_at_30_rad_s2_over_limit_ratio: board.extrapolated(),
        ticks_count: ticks,
        rows_accepted_count: rows_accepted,
        paths,
    };
    Ok(page::outcome(report))
}

/// Motion that a board fresh from the data sheet needs on each path to come within 1.1 of the reference, s.
fn within_1_1(
    stretches: &[Stretch],
    progress: Progress<'_>,
) -> Result<Vec<Option<f64>>, StudyError> {
    let mut times = Vec::new();
    for path in 0..PATHS.len() {
        progress("fresh on each path", path, PATHS.len());
        let mut board = Board::new()?;
        let first = stretches.iter().find(|stretch| stretch.path == path);
        times.push(match first {
            Some(stretch) => {
                let predicted = play(&mut board, &mut VecDeque::new(), stretch);
                scores::motion_until_close(stretch, &predicted.newest, WINDOW_S / PERIOD_S, CLOSE)
                    .map(|rows| rows as f64 * PERIOD_S)
            }
            None => None,
        });
    }
    Ok(times)
}

/// Error of parameters 10 s old over the reference's, geometric mean, of boards that have learnt all other paths before.
fn after_others(stretches: &[Stretch], progress: Progress<'_>) -> Result<f64, StudyError> {
    let mut ratios = Vec::new();
    for path in 0..PATHS.len() {
        progress("after the other paths", path, PATHS.len());
        let (mut board, mut history) = (Board::new()?, VecDeque::new());
        let mut scores = Scores::default();
        for stretch in stretches.iter().filter(|stretch| stretch.path != path) {
            play(&mut board, &mut history, stretch);
        }
        for stretch in stretches.iter().filter(|stretch| stretch.path == path) {
            scores.add(stretch, &play(&mut board, &mut history, stretch), 0);
        }
        ratios.extend(scores.aged.over(&scores.rich_aged).into_iter().flatten());
    }
    Ok(geometric_mean(&ratios))
}
