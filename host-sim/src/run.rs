use super::arm::RobotOptions;
use super::boards::{BoardChoice, on_arm};
use super::motion_log::MotionLog;
use super::simulate::{MotionArguments, PERIOD_S, Scene, Verdict};
use super::terminal::{self, Bar, show};
use super::{Failure, bail, bank, fitting, not_foreign, not_over, within};
use clap::Args;
use foretorque::arm::Arm;
use foretorque::feedforward::evaluate;
use foretorque::joint::JointVector;
use foretorque_link::excitation::{ExcitationCommand, ExcitationState, PlayLimits};
use foretorque_link::store::StoreHealth;
use foretorque_link::wire::{Configuration, Effort, Field};
use foretorque_workbench::board::{BoardError, Client};
use foretorque_workbench::closed_loop::{ClosedLoop, TickRecord, motion_f32};
use foretorque_workbench::dynamics::{Joints, State};
use foretorque_workbench::excitation::Excitation;
use foretorque_workbench::files::{WholeFile, remove_stale, write_whole};
use foretorque_workbench::report::ReportFiles;
use foretorque_workbench::report::closed_loop::{
    self, ClosedLoopLog, ClosedLoopReport, RunDescription,
};
use foretorque_workbench::robot::{Joint, Robot};
use foretorque_workbench::telemetry::{Recorder, Selection};
use foretorque_workbench::trajectory::Trajectory;
use std::path::PathBuf;

/// Ticks between the telemetry records from which a run is judged.
const WATCH_TICKS: u16 = 10;

