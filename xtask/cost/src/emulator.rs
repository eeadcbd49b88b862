//! Runs the bench ELF in the emulator, once to count and once to trace; the rows and the long run that it counts.

use std::io::BufReader;
use std::path::Path;
use std::process::{Command, ExitStatus, Stdio};

use anyhow::{Context as _, Result, ensure};

use crate::image::Image;
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

/// Counts the instructions of `calls` calls of every row, and of the ticks and the learning steps of the long run, exactly and
/// the same in every run.
pub(crate) fn count(elf: &Path, calls: u32) -> Result<(Vec<Counts>, [Spread; 2])> {
    let mut command = machine(elf, calls, TICKS);
    // One instruction is one nanosecond of virtual time, and TIM2 counts nanoseconds.
    command.args(["-icount", "shift=0,sleep=off"]);
    let output = command.stderr(Stdio::inherit()).output();
    let output = output.context(NOT_STARTED)?;
    succeeded(output.status)?;
    let text = String::from_utf8(output.stdout)?;
    let (text, learning) = last_spread(&text)?;
    let (rows, tick) = last_spread(text)?;
    Ok((read_counts(rows)?, [tick, learning]))
}

/// The lines before the last one of the long run, and that one.
fn last_spread(text: &str) -> Result<(&str, Spread)> {
    let lines = text.trim_end().rsplit_once('\n');
    let (before, line) = lines.context("the bench program printed nothing")?;
    Ok((before, Spread::read(line, TICKS)?))
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
    command
        .args(one_instruction_a_block()?)
        .args(["-d", "cpu,nochain"]);
    // The same pipe under a name: the emulator's own standard error is not buffered, five times slower.
    command.args(["-D", "/dev/stderr"]);
    command.stdout(Stdio::null()).stderr(Stdio::piped());
    let mut child = command.spawn().context(NOT_STARTED)?;
    let log = child.stderr.take().context("the emulator has no log")?;
    let calls = trace::follow(BufReader::with_capacity(1 << 16, log), image, &names);
    succeeded(child.wait()?)?;
    calls
}

/// Options for blocks of one instruction: QEMU 8.1 renamed them, QEMU 9 has the new ones alone.
fn one_instruction_a_block() -> Result<&'static [&'static str]> {
    let version = Command::new("qemu-system-arm").arg("--version").output();
    let version = String::from_utf8(version.context(NOT_STARTED)?.stdout)?;
    Ok(match is_renamed(&version) {
        true => &["-accel", "tcg,one-insn-per-tb=on"],
        false => &["-singlestep"],
    })
}

/// `QEMU emulator version 8.1.0 (…)` or newer.
fn is_renamed(version: &str) -> bool {
    let numbers = version
        .split_once("version ")
        .map(|(_, rest)| rest.split(['.', ' ']));
    let mut numbers = numbers
        .into_iter()
        .flatten()
        .map_while(|number| number.parse::<u32>().ok());
    (numbers.next(), numbers.next()) >= (Some(8), Some(1))
}

fn machine(elf: &Path, calls: u32, ticks: u32) -> Command {
    let line = format!(
        "{LIMIT} qemu-system-arm -machine netduinoplus2 -nographic -monitor none -serial none \
         -semihosting-config enable=on,target=native,arg={calls},arg={ticks} -kernel"
    );
    let mut command = Command::new("timeout");
    command.args(line.split(' ')).arg(elf).stdin(Stdio::null());
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

/// Ticks of the long run.
const TICKS: u32 = 100_000;

/// Largest distance of a tick from the mean, in thousandths of it: jitter of the tick is jitter of the torque.
pub(crate) const PERMILLE_LIMIT: u64 = 50;

/// Instructions of one row over many ticks.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Spread {
    pub(crate) row: String,
    pub(crate) ticks: u32,
    pub(crate) least: u32,
    pub(crate) mean: f64,
    pub(crate) most: u32,
}

impl Spread {
    /// From the line `name least sum most` over `ticks` ticks.
    fn read(line: &str, ticks: u32) -> Result<Self> {
        let read = || {
            let mut words = line.split(' ');
            let row = words.next()?.to_owned();
            let mut number = || words.next()?.parse::<u64>().ok();
            let (least, sum, most) = (number()?, number()?, number()?);
            Some(Self {
                row,
                ticks,
                least: u32::try_from(least).ok()?,
                mean: sum as f64 / f64::from(ticks),
                most: u32::try_from(most).ok()?,
            })
        };
        let spread = read().with_context(|| format!("no long run in `{line}`"))?;
        let range = f64::from(spread.least)..=f64::from(spread.most);
        ensure!(
            range.contains(&spread.mean),
            "the long run cannot be trusted: `{line}`"
        );
        Ok(spread)
    }

    /// Spread without the `bracket` that every count includes.
    pub(crate) fn without(self, bracket: u32) -> Self {
        Self {
            least: self.least.saturating_sub(bracket),
            mean: self.mean - f64::from(bracket),
            most: self.most.saturating_sub(bracket),
            ..self
        }
    }

    /// Largest distance from the mean, as a fraction of it.
    pub(crate) fn deviation(&self) -> f64 {
        (f64::from(self.most) - self.mean).max(self.mean - f64::from(self.least)) / self.mean
    }

    /// Largest distance from the mean in thousandths of it, rounded up.
    pub(crate) fn permille(&self) -> u64 {
        (1000.0 * self.deviation()).ceil() as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_options_of_the_emulator_follow_its_version() {
        let renamed = |version: &str| is_renamed(&format!("QEMU emulator version {version} (x)"));
        assert_eq!(["7.2.22", "8.0.5", ""].map(renamed), [false; 3]);
        assert_eq!(["8.1.0", "9.0.2", "10.1.50"].map(renamed), [true; 3]);
    }

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

    #[test]
    fn a_spread_is_the_larger_distance_from_the_mean() {
        let spread = |line| Spread::read(line, 10).unwrap();
        assert_eq!(spread("step 990 10100 1060").permille(), 50);
        assert_eq!(spread("step 990 10100 1060").without(10).mean, 1000.0);
        assert_eq!(spread("step 900 10000 1010").permille(), 100);
    }

    #[test]
    fn a_line_that_cannot_be_trusted_is_refused() {
        for line in [
            "step 990 9000 1060",
            "step 990 10100",
            "step x 10100 1060",
            "",
        ] {
            assert!(Spread::read(line, 10).is_err(), "{line:?}");
        }
    }
}
