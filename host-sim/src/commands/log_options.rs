//! Options on the columns and units of foreign logs.

use super::Failure;
use clap::Args;
use foretorque_workbench::robot::{EffortKind, LOG_SOURCES, LogColumns, Robot, Units};

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
    /// Units of the logs where they are not SI, such as q=deg,t=ms,tau=mNm
    #[arg(long)]
    units: Option<Units>,
    /// Quantity in the torque columns: torque, current (times the drive gain) or motor (times gear_ratios of --columns-from)
    #[arg(long)]
    effort: Option<EffortKind>,
}

impl LogOptions {
    /// Gives the robot the columns that were asked for, in the place of those of its description.
    ///
    /// Errors: a file that is no map.
    pub(super) fn apply(&self, robot: &mut Robot) -> Result<(), Failure> {
        let mut columns = match self.columns_from.as_deref() {
            None => robot.log_columns.clone().unwrap_or_default(),
            Some(name) if LOG_SOURCES.contains(&name) => LogColumns {
                source: Some(name.to_owned()),
                ..LogColumns::default()
            },
            Some(file) => LogColumns::load(file)?,
        };
        if !self.names.is_empty() {
            columns.names.clone_from(&self.names);
        }
        columns.effort = self.effort.or(columns.effort);
        columns.all_units.clone_from(&self.units);
        robot.log_columns = (columns != LogColumns::default()).then_some(columns);
        Ok(())
    }
}
