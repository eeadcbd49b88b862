//! The board's code learns an arm from logs, row by row, as if it had been there.

mod logs;
mod record;

pub use logs::ReplayPath;
pub use record::{PathScores, ReplayDecision, ReplayReport, WorstWindow};

use crate::real_ur5::{PATHS, geometric_mean};
use crate::{Outcome, Progress, StudyError};
use foretorque::arm::Arm;
use foretorque::arm::ur5::{self, PARAMETERS, Ur5};
use foretorque::feedforward::{FeedForward, FeedForwardConfig, FeedForwardState, ParameterSet};
use foretorque::joint::{JointMeasurement, JointMotion, JointSample, JointVector};
use foretorque::learning::{
    Exchange, LONGEST_SAMPLE_S, Learner, LearnerConfig, StartDeviations, SupervisorConfig, TAPS,
};
use foretorque::limits::Flags;
use foretorque_workbench::closed_loop::motion_f32;
use foretorque_workbench::identification::motion_filter;
use foretorque_workbench::robot::Robot;
use logs::{Scores, Stretch};
use record::Predictions;
use std::collections::VecDeque;
use std::path::Path;

/// Tick of a board, s. A row is played in as many as are nearest to it, one at least, on a straight line from the row before.
const TICK_S: f64 = 1e-3;
/// Age of the parameters that are scored beside the newest, s.
const AGE_S: f64 = 10.0;
/// Length of the window in which the first error is watched, s of motion.
const WINDOW_S: f64 = 2.0;
/// The error of the reference times this is good enough, for the first time.
const CLOSE: f64 = 1.1;

/// Length of the window in which the board may not lose to its start, s.
const WATCHED_S: f64 = 3.0;

/// The board before the first row.
#[derive(Clone, Copy)]
struct Start<const N: usize, const P: usize> {
    set: ParameterSet<N, P>,
    deviations: StartDeviations<N, P>,
    /// Period of the rows, s, and ticks in which a row is played.
    period_s: f64,
    ticks: u16,
    config: LearnerConfig<N, P>,
}

impl<const N: usize, const P: usize> Start<N, P> {
    fn new<A: Arm<N, P>>(
        set: ParameterSet<N, P>,
        deviations: StartDeviations<N, P>,
        period_s: f64,
    ) -> Self {
        let ticks = ((period_s / TICK_S).round() as u16).max(1);
        let mut config = LearnerConfig::for_arm::<A>((period_s / f64::from(ticks)) as f32);
        config.supervisor =
            SupervisorConfig::for_sensor::<A, N, P>(config.inv_period, ticks.into());
        Self {
            set,
            deviations,
            period_s,
            ticks,
            config,
        }
    }

    /// Period of the board, s.
    fn tick_s(&self) -> f64 {
        self.period_s / f64::from(self.ticks)
    }

    /// Lengthens the motion filter as ripple and noise of the logs require; a note says so.
    fn lengthen_filter(
        &mut self,
        paths: &[ReplayPath],
        robot: &Robot,
        notes: &mut Vec<String>,
    ) -> Result<(), StudyError> {
        let of_board = self.config.decimation;
        let sample_s = TAPS as f64 * self.tick_s();
        let longest = (f64::from(LONGEST_SAMPLE_S) / self.tick_s()).round() as u32;
        for file in paths.iter().flat_map(|path| &path.files) {
            let needed = motion_filter(file, robot, sample_s, of_board..=of_board.max(longest))?;
            let ticks = self.config.decimation.max(needed);
            self.config.lengthen_samples(ticks);
        }
        if self.config.decimation > of_board {
            let lengths = [self.config.decimation, of_board];
            let [own, board] = lengths.map(|ticks| 1e3 * sample_s * f64::from(ticks));
            notes.push(format!(
                "motion filter of {own:.0} ms in place of {board:.0} ms, in which ripple and noise are a large part of the accelerations"
            ));
        }
        Ok(())
    }
}

/// The board at the pace of the logs.
struct Board<A: Arm<N, P>, const N: usize, const P: usize> {
    start: Start<N, P>,
    feedforward: FeedForward<A, N, P>,
    learner: Learner<A, N, P>,
    exchange: Exchange<N, P>,
    decided: u32,
    decisions: Vec<ReplayDecision>,
    clipped: u32,
    ticks: u32,
}

