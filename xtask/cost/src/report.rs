//! The measured rows beside the best published figures of others, as a table and as JSON.

use std::fmt::Write as _;

use crate::anchors::{peer, reach};
use crate::budget::Budget;
use crate::memory::Memory;
use crate::row::Row;
use crate::spread::{PERMILLE_LIMIT, Spread};

/// The table for the terminal.
pub(crate) fn table(rows: &[Row], memory: &Memory, budget: &Budget) -> String {
    let mut text = format!(
        "{:<20} {:>9} {:>7} {:>8} {:>9} {:>9} {:>6}  {:>11} {:>11}  who\n",
        "row", "instr", "worst", "est.cyc", "est.flash", "stack B", "limit", "reach", "best peer",
    );
    for row in rows {
        let quantities = row.quantities();
        let peers = quantities.each_ref().map(|quantity| peer(quantity));
        let mut who: Vec<_> = peers.iter().flatten().map(|peer| peer.who).collect();
        who.dedup();
        let _ = writeln!(
            text,
            "{:<20} {:>9.1} {:>7} {:>8.0} {:>9.0} {:>9} {:>6}  {:>11} {:>11}  {}",
            row.name,
            row.instructions,
            row.worst,
            row.cycles,
            row.flash_cycles,
            format!("{}/{}", row.stack_bytes, row.stack_seen),
            or(budget.line(&quantities[0]).map(|line| line.limit), "–"),
            pair(quantities.each_ref().map(|quantity| reach(quantity))),
            pair(peers.map(|peer| peer.map(|peer| peer.value))),
            who.join("; "),
        );
        if let Some(short) = short_of(row) {
            let _ = writeln!(text, "{:<20} {short}", "");
        }
    }
    let _ = writeln!(
        text,
        "instr: executed in the emulator, mean; est.cyc: estimate at zero wait states; est.flash: with a model of the \
         flash at 168 MHz;\nstack: bound from the code / deepest seen; reach, best peer: instructions/estimated \
         cycles. Estimates of cycles are never\nmeasurements on silicon.\n\nfirmware: {} B flash, {} B static RAM; worst \
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
fn pair([instructions, cycles]: [Option<u32>; 2]) -> String {
    format!("{}/{}", or(instructions, "–"), or(cycles, "–"))
}

/// Ratio of a row to its goals; nothing if it meets them.
fn short_of(row: &Row) -> Option<String> {
    let [instructions, cycles] = row.quantities();
    let parts: Vec<_> = [
        (row.instructions, reach(&instructions), "instructions"),
        (row.cycles, reach(&cycles), "estimated cycles"),
    ]
    .into_iter()
    .filter_map(|(value, reach, unit)| {
        let ratio = value / f64::from(reach?);
        (ratio > 1.0).then(|| format!("{ratio:.2} × the {} {unit} to reach", or(reach, "")))
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

/// The instructions a row executes most, as shares.
pub(crate) fn mix(row: &Row) -> String {
    let total: u32 = row.mix.iter().map(|(_, count)| count).sum();
    let mut text = format!("{:<20}", row.name);
    for (place, (name, count)) in row.mix.iter().take(12).enumerate() {
        let share = 100.0 * f64::from(*count) / f64::from(total.max(1));
        let space = if place == 0 { " " } else { "  " };
        let _ = write!(text, "{space}{name} {share:.0}%");
    }
    text
}

/// `bench.json`. Neither the anchors' names nor rustc's version line have quotes or backslashes.
pub(crate) fn json(
    toolchain: &str,
    rows: &[Row],
    spread: &Spread,
    memory: &Memory,
    budget: &Budget,
) -> String {
    let anchor = |quantity: &str| {
        let peer = peer(quantity);
        format!(
            "{{\"reach\": {}, \"peer\": {}, \"who\": {}}}",
            or(reach(quantity), "null"),
            or(peer.map(|peer| peer.value), "null"),
            or(peer.map(|peer| format!("\"{}\"", peer.who)), "null")
        )
    };
    let rows = rows.iter().map(|row| {
        let [instructions, cycles] = row.quantities();
        format!(
            "    {{\"name\": \"{}\", \"instructions\": {:.1}, \"cycles_est\": {:.0}, \"limit_instructions\": {},\n     \
             \"anchor_instructions\": {},\n     \"anchor_cycles_est\": {}}}",
            row.name,
            row.instructions,
            row.cycles,
            or(budget.line(&instructions).map(|line| line.limit), "null"),
            anchor(&instructions),
            anchor(&cycles)
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
