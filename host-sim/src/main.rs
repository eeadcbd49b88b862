//! Command line of foretorque.

mod commands;

use std::process::ExitCode;

fn main() -> ExitCode {
    match commands::run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            commands::show_failure(&failure);
            ExitCode::from(commands::exit_code(&failure))
        }
    }
}
