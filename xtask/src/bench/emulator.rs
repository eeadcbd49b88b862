//! Runs the bench ELF in the emulator, once to count and once to trace.

use std::collections::BTreeMap;
use std::io::{BufReader, Read};
use std::path::Path;
use std::process::{Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, anyhow, bail, ensure};

use super::image::Image;
use super::spread::{Spread, TICKS};
use super::trace::{self, Call};
use crate::shell;

/// No run takes longer than half a minute; one that does hangs.
const LIMIT: Duration = Duration::from_secs(120);

/// The row whose function returns at once: what it is counted beyond its own instructions is the bracket.
const EMPTY: &str = "empty";

/// Executed instructions of every call of a row, the bracket's own included.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Counts {
    pub(crate) name: String,
    pub(crate) calls: Vec<u32>,
}

impl Counts {
    pub(crate) fn max(&self) -> u32 {
        self.calls.iter().copied().max().unwrap_or(0)
    }
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
    let (rows, long_run) = text
        .trim_end()
        .rsplit_once('\n')
        .context("the bench program said nothing")?;
    Ok((read_counts(rows)?, Spread::read(long_run, TICKS)?))
}

/// Traces `calls` calls of each of `rows`.
pub(crate) fn trace(
    elf: &Path,
    image: &Image,
    calls: u32,
    rows: &[String],
) -> Result<Vec<Vec<Call>>> {
    let mut command = machine(elf, calls, 0);
    // One instruction a block, and every block through the loop that logs the processor.
    command.args(["-singlestep", "-d", "cpu,nochain"]);
    // The same pipe under a name: the emulator's own standard error is not buffered, five times slower.
    command.args(["-D", "/dev/stderr"]);
    command.stdout(Stdio::null()).stderr(Stdio::piped());
    bounded(&mut command, |child| {
        trace::follow(BufReader::with_capacity(1 << 16, child), image, rows)
    })
}

fn machine(elf: &Path, calls: u32, ticks: u32) -> Command {
    let mut command = shell::command("qemu-system-arm");
    command
        .args([
            "-machine",
            "netduinoplus2",
            "-nographic",
            "-monitor",
            "none",
        ])
        .args(["-serial", "none", "-semihosting-config"])
        .arg(format!("enable=on,target=native,arg={calls},arg={ticks}"))
        .arg("-kernel")
        .arg(elf);
    command
}

/// Runs `command` for at most [`LIMIT`] while `read` reads what it was given as a pipe.
fn bounded<T: Send>(
    command: &mut Command,
    read: impl FnOnce(&mut (dyn Read + Send)) -> Result<T> + Send,
) -> Result<T> {
    let mut child = command
        .spawn()
        .with_context(|| format!("cannot start `{}`", shell::line(command)))?;
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
                bail!("the emulator gave no end within {} s", LIMIT.as_secs());
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
    let mut places = BTreeMap::new();
    for line in text.lines() {
        let (name, count) = line
            .split_once(' ')
            .and_then(|(name, count)| Some((name, count.parse::<u32>().ok()?)))
            .with_context(|| format!("the bench program said `{line}`"))?;
        let place = *places.entry(name.to_owned()).or_insert_with(|| {
            rows.push(Counts {
                name: name.to_owned(),
                calls: Vec::new(),
            });
            rows.len() - 1
        });
        rows[place].calls.push(count);
    }
    ensure!(
        rows.first().is_some_and(|row| row.name == EMPTY),
        "the bench program did not begin with row `{EMPTY}`"
    );
    let mut empty = rows[0].calls.iter();
    let first = empty.next();
    ensure!(
        empty.all(|count| Some(count) == first),
        "the empty row does not always cost the same: {:?}",
        rows[0].calls
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
        assert_eq!(rows[1].max(), 54);
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
