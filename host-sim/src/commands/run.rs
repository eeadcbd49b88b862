use super::boards::{BoardChoice, OnArm, on_arm};
use super::motion_log::{Effort, MotionLog};
use super::on_board;
use super::progress::Bar;
use super::simulate::{MotionArguments, PERIOD_S};
use super::terminal::{self, say};
use super::{Failure, bank, key, unusable};
use clap::Args;
use foretorque::arm::Arm;
use foretorque_link::excitation::ExcitationCommand;
use foretorque_link::store::StoreHealth;
use foretorque_workbench::closed_loop::ClosedLoop;
use foretorque_workbench::files::{WholeFile, write_whole};
use foretorque_workbench::report::closed_loop::{
    self, ClosedLoopLog, ClosedLoopReport, LinkReport,
};
use foretorque_workbench::robot::Robot;
use foretorque_workbench::table::joint_columns;
use foretorque_workbench::telemetry::{Recorder, Selection};
use std::path::PathBuf;

/// Close the loop around a board: the simulated arm under PD control and the board's feed-forward
#[derive(Debug, Args)]
#[command(allow_negative_numbers = true)]
pub(super) struct Arguments {
    /// Robot: a built-in name or a description file
    #[arg(long)]
    robot: String,
    /// Board: native, qemu, qemu-usart or serial:PORT
    #[arg(long, default_value = "native")]
    board: BoardChoice,
    #[command(flatten)]
    motion: MotionArguments,
    /// Parameter bank to start from; without it the description's rigid body
    #[arg(long, value_name = "FILE")]
    bank: Option<PathBuf>,
    /// Write key of the board, 32 hexadecimal digits
    #[arg(long, value_name = "FILE")]
    key_file: Option<PathBuf>,
    /// Record what the board tells into telemetry.csv: fields and every how many ticks, such as state,total,quality/10
    #[arg(long, value_name = "FIELDS/TICKS")]
    telemetry: Option<Selection>,
    /// Have the board play the excitation of --trajectory itself: uploaded, checked there, approached from 0.1 rad beside
    /// its beginning, and followed as the board asks
    #[arg(long)]
    excite_on_board: bool,
    /// Tracking error of any joint at which the board breaks its excitation off, rad
    #[arg(long, default_value_t = 0.05, requires = "excite_on_board")]
    tracking_rad: f32,
    /// Learn while it runs
    #[arg(long)]
    learn: bool,
    /// Write the log of the firmware as text (qemu-usart only)
    #[arg(long, value_name = "FILE")]
    log: Option<PathBuf>,
    /// Directory for log.csv, report.json, report.html and bank.bin, the parameters in force at the end; telemetry.csv
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    if arguments.log.is_some() && arguments.board != BoardChoice::QemuUsart {
        return Err(unusable(format!(
            "--log: board {} has none, only qemu-usart",
            arguments.board
        )));
    }
    // Asked before the emulator starts, which would have complaints of its own about the file; and the directory is there
    // for what the emulator writes.
    let log = arguments.log.as_deref().map(WholeFile::create);
    let place = log.transpose()?;
    let outcome = on_arm(&arguments.robot, arguments);
    drop(place);
    if let (Some(stream), Some(log)) = (arguments.stream(), &arguments.log) {
        // Of a run that failed the log is of the more interest, but its own failure of less.
        let written = arguments.board.write_log(&stream, log);
        return outcome.and(written);
    }
    outcome
}

impl Arguments {
    /// Where the emulator puts the raw log.
    fn stream(&self) -> Option<PathBuf> {
        self.log
            .as_ref()
            .map(|log| log.with_added_extension("defmt"))
    }
}

impl OnArm for &Arguments {
    type Output = ();

    fn on<A: Arm<N, P>, const N: usize, const P: usize>(
        self,
        robot: &Robot,
    ) -> Result<(), Failure> {
        play::<A, N, P>(self, robot)
    }
}

