//! Does learning help, how fast, and can it make anything worse? Learned against frozen boards in closed loop, over
//! everything that may go wrong.

mod bars;
mod baselines;
mod bound;
mod comparison;
mod controller;
mod drive;
mod emulated;
mod figures;
mod identified;
mod page;
mod scenario;
pub mod soak;
pub mod table;
mod twin;
mod watch;
mod world;

pub use bars::Outcome;
pub use comparison::MethodReport;
pub use emulated::EmulatedReport;

use drive::{Board, Run, Trace};
use figures::{Figures, Traces, figures};
use foretorque::arm::ur5::JOINTS;
use foretorque_workbench::board::Client;
use foretorque_workbench::parallel::{cores, in_parallel};
use identified::Starts;
use scenario::{SCENARIOS, Scenario};
use serde::Serialize;
use std::cell::Cell;
use std::collections::BTreeMap;
use std::error::Error;
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
    /// Estimators side by side on the same rows, by name; empty where only some scenarios were asked for.
    pub comparison: BTreeMap<String, MethodReport>,
    /// Scenarios replayed on the board, by name; empty without a board.
    pub emulated: BTreeMap<String, EmulatedReport>,
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

/// Runs the scenarios on all cores, then some of them again on `board`. Returns the figures and the page.
///
/// Errors: no scenario has that name; the board's.
pub fn run(
    config: &LearningConfig,
    mut board: Option<&mut Client<JOINTS>>,
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
    let comparison_alone = config.only.as_deref() == Some("comparison");
    if wanted.is_empty() && !comparison_alone {
        let only = config.only.as_deref().unwrap_or_default();
        return Err(format!("no scenario begins with '{only}': --list shows them").into());
    }
    let world = World::new(config.seed)?;
    let starts = Starts::new(&world)?;
    let mut runs = Vec::new();
    for (place, (name, scenario, bandwidth_hz)) in wanted.iter().enumerate() {
        let mut boards = vec![Board::Learning, Board::Frozen];
        boards.extend(scenario.against_pd.then_some(Board::None));
        boards.extend(scenario.without_network.then_some(Board::NoNetwork));
        runs.extend(boards.iter().map(|board_kind| {
            let run = Run {
                world: &world,
                starts: &starts,
                scenario,
                bandwidth_hz: *bandwidth_hz,
                board: *board_kind,
                quick: config.quick,
                tape: board.is_some()
                    && *board_kind == Board::Learning
                    && emulated::REPLAYED.contains(&name.as_str()),
            };
            (place, run)
        }));
    }
    let traces = run_all(&runs, progress)?;
    let mut by_place: BTreeMap<usize, Vec<(Board, Trace)>> = BTreeMap::new();
    for ((place, run), trace) in runs.iter().zip(traces) {
        by_place.entry(*place).or_default().push((run.board, trace));
    }
    let (mut scenarios, mut emulated) = (BTreeMap::new(), BTreeMap::new());
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
            no_network: take(Board::NoNetwork),
        };
        if let Some(board) = board
            .as_deref_mut()
            .filter(|_| !traces.learning.tape.is_empty())
        {
            let (start, all) = (starts.set(scenario.start), traces.learning.tape.len());
            let done = Cell::new(0);
            let replayed = emulated::replay(board, start, &traces.learning, &|ticks| {
                done.set(done.get() + ticks);
                progress("ticks on the board", done.get(), all);
            })?;
            emulated.insert(name.clone(), replayed);
        }
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
    let comparison = match config.only {
        Some(_) if !comparison_alone => BTreeMap::new(),
        _ => comparison::compare(&world, config.quick, &|done, all| {
            progress("estimators compared", done, all);
        })?,
    };
    let outcomes = bars::outcomes(scenarios.iter().map(|(name, s)| (name, &s.figures)));
    let report = LearningReport {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        seed: config.seed,
        scenarios,
        comparison,
        emulated,
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
    let done = AtomicUsize::new(0);
    let advance = |ticks: usize| {
        let before = done.fetch_add(ticks / 1000, Ordering::Relaxed);
        progress("seconds of arm time", before + ticks / 1000, all);
    };
    let work = |&k: &usize| {
        (
            k,
            runs[k].1.trace(&advance).map_err(|error| error.to_string()),
        )
    };
    let mut found = in_parallel(cores(), &order, work, || {});
    found.sort_by_key(|(k, _)| *k);
    let traces = found.into_iter().map(|(_, trace)| Ok(trace?));
    traces.collect()
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
            .0
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
