//! Python with the packages of a test.

use std::process::{Command, Stdio};

/// The program that imports `packages`, separated by commas: `FORETORQUE_PYTHON`, or `python3`. Without one the reason is
/// printed, and the test is to be skipped.
pub(crate) fn with(packages: &str) -> Option<String> {
    let python = std::env::var("FORETORQUE_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let import = Command::new(&python)
        .args(["-c", &format!("import {packages}")])
        .stderr(Stdio::null())
        .status();
    if import.is_ok_and(|status| status.success()) {
        return Some(python);
    }
    println!("skipped: {python} cannot import {packages}; FORETORQUE_PYTHON names one that can");
    None
}
