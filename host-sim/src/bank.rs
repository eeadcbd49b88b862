use super::arm::ArmOptions;
use super::boards::{BoardChoice, on_arm};
use super::terminal::show;
use super::{Failure, bail, text_of, unusable};
use clap::{Args, ValueEnum};
use foretorque::arm::Arm;
use foretorque_link::bank::{BankError, ParameterBank};
use foretorque_link::wire::BankSource;
use foretorque_link::write_key::{KEY_BYTES, WriteKey};
use foretorque_workbench::arms;
use foretorque_workbench::board::Described;
use foretorque_workbench::files::{at, write_whole};
use foretorque_workbench::report::page::figure;
use foretorque_workbench::robot::Robot;
use foretorque_workbench::snapshot::aligned;
use hex::FromHex as _;
use std::fs;
use std::io::Read as _;
use std::path::{Path, PathBuf};

const LARGEST: u64 = ParameterBank::MAX_BYTES as u64;

/// Print what a parameter bank holds; with a board, send it there or bring it from there
#[derive(Debug, Args)]
pub(super) struct Arguments {
    /// Bank file
    file: PathBuf,
    /// Board: native, qemu, qemu-usart or serial:PORT
    #[arg(long, requires = "robot")]
    board: Option<BoardChoice>,
    /// Robot that the board drives: a built-in name or a description file
    #[arg(long, requires = "board")]
    robot: Option<String>,
    #[command(flatten)]
    arm: ArmOptions,
    /// Bring this bank of the board into FILE, instead of sending FILE to the board
    #[arg(long, value_enum, requires = "board")]
    read: Option<Source>,
    /// Have the board keep over power-off what it was sent
    #[arg(long, requires = "board", conflicts_with = "read")]
    save: bool,
    /// Write key of the board, 32 hexadecimal digits
    #[arg(long, value_name = "FILE", requires = "board")]
    key_file: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Source {
    /// In force, with all that was learnt
    Live,
    /// Last loaded or committed
    Committed,
    /// In the store
    Stored,
    /// Live, and printed as the difference from the stored one
    Learnt,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    if arguments.robot.is_none() && arguments.arm != ArmOptions::default() {
        bail!("options of an arm need --robot");
    }
    if let (Some(_), Some(robot)) = (&arguments.board, &arguments.robot) {
        if arguments.read.is_none() {
            // Before a board is disturbed: is it a bank?
            read(&arguments.file)?;
        }
        if arguments.read.is_some() && arguments.file.exists() && read(&arguments.file).is_err() {
            let file = arguments.file.display();
            bail!("{file} is there and no bank: choose another name");
        }
        let robot = &arguments.arm.load(robot)?;
        let found: Result<_, Failure> =
            on_arm!(robot, A, N, P => arguments.exchange::<A, N, P>(robot));
        if let Some((live, stored)) = found? {
            return differences(&live, &stored);
        }
    }
    print(&read(&arguments.file)?)
}

impl Arguments {
    /// Sends the bank to the board, or brings it; live and stored bank where their difference is wanted.
    fn exchange<A: Arm<N, P>, const N: usize, const P: usize>(
        &self,
        robot: &Robot,
    ) -> Result<Option<(ParameterBank, ParameterBank)>, Failure> {
        let Some(board) = &self.board else {
            return Ok(None);
        };
        let mut board = board.connect::<A, N, P>(None)?;
        if let Some(file) = &self.key_file {
            board.key = Some(read_key(file)?);
        }
        let Some(source) = self.read else {
            board.upload_bank(&read_for(&self.file, robot)?)?;
            if self.save {
                board.save()?;
            }
            return Ok(None);
        };
        let bank = board.read_bank_of(match source {
            Source::Live | Source::Learnt => BankSource::Live,
            Source::Committed => BankSource::Committed,
            Source::Stored => BankSource::Stored,
        })?;
        let stored = match source {
            Source::Learnt => Some(board.read_bank_of(BankSource::Stored)?),
            _ => None,
        };
        write_whole(&self.file, &bytes(&bank)?)?;
        Ok(stored.map(|stored| (bank, stored)))
    }
}

/// Prints what has changed from the stored bank to the live one.
fn differences(live: &ParameterBank, stored: &ParameterBank) -> Result<(), Failure> {
    let rows = live.columns.iter().map(|column| {
        // Columns that a bank does not have are zero.
        let before = stored.column(column.id).map_or(0.0, |column| column.value);
        let change = column.value - before;
        let figures = [before, column.value, change].map(|value| figure(value.into(), 6));
        std::iter::once(column.id.to_string()).chain(figures)
    });
    show!("{}", aligned("column | stored (SI) | live | change", rows))?;
    let pairs = live.weights.iter().zip(&stored.weights);
    let changes = pairs.map(|(live, stored)| f64::from(live - stored).powi(2));
    let rms = (changes.sum::<f64>() / live.weights.len().max(1) as f64).sqrt();
    show!("weights   changed by {rms:.6} RMS")
}

fn print(bank: &ParameterBank) -> Result<(), Failure> {
    show!("arm       {} ({:08x})", bank.arm, bank.arm_hash)?;
    let network = &bank.network;
    show!(
        "network   {} × {}-{}-{} {:?}, {} weights",
        network.blocks,
        network.inputs,
        network.hidden,
        network.outputs,
        network.activation,
        bank.weights.len()
    )?;
    match usable(bank) {
        Ok(()) => show!("usable    yes, on a board that drives {}", bank.arm)?,
        Err(error) => show!("usable    no: {error}")?,
    }
    let columns = bank.columns.iter().map(|column| {
        let figures = [column.value, column.deviation].map(|value| figure(value.into(), 6));
        std::iter::once(column.id.to_string()).chain(figures)
    });
    show!("\n{}", aligned("column | value (SI) | deviation", columns))?;
    let joints = (1..).zip(bank.limits.iter().zip(&bank.drive_gains_nm_a));
    let joints = joints.map(|(joint, (limits, gain))| {
        let limits = [limits.torque_nm, limits.slew_nm_s, limits.network_share];
        let figures = limits.iter().chain([gain]).map(f32::to_string);
        std::iter::once(joint.to_string()).chain(figures.collect::<Vec<_>>())
    });
    let header = "joint | limit N·m | slew N·m/s | network share | gain N·m/A";
    show!("{}", aligned(header, joints).trim_end())
}

/// Whether the bank fits its arm, where that is built in.
fn usable(bank: &ParameterBank) -> Result<(), BankError> {
    let arms = Robot::built_in().filter_map(|name| Robot::load(name).ok());
    let mut judged = arms.map(|robot| {
        arms!(robot, N, P => {
            Described::<N, P>::read(&robot);
            bank.set::<Described<N, P>, N, P>().map(drop)
        }, else Err(BankError::WrongArm { found: bank.arm_hash }))
    });
    let known = judged.find(|judged| !matches!(judged, Err(BankError::WrongArm { .. })));
    known.unwrap_or(Ok(()))
}

/// A bank from its file.
///
/// Errors: the file's, or that it is no bank, each with the path.
pub(super) fn read(path: &Path) -> Result<ParameterBank, Failure> {
    // No more than the largest bank and one byte that makes it too long.
    let mut bytes = Vec::new();
    fs::File::open(path)
        .and_then(|file| file.take(LARGEST + 1).read_to_end(&mut bytes))
        .map_err(|error| at(path, error))?;
    ParameterBank::decode(&bytes).map_err(|error| unusable(format!("{}: {error}", path.display())))
}

/// A bank for a robot from its file, with a note where its arm has another name.
pub(super) fn read_for(path: &Path, robot: &Robot) -> Result<ParameterBank, Failure> {
    let bank = read(path)?;
    if bank.arm.as_str() != robot.name {
        let (path, arm, own) = (path.display(), &bank.arm, &robot.name);
        show!(
            "note: {path} is a bank of arm '{arm}', the robot is '{own}': it serves if their geometry is the same"
        )?;
    }
    Ok(bank)
}

pub(super) fn bytes(bank: &ParameterBank) -> Result<Vec<u8>, Failure> {
    let mut buffer = vec![0; ParameterBank::MAX_BYTES];
    Ok(bank.encode(&mut buffer)?.to_vec())
}

/// The key in `path`: 32 hexadecimal digits in one line.
///
/// Errors: the file's, or that it holds no key.
pub(super) fn read_key(path: &Path) -> Result<WriteKey, Failure> {
    let key = <[u8; KEY_BYTES]>::from_hex(text_of(path)?.trim()).ok();
    key.and_then(WriteKey::from_slot).ok_or_else(|| {
        let way = "32 hexadecimal digits, not all 0 or f";
        unusable(format!("{}: not a write key: {way}", path.display()))
    })
}
