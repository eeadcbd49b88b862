use super::progress::Bar;
use super::{Failure, unusable};
use crate::excitation::{Excitation, SearchConfig};
use crate::files::write_whole;
use crate::robot::Robot;
use crate::table::{TableWriter, state_columns};
use clap::Args;
use std::path::PathBuf;

/// Excitation trajectory inside the robot's limits: the best of many random Fourier series
#[derive(Debug, Args)]
pub(super) struct Arguments {
    /// Robot: a built-in name or a description file
    #[arg(long)]
    robot: String,
    /// Directory for excitation.json and excitation.csv
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Seed of the search
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Random candidates
    #[arg(long, default_value_t = 200)]
    candidates: usize,
    /// Period of the fundamental, s
    #[arg(long, default_value_t = 10.0)]
    period_s: f64,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let robot = Robot::load(&arguments.robot)?;
    if !(arguments.period_s.is_finite() && arguments.period_s > 0.0) {
        return Err(unusable("--period-s must be positive"));
    }
    match robot.joint_count() {
        6 => search::<6>(arguments, &robot),
        7 => search::<7>(arguments, &robot),
        joints => Err(unusable(format!(
            "robots of {joints} joints are not supported"
        ))),
    }
}

fn search<const N: usize>(arguments: &Arguments, robot: &Robot) -> Result<(), Failure> {
    let config = SearchConfig {
        period_s: arguments.period_s,
        candidates: arguments.candidates,
        ..SearchConfig::default()
    };
    let bar = Bar::new();
    let mut done = 0;
    let excitation = Excitation::search::<N>(robot, arguments.seed, &config, || {
        done += 1;
        bar.show("excitation", done, config.candidates);
    })?;
    drop(bar);
    let json = serde_json::to_string_pretty(&excitation)? + "\n";
    let mut header = vec!["t_s".to_owned()];
    header.extend(state_columns(N));
    let mut table = TableWriter::create(&arguments.out.join("excitation.csv"), &header)?;
    for k in 0..=(config.period_s * 1000.0).round() as usize {
        let t_s = k as f64 * 1e-3;
        let state = excitation.at::<N>(t_s);
        let values = state.q.iter().chain(&state.qd).chain(&state.qdd);
        table.row(std::iter::once(&t_s).chain(values))?;
    }
    write_whole(&arguments.out.join("excitation.json"), json.as_bytes())?;
    table.finish()?;
    let certificate = &excitation.certificate;
    println!(
        "condition number {:.1} (base regressor, Craig link frames, raw SI), peaks {:.2} rad, {:.2} rad/s, {:.2} rad/s²",
        certificate.condition_number,
        certificate.peak_q_rad,
        certificate.peak_qd_rad_s,
        certificate.peak_qdd_rad_s2
    );
    println!("{}", arguments.out.join("excitation.json").display());
    Ok(())
}
