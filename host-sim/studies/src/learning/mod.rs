//! Does learning help, how fast, and can it make anything worse? Learned against frozen boards in closed loop, over
//! everything that may go wrong.

mod bars;
mod controller;
mod cramer_rao;
mod drive;
mod emulated;
mod figures;
mod identified;
mod page;
mod record;
mod recorder;
mod scenario;
mod setup;
pub mod soak;
mod trace;
mod twin;

pub use bars::Comparison;
pub use emulated::EmulatedReport;
pub use record::{LearningReport, ScenarioReport};

use crate::{Outcome, Progress, StudyError};
use drive::{Board, Run};
use figures::{Traces, figures};
use foretorque::arm::ur5::JOINTS;
use foretorque_workbench::board::Client;
use foretorque_workbench::parallel::{cores, in_parallel};
use identified::Starts;
use scenario::Scenario;
use setup::Setup;
use std::cell::Cell;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicUsize, Ordering};
use trace::Trace;

/// Bandwidths of the PD loop in which every scenario is run, Hz.
const BANDWIDTHS_HZ: [(f64, &str); 2] = [(6.0, "pd6"), (3.0, "pd3")];

/// Settings of the study.
#[derive(Clone, Debug, PartialEq)]
pub struct LearningConfig {
    /// Seed of arm, prior, paths, noise and events.
    pub seed: u64,
    /// Only the scenarios whose names begin with this.
    pub only: Option<String>,
    /// The short form of every scenario.
    pub quick: bool,
}

/// A scenario in a loop of one bandwidth.
struct Case {
    name: String,
    scenario: Scenario,
    bandwidth_hz: f64,
}

fn cases() -> impl Iterator<Item = Case> {
    Scenario::all().flat_map(|scenario| {
        BANDWIDTHS_HZ.map(|(bandwidth_hz, loops)| Case {
            name: format!("{}-{loops}", scenario.name),
            scenario,
            bandwidth_hz,
        })
    })
}

/// Names of all scenarios, each with one line on what it shows.
pub fn scenarios() -> impl Iterator<Item = (String, &'static str)> {
    cases().map(|case| (case.name, case.scenario.shows))
}

/// Runs the scenarios on all cores, then some of them again on `board`.
///
/// Errors: no scenario has that name; the board's.
pub fn run(
    config: &LearningConfig,
    mut board: Option<&mut Client<JOINTS>>,
    progress: Progress<'_>,
) -> Result<Outcome<LearningReport>, StudyError> {
    let only = config.only.as_deref().unwrap_or_default();
    let cases: Vec<Case> = cases().filter(|case| case.name.starts_with(only)).collect();
    if cases.is_empty() {
        let reason = format!("no scenario begins with '{only}': --list shows them");
        return Err(StudyError::Unusable(reason));
    }
    let setup = Setup::new(config.seed)?;
    let starts = Starts::new(&setup)?;
    let mut runs = Vec::new();
    for case in &cases {
        let replayed = board.is_some() && emulated::REPLAYED.contains(&case.name.as_str());
        runs.extend(case.boards().map(|board| Run {
            setup: &setup,
            starts: &starts,
            scenario: &case.scenario,
            bandwidth_hz: case.bandwidth_hz,
            board,
            quick: config.quick,
            recording: replayed && board == Board::Learning,
        }));
    }
    let mut traces = run_all(&runs, progress)?.into_iter();
    let (mut scenarios, mut emulated) = (BTreeMap::new(), BTreeMap::new());
    for case in &cases {
        let mut own: Vec<(Board, Trace)> = case.boards().zip(traces.by_ref()).collect();
        let mut take = |board| {
            let place = own.iter().position(|(of, _)| *of == board)?;
            Some(own.swap_remove(place).1)
        };
        let (Some(learning), Some(frozen)) = (take(Board::Learning), take(Board::Frozen)) else {
            continue;
        };
        let traces = Traces {
            learning,
            frozen,
            pd: take(Board::None),
            no_network: take(Board::NoNetwork),
        };
        let all = traces.learning.recording.len();
        if let Some(board) = board.as_deref_mut().filter(|_| all > 0) {
            let start = starts.set(case.scenario.start);
            let done = Cell::new(0);
            let replayed = emulated::replay(board, start, &traces.learning, &|ticks| {
                done.set(done.get() + ticks);
                progress("ticks on the board", done.get(), all);
            })?;
            emulated.insert(case.name.clone(), replayed);
        }
        let events = case.scenario.events(&setup, config.quick);
        let report = ScenarioReport {
            seed: config.seed,
            ticks: traces.learning.ticks,
            nrmse_moving_percent: curve(&traces.learning),
            frozen_nrmse_moving_percent: curve(&traces.frozen),
            figures: figures(&case.scenario, &events, &traces),
            torque_checksum: format!("{:016x}", traces.learning.checksum),
        };
        scenarios.insert(case.name.clone(), report);
    }
    let outcomes = bars::comparisons(scenarios.iter().map(|(name, s)| (name, &s.figures)));
    Ok(page::outcome(LearningReport {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        seed: config.seed,
        scenarios,
        emulated,
        outcomes,
    }))
}

