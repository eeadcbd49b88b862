use super::boards::BoardChoice;
use super::campaign;
use super::progress::Bar;
use super::terminal::say;
use super::{Failure, unusable};
use crate::board::Client;
use crate::experiment::campaign::Shard;
use crate::experiment::demo::{self, DemoConfig, DemoReport};
use crate::experiment::learning::soak::{self, SoakConfig};
use crate::experiment::learning::{self, LearningConfig, LearningReport};
use crate::experiment::{EXPERIMENTS, real_ur5, replay_real};
use crate::files::{WholeFile, write_whole};
use crate::robot::Robot;
use clap::Args;
use foretorque::arm::Arm;
use foretorque::arm::ur5::{JOINTS, PARAMETERS, Ur5};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Run one of the reproducible studies
#[derive(Debug, Args)]
pub(super) struct Arguments {
    /// Name of the study
    #[arg(required_unless_present = "list")]
    name: Option<String>,
    /// List the studies; after `learning` its scenarios
    #[arg(long)]
    list: bool,
    /// Only the scenarios of learning whose names begin so
    #[arg(long, value_name = "NAME")]
    only: Option<String>,
    /// The short form of learning, excitation and paper
    #[arg(long)]
    pub(super) quick: bool,
    /// Seeds of excitation [default: 20] and paper [default: 10]
    #[arg(long, value_name = "N")]
    pub(super) seeds: Option<u64>,
    /// Only this part of excitation or paper, for example 2/8; `merge` puts the parts together
    #[arg(long, value_name = "i/n")]
    pub(super) shard: Option<Shard>,
    /// Robot of excitation: a built-in name or a description file
    #[arg(long, default_value = "ur5")]
    pub(super) robot: String,
    /// Excitation that paper trains on, an excitation.json for the UR5 [default: a precomputed one]
    #[arg(long, value_name = "FILE")]
    pub(super) excitation: Option<PathBuf>,
    /// Put learning's table of measured against reach between its marks in this file
    #[arg(long, value_name = "FILE")]
    table: Option<PathBuf>,
    /// Compare with the table in that file instead, and fail where a figure differs
    #[arg(long, requires = "table")]
    check: bool,
    /// Directory for report.json and report.html
    #[arg(long, value_name = "DIR", required_unless_present = "list")]
    out: Option<PathBuf>,
    /// Board: qemu or native. demo runs on it, and with qemu the flashable firmware beside it, over its USART; learning
    /// and soak run natively and compare a part with it bit for bit, unless it is native
    #[arg(long, default_value = "qemu")]
    board: BoardChoice,
    /// Seed of plant, prior, paths and noise
    #[arg(long, default_value_t = DemoConfig::default().seed)]
    pub(super) seed: u64,
    /// Arm time with learning on, long run, s
    #[arg(long, default_value_t = DemoConfig::default().learning_s)]
    learning_s: f64,
    /// Arm time with learning on, flashable firmware, s
    #[arg(long, default_value_t = DemoConfig::default().usart_learning_s)]
    usart_learning_s: f64,
    /// Ticks of soak in this process
    #[arg(long, default_value_t = 10_000_000)]
    ticks: usize,
    /// Ticks of soak that are compared with the board
    #[arg(long, default_value_t = 1_000_000)]
    board_ticks: usize,
    /// Directory of the logs of real-ur5 and replay-real
    #[arg(long, value_name = "DIR", default_value = "tests/data/ur5-real")]
    logs: PathBuf,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    if arguments.list && arguments.name.as_deref() == Some("learning") {
        for (name, shows) in learning::scenarios() {
            say(format_args!("{name:<26} {shows}"))?;
        }
        return Ok(());
    }
    if arguments.list {
        for (name, shows) in EXPERIMENTS {
            say(format_args!("{name:<12} {shows}"))?;
        }
        return Ok(());
    }
    let sharded = ["excitation", "paper"];
    if arguments.shard.is_some()
        && !arguments
            .name
            .as_deref()
            .is_some_and(|name| sharded.contains(&name))
    {
        return Err(unusable(format!(
            "--shard: only {} can be sharded",
            sharded.join(" and ")
        )));
    }
    match (arguments.name.as_deref(), &arguments.out) {
        (Some("demo"), Some(out)) => run_demo(arguments, out),
        (Some("excitation"), Some(out)) => campaign::run_excitation(arguments, out),
        (Some("learning"), Some(out)) => run_learning(arguments, out),
        (Some("soak"), Some(out)) => run_soak(arguments, out),
        (Some("paper"), Some(out)) => campaign::run_paper(arguments, out),
        (Some("real-ur5"), Some(out)) => run_real_ur5(arguments, out),
        (Some("replay-real"), Some(out)) => run_replay_real(arguments, out),
        (name, _) => Err(unusable(format!(
            "unknown experiment '{}': `experiment --list` shows them",
            name.unwrap_or_default()
        ))),
    }
}

