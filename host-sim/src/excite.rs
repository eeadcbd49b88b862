use super::arm::{RobotOptions, with_rotors};
use super::terminal::{Bar, show};
use super::{Failure, at_most, bail, finite, not_over, positive, within};
use clap::{Args, ValueEnum};
use foretorque_workbench::excitation::{self, Criterion, Excitation, MOST_PERIOD_S, SearchConfig};
use foretorque_workbench::files::{WholeFile, write_whole};
use foretorque_workbench::report::put_json;
use foretorque_workbench::table::{TableWriter, state_columns};
use foretorque_workbench::trajectory;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

/// Optimised excitation trajectory inside the robot's limits, with a certificate of each
#[derive(Debug, Args)]
pub(super) struct Arguments {
    #[command(flatten)]
    pub(super) robot: RobotOptions,
    /// Directory for excitation.json, excitation.csv, excitation.html and excitation.svg, in s, rad, rad/s and rad/s²
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Objective of the search
    #[arg(long, value_enum, default_value_t = CriterionName::Constrained)]
    criterion: CriterionName,
    /// Limit of the condition number for `constrained` (links' base regressor, raw SI); without it 60, or the best where no
    /// path reaches that
    #[arg(long, value_parser = positive)]
    condition_limit: Option<f64>,
    /// Seed of the search
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Starts of the search
    #[arg(long, default_value = "8")]
    starts: NonZeroUsize,
    /// Most iterations of a round for the best quarter of the starts
    #[arg(long, default_value = "80")]
    iterations: NonZeroUsize,
    /// Period of the fundamental, s; at most 1000
    #[arg(long, default_value_t = 10.0, value_parser = period, conflicts_with = "improve")]
    period_s: f64,
    /// Range of every joint around zero, rad, on top of the description's
    #[arg(long, default_value_t = std::f64::consts::PI, value_parser = positive)]
    range_rad: f64,
    /// Height of the table under the arm, m, in place of the description's
    #[arg(long, conflicts_with = "no_table", value_parser = finite)]
    table_m: Option<f64>,
    /// There is no table
    #[arg(long)]
    no_table: bool,
    /// Start from this excitation.json alone; the result is no worse
    #[arg(long, value_name = "FILE")]
    improve: Option<PathBuf>,
    /// Threads; the result does not depend on them [default: all cores]
    #[arg(long)]
    threads: Option<NonZeroUsize>,
}

const RESULTS: [&str; 4] = [
    "excitation.json",
    "excitation.csv",
    "excitation.html",
    "excitation.svg",
];

#[derive(Clone, Copy, Debug, ValueEnum)]
enum CriterionName {
    /// Condition number of the links' base regressor
    Condition,
    /// Volume of the confidence ellipsoid
    DOptimal,
    /// Predicted torque error on task motion
    VOptimal,
    /// V-optimal with the condition number below its limit
    Constrained,
}

/// Period of a motion, s.
pub(super) fn period(text: &str) -> Result<f64, String> {
    at_most(text, MOST_PERIOD_S)
}

