//! The one place that speaks to the terminal.

use std::fmt::Display;
use std::io::{self, Write};

/// Writes a line to stdout. Nobody listening any more (`host-sim … | head -1`) is no failure: the files are what counts.
///
/// Errors: any other that the system gives, such as a full disk.
pub(super) fn say(line: impl Display) -> io::Result<()> {
    heard(writeln!(io::stdout(), "{line}"))
}

/// Writes the line that a command failed with to stderr, as far as somebody listens.
pub fn complain(failure: impl Display) {
    // There is no one left to tell that telling failed.
    let _ = writeln!(io::stderr(), "error: {failure}");
}

fn heard(written: io::Result<()>) -> io::Result<()> {
    match written {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        Err(error) => Err(io::Error::new(error.kind(), format!("stdout: {error}"))),
        Ok(()) => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_closed_pipe_is_no_failure_and_a_full_disk_is_one() {
        assert!(heard(Err(io::ErrorKind::BrokenPipe.into())).is_ok());
        let full = heard(Err(io::ErrorKind::StorageFull.into())).expect_err("not silenced");
        assert!(full.to_string().starts_with("stdout: "), "{full}");
    }
}