impl<A: Arm<N, P>, const N: usize, const P: usize> Board<A, N, P> {
    fn new(start: &Start<N, P>) -> Result<Self, StudyError> {
        let period_s = start.tick_s() as f32;
        let set = start.set;
        let mut feedforward = FeedForward::new(FeedForwardConfig::for_arm::<A, P>(period_s), set)?;
        feedforward.set_learning(true);
        let mut learner = Learner::EMPTY;
        learner.restart_with(start.config, &set, &start.deviations)?;
        Ok(Self {
            start: *start,
            feedforward,
            learner,
            exchange: Exchange::new(),
            decided: 0,
            decisions: Vec::new(),
            clipped: 0,
            ticks: 0,
        })
    }

    fn tick(&mut self, sample: Option<&JointSample<N>>) -> JointVector<N> {
        self.feedforward.adopt(&mut self.exchange);
        let torque = match sample {
            Some(sample) => self.feedforward.step(sample),
            None => self.feedforward.step_stale(),
        };
        let measured = sample.and_then(|sample| sample.measured);
        let sample = self.feedforward.learning_sample(measured);
        self.learner.learn(&sample, &mut self.exchange);
        self.ticks += 1;
        self.clipped += u32::from(torque.flags.contains(Flags::LEARNED_CLIPPED));
        let log = &self.feedforward.state().report.decisions;
        for decision in (self.decided..log.count()).filter_map(|index| log.get(index)) {
            self.decisions.push(ReplayDecision {
                t_s: f64::from(self.ticks) * self.start.tick_s(),
                reason: decision.reason.to_string(),
                joint: decision.joint.map(|joint| joint + 1),
                figure: decision.figure,
            });
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
                largest = largest.max(f64::from(torque[joint].abs() / A::limits()[joint].torque));
            }
        }
        largest
    }
}

/// Play a stretch to the board. `history` holds the states of the last ten seconds.
fn play<A: Arm<N, P>, const N: usize, const P: usize>(
    board: &mut Board<A, N, P>,
    history: &mut VecDeque<FeedForwardState<N, P>>,
    stretch: &Stretch<N>,
) -> Predictions {
    let start = board.start;
    let loaded = FeedForwardState::new(start.set);
    let mut predicted = Predictions::default();
    let mut before: Option<JointMeasurement<N>> = None;
    // What follows does not join on to what came before.
    if board.ticks > 0 {
        board.tick(None);
    }
    for row in &stretch.rows {
        let desired = motion_f32(&row.state);
        let torques = |state: &FeedForwardState<N, P>| state.torque::<A>(&desired).cast::<f64>();
        let newest = board.feedforward.state();
        predicted.newest.extend(torques(newest).iter());
        predicted.frozen.extend(torques(&loaded).iter());
        if history.len() as f64 * start.period_s >= AGE_S {
            history.pop_front();
        }
        history.push_back(*newest);
        let aged = torques(history.front().unwrap_or(&loaded));
        predicted.aged.extend(aged.iter());
        let from = before.replace(row.measured).unwrap_or(row.measured);
        for k in 1..=start.ticks {
            let share = f32::from(k) / f32::from(start.ticks);
            board.tick(Some(&JointSample {
                desired,
                measured: Some(JointMeasurement {
                    q: from.q + (row.measured.q - from.q) * share,
                    tau: from.tau + (row.measured.tau - from.tau) * share,
                }),
            }));
        }
    }
    let Predictions {
        newest,
        aged,
        frozen,
    } = &mut predicted;
    for torques in [newest, aged, frozen] {
        stretch.preparation.smooth_torque(torques, N);
    }
    predicted
}