fn run_demo(arguments: &Arguments, out: &Path) -> Result<(), Failure> {
    let usable = |time_s: f64| time_s.is_finite() && time_s >= 1.0;
    if !usable(arguments.learning_s) || !usable(arguments.usart_learning_s) {
        return Err(unusable("times of learning must be at least 1 s"));
    }
    if arguments.usart_learning_s > arguments.learning_s {
        return Err(unusable("--usart-learning-s must not exceed --learning-s"));
    }
    let config = DemoConfig {
        seed: arguments.seed,
        learning_s: arguments.learning_s,
        usart_learning_s: arguments.usart_learning_s,
        ..DemoConfig::default()
    };
    // A directory that cannot be written is said now, not after the work.
    let mut json = WholeFile::create(&out.join("report.json"))?;
    let robot = Robot::load(Ur5::NAME)?;
    let mut bulk = arguments.board.connect::<Ur5, JOINTS, PARAMETERS>(None)?;
    let mut usart = match arguments.board {
        BoardChoice::Qemu => Some(BoardChoice::QemuUsart.connect::<Ur5, JOINTS, PARAMETERS>(None)?),
        _ => None,
    };
    let bar = Bar::new();
    let outcome = demo::run::<Ur5, JOINTS, PARAMETERS>(
        &robot,
        &config,
        &arguments.board.to_string(),
        &arguments.board.toolchain(),
        &mut bulk,
        usart.as_mut(),
        &|stage, done, all| bar.show(stage, done, all),
    )?;
    drop(bar);
    serde_json::to_writer_pretty(&mut json, &outcome.report)?;
    json.write_all(b"\n")?;
    write_whole(&out.join("report.html"), outcome.html.as_bytes())?;
    json.finish()?;
    summarise(&outcome.report)?;
    say(format_args!(
        "report           {}",
        out.join("report.html").display()
    ))?;
    Ok(())
}

fn run_learning(arguments: &Arguments, out: &Path) -> Result<(), Failure> {
    let config = LearningConfig {
        seed: arguments.seed,
        only: arguments.only.clone(),
        quick: arguments.quick,
    };
    let mut json = WholeFile::create(&out.join("report.json"))?;
    let mut board = board_beside(arguments)?;
    let bar = Bar::new();
    let (report, page) = learning::run(&config, board.as_mut(), &|stage, done, all| {
        bar.show(stage, done, all);
    })?;
    drop(bar);
    serde_json::to_writer_pretty(&mut json, &report)?;
    json.write_all(b"\n")?;
    write_whole(&out.join("report.html"), page.as_bytes())?;
    json.finish()?;
    for outcome in &report.outcomes {
        say(format_args!(
            "{:<26} {:<44} {:>10.4}  {} {:<6} {}",
            outcome.scenario,
            outcome.figure,
            outcome.measured,
            outcome.side,
            outcome.bar,
            if outcome.met { "met" } else { "MISSED" }
        ))?;
    }
    if let Some(file) = &arguments.table {
        keep_table(&report, file, arguments.check)?;
    }
    for (name, replayed) in &report.emulated {
        say(format_args!(
            "{name:<26} {} ticks on board {}, {} with other bits",
            replayed.ticks_count, arguments.board, replayed.ticks_with_other_bits_count
        ))?;
    }
    Ok(())
}

/// Writes the table of measured against reach into `file`, or compares it with the one there.
fn keep_table(report: &LearningReport, file: &Path, check: bool) -> Result<(), Failure> {
    let text = std::fs::read_to_string(file).map_err(|error| crate::files::at(file, error))?;
    let marked = format!("{}: ", file.display());
    let renewed = learning::table::renewed(&text, report)
        .ok_or_else(|| unusable(marked.clone() + "has not the two marks of the table"))?;
    if !check {
        return Ok(write_whole(file, renewed.as_bytes())?);
    }
    let lines = text.lines().zip(renewed.lines());
    match lines.into_iter().find(|(kept, new)| kept != new) {
        Some((kept, new)) => Err(unusable(format!("{marked}says {kept}, measured {new}"))),
        None if text != renewed => Err(unusable(marked + "has a table of another length")),
        None => Ok(()),
    }
}

