//! Command line of foretorque.

use std::process::ExitCode;

fn main() -> ExitCode {
    match host_sim::commands::run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            host_sim::commands::complain(&failure);
            ExitCode::FAILURE
        }
    }
}
