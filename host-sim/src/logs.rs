//! Logs: the columns that a command reads, telemetry recorded from a line, logs replayed to the learner.

use super::arm::RobotOptions;
use super::boards::{BoardChoice, on_arm};
use super::terminal::{Bar, SignalGuard, show};
use super::{Failure, bail, bank, duration, not_foreign, not_over, positive, sound, within};
use clap::Args;
use foretorque::arm::Arm;
use foretorque::learning::{ParameterSet, StartDeviations};
use foretorque_studies::replay::{self, ReplayPath};
use foretorque_workbench::board::Transport;
use foretorque_workbench::board::serial::{self, Serial};
use foretorque_workbench::files::at;
use foretorque_workbench::identification::{
    ColumnSet, IdentifyError, Judgement, PrepareConfig, judge, same_content,
};
use foretorque_workbench::report::ReportFiles;
use foretorque_workbench::report::page::or_dash;
use foretorque_workbench::robot::{EffortKind, LOG_SOURCES, LogColumns, Robot, Units};
use foretorque_workbench::telemetry::TelemetryTap;
use std::collections::HashSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Options that all commands with `--log` share.
#[derive(Debug, Args)]
pub(super) struct LogOptions {
    /// Columns of the logs: ros, rtde, franka, lerobot, or a TOML file with t_s, q_rad, tau_nm (see
    /// docs/identification.md); found without it where the log is of a known source
    #[arg(long, value_name = "SOURCE|FILE")]
    columns_from: Option<String>,
    /// Names of the columns of logs without a header row, separated by commas
    #[arg(long, value_delimiter = ',', value_name = "LIST")]
    names: Vec<String>,
    /// Units of the logs where they are not SI, such as q=deg,t=ms,tau=mNm; the same for all of them. Quantities
    /// that are not named keep the units of their source or file
    #[arg(long)]
    units: Option<Units>,
    /// Quantity in the torque columns: torque, current (times the drive gain) or motor (times gear_ratios of --columns-from)
    #[arg(long)]
    effort: Option<EffortKind>,
}

impl LogOptions {
    pub(super) fn file(&self) -> Option<PathBuf> {
        self.columns_from.as_ref().map(PathBuf::from)
    }

    /// Gives the robot the columns that were asked for, in the place of those of its description.
    ///
    /// Errors: a file that is no map.
    pub(super) fn apply(&self, robot: &mut Robot) -> Result<(), Failure> {
        let mut columns = match self.columns_from.as_deref() {
            None => robot.log_columns.clone().unwrap_or_default(),
            Some(name) if LOG_SOURCES.contains(&name) => LogColumns {
                source: Some(name.to_owned()),
                of_joints: robot.log_columns.as_ref().is_some_and(|map| map.of_joints),
                ..LogColumns::default()
            },
            Some(file) => {
                let map = LogColumns::load(file)?;
                LogColumns {
                    required: true,
                    ..map
                }
            }
        };
        if !self.names.is_empty() {
            columns.names.clone_from(&self.names);
        }
        columns.effort = self.effort.or(columns.effort);
        let of_map = columns.units.clone().filter(|_| columns.required);
        columns.all_units = match self.units.clone() {
            Some(units) => Some(units.over(of_map)),
            None => of_map,
        };
        robot.log_columns = (columns != LogColumns::default()).then_some(columns);
        Ok(())
    }
}

/// Errors: a log that is given twice, or a copy of another one.
pub(super) fn check_distinct(logs: &[PathBuf]) -> Result<(), Failure> {
    let mut files = HashSet::new();
    for log in logs {
        if fs::canonicalize(log).is_ok_and(|file| !files.insert(file)) {
            bail!("--log {} is given twice", log.display());
        }
    }
    for (place, log) in logs.iter().enumerate() {
        let mut others = logs[..place].iter();
        if let Some(same) = others.find(|other| same_content(log, other)) {
            bail!(
                "--log {} is a copy of --log {}",
                log.display(),
                same.display()
            );
        }
    }
    Ok(())
}