fn run_soak(arguments: &Arguments, out: &Path) -> Result<(), Failure> {
    let config = SoakConfig {
        seed: arguments.seed,
        ticks: arguments.ticks,
        board_ticks: arguments.board_ticks,
    };
    let mut json = WholeFile::create(&out.join("report.json"))?;
    let mut board = board_beside(arguments)?;
    let bar = Bar::new();
    let report = soak::run(&config, board.as_mut(), &|stage, done, all| {
        bar.show(stage, done, all);
    })?;
    drop(bar);
    serde_json::to_writer_pretty(&mut json, &report)?;
    json.write_all(b"\n")?;
    json.finish()?;
    say(serde_json::to_string_pretty(&report)?)?;
    Ok(())
}

/// The board that native runs are compared with; none if it would be the native one.
fn board_beside(arguments: &Arguments) -> Result<Option<Client<JOINTS>>, Failure> {
    match &arguments.board {
        BoardChoice::Native => Ok(None),
        board => Ok(Some(board.connect::<Ur5, JOINTS, PARAMETERS>(None)?)),
    }
}

fn run_replay_real(arguments: &Arguments, out: &Path) -> Result<(), Failure> {
    let bar = Bar::new();
    let (report, page) = replay_real::run(&arguments.logs, arguments.seed, &|stage, done, all| {
        bar.show(stage, done, all);
    })?;
    drop(bar);
    let json = serde_json::to_string_pretty(&report)? + "\n";
    write_whole(&out.join("report.html"), page.as_bytes())?;
    write_whole(&out.join("report.json"), json.as_bytes())?;
    for (value, what) in [
        (report.aged_10_s_vs_rich_wls_ratio, "parameters 10 s old"),
        (
            report.aged_10_s_after_other_paths_vs_rich_wls_ratio,
            "the same, other paths before",
        ),
        (report.newest_vs_rich_wls_ratio, "parameters as they are"),
        (report.frozen_vs_rich_wls_ratio, "data sheet, frozen"),
        (
            report.plain_wls_vs_rich_wls_ratio,
            "plain batch least squares",
        ),
    ] {
        say(format_args!("{what:<28} {value:.3} × {}", report.reference))?;
    }
    say(format_args!(
        "decisions of the guard       {:?}",
        report.decisions_count
    ))?;
    Ok(())
}

fn run_real_ur5(arguments: &Arguments, out: &Path) -> Result<(), Failure> {
    let bar = Bar::new();
    let (report, page) = real_ur5::run(&arguments.logs, arguments.seed, &|done, all| {
        bar.show("path held out", done, all);
    })?;
    drop(bar);
    let json = serde_json::to_string_pretty(&report)? + "\n";
    write_whole(&out.join("report.html"), page.as_bytes())?;
    write_whole(&out.join("report.json"), json.as_bytes())?;
    for path in &report.paths {
        say(format_args!(
            "{:<12} {:.3}",
            path.path, path.geometric_mean_vs_wls
        ))?;
    }
    say(format_args!(
        "{} over {}: {:.3}, worst path {:.3}",
        report.recommended,
        report.reference,
        report.geometric_mean_vs_wls,
        report.worst_path_vs_wls
    ))?;
    say(format_args!(
        "report       {}",
        out.join("report.html").display()
    ))?;
    Ok(())
}

fn summarise(report: &DemoReport) -> std::io::Result<()> {
    say(format_args!(
        "torque error     {:.1} % → {:.1} % NRMSE on the unseen path ({:.2} of before), {} ticks of learning",
        100.0 * report.torque_nrmse_before,
        100.0 * report.torque_nrmse_after,
        report.torque_nrmse_after / report.torque_nrmse_before,
        report.ticks
    ))?;
    let tracking = &report.tracking_rms_mrad;
    say(format_args!(
        "tracking error   {:.2} mrad PD alone, {:.2} with the wrong model, {:.2} with the learnt one",
        tracking.pd_only, tracking.before, tracking.after
    ))?;
    say(format_args!(
        "cost of a tick   {} instructions mean, {} largest",
        report.tick_instructions.mean, report.tick_instructions.max
    ))?;
    say(format_args!(
        "link             {} frames, {} errors",
        report.link.frames, report.link.errors
    ))?;
    if let Some(usart) = &report.usart {
        say(format_args!(
            "flashable ELF    {:.1} % → {:.1} % in {} ticks over its USART, {} of them with the same bits",
            100.0 * usart.torque_nrmse_before,
            100.0 * usart.torque_nrmse_after,
            usart.ticks,
            usart.ticks_with_equal_bits
        ))?;
    }
    Ok(())
}