/// Replays the logs in `directory` of a real UR5 to a board that starts from its data sheet.
///
/// Errors: a log is missing or damaged; an identification fails.
pub fn real_ur5(
    directory: &Path,
    seed: u64,
    progress: Progress<'_>,
) -> Result<Outcome<ReplayReport>, StudyError> {
    crate::real_ur5::check_directory(directory)?;
    let paths = PATHS.iter().map(|(name, files)| ReplayPath {
        name: (*name).to_owned(),
        files: files.iter().map(|file| directory.join(file)).collect(),
    });
    let nominal = ParameterSet::nominal::<Ur5>(1);
    let start = ("data sheet", nominal, StartDeviations::PRIOR);
    let robot = Robot::load("ur5")?;
    let paths: Vec<ReplayPath> = paths.collect();
    // The clocks of these logs have lost rows; the controller's period is known.
    let period_s = Some(8e-3);
    let outcome =
        run::<Ur5, { ur5::JOINTS }, PARAMETERS>(&robot, &paths, start, seed, period_s, progress)?;
    Ok(Outcome {
        text: format!("host-sim experiment replay-real\n\n{}", outcome.text),
        ..outcome
    })
}

/// Replays logs to a board that starts from a set. Returns the figures and the page.
///
/// * `start` its name, the set, and its deviations
/// * `period_s` time between two rows; where none is given, that of the first log
///
/// Errors: a log is missing or damaged; an identification fails.
pub fn run<A: Arm<N, P>, const N: usize, const P: usize>(
    robot: &Robot,
    paths: &[ReplayPath],
    (named, set, deviations): (&str, ParameterSet<N, P>, StartDeviations<N, P>),
    seed: u64,
    period_s: Option<f64>,
    progress: Progress<'_>,
) -> Result<Outcome<ReplayReport>, StudyError> {
    let logs = logs::read::<N>(paths, robot, seed, progress)?;
    let (stretches, period_s) = (logs.stretches, period_s.unwrap_or(logs.period_s));
    let mut notes = logs.notes;
    let mut start = Start::new::<A>(set, deviations, period_s);
    start.lengthen_filter(paths, robot, &mut notes)?;
    let mut board = Board::<A, N, P>::new(&start)?;
    let mut history = VecDeque::new();
    let mut scores: Vec<Scores<N>> = paths.iter().map(|_| Scores::default()).collect();
    let limits = std::array::from_fn(|joint| f64::from(A::limits()[joint].torque));
    let mut played: Vec<(&Stretch<N>, Predictions)> = Vec::new();
    for (number, stretch) in stretches.iter().enumerate() {
        progress("log replayed", number, stretches.len());
        // Before, no parameters are as old.
        let skipped = ((AGE_S / period_s) as usize).saturating_sub(history.len());
        let predicted = play(&mut board, &mut history, stretch);
        scores[stretch.path].add(stretch, &predicted, skipped);
        played.push((stretch, predicted));
    }
    for log in played.chunk_by(|(a, _), (b, _)| (a.path, a.file) == (b.path, b.file)) {
        let of_path = &mut scores[log[0].0.path];
        of_path.watch(log, (WATCHED_S / period_s) as usize, &limits);
    }
    let within = within_1_1::<A, N, P>(&stretches, paths.len(), &start, progress)?;
    let (after_others, others) = match paths.len() {
        1 => (None, "the same path"),
        count => {
            let ratio = after_others::<A, N, P>(&stretches, count, &start, progress)?;
            (Some(ratio), "other paths")
        }
    };
    let (ticks, clipped) = (board.ticks, board.clipped);
    let statistics = board.learner.state().statistics;
    let decisions = board.decisions.clone();
    let reference = match logs.columns {
        Some(columns) => format!("wls, {columns}, {others}"),
        None => "the description without friction".to_owned(),
    };
    let fitted = logs.columns.is_some();
    let paths = paths.iter().zip(&scores).zip(&within);
    let paths = paths.map(|((path, scores), within)| scores.record(&path.name, *within));
    let paths: Vec<PathScores> = paths.collect();
    let mean = |pick: &dyn Fn(&Scores<N>) -> Vec<Option<f64>>| {
        let ratios: Vec<f64> = scores.iter().flat_map(pick).flatten().collect();
        (!ratios.is_empty()).then(|| geometric_mean(&ratios))
    };
    let plain = |pick| mean(pick).filter(|_| fitted);
    let windows = scores
        .iter()
        .filter_map(|scores| Some(scores.worst_window?.ratio));
    let worst = within.iter().copied().reduce(|a, b| Some(a?.max(b?)));
    let report = ReplayReport {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        robot: robot.name.clone(),
        start: named.to_owned(),
        notes,
        period_s,
        reference,
        worst_window_over_start_ratio: windows.reduce(f64::max),
        newest_vs_rich_wls_ratio: mean(&|s| s.newest.over(&s.rich)),
        aged_10_s_vs_rich_wls_ratio: mean(&|s| s.aged.over(&s.rich_aged)),
        aged_10_s_after_other_paths_vs_rich_wls_ratio: after_others,
        frozen_vs_rich_wls_ratio: mean(&|s| s.frozen.over(&s.rich)),
        plain_wls_vs_rich_wls_ratio: plain(&|s| s.plain.over(&s.rich)),
        aged_10_s_vs_plain_wls_ratio: plain(&|s| s.aged.over(&s.plain_aged)),
        within_1_1_worst_s: worst.flatten(),
        decisions,
        learned_clipped_ticks_count: clipped,
        torque_at_30_rad_s2_over_limit_ratio: board.extrapolated(),
        ticks_count: ticks,
        rows_accepted_count: statistics.accepted,
        rows_paused_count: statistics.frozen,
        paths,
    };
    Ok(record::outcome(report))
}