impl From<CriterionName> for Criterion {
    fn from(name: CriterionName) -> Self {
        match name {
            CriterionName::Condition => Self::Condition,
            CriterionName::DOptimal => Self::DOptimal,
            CriterionName::VOptimal => Self::VOptimal,
            CriterionName::Constrained => Self::Constrained,
        }
    }
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let files = arguments.robot.files().into_iter();
    not_over(
        files.chain(arguments.improve.clone()),
        within(&arguments.out, &RESULTS),
    )?;
    let has_limit = arguments.condition_limit.is_some();
    if has_limit && !matches!(arguments.criterion, CriterionName::Constrained) {
        bail!("--condition-limit belongs to --criterion constrained");
    }
    let mut robot = with_rotors(&arguments.robot.load_coupled()?)?;
    let solid = robot.joints.iter().any(|joint| !joint.capsules.is_empty());
    let unchecked = match robot.coupling {
        Some(_) => Some("its joints are coupled"),
        None => (!solid).then_some("its description has no capsules"),
    };
    if let Some((reason, table_m)) = unchecked.zip(arguments.table_m) {
        bail!(
            "--table-m {table_m}: no table is checked for '{}', {reason}: add capsules to single joints (docs/identification.md, Limits), or leave --table-m out",
            robot.name
        );
    }
    if robot.coupling.is_some() {
        let joints = robot.joints.iter_mut();
        joints.for_each(|joint| joint.capsules.clear());
    }
    if arguments.no_table {
        robot.workspace.table_height = None;
    }
    robot.workspace.table_height = arguments.table_m.or(robot.workspace.table_height);
    let robot = &robot;
    let given = arguments.improve.as_ref();
    let given = given
        .map(|path| trajectory::excitation(path, robot))
        .transpose()?;
    let limit = arguments.condition_limit;
    let config = SearchConfig {
        // A given trajectory keeps its period.
        period_s: given.as_ref().map_or(arguments.period_s, |e| e.period_s),
        criterion: arguments.criterion.into(),
        condition_limit: limit.unwrap_or(SearchConfig::default().condition_limit),
        condition_required: limit.is_some(),
        seed: arguments.seed,
        starts: arguments.starts.get(),
        iterations: arguments.iterations.get(),
        range_rad: arguments.range_rad,
        threads: arguments.threads,
    };
    // A directory that cannot be written is refused before the work.
    let mut json = WholeFile::create(&arguments.out.join("excitation.json"))?;
    let bar = Bar::new();
    let excitation = excitation::optimise(robot, &config, given.as_ref(), |done, all| {
        bar.show("excitation", done, all);
    })?;
    drop(bar);
    let certificate = excitation.certificate.iter();
    let errors = certificate.flat_map(|certificate| &certificate.predicted_error_of_limit);
    let worst = errors.copied().fold(0.0, f64::max);
    if worst > 1.0 {
        bail!(
            "no path of {} s shows the parameters: the torque that they predict would be off by {worst:.1} times its limit: a longer --period-s, more --starts, or a wider range",
            config.period_s
        );
    }
    write(&excitation, &arguments.out)?;
    put_json(&mut json, &excitation)?;
    json.finish()?;
    if let Some(certificate) = &excitation.certificate {
        for (joint, share) in robot.joints.iter().zip(&certificate.speed_share) {
            if *share < 1.0 {
                show!(
                    "joint '{}' moves at {:.0} % of its speed and acceleration limits: the torque limits allow no more, friction included",
                    joint.name,
                    100.0 * share
                )?;
            }
        }
        let errors = certificate.predicted_error_nm.iter();
        let errors = errors.zip(&certificate.predicted_error_of_limit);
        let errors = errors.map(|(error, share)| format!("{error:.4} ({:.2} %)", 100.0 * share));
        let errors: Vec<String> = errors.collect();
        show!(
            "predicted torque error of the joints {} N·m RMS (share of the torque limit; 10 s, 1 % noise)",
            errors.join(", ")
        )?;
        show!(
            "condition number {:.1} (links' base regressor, {} columns, {}, raw SI; {:.1} in the board's frames), {} limits kept on {} points and between them",
            certificate.condition_number_dh,
            certificate.condition_number_columns,
            certificate.condition_number_frames,
            certificate.condition_number_board,
            certificate.limits.len(),
            certificate.points,
        )?;
    }
    if let Some(reason) = unchecked {
        let name = &robot.name;
        show!("note: clearances of '{name}' from table and own links are not checked: {reason}")?;
    }
    show!("{}", arguments.out.join("excitation.json").display())?;
    Ok(())
}

/// Everything but the coefficients.
fn write(excitation: &Excitation, out: &Path) -> Result<(), Failure> {
    let mut header = vec!["t_s".to_owned()];
    header.extend(state_columns(excitation.joints.len()));
    let mut table = TableWriter::create(&out.join("excitation.csv"), &header)?;
    for k in 0..=(excitation.period_s * 1000.0).round() as usize {
        let t_s = k as f64 * 1e-3;
        let motion = excitation.motion(t_s);
        let values = [&motion.q, &motion.qd, &motion.qdd].into_iter();
        table.row(std::iter::once(&t_s).chain(values.flat_map(|values| values.iter())))?;
    }
    table.finish()?;
    let page = excitation::page::page(excitation).html()?;
    write_whole(&out.join("excitation.html"), page.as_bytes())?;
    let picture = excitation::page::picture(excitation)?;
    write_whole(&out.join("excitation.svg"), picture.as_bytes())?;
    Ok(())
}
