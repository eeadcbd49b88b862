//! The measured rows beside the best published figures of others, as a table and as JSON.

use std::fmt::Write as _;

use crate::budget::{Budget, Line};
use crate::emulator::{PERMILLE_LIMIT, Spread};
use crate::firmware::Memory;
use crate::row::Row;

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
        "{} over {} different ticks, learning on: {} to {} instructions, mean {:.0}: within ± {:.1} % (± {} % allowed)",
        spread.row,
        spread.ticks,
        spread.least,
        spread.most,
        spread.mean,
        100.0 * spread.deviation(),
        PERMILLE_LIMIT / 10
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