fn play<A: Arm<N, P>, const N: usize, const P: usize>(
    arguments: &Arguments,
    robot: &Robot,
) -> Result<(), Failure> {
    let bank = arguments.bank.as_deref().map(bank::read).transpose()?;
    let mut scene = arguments.motion.scene::<N>(robot)?;
    let mut board = arguments
        .board
        .connect::<A, N, P>(arguments.stream().as_deref())?;
    if let Some(file) = &arguments.key_file {
        board.set_write_key(key::read(file)?);
    }
    if let Some(bank) = &bank {
        board.upload_bank(bank)?;
    }
    if arguments.excite_on_board {
        on_board::load::<A, N, P>(&mut board, &mut scene, robot, arguments.tracking_rad)?;
    }
    let mut columns = joint_columns("feed_forward", "nm", N);
    columns.push("flags".to_owned());
    let mut log = MotionLog::<N>::create(&arguments.out.join("log.csv"), Effort::Torque, &columns)?;
    let mut seen = ClosedLoopLog::<N>::new(scene.ticks);
    let bar = Bar::new();
    let mut play = ClosedLoop::new(
        &mut scene.plant,
        &scene.pd,
        &scene.trajectory,
        PERIOD_S,
        Some(&mut board),
    )?;
    board.learning(arguments.learn)?;
    let mut recorder = match arguments.telemetry {
        Some(chosen) => {
            board.stream(chosen.fields, chosen.every)?;
            let path = arguments.out.join("telemetry.csv");
            Some(Recorder::create(&path, chosen, N, PERIOD_S)?)
        }
        None => None,
    };
    if arguments.excite_on_board {
        board.excitation(ExcitationCommand::Start)?;
    }
    let mut ticks = 0;
    for tick in 0..scene.ticks {
        let record = play.tick(&mut scene.plant, Some(&mut board))?;
        seen.add(&record);
        let answer = record.feed_forward.iter().map(|tau| f64::from(*tau));
        let flags = f64::from(record.flags);
        log.add(&record, record.measured, answer.chain([flags]).collect())?;
        if let Some(recorder) = &mut recorder {
            recorder.take(&board.take_telemetry())?;
        }
        ticks += 1;
        if arguments.excite_on_board && on_board::has_ended(&mut board, tick, record.stage)? {
            break;
        }
        if tick % 256 == 0 {
            bar.show("run", tick, scene.ticks);
        }
    }
    drop(bar);
    board.learning(false)?;
    board.stream(0, 1)?;
    board.disarm()?;
    let statistics = board.statistics()?;
    let learnt = bank::bytes(&board.read_bank()?)?;
    let report = ClosedLoopReport {
        robot: robot.name.clone(),
        board: arguments.board.to_string(),
        seed: arguments.motion.seed,
        ticks,
        period_s: PERIOD_S,
        toolchain: arguments.board.toolchain(),
        learning: arguments.learn,
        tracking_rms_mrad: seen.tracking_rms_mrad(),
        tracking_rms_joint_mrad: seen.tracking_rms_joint_mrad(),
        tracking_peak_joint_mrad: seen.tracking_peak_joint_mrad(),
        torque_rms_nm: seen.torque_rms_nm(),
        torque_peak_nm: seen.torque_peak_nm(),
        feed_forward_rms_nm: seen.feed_forward_rms_nm(),
        flag_ticks: seen.flag_ticks(),
        link: LinkReport::from(&statistics),
        late_sets: statistics.late_sets,
        lessons_lost: statistics.learning_samples_lost,
        boot_us: board.hello().boot_us(),
        store: statistics.store,
        tick_cost: statistics.tick_cost.into(),
        learning_cost: statistics.learn_cost.into(),
    };
    let page = closed_loop::html(&report, &seen, &terminal::command_line())?;
    log.finish()?;
    if let Some(recorder) = recorder {
        recorder.finish()?;
    }
    write_whole(&arguments.out.join("bank.bin"), &learnt)?;
    write_whole(&arguments.out.join("report.html"), page.as_bytes())?;
    let text = serde_json::to_string_pretty(&report)? + "\n";
    write_whole(&arguments.out.join("report.json"), text.as_bytes())?;
    say(format_args!(
        "{} ticks, tracking error {:.3} mrad RMS, {} link errors",
        report.ticks,
        report.tracking_rms_mrad,
        report.link.errors()
    ))?;
    if report.store == StoreHealth::Failing {
        say(
            "the board's flash keeps nothing: it runs from RAM, and forgets what it learnt at power-off",
        )?;
    }
    say(arguments.out.join("report.html").display())?;
    Ok(())
}
