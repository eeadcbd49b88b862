use super::arm::{LogOptions, RobotOptions};
use super::boards::on_arm;
use super::terminal::Bar;
use super::terminal::show;
use super::{Failure, bank, sound};
use clap::Args;
use foretorque::arm::Arm;
use foretorque::learning::{ParameterSet, StartDeviations};
use foretorque_studies::replay::{self, ReplayPath};
use foretorque_workbench::identification::{ColumnSet, PrepareConfig, judge, longest_period_s};
use foretorque_workbench::report::ReportFiles;
use foretorque_workbench::robot::Robot;
use std::path::{Path, PathBuf};

/// Replay logs to the board's learner, row by row, and score it against batch least squares and against its start
#[derive(Debug, Args)]
pub(super) struct Arguments {
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

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let mut robot = arguments.robot.load()?;
    arguments.columns_of_log.apply(&mut robot)?;
    if !arguments.force {
        let logs: Vec<&Path> = arguments.logs.iter().map(PathBuf::as_path).collect();
        let prepare = PrepareConfig::for_rows(longest_period_s(&logs, &robot)?);
        let judgement = judge(&robot, &arguments.logs, &ColumnSet::default(), &prepare)?;
        sound(&judgement, &arguments.logs, "--force replays all the same")?;
    }
    on_arm!(&robot, A, N, P => arguments.replay::<A, N, P>(&robot))
}

impl Arguments {
    fn replay<A: Arm<N, P>, const N: usize, const P: usize>(
        &self,
        robot: &Robot,
    ) -> Result<(), Failure> {
        let (set, deviations) = match &self.bank {
            Some(file) => {
                let bank = bank::read(file)?;
                (bank.set::<A, N, P>()?, bank.start_deviations::<A, N, P>())
            }
            None => (ParameterSet::nominal::<A>(1), StartDeviations::PRIOR),
        };
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
