//! The measured rows: two runs of one ELF, counted and traced, that must agree call by call. As a table beside the best published
//! figures of others, and as JSON.

use std::fmt::Write as _;
use std::path::Path;

use anyhow::{Context as _, Result, ensure};

use crate::budget::{Budget, Line};
use crate::emulator::{self, Counts, Spread};
use crate::firmware::{self, Memory};
use crate::image::Image;
use crate::trace::Call;

/// Calls of each row that are counted, and that are traced: enough for the turn of every joint.
const COUNTED: u32 = 96;
const TRACED: u32 = 13;

pub(crate) struct Row {
    pub(crate) name: String,
    /// Mean over the counted calls.
    pub(crate) instructions: f64,
    /// Most in any counted call.
    pub(crate) worst: u32,
    /// Estimated cycles at zero wait states, mean.
    pub(crate) cycles: f64,
    /// Most estimated cycles in any traced call.
    pub(crate) worst_cycles: u64,
    /// Bound of the stack below the caller's, from the code.
    pub(crate) stack_bytes: u32,
    /// Deepest stack in a traced call.
    pub(crate) stack_seen: u32,
}

impl Row {
    /// Names of instructions and cycles in the budget.
    pub(crate) fn quantities(&self) -> [String; 2] {
        ["instructions", "est. cycles"].map(|unit| format!("{}, {unit}", self.name))
    }

    fn new(image: &Image, counts: &Counts, calls: &[Call], bracket: u32) -> Result<Self> {
        let name = &counts.name;
        let counted = counts.calls.iter();
        let counted: Vec<u32> = counted.map(|n| n.saturating_sub(bracket)).collect();
        ensure!(
            calls.len() == TRACED as usize,
            "`{name}` was traced {} times",
            calls.len()
        );
        for (number, (counted, traced)) in counted.iter().zip(calls).enumerate() {
            ensure!(
                *counted == traced.instructions,
                "call {number} of `{name}`: {counted} instructions counted and {} traced",
                traced.instructions
            );
        }
        let stack_bytes = firmware::bounded_depth(image, image.row(name)?.code.start)?.bytes;
        let stack_seen = calls.iter().map(|call| call.stack_bytes).max().unwrap_or(0);
        ensure!(
            stack_seen <= stack_bytes,
            "`{name}` was seen {stack_seen} B deep, beyond its bound of {stack_bytes} B: the walk is wrong"
        );
        // The budget's means leave the first call out.
        let steady = calls.get(1..).unwrap_or_default();
        let cycles: u64 = steady.iter().map(|call| call.cycles).sum();
        let sum: f64 = counted.iter().map(|&n| f64::from(n)).sum();
        Ok(Self {
            name: name.clone(),
            instructions: sum / counted.len().max(1) as f64,
            worst: counted.iter().copied().max().unwrap_or(0),
            cycles: cycles as f64 / steady.len().max(1) as f64,
            worst_cycles: calls.iter().map(|call| call.cycles).max().unwrap_or(0),
            stack_bytes,
            stack_seen,
        })
    }
}

/// Counts and traces every row, compares both runs, and counts the long run.
pub(crate) fn measure(path: &Path) -> Result<(Vec<Row>, [Spread; 2])> {
    let image = Image::read(path)?;
    let (counts, spreads) = emulator::count(path, COUNTED)?;
    let traces = emulator::trace(path, &image, TRACED, &counts)?;
    let mut pairs = counts.iter().zip(&traces);
    // The first row returns at once: its count beyond its own instructions is the bracket.
    let (empty, own) = pairs.next().context("the bench program has no rows")?;
    let own = own.first().context("the first row was not traced")?;
    let most = empty.calls.iter().copied().max().unwrap_or(0);
    let bracket = most.saturating_sub(own.instructions);
    let rows = pairs.map(|(counts, calls)| Row::new(&image, counts, calls, bracket));
    let spreads = spreads.map(|spread| spread.without(bracket));
    Ok((rows.collect::<Result<_>>()?, spreads))
}

