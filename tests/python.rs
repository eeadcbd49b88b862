//! Python with the packages of a test, and tests that this machine cannot run.

use std::io::Write as _;
use std::process::{Command, Stdio};

/// Print on the terminal why a test does not run here: `cargo xtask test` counts these lines.
pub(crate) fn skipped(reason: &str) {
    // `println!` shows nothing of a test that passes.
    let _ = writeln!(std::io::stdout(), "skipped: {reason}");
}

/// The program that imports `packages`, separated by commas: `FORETORQUE_PYTHON`, or `python3`. Without one the test is skipped.
pub(crate) fn with(packages: &str) -> Option<String> {
    let python = std::env::var("FORETORQUE_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let import = Command::new(&python)
        .args(["-c", &format!("import {packages}")])
        .stderr(Stdio::null())
        .status();
    if import.is_ok_and(|status| status.success()) {
        return Some(python);
    }
    let way = "FORETORQUE_PYTHON names one that can";
    skipped(&format!("{python} cannot import {packages}; {way}"));
    None
}
