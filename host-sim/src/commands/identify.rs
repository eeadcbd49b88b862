use super::log_options::LogOptions;
use super::terminal::say;
use super::{Failure, unsupported, unusable};
use clap::Args;
use foretorque_link::bank::ParameterBank;
use foretorque_workbench::arms;
use foretorque_workbench::board::Described;
use foretorque_workbench::excitation::Excitation;
use foretorque_workbench::files::write_whole;
use foretorque_workbench::identification::{
    ColumnSet, IdentifyConfig, METHODS, MethodName, Outcome, PrepareConfig, bank_of_fit, identify,
    page,
};
use foretorque_workbench::report::ReportFiles;
use foretorque_workbench::robot::{Perturbation, Robot};
use indicatif::{ProgressBar, ProgressStyle};
use std::path::PathBuf;
use std::time::Duration;

/// Identify an arm's parameters from logs, by all methods side by side, and validate them on unseen logs
#[derive(Debug, Args)]
#[command(allow_negative_numbers = true)]
pub(super) struct Arguments {
    /// Robot: a built-in name or a description file; its log_columns map foreign logs
    #[arg(long)]
    robot: String,
    /// Training log (CSV or CSV.gz); may be given several times
    #[arg(long = "log", value_name = "FILE", required = true)]
    logs: Vec<PathBuf>,
    /// Log of an unseen path to validate on; may be given several times
    #[arg(long, value_name = "FILE")]
    validate: Vec<PathBuf>,
    #[command(flatten)]
    columns_of_log: LogOptions,
    /// Directory for report.json, report.html, parameters.bank, and robot.toml and robot.urdf of the consistent parameters
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Methods, separated by commas: ols, wls, irls, consistent, evidence, bp_physical, bp_black_box, bp_residual
    #[arg(long, value_delimiter = ',', value_name = "LIST")]
    methods: Vec<MethodName>,
    /// Friction columns, joined by '+': coulomb-viscous, offset, stribeck, sqrt, cubic, load, cogging,
    /// warm-up; or full for all
    #[arg(long, default_value = "coulomb-viscous+offset+stribeck+load")]
    columns: ColumnSet,
    /// Filter of the training logs; fourier folds a log that repeats into one period and projects it on the harmonics
    /// below the cut-offs. Validation logs always go through the zero-phase Butterworth filter.
    #[arg(long, default_value = "butterworth")]
    filter: Filter,
    /// Period of the training logs, s, for --filter fourier
    #[arg(long, conflicts_with = "excitation")]
    period_s: Option<f64>,
    /// The excitation.json that the training logs repeat, for --filter fourier
    #[arg(long, value_name = "FILE")]
    excitation: Option<PathBuf>,
    /// Cut-off of the zero-phase filter on the motion, Hz; above that on the torque, so that the filter on both sides
    /// of the equation is the same where it acts
    #[arg(long, default_value_t = 40.0)]
    motion_hz: f64,
    /// Cut-off of the zero-phase filter on torque and regressor, Hz; 0 for none
    #[arg(long, default_value_t = 20.0)]
    torque_hz: f64,
    /// A joint slower than this stands still, rad/s
    #[arg(long, default_value_t = 0.05)]
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
    /// Seed of random starts and of the 80/20 split
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
fn fold_period_s(arguments: &Arguments) -> Result<Option<f64>, Failure> {
    let period_s = match (&arguments.excitation, arguments.period_s) {
        (Some(path), _) => {
            let text = std::fs::read_to_string(path)
                .map_err(|error| foretorque_workbench::files::at(path, error))?;
            let series: Excitation = serde_json::from_str(&text)
                .map_err(|error| unusable(format!("{}: {error}", path.display())))?;
            Some(series.period_s)
        }
        (None, period_s) => period_s,
    };
    match (arguments.filter, period_s) {
        (Filter::Butterworth, None) => Ok(None),
        (Filter::Butterworth, Some(_)) => Err(unusable(
            "--period-s and --excitation belong to --filter fourier",
        )),
        (Filter::Fourier, Some(period_s)) if period_s.is_finite() && period_s > 0.0 => {
            Ok(Some(period_s))
        }
        (Filter::Fourier, Some(_)) => Err(unusable("--period-s must be positive")),
        (Filter::Fourier, None) => Err(unusable(
            "--filter fourier needs --period-s or --excitation",
        )),
    }
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let mut robot = Robot::load(&arguments.robot)?;
    arguments.columns_of_log.apply(&mut robot)?;
    let config = config(arguments, &robot)?;
    arms!(robot, N, P => {
        identify_arm::<N>(arguments, &robot, &config, |outcome| bank::<N, P>(&robot, outcome))
    }, else Err(unsupported(robot.joint_count())))
}

fn config(arguments: &Arguments, robot: &Robot) -> Result<IdentifyConfig, Failure> {
    let not_negative = |name: &str, value: f64| {
        if value.is_finite() && value >= 0.0 {
            Ok(value)
        } else {
            Err(unusable(format!("{name} must not be negative")))
        }
    };
    let torque_hz = not_negative("--torque-hz", arguments.torque_hz)?;
    let motion_hz = not_negative("--motion-hz", arguments.motion_hz)?;
    if motion_hz == 0.0 {
        return Err(unusable("--motion-hz must be positive"));
    }
    let truth = match &arguments.truth {
        Some(name) => {
            let truth = Robot::load(name)?;
            if truth.joint_count() != robot.joint_count() {
                return Err(unusable(format!(
                    "--truth {name}: another number of joints"
                )));
            }
            Some(match arguments.truth_seed {
                Some(seed) => truth.perturbed(seed, &Perturbation::PLANT),
                None => truth,
            })
        }
        None => None,
    };
    let methods = if arguments.methods.is_empty() {
        METHODS.iter().map(|(method, _)| *method).collect()
    } else {
        arguments.methods.clone()
    };
    Ok(IdentifyConfig {
        methods,
        columns: arguments.columns.clone(),
        prepare: PrepareConfig {
            motion_hz,
            torque_hz: (torque_hz > 0.0).then_some(torque_hz),
            still_rad_s: not_negative("--still-rad-s", arguments.still_rad_s)?,
        },
        gains_from_standstill: arguments.gains == Gains::Standstill,
        fold_period_s: fold_period_s(arguments)?,
        seed: arguments.seed,
        truth,
    })
}

fn bank<const N: usize, const P: usize>(
    robot: &Robot,
    outcome: &Outcome<N>,
) -> Option<ParameterBank> {
    Described::<N, P>::read(robot)?;
    bank_of_fit::<Described<N, P>, N, P>(
        robot,
        &outcome.bank_layout,
        &outcome.bank_fit,
        outcome.networks.as_deref(),
        outcome.cogging.as_ref(),
    )
}

fn identify_arm<const N: usize>(
    arguments: &Arguments,
    robot: &Robot,
    config: &IdentifyConfig,
    bank: impl Fn(&Outcome<N>) -> Option<ParameterBank>,
) -> Result<(), Failure> {
    let bar = ProgressBar::new_spinner();
    // A template that does not parse would only cost the line its looks.
    if let Ok(style) = ProgressStyle::with_template("{spinner} {elapsed} {msg}") {
        bar.set_style(style);
    }
    bar.enable_steady_tick(Duration::from_millis(100));
    let files = ReportFiles::create(&arguments.out)?;
    let outcome = identify::<N>(
        robot,
        &arguments.logs,
        &arguments.validate,
        config,
        &|message| {
            bar.set_message(message.to_owned());
        },
    );
    bar.finish_and_clear();
    let outcome = outcome?;
    let report = &outcome.report;
    let shown = files.finish(report, &page::<N>(report, &outcome.trace))?;
    for note in &report.notes {
        say(format_args!("note  {note}"))?;
    }
    for (joint, gain) in report.drive_gains.iter().enumerate() {
        let found = gain.std_nm_a.map_or_else(
            || "of the description, standstill does not tell it".to_owned(),
            |std| format!("± {std:.3}, description {:.3}", gain.description_nm_a),
        );
        say(format_args!(
            "gain  joint {}  {:.3} N·m/A {found}",
            joint + 1,
            gain.gain_nm_a
        ))?;
    }
    say(format_args!(
        "rank {}, condition number {:.1} ({})",
        report.rank, report.condition_number, report.condition_number_of
    ))?;
    for (name, method) in &report.methods {
        let mut line = format!(
            "{name:<14} {:>7} epochs {:>8.3} s",
            method.epochs, method.seconds
        );
        for (file, record) in &method.validation {
            line += &format!(
                "   {file} {:.3} %",
                100.0 * record.joints_nrmse_moving_ratio
            );
        }
        say(format_args!("{line}"))?;
    }
    if let Some(robot) = &outcome.robot {
        let path = arguments.out.join("robot.toml");
        write_whole(&path, robot.to_toml()?.as_bytes())?;
        say(format_args!("robot   {}", path.display()))?;
        let path = arguments.out.join("robot.urdf");
        write_whole(&path, foretorque_workbench::urdf::write(robot).as_bytes())?;
        say(format_args!("robot   {}", path.display()))?;
    }
    match bank(&outcome) {
        Some(bank) => {
            let path = arguments.out.join("parameters.bank");
            write_whole(&path, &super::bank::bytes(&bank)?)?;
            say(format_args!("bank    {}", path.display()))?;
        }
        None => say(format_args!(
            "no bank: no firmware arm is called '{}'",
            robot.name
        ))?,
    }
    say(format_args!("report  {}", shown.display()))?;
    Ok(())
}