/// Motion that a board fresh from its start needs on each path to come within 1.1 of the reference, s.
fn within_1_1<A: Arm<N, P>, const N: usize, const P: usize>(
    stretches: &[Stretch<N>],
    paths: usize,
    start: &Start<N, P>,
    progress: Progress<'_>,
) -> Result<Vec<Option<f64>>, StudyError> {
    let time = |path| {
        progress("fresh on each path", path, paths);
        let mut board = Board::<A, N, P>::new(start)?;
        let mut history = VecDeque::new();
        let own = stretches.iter().filter(|stretch| stretch.path == path);
        let own = own.map(|stretch| (stretch, play(&mut board, &mut history, stretch).newest));
        let own: Vec<(&Stretch<N>, Vec<f64>)> = own.collect();
        let rows = logs::motion_until_close(&own, WINDOW_S / start.period_s, CLOSE);
        Ok(rows.map(|rows| rows as f64 * start.period_s))
    };
    (0..paths).map(time).collect()
}

/// Error of parameters 10 s old over the reference's, geometric mean, of boards that have learnt all other paths before.
fn after_others<A: Arm<N, P>, const N: usize, const P: usize>(
    stretches: &[Stretch<N>],
    paths: usize,
    start: &Start<N, P>,
    progress: Progress<'_>,
) -> Result<f64, StudyError> {
    let mut ratios = Vec::new();
    for path in 0..paths {
        progress("after the other paths", path, paths);
        let (mut board, mut history) = (Board::<A, N, P>::new(start)?, VecDeque::new());
        let mut scores = Scores::<N>::default();
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_played_in_ticks_of_a_board_and_blocks_have_two_of_them() {
        // Rows a second, ticks of a row and of a block.
        for (rate_hz, ticks, block) in [(1e3, 1, 10), (700.0, 1, 7), (125.0, 8, 16), (30.0, 33, 66)]
        {
            let set = ParameterSet::nominal::<Ur5>(1);
            let start = Start::new::<Ur5>(set, StartDeviations::PRIOR, 1.0 / rate_hz);
            assert_eq!(start.ticks, ticks, "{rate_hz} Hz");
            let supervisor = start.config.supervisor;
            assert_eq!(supervisor.block_ticks, block, "{rate_hz} Hz");
            assert!(supervisor.checkpoint_ticks >= 4 * block, "{rate_hz} Hz");
            let time_s = |blocks: u32| f64::from(blocks * block) * start.tick_s();
            assert!((time_s(supervisor.timeout_blocks) - 3.0).abs() < 0.1);
        }
        // Rows of two seconds teach nothing, but are valid.
        let set = ParameterSet::nominal::<Ur5>(1);
        let start = Start::new::<Ur5>(set, StartDeviations::PRIOR, 2.0);
        assert_eq!(start.config.validate(), Ok(()));
    }
}