/// The table for the terminal.
pub(crate) fn table(rows: &[Row], memory: &Memory, budget: &Budget) -> String {
    let mut text = format!(
        "{:<20} {:>9} {:>7} {:>8} {:>9} {:>6}  {:>11} {:>11}  who\n",
        "row", "instr", "worst", "est.cyc", "stack B", "limit", "reach", "best peer",
    );
    for row in rows {
        let lines = row.quantities().map(|quantity| budget.line(&quantity));
        let who = lines.iter().flatten().map(|line| line.who.as_str());
        let mut who: Vec<_> = who.filter(|who| !who.is_empty()).collect();
        who.dedup();
        let _ = writeln!(
            text,
            "{:<20} {:>9.1} {:>7} {:>8.0} {:>9} {:>6}  {:>11} {:>11}  {}",
            row.name,
            row.instructions,
            row.worst,
            row.cycles,
            format!("{}/{}", row.stack_bytes, row.stack_seen),
            or(lines[0].map(|line| line.limit), "–"),
            pair(lines.map(|line| line?.reach)),
            pair(lines.map(|line| line?.peer)),
            who.join("; "),
        );
        if let Some(short) = short_of(row, lines) {
            let _ = writeln!(text, "{:<20} {short}", "");
        }
    }
    let _ = writeln!(
        text,
        "instr: executed in the emulator, mean; est.cyc: estimate at zero wait states;\nstack: bound from the code \
         / deepest seen; reach, best peer: instructions/estimated cycles. Estimates of cycles are never\nmeasurements on \
         silicon.\n\nfirmware: {} B flash, {} B static RAM; worst \
         stack of the tick {} B, of everything nested {} B",
        memory.flash_bytes, memory.ram_bytes, memory.stack_bytes, memory.nested_bytes
    );
    let path = memory.deepest.path.iter();
    let path: Vec<_> = path
        .map(|(name, bytes)| format!("{name} {bytes}"))
        .collect();
    let _ = writeln!(text, "deepest: {}", path.join(" → "));
    text
}

fn or<T: ToString>(value: Option<T>, absent: &str) -> String {
    value.map_or(absent.into(), |value| value.to_string())
}

/// `instructions/cycles`, a dash for an unknown one.
fn pair([instructions, cycles]: [Option<u64>; 2]) -> String {
    format!("{}/{}", or(instructions, "–"), or(cycles, "–"))
}

/// Ratio of a row to its goals; nothing if it meets them.
fn short_of(row: &Row, [instructions, cycles]: [Option<&Line>; 2]) -> Option<String> {
    let parts: Vec<_> = [
        (row.instructions, instructions, "instructions"),
        (row.cycles, cycles, "estimated cycles"),
    ]
    .into_iter()
    .filter_map(|(value, line, unit)| {
        let reach = line?.reach?;
        let ratio = value / reach as f64;
        (ratio > 1.0).then(|| format!("{ratio:.2} × the {reach} {unit} to reach"))
    })
    .collect();
    (!parts.is_empty()).then(|| parts.join(", "))
}

/// The long run in one line.
pub(crate) fn spread(spread: &Spread) -> String {
    format!(
        "{} over {} different ticks, learning on: {} to {} instructions, mean {:.0}: within ± {:.1} %",
        spread.row,
        spread.ticks,
        spread.least,
        spread.most,
        spread.mean,
        100.0 * spread.deviation(),
    )
}

/// `bench.json`. Rustc's version line has no quotes or backslashes; goals and peers are in the budget.
pub(crate) fn json(
    toolchain: &str,
    rows: &[Row],
    spread: &Spread,
    memory: &Memory,
    budget: &Budget,
) -> String {
    let rows = rows.iter().map(|row| {
        let [instructions, _] = row.quantities();
        let line = budget.line(&instructions);
        format!(
            "    {{\"name\": \"{}\", \"instructions\": {:.1}, \"cycles_est\": {:.0}, \"limit_instructions\": {}}}",
            row.name,
            row.instructions,
            row.cycles,
            or(line.map(|line| line.limit), "null")
        )
    });
    format!(
        "{{\n  \"toolchain\": \"{toolchain}\",\n  \"rows\": [\n{}\n  ],\n  \
         \"long_run\": {{\"name\": \"{}\", \"ticks\": {}, \"least\": {}, \"mean\": {:.1}, \"most\": {}}},\n  \
         \"memory\": {{\"flash_bytes\": {}, \"ram_bytes\": {}, \"stack_bytes\": {}}}\n}}\n",
        rows.collect::<Vec<_>>().join(",\n"),
        spread.row,
        spread.ticks,
        spread.least,
        spread.mean,
        spread.most,
        memory.flash_bytes,
        memory.ram_bytes,
        memory.stack_bytes
    )
}
