//! Does learning pay on every arm, and can it make anything worse? A world of arms in closed loop, over everything that may
//! go wrong.

mod job;
mod run;
pub mod soak;
mod twin;
mod world;

use crate::{Outcome, Progress, StudyError, unsupported};
use foretorque_workbench::arms;
use foretorque_workbench::board::Described;
use foretorque_workbench::parallel::{cores, in_parallel};
use foretorque_workbench::report::page::{Page, Section};
use foretorque_workbench::report::plot::{Curve, Panel, PlotColor};
use foretorque_workbench::robot::Robot;
use foretorque_workbench::snapshot::{aligned, significant};
use job::Bench;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::{AtomicUsize, Ordering};
use world::{ARMS, Scenario, WorldArm};

const PERIOD_S: f64 = 1e-3;

/// Figures by name; the unit is the end of the name.
pub type Figures = BTreeMap<&'static str, f64>;

/// Settings of the study.
#[derive(Clone, Debug, PartialEq)]
pub struct LearningConfig {
    /// First seed of arms, paths, noise and events, and their number.
    pub seeds: (u64, u64),
    /// Only `ARM/SCENARIO`, of which either may be cut short or empty.
    pub only: Option<String>,
    /// The short form.
    pub quick: bool,
    /// Arm that takes the place of those that are built in.
    pub robot: Option<Robot>,
}

/// Figures of one scenario of one arm.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ScenarioReport {
    /// Arm.
    pub arm: String,
    /// Scenario, start and torque source.
    pub scenario: String,
    /// Seed.
    pub seed: u64,
    /// Figures.
    pub figures: Figures,
    /// Time, s, and torque error on the unseen path over that of the start.
    pub curve: Vec<(f64, f64)>,
}

/// `report.json`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LearningReport {
    /// Version of this program.
    pub version: String,
    /// All runs.
    pub scenarios: Vec<ScenarioReport>,
    /// Every figure that has a bar.
    pub outcomes: Vec<Comparison>,
}

/// Names of all built-in arms and scenarios, each with one line on what it shows.
pub fn names() -> impl Iterator<Item = (&'static str, &'static str)> {
    let scenarios = Scenario::all(false).map(|scenario| (scenario.name, scenario.shows));
    ARMS.iter()
        .map(|(name, _, kind)| (*name, *kind))
        .chain(scenarios)
}

/// Runs the scenarios of all arms on all cores.
///
/// Errors: no arm or scenario has that name; the board's.
pub fn run(
    config: &LearningConfig,
    progress: Progress<'_>,
) -> Result<Outcome<LearningReport>, StudyError> {
    let only = config.only.as_deref().unwrap_or_default();
    let (arm, scenario) = only.split_once('/').unwrap_or((only, ""));
    let (first, count) = config.seeds;
    let world = match &config.robot {
        Some(robot) => vec![WorldArm {
            described: robot.clone(),
            kind: "given by --robot",
            guessed_rotors: false,
        }],
        None => WorldArm::all()?,
    };
    let arms = world.iter();
    let arms = arms.filter(|own| own.described.name.starts_with(arm));
    let seeds = first..first + count;
    let jobs = seeds.flat_map(|seed| arms.clone().map(move |arm| (arm, seed)));
    let jobs: Vec<(&WorldArm, u64)> = jobs.collect();
    let runs =
        Scenario::all(config.quick).map(|own| own.runs(scenario).count() * own.ticks(config.quick));
    let all = jobs.len() * runs.sum::<usize>() / 1000;
    if all == 0 {
        let reason = format!("no arm and scenario begin with '{only}': --list shows them");
        return Err(StudyError::from(reason));
    }
    let done = AtomicUsize::new(0);
    let advance = |ticks: usize| {
        let before = done.fetch_add(ticks / 1000, Ordering::Relaxed);
        progress("seconds of arm time", before + ticks / 1000, all);
    };
    let work = |&(arm, seed): &(&WorldArm, u64)| of_arm(arm, seed, config, scenario, &advance);
    let found = in_parallel(cores(), &jobs, work, || {}).into_iter();
    let found: Result<Vec<_>, StudyError> = found.collect();
    let scenarios: Vec<ScenarioReport> = found?.into_iter().flatten().collect();
    let report = LearningReport {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        outcomes: comparisons(&scenarios),
        scenarios,
    };
    Ok(Outcome {
        page: page(&report, &world),
        text: text(&report),
        report,
        broken: None,
    })
}

