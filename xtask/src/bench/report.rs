//! The measured rows beside the best anybody else has published, as a table and as JSON.

use std::fmt::Write as _;

use super::Row;
use super::anchors;
use super::budget::Budget;
use super::memory::Memory;
use super::spread::{PERMILLE_LIMIT, Spread};

/// The table for the terminal.
pub(crate) fn table(rows: &[Row], memory: &Memory, budget: &Budget) -> String {
    let mut text = format!(
        "{:<20} {:>9} {:>7} {:>8} {:>9} {:>9} {:>6}  {:>11} {:>11}  {}\n",
        "row",
        "instr",
        "worst",
        "est.cyc",
        "est.flash",
        "stack B",
        "limit",
        "reach",
        "best peer",
        "who"
    );
    for row in rows {
        let (instructions, cycles) = (row.instructions_quantity(), row.cycles_quantity());
        let limit = budget.line(&instructions).map(|line| line.limit);
        let peers = [&instructions, &cycles].map(|quantity| anchors::peer(quantity));
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
            limit.map_or("–".into(), |limit| limit.to_string()),
            pair([&instructions, &cycles].map(|quantity| anchors::reach(quantity))),
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
         cycles. Estimates of cycles are never\nmeasurements on silicon.\n\nfirmware: {} B flash, {} B static RAM; worst stack of the tick {} B, of everything nested {} B",
        memory.flash_bytes, memory.ram_bytes, memory.stack_bytes, memory.nested_bytes
    );
    let path: Vec<_> = memory
        .deepest
        .path
        .iter()
        .map(|(name, bytes)| format!("{name} {bytes}"))
        .collect();
    let _ = writeln!(text, "deepest: {}", path.join(" → "));
    text
}

/// `instructions/cycles`, a dash for what nobody knows.
fn pair(figures: [Option<u32>; 2]) -> String {
    let [instructions, cycles] =
        figures.map(|figure| figure.map_or("–".into(), |f| f.to_string()));
    format!("{instructions}/{cycles}")
}

/// How far a row is from what it should reach; nothing if it has arrived.
fn short_of(row: &Row) -> Option<String> {
    let gap = |value: f64, quantity: &str, unit: &str| {
        let reach = f64::from(anchors::reach(quantity)?);
        (value > reach).then(|| format!("{:.2} × the {reach:.0} {unit} to reach", value / reach))
    };
    let parts: Vec<_> = [
        gap(
            row.instructions,
            &row.instructions_quantity(),
            "instructions",
        ),
        gap(row.cycles, &row.cycles_quantity(), "estimated cycles"),
    ]
    .into_iter()
    .flatten()
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
    let shares = row.mix.iter().take(12).map(|(name, count)| {
        let share = 100.0 * f64::from(*count) / f64::from(total.max(1));
        format!("{name} {share:.0}%")
    });
    format!("{:<20} {}", row.name, shares.collect::<Vec<_>>().join("  "))
}

/// `bench.json`.
pub(crate) fn json(
    toolchain: &str,
    rows: &[Row],
    spread: &Spread,
    memory: &Memory,
    budget: &Budget,
) -> String {
    let number = |value: Option<u64>| value.map_or("null".into(), |value| value.to_string());
    // Neither the anchors' names nor rustc's own version line have quotes or backslashes.
    let anchor = |quantity: &str| {
        let peer = anchors::peer(quantity);
        format!(
            "{{\"reach\": {}, \"peer\": {}, \"who\": {}}}",
            number(anchors::reach(quantity).map(u64::from)),
            number(peer.map(|peer| u64::from(peer.value))),
            peer.map_or("null".into(), |peer| format!("\"{}\"", peer.who))
        )
    };
    let rows: Vec<_> = rows
        .iter()
        .map(|row| {
            let limit = budget.line(&row.instructions_quantity());
            format!(
                "    {{\"name\": \"{}\", \"instructions\": {:.1}, \"cycles_est\": {:.0}, \
                 \"limit_instructions\": {},\n     \"anchor_instructions\": {},\n     \
                 \"anchor_cycles_est\": {}}}",
                row.name,
                row.instructions,
                row.cycles,
                number(limit.map(|line| line.limit)),
                anchor(&row.instructions_quantity()),
                anchor(&row.cycles_quantity())
            )
        })
        .collect();
    format!(
        "{{\n  \"toolchain\": \"{toolchain}\",\n  \"rows\": [\n{}\n  ],\n  \
         \"long_run\": {{\"name\": \"{}\", \"ticks\": {}, \"least\": {}, \"mean\": {:.1}, \"most\": {}}},\n  \
         \"memory\": {{\"flash_bytes\": {}, \"ram_bytes\": {}, \"stack_bytes\": {}}}\n}}\n",
        rows.join(",\n"),
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