/// Record the telemetry of a board that another host drives, into CSV and MCAP; nothing is sent
#[derive(Debug, Args)]
pub(super) struct Record {
    /// serial:PORT of an adapter whose RX is on the board's TX, too
    #[arg(long)]
    board: BoardChoice,
    /// Period of the board, ms; a hello on the line replaces it
    #[arg(long, value_name = "MS", default_value_t = 1.0, value_parser = positive)]
    period_ms: f64,
    /// Record this long, s; without it until Ctrl-C
    #[arg(long, value_parser = duration)]
    duration_s: Option<f64>,
    /// Table of the records; the MCAP beside it has the same name
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

const WAIT: Duration = Duration::from_millis(50);

impl Record {
    pub(super) fn run(&self) -> Result<(), Failure> {
        let BoardChoice::Serial(port) = &self.board else {
            bail!(
                "--board {}: only the line of a board at serial:PORT can be read along",
                self.board
            );
        };
        let end = self.duration_s.map(Duration::from_secs_f64);
        let end = end.map(|duration| Instant::now() + duration);
        let mut line = Serial::open(port, serial::BAUD)?;
        let mut telemetry_tap = TelemetryTap::new(&self.out, 1e-3 * self.period_ms);
        let named = |error| at(&self.out, error);
        let mut buffer = [0; 4096];
        let guard = SignalGuard::begin();
        let runs = || !guard.interrupted() && end.is_none_or(|end| Instant::now() < end);
        // A line that ends takes nothing away from what was recorded.
        let mut gone = None;
        while gone.is_none() && runs() {
            match line.receive(&mut buffer, WAIT) {
                Ok(count) => telemetry_tap.take(&buffer[..count]).map_err(named)?,
                Err(error) => gone = Some(error),
            }
        }
        let Some((records, torn)) = telemetry_tap.finish().map_err(named)? else {
            bail!(
                "serial:{port}: no telemetry: the host of the board asks for it with Telemetry (docs/protocol.md)"
            );
        };
        if let Some(error) = gone {
            show!("note: the line ended: {error}")?;
        }
        let out = self.out.display();
        show!("{records} records, {torn} left out with a part missing, {out}")
    }
}

/// Replay logs to the board's learner, row by row, and score it against batch least squares and against its start
#[derive(Debug, Args)]
pub(super) struct Replay {
    #[command(flatten)]
    robot: RobotOptions,
    /// Log (CSV, ROS 2 bag, MCAP); given several times, batch least squares learns each from the others
    #[arg(long = "log", value_name = "FILE", required = true)]
    logs: Vec<PathBuf>,
    #[command(flatten)]
    columns_of_log: LogOptions,
    /// Parameter bank to start from; without it the description's rigid body
    #[arg(long, value_name = "FILE")]
    bank: Option<PathBuf>,
    /// Seed of the batch identification
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Replay although a check refuses a log, such as torques of the wrong sign
    #[arg(long)]
    force: bool,
    /// Directory for report.json and report.html
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

impl Replay {
    pub(super) fn run(&self) -> Result<(), Failure> {
        check_distinct(&self.logs)?;
        let mut robot = self.robot.load()?;
        self.columns_of_log.apply(&mut robot)?;
        let mut read = self.robot.files();
        read.extend(self.logs.iter().chain(&self.bank).cloned());
        read.extend(self.columns_of_log.file());
        let results = ["report.html", "report.json"];
        not_over(read, within(&self.out, &results))?;
        not_foreign(&self.out, &results)?;
        if !self.force {
            let logs: Vec<&Path> = self.logs.iter().map(PathBuf::as_path).collect();
            let prepare = PrepareConfig::for_logs(&logs, &robot)?;
            let judgement = judge(&robot, &self.logs, &ColumnSet::default(), &prepare)?;
            sound(&judgement, &self.logs, "--force replays all the same")?;
            show_warnings(&judgement)?;
        }
        on_arm!(&robot, A, N, P => self.replay::<A, N, P>(&robot))
    }

