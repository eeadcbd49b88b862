//! Does learning help, how fast, and can it make anything worse? Learned against frozen boards in closed loop, over
//! everything that may go wrong.

mod bars;
mod controller;
mod drive;
mod figures;
mod identified;
mod page;
mod scenario;
mod world;

pub use bars::Outcome;

use drive::{Board, Run, Trace};
use figures::{Figures, Traces, figures};
use identified::Starts;
use scenario::{SCENARIOS, Scenario};
use serde::Serialize;
use std::collections::BTreeMap;
use std::error::Error;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use world::World;

/// Bandwidths of the PD loop in which every scenario is run, Hz.
const BANDWIDTHS_HZ: [(f64, &str); 2] = [(6.0, "pd6"), (3.0, "pd3")];

/// What is to be run.
#[derive(Clone, Debug, PartialEq)]
pub struct LearningConfig {
    /// Seed of arm, prior, paths, noise and events.
    pub seed: u64,
    /// Only the scenarios whose names begin with this.
    pub only: Option<String>,
    /// The short form of every scenario.
    pub quick: bool,
}

/// One scenario at one bandwidth.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ScenarioReport {
    /// Seed.
    pub seed: u64,
    /// Ticks of the learning run.
    pub ticks: usize,
    /// Time, s, and error of the active set on the unseen path, moving rows, %.
    pub nrmse_moving_percent: Vec<(f64, f64)>,
    /// The same of the board that never learns.
    pub frozen_nrmse_moving_percent: Vec<(f64, f64)>,
    /// Figures, units in the keys; `null` where there is none.
    pub figures: Figures,
    /// Checksum of all torques of the learning run, bit for bit.
    pub torque_checksum: String,
}

/// `report.json`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LearningReport {
    /// Version of this program.
    pub version: String,
    /// Seed.
    pub seed: u64,
    /// Scenarios by name.
    pub scenarios: BTreeMap<String, ScenarioReport>,
    /// Figures against their bars.
    pub outcomes: Vec<Outcome>,
}

/// Told how far it is: seconds of arm time done, and in all.
pub type Progress<'p> = &'p (dyn Fn(&'static str, usize, usize) + Sync);

/// Names of all scenarios, each with one line on what it shows.
pub fn scenarios() -> impl Iterator<Item = (String, &'static str)> {
    SCENARIOS.iter().flat_map(|scenario| {
        BANDWIDTHS_HZ
            .iter()
            .map(|(_, loops)| (format!("{}-{loops}", scenario.name), scenario.shows))
    })
}

/// Runs the scenarios on all cores. Returns the figures and the page.
///
/// Errors: no scenario has that name.
pub fn run(
    config: &LearningConfig,
    progress: Progress<'_>,
) -> Result<(LearningReport, String), Box<dyn Error>> {
    let wanted: Vec<(String, &Scenario, f64)> = SCENARIOS
        .iter()
        .flat_map(|scenario| {
            BANDWIDTHS_HZ.map(|(hz, loops)| (format!("{}-{loops}", scenario.name), scenario, hz))
        })
        .filter(|(name, ..)| {
            config
                .only
                .as_ref()
                .is_none_or(|only| name.starts_with(only))
        })
        .collect();
    if wanted.is_empty() {
        let only = config.only.as_deref().unwrap_or_default();
        return Err(format!("no scenario begins with '{only}': --list shows them").into());
    }
    let world = World::new(config.seed)?;
    let starts = Starts::new(&world)?;
    let mut runs = Vec::new();
    for (place, (_, scenario, bandwidth_hz)) in wanted.iter().enumerate() {
        let boards: &[Board] = if scenario.against_pd {
            &[Board::Learning, Board::Frozen, Board::None]
        } else {
            &[Board::Learning, Board::Frozen]
        };
        runs.extend(boards.iter().map(|board| {
            let run = Run {
                world: &world,
                starts: &starts,
                scenario,
                bandwidth_hz: *bandwidth_hz,
                board: *board,
                quick: config.quick,
                tape: false,
            };
            (place, run)
        }));
    }
    let traces = run_all(&runs, progress)?;
    let mut by_place: BTreeMap<usize, Vec<(Board, Trace)>> = BTreeMap::new();
    for ((place, run), trace) in runs.iter().zip(traces) {
        by_place.entry(*place).or_default().push((run.board, trace));
    }
    let mut scenarios = BTreeMap::new();
    for (place, traces) in by_place {
        let (name, scenario, _) = &wanted[place];
        let mut traces: BTreeMap<u8, Trace> = traces
            .into_iter()
            .map(|(board, trace)| (board as u8, trace))
            .collect();
        let mut take = |board: Board| traces.remove(&(board as u8));
        let (Some(learning), Some(frozen)) = (take(Board::Learning), take(Board::Frozen)) else {
            continue;
        };
        let traces = Traces {
            learning,
            frozen,
            pd: take(Board::None),
        };
        let events = scenario.events(&world, config.quick);
        let figures = figures(scenario, &events, &traces);
        scenarios.insert(
            name.clone(),
            ScenarioReport {
                seed: config.seed,
                ticks: traces.learning.ticks,
                nrmse_moving_percent: curve(&traces.learning),
                frozen_nrmse_moving_percent: curve(&traces.frozen),
                figures,
                torque_checksum: format!("{:016x}", traces.learning.checksum),
            },
        );
    }
    let outcomes = bars::outcomes(scenarios.iter().map(|(name, s)| (name, &s.figures)));
    let report = LearningReport {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        seed: config.seed,
        scenarios,
        outcomes,
    };
    let page = page::page(&report)?;
    Ok((report, page))
}

/// Error over time, %.
fn curve(trace: &Trace) -> Vec<(f64, f64)> {
    let looks = trace.looks.iter();
    looks.map(|look| (look.t_s, 100.0 * look.nrmse)).collect()
}

/// Runs everything on all cores, the longest first; traces in the order of `runs`.
fn run_all(
    runs: &[(usize, Run<'_>)],
    progress: Progress<'_>,
) -> Result<Vec<Trace>, Box<dyn Error>> {
    let mut order: Vec<usize> = (0..runs.len()).collect();
    order.sort_by_key(|&k| std::cmp::Reverse(runs[k].1.ticks()));
    let all: usize = runs.iter().map(|(_, run)| run.ticks() / 1000).sum();
    let (next, done) = (AtomicUsize::new(0), AtomicUsize::new(0));
    let found: Mutex<Vec<Option<Result<Trace, String>>>> = Mutex::new(vec![None; runs.len()]);
    let advance = |ticks: usize| {
        let before = done.fetch_add(ticks / 1000, Ordering::Relaxed);
        progress("seconds of arm time", before + ticks / 1000, all);
    };
    let work = || {
        while let Some(&k) = order.get(next.fetch_add(1, Ordering::Relaxed)) {
            let trace = runs[k].1.trace(&advance).map_err(|error| error.to_string());
            if let Ok(mut found) = found.lock() {
                found[k] = Some(trace);
            }
        }
    };
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    std::thread::scope(|scope| {
        for _ in 0..cores {
            scope.spawn(work);
        }
    });
    let found = found.into_inner().map_err(|_| "a run ended early")?;
    found
        .into_iter()
        .map(|trace| Ok(trace.ok_or("a run ended early")??))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn report(only: &str) -> LearningReport {
        let config = LearningConfig {
            seed: 1,
            only: Some(only.to_owned()),
            quick: true,
        };
        run(&config, &|_, _, _| {}).expect("runs").0
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
