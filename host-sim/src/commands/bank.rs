use super::terminal::say;
use super::{Failure, unusable};
use clap::Args;
use foretorque::arm::panda::{self, Panda};
use foretorque::arm::ur5::{self, Ur5};
use foretorque::edge::bank::{BankError, ParameterBank};
use std::fs;
use std::path::{Path, PathBuf};

/// Print what a parameter bank holds
#[derive(Debug, Args)]
pub(super) struct Arguments {
    /// Bank file
    file: PathBuf,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let bank = read(&arguments.file)?;
    say(format_args!(
        "arm       {} ({:08x})",
        bank.arm, bank.arm_hash
    ))?;
    let network = &bank.network;
    say(format_args!(
        "network   {} × {}-{}-{} {:?}, {} weights",
        network.blocks,
        network.inputs,
        network.hidden,
        network.outputs,
        network.activation,
        bank.weights.len()
    ))?;
    say(format_args!(
        "usable    {}",
        match usable(&bank) {
            Ok(()) => format!("yes, on a board that drives {}", bank.arm),
            Err(error) => format!("no: {error}"),
        }
    ))?;
    say(format_args!(
        "\n{:<8} {:>14} {:>14}",
        "column", "value (SI)", "deviation"
    ))?;
    for column in &bank.columns {
        say(format_args!(
            "{:<8} {:>14.6} {:>14.6}",
            column.id.to_string(),
            column.value,
            column.deviation
        ))?;
    }
    say(format_args!(
        "\n{:<8} {:>10} {:>12} {:>14} {:>12}",
        "joint", "limit N·m", "slew N·m/s", "network share", "gain N·m/A"
    ))?;
    for (joint, (limits, gain)) in bank.limits.iter().zip(&bank.drive_gains_nm_a).enumerate() {
        say(format_args!(
            "{:<8} {:>10} {:>12} {:>14} {:>12}",
            joint + 1,
            limits.torque_nm,
            limits.slew_nm_s,
            limits.network_share,
            gain
        ))?;
    }
    Ok(())
}

/// The bank is one for an arm of the firmware.
fn usable(bank: &ParameterBank) -> Result<(), BankError> {
    match bank.set::<Ur5, { ur5::JOINTS }, { ur5::PARAMETERS }>() {
        Err(BankError::WrongArm { .. }) => bank
            .set::<Panda, { panda::JOINTS }, { panda::PARAMETERS }>()
            .map(drop),
        judged => judged.map(drop),
    }
}

/// A bank from its file.
///
/// Errors: the file's, or that it is no bank, each with the path.
pub(super) fn read(path: &Path) -> Result<ParameterBank, Failure> {
    let bytes = fs::read(path).map_err(|error| crate::files::at(path, error))?;
    ParameterBank::decode(&bytes).map_err(|error| unusable(format!("{}: {error}", path.display())))
}

/// The bytes of a bank file.
pub(super) fn bytes(bank: &ParameterBank) -> Result<Vec<u8>, Failure> {
    let mut room = vec![0; ParameterBank::MAX_BYTES];
    Ok(bank.encode(&mut room)?.to_vec())
}