/// The scenarios of one arm and seed, by the code of its board.
fn of_arm(
    arm: &WorldArm,
    seed: u64,
    config: &LearningConfig,
    scenario: &str,
    done: &dyn Fn(usize),
) -> Result<Vec<ScenarioReport>, StudyError> {
    let robot = &arm.described;
    // Arms of the world have five joints or more: each size costs compile time.
    arms!(robot, N, P in (5, 36) (6, 40) (6, 44) (7, 48) (7, 52) (8, 60) => {
        Described::<N, P>::read(robot).ok_or_else(|| unsupported(N))?;
        Bench::<N>::new(arm, seed)?.scenarios::<Described<N, P>, P>(config, scenario, done)
    }, else {
        let (name, joints) = (&robot.name, robot.joint_count());
        Err(format!("{name}: {joints} joints; the learning scenarios take arms of 5 to 8").into())
    })
}

/// Beginnings of the names of arm and scenario, figure, side, bar.
#[rustfmt::skip]
const BARS: [(&str, &str, &str, &str, f64); 15] = [
    ("",    "path-description",      "unseen_over_start_ratio",           "at most",  0.35),
    ("",    "jitter-description",    "unseen_over_start_ratio",           "at most",  0.35),
    ("",    "path-bank",             "unseen_over_start_ratio",           "at most",  1.1),
    ("",    "path-",                 "unseen_over_batch_ratio",           "at most",  1.3),
    ("",    "path-description-link", "unseen_over_batch_ratio",           "at most",  1.1),
    ("",    "slow-",                 "unseen_over_batch_ratio",           "at most",  1.5),
    ("",    "",                      "windows_above_1.05_percent",        "at most",  1.0),
    ("",    "",                      "worst_window_ratio",                "at most",  1.1),
    ("",    "path-",                 "tracking_over_pd_ratio",            "at most",  0.2),
    ("",    "rigid-",                "tracking_over_pd_ratio",            "at most",  0.2),
    ("ur5", "rigid-",                "tracking_over_pd_ratio",            "at most",  0.05),
    ("",    "drift-",                "mean_over_start_ratio",             "at most",  0.8),
    ("",    "",                      "alarms_count",                      "at most",  0.0),
    ("",    "payload-",              "payload_mass_error_worst_percent",  "at most",  10.0),
    ("",    "",                      "armed_at_the_end_count",            "at least", 1.0),
];

/// One figure against its bar.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// Arm.
    pub arm: String,
    /// Scenario.
    pub scenario: String,
    /// Seed.
    pub seed: u64,
    /// Figure, its unit at the end.
    pub figure: String,
    /// Measured value.
    pub measured: f64,
    /// `at most` or `at least`.
    pub side: &'static str,
    /// The bar.
    pub bar: f64,
    /// It is reached.
    pub met: bool,
}

/// Every figure that has a bar, bar by bar.
fn comparisons(reports: &[ScenarioReport]) -> Vec<Comparison> {
    let mut out = Vec::new();
    for (arm, scenario, figure, side, bar) in BARS {
        let of_bar = |report: &&ScenarioReport| {
            (arm.is_empty() || report.arm == arm) && report.scenario.starts_with(scenario)
        };
        for report in reports.iter().filter(of_bar) {
            let Some(&measured) = report.figures.get(figure) else {
                continue;
            };
            out.push(Comparison {
                arm: report.arm.clone(),
                scenario: report.scenario.clone(),
                seed: report.seed,
                figure: figure.to_owned(),
                measured,
                side,
                bar,
                // A figure that is not a number is on neither side.
                met: match side {
                    "at most" => measured <= bar,
                    _ => measured >= bar,
                },
            });
        }
    }
    out
}

fn reached(outcomes: &[&Comparison]) -> String {
    let met = outcomes.iter().filter(|outcome| outcome.met).count();
    format!("{met} of {}", outcomes.len())
}

/// Names of the arms that ran, in their order.
fn arms(report: &LearningReport) -> Vec<&str> {
    let mut ran: Vec<&str> = report.scenarios.iter().map(|s| s.arm.as_str()).collect();
    let mut seen = BTreeSet::new();
    ran.retain(|arm| seen.insert(*arm));
    ran
}

