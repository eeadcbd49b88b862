//! Runs the bench ELF in the emulator, once to count and once to trace.

use std::io::BufReader;
use std::path::Path;
use std::process::{Command, ExitStatus, Stdio};

use anyhow::{Context as _, Result, ensure};

use crate::image::Image;
use crate::spread::{Spread, TICKS};
use crate::trace::{self, Call};

/// A run takes less than half a minute on a quiet machine; one of ten minutes hangs.
const LIMIT: &str = "600";

const NOT_STARTED: &str = "cannot start qemu-system-arm";

/// The row whose function returns at once: its count beyond its own instructions is the bracket.
const EMPTY: &str = "empty";

/// Executed instructions of every call of a row, the bracket's own included.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Counts {
    pub(crate) name: String,
    pub(crate) calls: Vec<u32>,
}

/// Counts the instructions of `calls` calls of every row and of the long run, exactly and the same in every run.
pub(crate) fn count(elf: &Path, calls: u32) -> Result<(Vec<Counts>, Spread)> {
    let mut command = machine(elf, calls, TICKS);
    // One instruction is one nanosecond of virtual time, and TIM2 counts nanoseconds.
    command.args(["-icount", "shift=0,sleep=off"]);
    let output = command.stderr(Stdio::inherit()).output();
    let output = output.context(NOT_STARTED)?;
    succeeded(output.status)?;
    let text = String::from_utf8(output.stdout)?;
    let lines = text.trim_end().rsplit_once('\n');
    let (rows, long_run) = lines.context("the bench program printed nothing")?;
    Ok((read_counts(rows)?, Spread::read(long_run, TICKS)?))
}

/// Traces `calls` calls of each of `rows`.
pub(crate) fn trace(
    elf: &Path,
    image: &Image,
    calls: u32,
    rows: &[Counts],
) -> Result<Vec<Vec<Call>>> {
    let names: Vec<_> = rows.iter().map(|row| row.name.as_str()).collect();
    let mut command = machine(elf, calls, 0);
    // One instruction a block, and every block through the loop that logs the processor.
    command.args(["-singlestep", "-d", "cpu,nochain"]);
    // The same pipe under a name: the emulator's own standard error is not buffered, five times slower.
    command.args(["-D", "/dev/stderr"]);
    command.stdout(Stdio::null()).stderr(Stdio::piped());
    let mut child = command.spawn().context(NOT_STARTED)?;
    let log = child.stderr.take().context("the emulator has no log")?;
    let calls = trace::follow(BufReader::with_capacity(1 << 16, log), image, &names);
    succeeded(child.wait()?)?;
    calls
}

fn machine(elf: &Path, calls: u32, ticks: u32) -> Command {
    let mut command = Command::new("timeout");
    command
        .args([LIMIT, "qemu-system-arm"])
        .args(["-machine", "netduinoplus2", "-nographic"])
        .args(["-monitor", "none", "-serial", "none", "-semihosting-config"])
        .arg(format!("enable=on,target=native,arg={calls},arg={ticks}"))
        .arg("-kernel")
        .arg(elf)
        .stdin(Stdio::null());
    command
}

fn succeeded(status: ExitStatus) -> Result<()> {
    ensure!(
        status.code() != Some(124),
        "the emulator took more than {LIMIT} s and was ended"
    );
    ensure!(status.success(), "the bench program failed ({status})");
    Ok(())
}

/// Lines `name count`, one a call.
fn read_counts(text: &str) -> Result<Vec<Counts>> {
    let mut rows: Vec<Counts> = Vec::new();
    for line in text.lines() {
        let (name, count) = line
            .split_once(' ')
            .and_then(|(name, count)| Some((name, count.parse::<u32>().ok()?)))
            .with_context(|| format!("unexpected line of the bench program: `{line}`"))?;
        match rows.iter_mut().find(|row| row.name == name) {
            Some(row) => row.calls.push(count),
            None => rows.push(Counts {
                name: name.to_owned(),
                calls: vec![count],
            }),
        }
    }
    let empty = rows.first().filter(|row| row.name == EMPTY);
    let empty = empty.context("the bench program did not begin with row `empty`")?;
    ensure!(
        empty.calls.iter().all(|count| *count == empty.calls[0]),
        "the empty row does not always cost the same: {:?}",
        empty.calls
    );
    Ok(rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn calls_are_kept_by_row_and_in_order() {
        let rows = read_counts("empty 11\nempty 11\nsin_cos 50\nsin_cos 54\n").unwrap();
        assert_eq!(rows.len(), 2);
        assert_eq!(rows[1].calls, [50, 54]);
    }

    #[test]
    fn a_count_that_cannot_be_trusted_is_refused() {
        for text in [
            "empty 11\nempty 12\n",
            "sin_cos 50\n",
            "empty 11\npanicked at src/x.rs\n",
            "",
        ] {
            assert!(read_counts(text).is_err(), "{text:?}");
        }
    }
}
