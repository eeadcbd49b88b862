use super::arm::RobotOptions;
use super::boards::{BoardChoice, on_arm};
use super::simulate::PERIOD_S;
use super::terminal::{Bar, show};
use super::{Failure, bail, bank, not_over, unsupported};
use clap::Args;
use foretorque::arm::Arm;
use foretorque_workbench::closed_loop::motion_f32;
use foretorque_workbench::dynamics::{RigidBodies, State};
use foretorque_workbench::joints;
use foretorque_workbench::robot::Robot;
use foretorque_workbench::table::{StateReader, TableError, TableWriter, joint_columns};
use foretorque_workbench::trajectory::Trajectory;
use std::path::PathBuf;

/// Feed-forward torque of every row of a table of states, computed by the firmware
#[derive(Debug, Args)]
pub(super) struct Arguments {
    #[command(flatten)]
    robot: RobotOptions,
    /// Board: native, qemu, qemu-usart or serial:PORT
    #[arg(long, default_value = "native")]
    board: BoardChoice,
    /// Table with q1_rad…, qd1_rad_s…, qdd1_rad_s2… (CSV, or CSV.gz); t_s is optional
    #[arg(long = "in", value_name = "FILE")]
    #[arg(required_unless_present = "trajectory")]
    input: Option<PathBuf>,
    /// In place of a table: an excitation (.json), a path of the tool (.toml), a table with t_s, or `validation`, every
    /// millisecond
    #[arg(long, value_name = "FILE|validation", conflicts_with = "input")]
    trajectory: Option<String>,
    /// Write key of the board, 32 hexadecimal digits, where it takes signed banks only
    #[arg(long, value_name = "FILE", requires = "bank")]
    key_file: Option<PathBuf>,
    /// Seed of the validation path
    #[arg(long, default_value_t = 1, conflicts_with = "input")]
    seed: u64,
    /// Table to write: tau1_nm…; with a bank also rigid1_nm…, friction1_nm…, network1_nm…; of coupled joints, whose
    /// torques have the described friction, also rigid1_nm…, friction1_nm…
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Parameter bank to load; without it the rigid-body torque of the description's parameters
    #[arg(long, value_name = "FILE")]
    bank: Option<PathBuf>,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    super::terminal::keep_stdout_for(&arguments.out);
    let robot = &arguments.robot.load_coupled()?;
    let files = [&arguments.input, &arguments.bank, &arguments.key_file];
    let trajectory = arguments.trajectory.as_ref().map(PathBuf::from);
    let mut read = arguments.robot.files();
    read.extend(files.into_iter().cloned().chain([trajectory]).flatten());
    not_over(read, [arguments.out.clone()])?;
    if robot.coupling.is_some() {
        return joints!(robot.joint_count(), N => coupled::<N>(arguments, robot), else Err(unsupported(robot.joint_count())));
    }
    on_arm!(robot, A, N, P => torque::<A, N, P>(arguments, robot))
}

/// Times, s, and states one after the other, from a table or a trajectory.
type States<const N: usize> = Box<dyn Iterator<Item = Result<(Option<f64>, State<N>), TableError>>>;

impl Arguments {
    /// Whether the states have times, and the states.
    fn states<const N: usize>(&self, robot: &Robot) -> Result<(bool, States<N>), Failure> {
        if let Some(path) = &self.input {
            let states = StateReader::<N>::open(path)?;
            return Ok((states.has_time(), Box::new(states)));
        }
        let name = self.trajectory.as_deref().unwrap_or_default();
        let path = Trajectory::<N>::load(name, robot, self.seed, None, PERIOD_S)?;
        let states = (0..=path.ticks(PERIOD_S)).map(move |tick| {
            let t_s = tick as f64 * PERIOD_S;
            Ok((Some(t_s), path.at(t_s)))
        });
        Ok((true, Box::new(states)))
    }