/// Close the loop around a board: the simulated arm under PD control and the board's feed-forward
#[derive(Debug, Args)]
pub(super) struct Arguments {
    #[command(flatten)]
    robot: RobotOptions,
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
    /// Time that the brakes of the arm take to close, ms: the torque of gravity is kept for it. 0 without brakes
    #[arg(long, value_name = "MS", default_value_t = 0, value_parser = brake_range())]
    brake_close_ms: u16,
    /// Record the telemetry of the board into telemetry.csv: fields and every how many ticks, such as state,total,quality/10
    #[arg(long, value_name = "FIELDS/TICKS")]
    telemetry: Option<Selection>,
    /// Have the board play the excitation of --trajectory itself: uploaded, checked there, approached from 0.1 rad beside
    /// its beginning, and followed
    #[arg(long)]
    excite_on_board: bool,
    /// Tracking error of any joint at which the board breaks its excitation off, rad
    #[arg(long, default_value_t = 0.05, requires = "excite_on_board", value_parser = tracking)]
    tracking_rad: f32,
    /// Learn while it runs
    #[arg(long)]
    learn: bool,
    /// Write the log of the firmware as text (qemu-usart only)
    #[arg(long, value_name = "FILE")]
    log: Option<PathBuf>,
    #[command(flatten)]
    verdict: Verdict,
    /// Directory for log.csv, report.json, report.html and bank.bin, the parameters in force at the end; telemetry.csv and the
    /// MCAP files beside
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

const RESULTS: [&str; 7] = [
    "log.csv",
    "log.mcap",
    "report.html",
    "bank.bin",
    "telemetry.csv",
    "telemetry.mcap",
    "report.json",
];

fn brake_range() -> clap::builder::RangedI64ValueParser<u16> {
    clap::value_parser!(u16).range(..=i64::from(Configuration::MAX_BRAKE_CLOSE_MS))
}

/// A tracking error that boards take, rad.
fn tracking(text: &str) -> Result<f32, String> {
    const MOST_RAD: f32 = PlayLimits::<1>::TRACKING_RAD;
    let wrong = format!("must be above 0 and at most {MOST_RAD} rad");
    let fits = |value| value > 0.0 && value <= f64::from(MOST_RAD);
    fitting(text, fits, &wrong).map(|value| value as f32)
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let robot = &arguments.robot.load()?;
    let options = [&arguments.bank, &arguments.key_file].into_iter().flatten();
    let mut read = arguments.robot.files();
    read.extend(arguments.motion.files().chain(options.cloned()));
    let out = within(&arguments.out, &RESULTS).chain(arguments.log.clone());
    not_over(read, out)?;
    not_foreign(&arguments.out, &RESULTS)?;
    if arguments.log.is_some() && arguments.board != BoardChoice::QemuUsart {
        bail!("--log: board {} has none, only qemu-usart", arguments.board);
    }
    // Before the emulator starts, which would have an error of its own about the file; the emulator finds the directory.
    let log = arguments.log.as_deref().map(WholeFile::create);
    let place = log.transpose()?;
    let outcome = on_arm!(robot, A, N, P => play::<A, N, P>(arguments, robot));
    drop(place);
    if let (Some(stream), Some(log)) = (arguments.stream(), &arguments.log) {
        // Of a run that failed the log is of the more interest, but its own failure of less.
        return outcome.and(arguments.board.write_log(&robot.name, &stream, log));
    }
    outcome
}

impl Arguments {
    /// Where the emulator puts the raw log.
    fn stream(&self) -> Option<PathBuf> {
        let mut stream = self.log.clone()?.into_os_string();
        stream.push(".defmt");
        Some(stream.into())
    }
}

fn play<A: Arm<N, P>, const N: usize, const P: usize>(
    arguments: &Arguments,
    robot: &Robot,
) -> Result<(), Failure> {
    let bank = arguments.bank.as_deref();
    let mut bank = bank.map(|file| bank::read_for(file, robot)).transpose()?;
    let mut scene = arguments.motion.scene::<N>(robot)?;
    let stream = arguments.stream();
    let mut board = arguments.board.connect::<A, N, P>(stream.as_deref())?;
    if let Some(file) = &arguments.key_file {
        board.key = Some(bank::read_key(file)?);
    }
    if arguments.brake_close_ms > 0 {
        board.configure(Configuration {
            brake_close_ms: arguments.brake_close_ms,
            ..board.hello().configuration
        })?;
    }
    let beyond = |joint: &Joint| joint.limits.torque > f64::from(Effort::MAX);
    if robot.joints.iter().any(beyond) {
        let gains: JointVector<N> = gains_for_currents(robot)?;
        let mut with_gains = bank.map_or_else(|| board.read_bank(), Ok)?;
        with_gains.drive_gains_nm_a = gains.iter().copied().collect();
        bank = Some(with_gains);
        board.gains = Some(gains);
    }
    if let Some(bank) = &bank {
        board.upload_bank(bank)?;
    }
    if arguments.excite_on_board {
        load_excitation::<A, N, P>(&mut board, &mut scene, robot, arguments.tracking_rad)?;
    }
    let mut log = Log {
        motion: MotionLog::create(&arguments.out.join("log.csv"), true, None, true)?,
        seen: ClosedLoopLog::new(&scene.robot, scene.ticks),
        telemetry: None,
        every: WATCH_TICKS,
    };
    let set = board.read_bank()?.set::<A, N, P>();
    let set = set.map_err(BoardError::Bank)?;
    let started = |motion: &State<N>| evaluate::<A, N, P>(&set, &motion_f32(motion)).total.cast();
    close_loop(arguments, &mut scene, &mut board, &mut log, &started)?;
    board.learning(false)?;
    board.stream(0, 1)?;
    board.disarm()?;
    let statistics = board.statistics()?;
    let learnt = bank::bytes(&board.read_bank()?)?;
    let run = RunDescription {
        robot: robot.name.clone(),
        board: arguments.board.to_string(),
        seed: arguments.motion.seed,
        period_s: PERIOD_S,
        toolchain: arguments.board.toolchain(&robot.name),
        learning: arguments.learn,
        boot_us: board.hello().boot_us(),
    };
    let report = log.seen.report(run, &statistics);
    log.finish(&report, &learnt, arguments)
}

/// Drive gains of `robot`, N × N·m/A, with which a sample carries the currents of all torques.
///
/// Errors: a joint whose gain is too small for that.
fn gains_for_currents<const N: usize>(robot: &Robot) -> Result<JointVector<N>, Failure> {
    for joint in &robot.joints {
        let (name, limit, gain) = (&joint.name, joint.limits.torque, joint.gain());
        if limit / gain > f64::from(Effort::MAX) {
            bail!(
                "joint {name}: {limit} N·m at {gain} N·m/A is more than the {:.0} A that a sample carries: give --drive-gains",
                Effort::MAX
            );
        }
    }
    let gain = |j: usize| robot.joints[j].gain() as f32;
    Ok(JointVector::from_fn(|j, _| gain(j)))
}

/// Plays the scene to its end, or to that of the board's excitation.
fn close_loop<const N: usize>(
    arguments: &Arguments,
    scene: &mut Scene<N>,
    board: &mut Client<N>,
    log: &mut Log<N>,
    started: &dyn Fn(&State<N>) -> Joints<N>,
) -> Result<(), Failure> {
    let bar = Bar::new();
    let (plant, path) = (&mut scene.plant, &scene.trajectory);
    let mut play = ClosedLoop::new(plant, &scene.pd, path, PERIOD_S, Some(board))?;
    board.learning(arguments.learn)?;
    let watched = Field::Quality.bit() | Field::Decision.bit();
    let chosen = arguments.telemetry;
    let (fields, every) = chosen.map_or((watched, WATCH_TICKS), |own| (own.fields, own.every));
    board.stream(fields | watched, every)?;
    log.every = every;
    if let Some(chosen) = arguments.telemetry {
        let path = arguments.out.join("telemetry.csv");
        log.telemetry = Some(Recorder::create(&path, chosen, N, PERIOD_S)?);
    } else {
        remove_stale(&arguments.out, &["telemetry.csv", "telemetry.mcap"])?;
    }
    if arguments.excite_on_board {
        board.excitation(ExcitationCommand::Start)?;
    }
    for tick in 0..scene.ticks {
        let record = play.tick(plant, Some(board))?;
        log.add(&record, board, &started(&record.desired))?;
        if arguments.excite_on_board && has_ended(board, tick, record.stage)? {
            // The next host finds a board that follows its samples.
            board.excitation(ExcitationCommand::Release)?;
            break;
        }
        if tick % 256 == 0 {
            bar.show("run", tick, scene.ticks);
        }
    }
    Ok(())
}

struct Log<const N: usize> {
    motion: MotionLog<N>,
    seen: ClosedLoopLog<N>,
    telemetry: Option<Recorder>,
    /// Ticks from one telemetry record to the next.
    every: u16,
}

impl<const N: usize> Log<N> {
    fn add(
        &mut self,
        record: &TickRecord<N>,
        board: &mut Client<N>,
        started: &Joints<N>,
    ) -> Result<(), Failure> {
        self.seen.add(record, Some(board.safety()), Some(started));
        self.motion.add(record)?;
        let frames = board.take_telemetry();
        self.seen.take(&frames, self.every, PERIOD_S);
        if let Some(recorder) = &mut self.telemetry {
            recorder.take(&frames)?;
        }
        Ok(())
    }

