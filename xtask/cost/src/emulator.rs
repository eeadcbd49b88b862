//! Runs the bench ELF in the emulator, once to count and once to trace.

use std::io::{BufReader, Read};
use std::path::Path;
use std::process::{Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, anyhow, bail, ensure};

use crate::image::Image;
use crate::spread::{Spread, TICKS};
use crate::trace::{self, Call};

/// A run takes less than half a minute on a quiet machine; one of ten minutes hangs.
const LIMIT: Duration = Duration::from_secs(600);

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
    command.stdout(Stdio::piped()).stderr(Stdio::inherit());
    let text = bounded(&mut command, |child| {
        let mut text = String::new();
        child.read_to_string(&mut text)?;
        Ok(text)
    })?;
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
    bounded(&mut command, |child| {
        trace::follow(BufReader::with_capacity(1 << 16, child), image, &names)
    })
}

fn machine(elf: &Path, calls: u32, ticks: u32) -> Command {
    let mut command = Command::new("qemu-system-arm");
    command
        .args(["-machine", "netduinoplus2", "-nographic"])
        .args(["-monitor", "none", "-serial", "none", "-semihosting-config"])
        .arg(format!("enable=on,target=native,arg={calls},arg={ticks}"))
        .arg("-kernel")
        .arg(elf)
        .stdin(Stdio::null());
    command
}

/// Runs `command` for at most [`LIMIT`] while `read` reads its pipe.
fn bounded<T: Send>(
    command: &mut Command,
    read: impl FnOnce(&mut (dyn Read + Send)) -> Result<T> + Send,
) -> Result<T> {
    let mut child = command.spawn().context("cannot start qemu-system-arm")?;
    let mut pipe: Box<dyn Read + Send> = match (child.stdout.take(), child.stderr.take()) {
        (Some(stdout), _) => Box::new(stdout),
        (_, Some(stderr)) => Box::new(stderr),
        _ => bail!("the emulator has no pipe"),
    };
    thread::scope(|scope| {
        let reader = scope.spawn(move || read(&mut *pipe));
        let start = Instant::now();
        let status = loop {
            if let Some(status) = child.try_wait()? {
                break status;
            }
            if start.elapsed() > LIMIT {
                child.kill()?;
                child.wait()?;
                bail!(
                    "the emulator took more than {} s and was ended",
                    LIMIT.as_secs()
                );
            }
            thread::sleep(Duration::from_millis(5));
        };
        let read = reader.join().map_err(|_| anyhow!("the reader panicked"))?;
        ensure!(status.success(), "the bench program failed ({status})");
        read
    })
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