    /// Writes `shares` of the torque of every joint in every state, beside the times if there are any.
    ///
    /// * `torques` shares in a motion, joint by joint; `None` where one is not finite
    ///
    /// Errors: those of `torques`; a torque that is not finite; no rows; the file system's.
    fn write<const N: usize, T: ToString>(
        &self,
        robot: &Robot,
        (timed, states): (bool, States<N>),
        shares: &[&str],
        mut torques: impl FnMut(&State<N>) -> Result<Option<Vec<T>>, Failure>,
    ) -> Result<(), Failure> {
        let mut header: Vec<String> = timed.then(|| "t_s".to_owned()).into_iter().collect();
        let columns = shares.iter();
        header.extend(columns.flat_map(|share| joint_columns(share, "nm", N)));
        let mut table = TableWriter::create(&self.out, &header)?;
        let (bar, mut rows) = (Bar::new(), 0);
        let mut farthest = [0.0_f64; N];
        for state in states {
            let (t_s, state) = state?;
            rows += 1;
            for (farthest, q) in farthest.iter_mut().zip(&state.q) {
                *farthest = farthest.max(q.abs());
            }
            let Some(torques) = torques(&state)? else {
                bail!("state {rows}: its torque is not a number: are these rad, rad/s and rad/s²?");
            };
            let time = t_s.iter().map(f64::to_string);
            table.row(time.chain(torques.iter().map(T::to_string)))?;
            if rows % 256 == 0 {
                bar.show("torque", rows, rows);
            }
        }
        if let (0, Some(path)) = (rows, &self.input) {
            return Err(TableError::empty(path).into());
        }
        table.finish()?;
        for (number, (joint, farthest)) in (1..).zip(robot.joints.iter().zip(farthest)) {
            let (low, high) = joint.limits.position;
            if farthest > low.abs().max(high.abs()) {
                show!(
                    "note  q{number} is {farthest:.3} rad in size, beyond its range of {low:.3} … {high:.3} rad: are these degrees?"
                )?;
            }
        }
        Ok(())
    }
}

/// Writes the torques of drives that turn several joints, in f64: no board has them.
fn coupled<const N: usize>(arguments: &Arguments, robot: &Robot) -> Result<(), Failure> {
    if arguments.bank.is_some() || arguments.board != BoardChoice::Native {
        bail!("boards have no coupled joints: leave out --bank and --board");
    }
    let model = RigidBodies::new(robot);
    let (states, shares) = (arguments.states::<N>(robot)?, ["tau", "rigid", "friction"]);
    arguments.write(robot, states, &shares, |motion| {
        let rigid = model.inverse_dynamics(&(*motion).into());
        let drives = robot.joints.iter().zip(&motion.qd);
        let friction = drives.map(|(drive, qd)| drive.friction.sliding(*qd));
        let friction: Vec<f64> = friction.collect();
        let total: Vec<f64> = rigid.iter().zip(&friction).map(|(a, b)| a + b).collect();
        let finite = total.iter().all(|tau| tau.is_finite());
        Ok(finite.then(|| [&total[..], &rigid, &friction].concat()))
    })
}

fn torque<A: Arm<N, P>, const N: usize, const P: usize>(
    arguments: &Arguments,
    robot: &Robot,
) -> Result<(), Failure> {
    let bank = arguments.bank.as_deref();
    let bank = bank.map(|file| bank::read_for(file, robot)).transpose()?;
    let states = arguments.states::<N>(robot)?;
    let mut board = arguments.board.connect::<A, N, P>(None)?;
    if let Some(bank) = &bank {
        if let Some(file) = &arguments.key_file {
            board.key = Some(bank::read_key(file)?);
        }
        board.upload_bank(bank)?;
    }
    let shares: &[&str] = match bank {
        Some(_) => &["tau", "rigid", "friction", "network"],
        None => &["tau"],
    };
    arguments.write(robot, states, shares, |motion| {
        let torque = board.evaluate(&motion_f32(motion))?;
        let own = torque.shares;
        let mut torques = own.rigid.iter().chain(&torque.total);
        let finite = torques.all(|tau| tau.is_finite());
        let shares = match bank {
            Some(_) => vec![torque.total, own.rigid, own.friction, own.network],
            None => vec![own.rigid],
        };
        Ok(finite.then(|| shares.iter().flatten().copied().collect::<Vec<f32>>()))
    })
}
