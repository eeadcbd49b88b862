use super::super::boards::BoardChoice;
use super::super::progress::Bar;
use super::super::report_files::ReportFiles;
use super::super::terminal::say;
use super::super::{Failure, unusable};
use super::Out;
use clap::Args;
use foretorque::arm::Arm;
use foretorque::arm::ur5::{JOINTS, PARAMETERS, Ur5};
use foretorque_studies::demo::{self, DemoConfig, DemoReport};
use foretorque_workbench::robot::Robot;

/// From a wrong prior, learn on the board in closed loop, freeze, play an unseen path
#[derive(Debug, Args)]
#[command(allow_negative_numbers = true)]
pub(super) struct Arguments {
    #[command(flatten)]
    out: Out,
    /// Board: native, qemu, with the flashable firmware beside it over its USART, qemu-usart or serial:PORT
    #[arg(long, default_value = "qemu")]
    board: BoardChoice,
    /// Seed of plant, prior, paths and noise
    #[arg(long, default_value_t = DemoConfig::default().seed)]
    seed: u64,
    /// Arm time with learning on, long run, s
    #[arg(long, default_value_t = DemoConfig::default().learning_s)]
    learning_s: f64,
    /// Arm time with learning on, flashable firmware, s
    #[arg(long, default_value_t = DemoConfig::default().usart_learning_s)]
    usart_learning_s: f64,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
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
    let files = ReportFiles::create(&arguments.out.out)?;
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
    let page = files.finish(&outcome.report, &outcome.html)?;
    summarise(&outcome.report)?;
    say(format_args!("report           {}", page.display()))?;
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
