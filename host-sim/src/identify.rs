use super::arm::RobotOptions;
use super::logs::{LogOptions, check_distinct, show_check};
use super::terminal::{Lines, show};
use super::{Failure, bail, excite, not_foreign, not_negative, not_over, positive, sound, within};
use clap::Args;
use foretorque_link::bank::{BankError, ParameterBank};
use foretorque_workbench::arms;
use foretorque_workbench::board::Described;
use foretorque_workbench::files::{remove_stale, write_whole};
use foretorque_workbench::identification::{
    ColumnSet, Finding, GainRecord, IdentifyConfig, Judgement, Layout, METHODS, MethodName,
    Outcome, PrepareConfig, bank_of_fit, identify, judge, page, unexplained, with_gains,
};
use foretorque_workbench::report::ReportFiles;
use foretorque_workbench::report::page::{figure, or_dash};
use foretorque_workbench::robot::Robot;
use foretorque_workbench::trajectory;
use indicatif::{ProgressBar, ProgressStyle};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Identify an arm's parameters from logs, by all methods side by side, and validate them on unseen logs
#[derive(Debug, Args)]
pub(super) struct Arguments {
    #[command(flatten)]
    pub(super) robot: RobotOptions,
    /// Training log (CSV, CSV.gz, ROS 2 bag, MCAP); may be given several times
    #[arg(long = "log", value_name = "FILE", required = true)]
    logs: Vec<PathBuf>,
    /// Log of an unseen path to validate on, by which the method for the bank is chosen; may be given several times
    #[arg(long, value_name = "FILE")]
    validate: Vec<PathBuf>,
    /// Log of an unseen path by which nothing is chosen; may be given several times
    #[arg(long, value_name = "FILE")]
    test: Vec<PathBuf>,
    /// Judge the training logs only: units, signs, clock, delay, excitation; nothing is identified
    #[arg(long)]
    data_check: bool,
    /// Identify from logs that are refused, and write a bank that predicts worse than the description
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    columns_of_log: LogOptions,
    /// Directory for report.json, report.html, parameters.bank, and robot.toml and robot.urdf of the consistent parameters
    #[arg(long, value_name = "DIR", required_unless_present = "data_check")]
    out: Option<PathBuf>,
    /// Methods, separated by commas: ols, wls, irls, consistent, evidence, bp_physical, bp_black_box, bp_residual
    #[arg(long, value_delimiter = ',', value_name = "LIST")]
    methods: Vec<MethodName>,
    /// Friction columns, joined by '+': coulomb-viscous, offset, stribeck, sqrt, cubic, load, cogging,
    /// warm-up; or full for all
    #[arg(long, default_value_t)]
    columns: ColumnSet,
    /// Filter of the training logs; fourier folds a log that repeats into one period and projects it on the harmonics
    /// below the cut-offs. Validation logs always go through the zero-phase Butterworth filter.
    #[arg(long, default_value = "butterworth")]
    filter: Filter,
    /// Period of the training logs, s, for --filter fourier; at most 1000
    #[arg(long, conflicts_with = "excitation", value_parser = excite::period)]
    period_s: Option<f64>,
    /// The excitation.json that the training logs repeat, for --filter fourier
    #[arg(long, value_name = "FILE")]
    excitation: Option<PathBuf>,
    /// Cut-off of the zero-phase filter on the motion, Hz; above that on the torque, so that the filter on both sides
    /// of the equation is the same where it acts; without it 40, or 0.4 of the rows a second of a slow log
    #[arg(long, value_parser = positive)]
    motion_hz: Option<f64>,
    /// Cut-off of the zero-phase filter on torque and regressor, Hz; 0 for none; without it 20, or 0.2 of the rows a
    /// second of a slow log, and at most half of that on the motion
    #[arg(long, value_parser = not_negative)]
    torque_hz: Option<f64>,
    /// A joint slower than this stands still, rad/s
    #[arg(long, default_value_t = PrepareConfig::STILL_RAD_S, value_parser = not_negative)]
    still_rad_s: f64,
    /// Where drive gains come from when the logs hold currents: the description, or the gravity torque of the description
    /// over the current while the arm stands still
    #[arg(long, default_value = "description")]
    gains: Gains,
    /// Robot whose parameters are the truth
    #[arg(long, value_name = "ROBOT")]
    truth: Option<String>,
    /// The truth is the plant that `simulate --seed` made of that robot
    #[arg(long, value_name = "SEED", requires = "truth")]
    truth_seed: Option<u64>,
    /// Seed of random starts
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Gains {
    Description,
    Standstill,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Filter {
    Butterworth,
    Fourier,
}

/// The period to fold training logs on, if that is wanted.
fn fold_period_s(arguments: &Arguments, robot: &Robot) -> Result<Option<f64>, Failure> {
    let mut period_s = arguments.period_s;
    if let Some(path) = &arguments.excitation {
        period_s = Some(trajectory::excitation(path, robot)?.period_s);
    }
    match (arguments.filter, period_s) {
        (Filter::Butterworth, Some(_)) => {
            bail!("--period-s and --excitation belong to --filter fourier")
        }
        (Filter::Fourier, None) => bail!("--filter fourier needs --period-s or --excitation"),
        (_, period_s) => Ok(period_s),
    }
}

impl Arguments {
    /// Errors: a result that would take the place of a file that is read, or that no earlier run wrote; a training log that is
    /// given twice, or a copy of another one.
    fn check_files(&self) -> Result<(), Failure> {
        check_distinct(&self.logs)?;
        let Some(out) = self.out.as_ref().filter(|_| !self.data_check) else {
            return Ok(());
        };
        not_foreign(out, &RESULTS)?;
        let logs = [&self.logs, &self.validate, &self.test];
        let mut read = self.robot.files();
        read.extend(self.truth.iter().map(Path::new).flat_map(Robot::files));
        read.extend(logs.into_iter().flatten().cloned());
        read.extend(self.excitation.clone());
        read.extend(self.columns_of_log.file());
        not_over(read, within(out, &RESULTS))
    }
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    arguments.check_files()?;
    let mut robot = arguments.robot.load_coupled()?;
    arguments.columns_of_log.apply(&mut robot)?;
    let mut drive_gains = Vec::new();
    if arguments.gains == Gains::Standstill {
        (robot, drive_gains) = with_gains(&robot, &arguments.logs, arguments.still_rad_s)?;
    }
    identify_arm(arguments, &robot, drive_gains, &config(arguments, &robot)?)
}

fn config(arguments: &Arguments, robot: &Robot) -> Result<IdentifyConfig, Failure> {
    let mut truth = None;
    if let Some(name) = &arguments.truth {
        // As `simulate` has it, options of the arm and assumed rotors included.
        let described = arguments.robot.arm.load_coupled(name)?;
        let (described, _) = described.with_assumed_rotors();
        let names = |robot: &Robot| {
            let layout = Layout::new(robot, &arguments.columns);
            let names = layout.parameters.into_iter().map(|own| own.name);
            names.collect::<Vec<_>>()
        };
        if names(&described) != names(robot) {
            bail!("--truth {name}: an arm with other parameters");
        }
        truth = Some(match arguments.truth_seed {
            Some(seed) => described.perturbed(seed),
            None => described,
        });
    }
    let fold_period_s = fold_period_s(arguments, robot)?;
    let logs: Vec<&Path> = arguments.logs.iter().map(PathBuf::as_path).collect();
    let rows = PrepareConfig::for_logs(&logs, robot)?;
    let methods = match &arguments.methods[..] {
        [] => METHODS.iter().map(|(method, _)| *method).collect(),
        chosen if chosen.iter().all(|name| *name == MethodName::BpBlackBox) => {
            bail!("--methods: bp_black_box has no bank, add another one")
        }
        chosen => chosen.to_vec(),
    };
    let motion_hz = arguments.motion_hz.unwrap_or(rows.motion_hz);
    let below_motion = rows.torque_hz.map(|hz| hz.min(0.5 * motion_hz));
    let torque_hz = arguments.torque_hz.or(below_motion);
    Ok(IdentifyConfig {
        methods,
        columns: arguments.columns.clone(),
        prepare: PrepareConfig {
            motion_hz,
            torque_hz: torque_hz.filter(|hz| *hz > 0.0),
            still_rad_s: arguments.still_rad_s,
        },
        fold_period_s,
        seed: arguments.seed,
        truth,
        test: arguments.test.clone(),
    })
}

/// The bank of a fit; `None` where none holds it.
///
/// Errors: the reason for which boards refuse it.
fn bank(robot: &Robot, outcome: &Outcome) -> Result<Option<ParameterBank>, BankError> {
    if robot.coupling.is_some() {
        return Ok(None);
    }
    arms!(robot, N, P => {
        let bank = Described::<N, P>::read(robot).and_then(|_| bank_of_fit::<Described<N, P>, N, P>(robot, outcome));
        let checked = bank.as_ref().map(|bank| bank.parameters::<Described<N, P>, N, P>());
        checked.transpose().map(|_| bank)
    }, else Ok(None))
}

fn identify_arm(
    arguments: &Arguments,
    robot: &Robot,
    drive_gains: Vec<GainRecord>,
    config: &IdentifyConfig,
) -> Result<(), Failure> {
    let judgement = judge(robot, &arguments.logs, &config.columns, &config.prepare)?;
    let out = match &arguments.out {
        Some(out) if !arguments.data_check => out,
        _ => {
            return show_check(
                &judgement,
                Layout::new(robot, &config.columns).parameters.len(),
            );
        }
    };
    let refuse = |judgement: &Judgement, logs: &[PathBuf]| match arguments.force {
        true => Ok(()),
        false => sound(judgement, logs, "no bank; --force identifies all the same"),
    };
    refuse(&judgement, &arguments.logs)?;
    let mut findings = judgement.findings.clone();
    for log in arguments.validate.iter().chain(&arguments.test) {
        let logs = std::slice::from_ref(log);
        let prepare = config.prepare.lowered(log, robot, &mut Vec::new())?;
        let judgement = judge(robot, logs, &config.columns, &prepare)?;
        refuse(&judgement, logs)?;
        findings.extend(judgement.findings.into_iter().map(|mut finding| {
            finding.text = format!("{}: {}", log.display(), finding.text);
            finding
        }));
    }
    let bar = ProgressBar::new_spinner();
    // A template that does not parse would only cost the line its looks.
    if let Ok(style) = ProgressStyle::with_template("{spinner} {elapsed} {msg}") {
        bar.set_style(style);
    }
    bar.enable_steady_tick(Duration::from_millis(100));
    let files = ReportFiles::create(out)?;
    let lines = Lines::new();
    let progress = |message: &str| {
        lines.show(|| format!("identify: {message}"));
        bar.set_message(message.to_owned());
    };
    let (logs, validate) = (&arguments.logs, &arguments.validate);
    let mut outcome = identify(robot, logs, validate, config, &progress)?;
    bar.finish_and_clear();
    let report = &mut outcome.report;
    report.drive_gains = drive_gains;
    report.findings.extend(findings);
    report.data_check = Some(judgement);
    report.findings.extend(unexplained(report));
    let (bank, useless) = match bank(robot, &outcome) {
        Ok(bank) => (bank, None),
        Err(error) => (
            None,
            Some(format!("no board takes the fitted parameters: {error}")),
        ),
    };
    let report = &mut outcome.report;
    report.findings.extend(useless.clone().map(|text| Finding {
        refuses: true,
        text,
    }));
    report.findings.sort_by_key(|finding| !finding.refuses);
    let report = &outcome.report;
    let refused = report.findings.iter().find(|finding| finding.refuses);
    let refused = refused.filter(|_| !arguments.force);
    let bank = bank.filter(|_| refused.is_none());
    let [_, made @ .., _] = RESULTS;
    let stays = within(out, &made).any(|file| file.exists());
    let described = outcome.robot.as_ref();
    let toml = described.map(Robot::to_toml).transpose()?;
    let urdf = described.map(foretorque_workbench::urdf::write);
    let bytes = bank.as_ref().map(super::bank::bytes).transpose()?;
    let [toml, urdf] = [toml, urdf].map(|text| text.map(String::into_bytes));
    let contents = [("bank", bytes), ("robot", toml), ("robot", urdf)];
    let shown = files.finish(report, &page(report, &outcome.trace))?;
    // A refused fit leaves what an earlier one gave.
    let made = made.into_iter().zip(contents);
    let made: Vec<_> = made.filter(|_| refused.is_none()).collect();
    for (name, (_, content)) in &made {
        match content {
            Some(content) => write_whole(&out.join(name), content)?,
            None => remove_stale(out, &[name])?,
        }
    }
    for note in &report.notes {
        show!("note  {note}")?;
    }
    for finding in &report.findings {
        let kind = if finding.refuses { "wrong" } else { "warning" };
        show!("{kind}  {}", finding.text)?;
    }
    for (joint, gain) in report.drive_gains.iter().enumerate() {
        let described = gain.description_nm_a;
        let described = described.map_or("not known".to_owned(), |gain| format!("{gain:.3}"));
        let found = match gain.std_nm_a {
            Some(std) => format!("± {std:.3}, description {described}"),
            None => "of the description, standstill does not show it".to_owned(),
        };
        let (joint, value) = (joint + 1, gain.gain_nm_a);
        show!("gain  joint {joint}  {value:.3} N·m/A {found}")?;
    }
    let (rank, of) = (report.rank, &report.condition_number_of);
    let condition = report.condition_number;
    show!("rank {rank}, condition number {condition:.1} ({of})")?;
    for (name, method) in &report.methods {
        let mut line = format!(
            "{name:<14} {:>7} epochs {:>8.3} s",
            method.epochs, method.seconds
        );
        for (file, record) in method.validation.iter().chain(&method.test) {
            let joints = newton_metres(&record.rmse_moving_nm);
            let error = record.joints_nrmse_moving_ratio;
            let percent = or_dash(error, |error| format!("{:.2}", 100.0 * error));
            line += &format!("   {file} {joints} N·m ({percent} %)");
        }
        show!("{line}")?;
    }
    let floors = report.data_check.iter().flat_map(|check| &check.joints);
    let floors: Vec<_> = floors.map(|joint| Some(joint.noise_floor_nm)).collect();
    show!(
        "torque error joint by joint, {}, {}: {} N·m; description {}; scatter from row to row, of the training logs, {}",
        report.recommended,
        report.headline_rows(),
        newton_metres(&report.headline_rmse_nm),
        newton_metres(&report.headline_description_rmse_nm),
        newton_metres(&floors)
    )?;
    if refused.is_some() && stays {
        show!(
            "note  bank and description of an earlier run stay, the report is of the refused fit"
        )?;
    }
    for (name, (kind, content)) in &made {
        if content.is_some() {
            show!("{kind:<8}{}", out.join(name).display())?;
        }
    }
    show!("report  {}", shown.display())?;
    if let (Some(_), None) = (&robot.coupling, refused) {
        if outcome.robot.is_none() {
            bail!(
                "no bank: boards have no coupled joints; --methods consistent gives a robot.toml"
            );
        }
        return show!("no bank: boards have no coupled joints; robot.toml is for `torque`");
    }
    if let Some(text) = useless {
        bail!("no bank: {text}");
    }
    if let Some(Finding { text, .. }) = refused {
        bail!("{text} (no bank; --force writes one)");
    }
    if bank.is_none() {
        bail!("no bank: a bank has no place for a parameter of this fit (--columns)");
    }
    Ok(())
}

/// Files of this command that an earlier run may have left.
const RESULTS: [&str; 5] = [
    "report.html",
    "parameters.bank",
    "robot.toml",
    "robot.urdf",
    "report.json",
];

/// Values joint by joint, N·m, separated by spaces.
fn newton_metres(joints: &[Option<f64>]) -> String {
    let shown = joints
        .iter()
        .map(|value| or_dash(*value, |value| figure(value, 3)));
    shown.collect::<Vec<_>>().join(" ")
}