/// Bars as rows, and one column for each arm: how many of its scenarios reach the bar, and the worst figure.
fn matrix(report: &LearningReport) -> (String, Vec<Vec<String>>) {
    let mut bars: Vec<(&str, &str, f64)> = Vec::new();
    for outcome in &report.outcomes {
        let bar = (outcome.figure.as_str(), outcome.side, outcome.bar);
        if !bars.contains(&bar) {
            bars.push(bar);
        }
    }
    let rows = bars.into_iter().map(|(figure, side, bar)| {
        let cells = arms(report).into_iter().map(|arm| {
            let mut own: Vec<&Comparison> = report.outcomes.iter().collect();
            own.retain(|own| own.arm == arm && (own.figure.as_str(), own.bar) == (figure, bar));
            let sign = if side == "at most" { 1.0 } else { -1.0 };
            let worst = own.iter().map(|outcome| sign * outcome.measured);
            let worst = sign * worst.fold(f64::NEG_INFINITY, f64::max);
            match (own.is_empty(), own.iter().any(|outcome| !outcome.met)) {
                (true, _) => String::new(),
                (_, false) => format!("{}, worst {}", reached(&own), number(worst)),
                (_, true) => format!("MISSED {}, worst {}", reached(&own), number(worst)),
            }
        });
        let first = [figure.to_owned(), format!("{side} {bar}")];
        first.into_iter().chain(cells).collect()
    });
    let header = arms(report).join(" | ");
    (format!("figure | bar | {header}"), rows.collect())
}

fn page(report: &LearningReport, world: &[WorldArm]) -> Page {
    let all: Vec<&Comparison> = report.outcomes.iter().collect();
    let (header, rows) = matrix(report);
    let missed = report.outcomes.iter().filter(|outcome| !outcome.met);
    let scenarios = report.scenarios.iter();
    let panels = scenarios
        .filter(|s| s.scenario.starts_with("path-"))
        .map(|scenario| {
            let title = format!("{} {}", scenario.arm, scenario.scenario);
            let curve = Curve::new(PlotColor::After, &scenario.curve, |point| *point);
            let mut panel = Panel::new(&title, "t / s", "error over start", vec![curve]);
            panel.from_zero = true;
            panel
        });
    let panels: Vec<Panel> = panels.collect();
    let figures = report.scenarios.iter().flat_map(|scenario| {
        scenario.figures.iter().map(|(figure, value)| {
            [
                scenario.arm.clone(),
                scenario.scenario.clone(),
                scenario.seed.to_string(),
                (*figure).to_owned(),
                number(*value),
            ]
        })
    });
    let kinds = world.iter();
    let kinds = kinds.map(|arm| [arm.described.name.clone(), arm.kind.to_owned()]);
    Page::new(
        "Learning on the board of every arm",
        "Simulated arms with elastic gears, sticking friction, sensor errors and late reports under PD control. The \
         firmware's own session learns in one configuration.",
    )
    .card(reached(&all), "figures reach their bar")
    .sections([
        Section::new("Bars by arm", "Scenarios that reach the bar, and the worst figure.")
            .table(header, rows),
        Section::new("Missed", "Every figure that misses its bar.")
            .table("arm | scenario | seed | figure | measured | bar", missed.map(row)),
        Section::new(
            "Torque error on a path that is never played",
            "Error of the set in force over that of the start; joints below 2 % of their limit count as 2 %.",
        )
        .plots(panels, 4),
        Section::new("Arms", "Descriptions in host-sim/robots, or of --robot.").table("arm | kind", kinds),
        Section::new("All figures", "The unit is the end of the name.")
            .table("arm | scenario | seed | figure | value", figures),
    ])
}

fn row(outcome: &Comparison) -> [String; 6] {
    [
        outcome.arm.clone(),
        outcome.scenario.clone(),
        outcome.seed.to_string(),
        outcome.figure.clone(),
        number(outcome.measured),
        format!("{} {}", outcome.side, outcome.bar),
    ]
}

fn text(report: &LearningReport) -> String {
    let all: Vec<&Comparison> = report.outcomes.iter().collect();
    let (header, rows) = matrix(report);
    let missed = report.outcomes.iter().filter(|outcome| !outcome.met);
    let mut missed = missed.map(row).peekable();
    let columns = "arm | scenario | seed | figure | measured | reach";
    let matrix = aligned(&header, rows);
    let missed = match missed.peek() {
        None => String::new(),
        Some(_) => format!("\nMissed:\n\n{}", aligned(columns, missed)),
    };
    let reached = reached(&all);
    format!("host-sim experiment learning: {reached} reached.\n\n{matrix}{missed}")
}

fn number(value: f64) -> String {
    significant(value, 4)
}
