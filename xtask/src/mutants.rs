//! Mutation campaign over the code that limits torque: each substitution must fail a fast test.

use std::fs;
use std::path::PathBuf;
use std::process::Stdio;

use anyhow::{Context as _, Result, bail, ensure};

use crate::shell::{capture, command, root};

/// One substitution: file, text that occurs once, its replacement.
type Mutant = (&'static str, &'static str, &'static str);

/// Packages whose library tests judge.
const PACKAGES: [&str; 4] = ["-p", "foretorque", "-p", "foretorque-link"];

const LIMITS: &str = "firmware/foretorque-link/src/safety/limits.rs";
const INPUT: &str = "firmware/foretorque-link/src/safety/input.rs";
const THERMAL: &str = "firmware/foretorque-link/src/safety/thermal_derating.rs";
const SHARES: &str = "firmware/foretorque/src/feedforward/shares.rs";
const PROTOCOL: &str = "firmware/foretorque-link/src/session/protocol/mod.rs";
const DISPATCH: &str = "firmware/foretorque-link/src/session/dispatch.rs";
const HOUSEKEEPING: &str = "firmware/foretorque-link/src/session/housekeeping.rs";
const BANK: &str = "firmware/foretorque-link/src/bank/parameters.rs";

/// The campaign.
const MUTANTS: [Mutant; 24] = [
    (
        LIMITS,
        "COMMAND_TIMEOUT_US: u32 = 50_000",
        "COMMAND_TIMEOUT_US: u32 = 60_000",
    ),
    (
        LIMITS,
        "MEASUREMENT_TIMEOUT_US: u32 = 100_000",
        "MEASUREMENT_TIMEOUT_US: u32 = 200_000",
    ),
    (
        LIMITS,
        "TEMPERATURE_TIMEOUT_US: u32 = 10_000_000",
        "TEMPERATURE_TIMEOUT_US: u32 = 20_000_000",
    ),
    (
        LIMITS,
        "HARD_SLEW_TIME_S: f32 = 0.01",
        "HARD_SLEW_TIME_S: f32 = 0.005",
    ),
    (
        LIMITS,
        "SPEED_MARGIN: f32 = 1.5",
        "SPEED_MARGIN: f32 = 15.0",
    ),
    (LIMITS, "JUMP_MARGIN: f32 = 0.02", "JUMP_MARGIN: f32 = 0.2"),
    (LIMITS, "RANGE_MARGIN: f32 = 0.1", "RANGE_MARGIN: f32 = 1.0"),
    (
        LIMITS,
        "EFFORT_MARGIN: f32 = 3.0",
        "EFFORT_MARGIN: f32 = 30.0",
    ),
    (INPUT, "ARM_SAMPLES: u32 = 3", "ARM_SAMPLES: u32 = 2"),
    (INPUT, "ARM_DISTANCE: f32 = 0.2", "ARM_DISTANCE: f32 = 0.4"),
    (
        INPUT,
        "IMPLAUSIBLE_WEIGHT: u32 = 4",
        "IMPLAUSIBLE_WEIGHT: u32 = 2",
    ),
    (THERMAL, "WARM_C: i8 = 80", "WARM_C: i8 = 90"),
    (THERMAL, "HOT_C: i8 = 100", "HOT_C: i8 = 110"),
    (THERMAL, "HYSTERESIS_C: i8 = 5", "HYSTERESIS_C: i8 = 0"),
    (
        SHARES,
        "LEARNED_BOUND: f32 = 0.20",
        "LEARNED_BOUND: f32 = 0.40",
    ),
    (
        SHARES,
        "RIGID_PLAUSIBLE: f32 = 10.0",
        "RIGID_PLAUSIBLE: f32 = 1000.0",
    ),
    (
        SHARES,
        "FRICTION_PLAUSIBLE: f32 = 2.0",
        "FRICTION_PLAUSIBLE: f32 = 200.0",
    ),
    (
        PROTOCOL,
        "let nonce = self.challenge.take()",
        "let nonce = self.challenge",
    ),
    (
        PROTOCOL,
        "self.permission.take() == Some(order)",
        "self.permission == Some(order)",
    ),
    (
        PROTOCOL,
        "self.permission = right.then_some(order)",
        "self.permission = Some(order)",
    ),
    (
        DISPATCH,
        "board.sustains(controller.configuration().period_us)?;",
        "",
    ),
    (
        HOUSEKEEPING,
        "if CRC.checksum(bytes) != upload.crc {",
        "if false {",
    ),
    (
        HOUSEKEEPING,
        "if !signature.verifies(A::hash(), bytes) =>",
        "if false && !signature.verifies(A::hash(), bytes) =>",
    ),
    (
        BANK,
        "LARGEST_DIFFERENCE: f32 = 0.75",
        "LARGEST_DIFFERENCE: f32 = 75.0",
    ),
];

/// Restores a file when it goes out of scope.
struct Original(PathBuf, String);

impl Drop for Original {
    fn drop(&mut self) {
        if let Err(error) = fs::write(&self.0, &self.1) {
            eprintln!("cannot restore {}: {error}", self.0.display());
        }
    }
}

/// Applies every mutant to the work tree, one at a time, and runs the library tests; fails if one survives.
pub(crate) fn run() -> Result<()> {
    let status = capture(command("git").args(["status", "--porcelain", "--", "firmware"]));
    ensure!(
        status.is_some_and(|changes| changes.trim().is_empty()),
        "`firmware` has changes: commit them, the campaign edits and restores these files"
    );
    ensure!(tests_pass()?, "the tests fail without a mutant");
    let mut survivors = 0;
    for (number, (file, from, to)) in MUTANTS.iter().enumerate() {
        let path = root().join(file);
        let text = fs::read_to_string(&path).with_context(|| format!("cannot read {file}"))?;
        let original = Original(path, text);
        fs::write(&original.0, original.1.replacen(from, to, 1))?;
        let lives = tests_pass()?;
        drop(original);
        survivors += u32::from(lives);
        let verdict = if lives { "LIVES" } else { "killed" };
        println!("{:>3} {verdict} {file}: {from} -> {to}", number + 1);
    }
    println!(
        "{} of {} killed",
        MUTANTS.len() as u32 - survivors,
        MUTANTS.len()
    );
    if survivors > 0 {
        bail!("{survivors} mutants live");
    }
    Ok(())
}

fn tests_pass() -> Result<bool> {
    let mut cargo = command("cargo");
    cargo.arg("test").args(PACKAGES).args(["--lib", "--quiet"]);
    let status = cargo.stdout(Stdio::null()).stderr(Stdio::null()).status();
    Ok(status.context("cannot start cargo")?.success())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_mutant_changes_one_place() {
        for (file, from, to) in MUTANTS {
            let text = fs::read_to_string(root().join(file)).unwrap();
            assert_eq!(text.matches(from).count(), 1, "{file}: {from}");
            assert_ne!(from, to);
        }
    }
}