impl Case {
    /// The boards that the scenario is run with.
    fn boards(&self) -> impl Iterator<Item = Board> {
        let (pd, network) = (self.scenario.against_pd, self.scenario.without_network);
        let beside = [
            pd.then_some(Board::None),
            network.then_some(Board::NoNetwork),
        ];
        let both = [Board::Learning, Board::Frozen];
        both.into_iter().chain(beside.into_iter().flatten())
    }
}

/// Error over time, %.
fn curve(trace: &Trace) -> Vec<(f64, f64)> {
    let evaluations = trace.evaluations.iter();
    evaluations.map(|e| (e.t_s, 100.0 * e.nrmse)).collect()
}

/// Runs everything on all cores, the longest first; traces in the order of `runs`.
fn run_all(runs: &[Run<'_>], progress: Progress<'_>) -> Result<Vec<Trace>, StudyError> {
    let mut order: Vec<usize> = (0..runs.len()).collect();
    order.sort_by_key(|&k| std::cmp::Reverse(runs[k].ticks()));
    let all: usize = runs.iter().map(|run| run.ticks() / 1000).sum();
    let done = AtomicUsize::new(0);
    let advance = |ticks: usize| {
        let before = done.fetch_add(ticks / 1000, Ordering::Relaxed);
        progress("seconds of arm time", before + ticks / 1000, all);
    };
    let work = |&k: &usize| (k, runs[k].trace(&advance));
    let mut found = in_parallel(cores(), &order, work, || {});
    found.sort_by_key(|(k, _)| *k);
    found.into_iter().map(|(_, trace)| trace).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use foretorque::arm::ur5::{PARAMETERS, Ur5};
    use foretorque_workbench::board::Native;
    use std::time::Duration;

    fn report(only: &str) -> LearningReport {
        let native = Native::<Ur5, JOINTS, PARAMETERS>::new().expect("boots");
        let mut board =
            Client::connect::<Ur5, PARAMETERS>(Box::new(native), Duration::from_secs(1))
                .expect("hello");
        let config = LearningConfig {
            seed: 1,
            only: Some(only.to_owned()),
            quick: true,
        };
        run(&config, Some(&mut board), &|_, _, _| {})
            .expect("runs")
            .report
    }

    #[test]
    fn a_wrong_prior_is_learnt_and_the_same_seed_gives_the_same_bits() {
        let first = report("convergence");
        assert_eq!(first.scenarios.len(), 2);
        for (name, scenario) in &first.scenarios {
            let figures = &scenario.figures;
            let last = figures["last_nrmse_moving_percent"];
            assert!(figures["first_nrmse_moving_percent"] > 20.0, "{name}");
            assert!(
                last < 0.25 * figures["last_frozen_nrmse_moving_percent"],
                "{name}: {last}"
            );
        }
        // The firmware's session, over its link, gives the same bits.
        let replayed = &first.emulated["convergence-pd6"];
        assert_eq!(replayed.ticks_count, 22_000);
        assert_eq!(replayed.ticks_with_other_bits_count, 0);
        // As text, in which what never happened is equal to itself.
        let text = |report: &LearningReport| serde_json::to_string(report).expect("is written");
        assert_eq!(text(&first), text(&report("convergence")));
    }

    #[test]
    fn standstill_changes_no_parameter() {
        for scenario in report("standstill").scenarios.values() {
            assert_eq!(scenario.figures["parameter_drift_prior_sigmas"], 0.0);
        }
    }
}
