//! The measured rows beside the best anybody else has published, as a table and as JSON.

use std::fmt::Write as _;

use super::Row;
use super::budget::Budget;
use super::memory::Memory;

/// What a row is compared with.
struct Anchor {
    row: &'static str,
    /// What this project wants to reach: instructions, estimated cycles.
    reach: (Option<u32>, Option<u32>),
    /// The best peer, measured the same way: instructions, estimated cycles.
    peer: (u32, u32),
    who: &'static str,
}

const ANCHORS: [Anchor; 6] = [
    Anchor {
        row: "sin_cos",
        reach: (Some(40), None),
        peer: (152, 272),
        who: "newlib sinf + cosf",
    },
    Anchor {
        row: "rnea_ur5",
        reach: (Some(1000), Some(1700)),
        peer: (1790, 2908),
        who: "Pinocchio + CasADi, 60 run-time parameters, gcc -Ofast",
    },
    Anchor {
        row: "regressor_row_ur5",
        reach: (Some(500), None),
        peer: (2834, 4216),
        who: "Pinocchio + CasADi, all six rows",
    },
    Anchor {
        row: "regressor_ur5",
        reach: (Some(1800), None),
        peer: (2834, 4216),
        who: "Pinocchio + CasADi, 60 columns",
    },
    Anchor {
        row: "bp_18_32_6_forward",
        reach: (Some(2600), Some(4766)),
        peer: (3049, 6360),
        who: "CMSIS-DSP mat_vec_mult",
    },
    Anchor {
        row: "bp_18_32_6_update",
        reach: (Some(6500), Some(11635)),
        peer: (7926, 11635),
        who: "plain C, -O3 -ffast-math -funroll-loops",
    },
];

/// The table for the terminal.
pub(crate) fn table(rows: &[Row], memory: &Memory, budget: &Budget) -> String {
    let mut text = format!(
        "{:<20} {:>9} {:>7} {:>8} {:>9} {:>9} {:>6}  {:>7} {:>8}  {}\n",
        "row",
        "instr",
        "worst",
        "est.cyc",
        "est.flash",
        "stack B",
        "limit",
        "reach",
        "best peer",
        ""
    );
    for row in rows {
        let limit = budget.line(&row.instructions_quantity());
        let anchor = ANCHORS.iter().find(|anchor| anchor.row == row.name);
        let number = |value: Option<u64>| value.map_or("–".into(), |value| value.to_string());
        let _ = writeln!(
            text,
            "{:<20} {:>9.1} {:>7} {:>8.0} {:>9.0} {:>9} {:>6}  {:>7} {:>8}  {}",
            row.name,
            row.instructions,
            row.worst,
            row.cycles,
            row.flash_cycles,
            format!("{}/{}", row.stack_bytes, row.stack_seen),
            number(limit.map(|line| line.limit)),
            number(anchor.and_then(|a| a.reach.0).map(u64::from)),
            number(anchor.map(|a| u64::from(a.peer.0))),
            anchor.map_or("", |a| a.who),
        );
        if let Some(short) = anchor.and_then(|anchor| short_of(row, anchor)) {
            let _ = writeln!(text, "{:<20} {short}", "");
        }
    }
    let _ = writeln!(
        text,
        "instr: executed in the emulator, mean; est.cyc: estimate at zero wait states; est.flash: with a model of the \
         flash at 168 MHz;\nstack: bound from the code / deepest seen. Estimates of cycles are never measurements \
         on silicon.\n\nfirmware: {} B flash, {} B static RAM; worst stack of the tick {} B, of everything nested {} B",
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

/// How far a row is from what it should reach; nothing if it has arrived.
fn short_of(row: &Row, anchor: &Anchor) -> Option<String> {
    let gap = |value: f64, reach: Option<u32>, unit: &str| {
        let reach = f64::from(reach?);
        (value > reach).then(|| format!("{:.2} × the {reach:.0} {unit} to reach", value / reach))
    };
    let parts: Vec<_> = [
        gap(row.instructions, anchor.reach.0, "instructions"),
        gap(row.cycles, anchor.reach.1, "estimated cycles"),
    ]
    .into_iter()
    .flatten()
    .collect();
    (!parts.is_empty()).then(|| parts.join(", "))
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
pub(crate) fn json(toolchain: &str, rows: &[Row], memory: &Memory, budget: &Budget) -> String {
    let rows: Vec<_> = rows
        .iter()
        .map(|row| {
            let limit = budget.line(&row.instructions_quantity());
            format!(
                "    {{\"name\": \"{}\", \"instructions\": {:.1}, \"cycles_est\": {:.0}, \"limit_instructions\": {}}}",
                row.name,
                row.instructions,
                row.cycles,
                limit.map_or("null".into(), |line| line.limit.to_string())
            )
        })
        .collect();
    // The toolchain is rustc's own version line, without quotes or backslashes.
    format!(
        "{{\n  \"toolchain\": \"{toolchain}\",\n  \"rows\": [\n{}\n  ],\n  \"memory\": {{\"flash_bytes\": {}, \
         \"ram_bytes\": {}, \"stack_bytes\": {}}}\n}}\n",
        rows.join(",\n"),
        memory.flash_bytes,
        memory.ram_bytes,
        memory.stack_bytes
    )
}