    fn replay<A: Arm<N, P>, const N: usize, const P: usize>(
        &self,
        robot: &Robot,
    ) -> Result<(), Failure> {
        let (mut set, mut deviations) = (ParameterSet::nominal::<A>(1), StartDeviations::PRIOR);
        if let Some(file) = &self.bank {
            let bank = bank::read_for(file, robot)?;
            (set, deviations) = (bank.set::<A, N, P>()?, bank.start_deviations::<A, N, P>());
        }
        let name = |path: &Path| path.display().to_string();
        let start = self.bank.as_deref().map_or("description".to_owned(), name);
        let path = |file: &PathBuf| ReplayPath {
            name: name(file),
            files: vec![file.clone()],
        };
        let paths: Vec<ReplayPath> = self.logs.iter().map(path).collect();
        let files = ReportFiles::create(&self.out)?;
        let bar = Bar::new();
        let progress = |stage, done, all| bar.show(stage, done, all);
        let start = (start.as_str(), set, deviations);
        let outcome = replay::run::<A, N, P>(robot, &paths, start, self.seed, None, &progress)?;
        drop(bar);
        let page = files.finish(&outcome.report, &outcome.page)?;
        show!("{}", outcome.text.trim_end())?;
        show!("report  {}", page.display())
    }
}

fn show_warnings(judgement: &Judgement) -> Result<(), Failure> {
    let mut warnings = judgement.warnings();
    warnings.try_for_each(|text| show!("warning  {text}"))
}

/// Prints the judgement of `--data-check`.
///
/// Errors: the first finding that refuses, after the others are printed; logs that do not show all `parameters`.
pub(super) fn show_check(judgement: &Judgement, parameters: usize) -> Result<(), Failure> {
    show!("rows every {:.3} ms", 1e3 * judgement.period_s)?;
    for note in &judgement.notes {
        show!("note  {note}")?;
    }
    for (number, joint) in (1..).zip(&judgement.joints) {
        let scale = or_dash(joint.scale_ratio, |scale| format!("{scale:.2}"));
        let (low, high) = joint.position_rad;
        show!(
            "joint {number}  {low:.2} … {high:.2} rad, {:.2} rad/s, torque {:.3} N·m RMS, noise {:.3} N·m, {:.0} % unexplained, {scale} × description",
            joint.speed_rad_s,
            joint.torque_rms_nm,
            joint.noise_floor_nm,
            100.0 * joint.unexplained_ratio
        )?;
    }
    if let Some(condition) = judgement.condition_number_equilibrated {
        show!("every parameter is shown, condition number {condition:.0} at unit length")?;
    }
    if let Some((delay_s, deviation_s)) = judgement.delay_s {
        let [delay, deviation] = [delay_s, deviation_s].map(|time_s| 1e3 * time_s);
        show!("torque delay {delay:.2} ± {deviation:.2} ms")?;
    }
    show_warnings(judgement)?;
    let mut refusing = judgement.findings.iter().filter(|finding| finding.refuses);
    if let Some(first) = refusing.next() {
        refusing.try_for_each(|other| show!("also wrong  {}", other.text))?;
        bail!("{}", first.text);
    }
    let unseen = &judgement.unseen;
    if unseen.is_empty() {
        return show!("no finding that refuses a bank");
    }
    Err(IdentifyError::RankDeficient(parameters - unseen.len(), parameters, unseen.clone()).into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_check_refuses_logs_that_do_not_show_all() {
        let judgement = Judgement {
            unseen: vec!["Fo4".to_owned()],
            ..Judgement::default()
        };
        let refused = show_check(&judgement, 9).expect_err("refused").to_string();
        assert!(
            refused.contains("(8 of 9): it does not show Fo4: --columns"),
            "{refused}"
        );
    }
}