    /// Gives all files their names; a run in trouble fails.
    fn finish(
        self,
        report: &ClosedLoopReport,
        learnt: &[u8],
        arguments: &Arguments,
    ) -> Result<(), Failure> {
        let out = &arguments.out;
        let page = closed_loop::page(report, &self.seen, &terminal::command_line());
        self.motion.finish()?;
        if let Some(recorder) = self.telemetry {
            recorder.finish()?;
        }
        write_whole(&out.join("bank.bin"), learnt)?;
        let page = ReportFiles::create(out)?.finish(report, &page)?;
        arguments.verdict.show(&report.troubles)?;
        let (ticks, errors) = (report.ticks, report.link.errors());
        let rms = report.tracking_rms_mrad;
        show!(
            "{ticks} ticks, tracking error {rms:.3} mrad RMS, {errors} link errors and missed deadlines"
        )?;
        if report.run.learning {
            show!("{}", report.learnt.line())?;
        }
        if report.store == StoreHealth::Failing {
            show!("the board's flash keeps nothing: what it learnt is lost at power-off")?;
        }
        show!("{}", page.display())?;
        arguments.verdict.judge(&report.troubles)
    }
}

/// Distance from the start of the series at which the arm waits, rad: the approach has work to do.
const ASIDE_RAD: f64 = 0.1;
/// Longer than check, approach and stop together, s.
const AROUND_S: f64 = 60.0;
/// Ticks after which the check is over.
const CHECK_TICKS: usize = 300;

/// Uploads the excitation that `scene` was to play, and has the arm wait beside its beginning instead.
///
/// Errors: a trajectory that is no excitation; what the board refuses.
fn load_excitation<A: Arm<N, P>, const N: usize, const P: usize>(
    board: &mut Client<N>,
    scene: &mut Scene<N>,
    robot: &Robot,
    tracking_rad: f32,
) -> Result<(), Failure> {
    let Trajectory::Excitation { series, duration_s } = &scene.trajectory else {
        bail!("--excite-on-board: --trajectory must be an excitation.json");
    };
    let periods = (duration_s / series.period_s).ceil().max(1.0);
    if periods > f64::from(u16::MAX) {
        bail!("--duration-s is {periods} periods");
    }
    let whole_s = periods * series.period_s;
    if whole_s > *duration_s {
        show!(
            "the board plays {periods} whole periods of {} s",
            series.period_s
        )?;
    }
    let program = series.program::<N>(A::hash(), periods as u16, tracking_rad)?;
    board.load_excitation(&program)?;
    scene.ticks = ((periods * series.period_s + AROUND_S) / PERIOD_S) as usize;
    scene.trajectory = Trajectory::Sampled(vec![(0.0, State::rest(beside(series, robot)))]);
    Ok(())
}

/// The beginning of the series, every joint a little nearer to the middle of its range.
fn beside<const N: usize>(series: &Excitation, robot: &Robot) -> Joints<N> {
    let mut q = series.at::<N>(0.0).q;
    for (q, joint) in q.iter_mut().zip(&robot.joints) {
        let (low, high) = joint.limits.position;
        *q += ASIDE_RAD.copysign(0.5 * (low + high) - *q);
    }
    q
}

/// True after tick `tick`, whose reply had `stage` or none, if the excitation has come to its end.
///
/// Errors: a board that broke it off, refused it after its check, or never began.
fn has_ended<const N: usize>(
    board: &mut Client<N>,
    tick: usize,
    stage: Option<ExcitationState>,
) -> Result<bool, Failure> {
    match stage {
        Some(ExcitationState::Holding) => Ok(true),
        Some(ExcitationState::Aborted(reason)) => {
            let t_s = tick as f64 * PERIOD_S;
            bail!("the board broke the excitation off after {t_s:.3} s: {reason}")
        }
        None if tick == CHECK_TICKS => match board.excitation(ExcitationCommand::Status)? {
            stage if stage.is_active() => Ok(false),
            stage => bail!("the board did not begin the excitation: {stage:?}"),
        },
        _ => Ok(false),
    }
}
