//! What the firmware costs: instructions, estimated cycles, flash, RAM and stack, against the committed budget.
//!
//! Two runs of one ELF in the emulator: one counts the instructions of every call, the other logs the processor before
//! each instruction. What was logged is decoded here and priced. The two must agree, call by call.

mod anchors;
mod budget;
mod calls;
mod cycles;
mod emulator;
mod gates;
mod image;
mod memory;
mod report;
mod rooms;
mod spread;
mod step;
mod thumb;
mod trace;

use std::fs;

use anyhow::{Context as _, Result, bail, ensure};

use budget::{Budget, Measured};
use emulator::Counts;
use image::Image;
use memory::Memory;
use spread::{PERMILLE_LIMIT, Spread};
use trace::Call;

use crate::setup::{self, Way};
use crate::shell;
use crate::toolchain::{Toolchain, elf};

/// Calls of each row that are counted, and that are traced: enough for every joint to have its turn.
const COUNTED: u32 = 96;
const TRACED: u32 = 13;

/// The firmware that drives its joint: a motor stage and an encoder more than `joint`.
const DRIVE: &str = "joint-drive";

/// Where the figures go, from the workspace's root.
const OUT: &str = "target/foretorque/bench.json";

/// One measured row.
pub(crate) struct Row {
    name: String,
    /// Mean over the counted calls.
    instructions: f64,
    /// Most in any counted call.
    worst: u32,
    /// Estimated cycles at zero wait states, mean.
    cycles: f64,
    /// The same with the flash model.
    flash_cycles: f64,
    /// Bound of the stack below the caller's, from the code.
    stack_bytes: u32,
    /// Deepest stack that was seen in a traced call.
    stack_seen: u32,
    /// Executed instructions by name over the traced calls, most frequent first.
    mix: Vec<(&'static str, u32)>,
}

impl Row {
    fn instructions_quantity(&self) -> String {
        format!("{}, instructions", self.name)
    }

    fn cycles_quantity(&self) -> String {
        format!("{}, est. cycles", self.name)
    }
}

/// Measures, prints the table, writes `bench.json`, and compares with the budget; `accept` writes the budget anew.
pub(crate) fn run(forced: Option<Way>, accept: bool) -> Result<()> {
    let tools = setup::run(forced)?;
    shell::run(
        tools
            .board
            .board_cargo("build")
            .args(["--bin", "bench", "--bin", "joint", "--bin", DRIVE]),
    )?;
    let toolchain = version(tools.board)?;
    let (rows, spread) = measure()?;
    let joint = Image::read(&elf("joint"))?;
    let seen = gates::check(&joint)?;
    let memory = Memory::of(&joint)?;
    let drive = firmware(DRIVE)?;

    let measured = quantities(&rows, &spread, &memory, &drive);
    let committed = Budget::read();
    let budget = if accept {
        let before = committed.unwrap_or_default();
        let after = before.accept(&toolchain, &measured)?;
        after.write()?;
        after
    } else {
        committed?
    };
    println!("\n{}", report::table(&rows, &memory, &budget));
    println!(
        "{DRIVE}: {} B flash, {} B static RAM; worst stack of the tick {} B\n",
        drive.flash_bytes, drive.ram_bytes, drive.stack_bytes
    );
    println!("{}", rooms::table(&joint));
    println!("{}\n", report::spread(&spread));
    println!("executed instructions by kind");
    for row in &rows {
        println!("{}", report::mix(row));
    }
    println!(
        "\ngates: no handler reaches a panic, software f64 or an allocator ({seen} functions seen)"
    );

    let out = shell::root().join(OUT);
    if let Some(parent) = out.parent() {
        fs::create_dir_all(parent)?;
    }
    fs::write(
        &out,
        report::json(&toolchain, &rows, &spread, &memory, &budget),
    )
    .with_context(|| format!("cannot write {}", out.display()))?;
    println!("figures: {OUT}");

    let verdict = budget.compare(&toolchain, &measured);
    for note in &verdict.notes {
        println!("budget: {note}");
    }
    for line in &verdict.exceeded {
        println!("budget: EXCEEDED: {line}");
    }
    if !verdict.exceeded.is_empty() {
        bail!("the budget of {} is not kept", budget::PAGE);
    }
    println!("budget: kept");
    Ok(())
}

/// The gates on the linked firmware, which must have been built: what its handlers reach, and that its RAM suffices. On the
/// board that drives its joint, too, whose tick does more.
pub(crate) fn check_firmware() -> Result<()> {
    ["joint", DRIVE]
        .into_iter()
        .try_for_each(|name| firmware(name).map(|_| ()))
}

/// What one firmware takes, after its gates.
fn firmware(name: &str) -> Result<Memory> {
    let image = Image::read(&elf(name)).with_context(|| format!("cannot read `{name}`"))?;
    let seen = gates::check(&image).with_context(|| format!("in `{name}`"))?;
    let memory = Memory::of(&image).with_context(|| format!("in `{name}`"))?;
    println!(
        "{name}: {seen} functions reachable from interrupts: no panic, no software f64, no allocator; stack bounded by {} B, \
         the tick's by {} B",
        memory.nested_bytes, memory.stack_bytes
    );
    Ok(memory)
}

/// The version line of the compiler that builds for the board.
fn version(toolchain: Toolchain) -> Result<String> {
    let line = shell::capture(toolchain.tool("rustc").arg("--version"));
    Ok(line.context("rustc names no version")?.trim().to_owned())
}

/// Counts and traces every row and lets the two runs judge each other; counts the long run.
fn measure() -> Result<(Vec<Row>, Spread)> {
    let path = elf("bench");
    let image = Image::read(&path)?;
    let (counts, spread) = emulator::count(&path, COUNTED)?;
    let names: Vec<String> = counts.iter().map(|row| row.name.clone()).collect();
    let traces = emulator::trace(&path, &image, TRACED, &names)?;
    let mut pairs = counts.iter().zip(&traces);
    // The first row returns at once: what it was counted beyond its own instructions is the bracket.
    let (empty, own) = pairs.next().context("the bench program has no rows")?;
    let own = own.first().context("the first row was not traced")?;
    let bracket = empty.max().saturating_sub(own.instructions);
    let rows = pairs
        .map(|(counts, calls)| row(&image, counts, calls, bracket))
        .collect::<Result<_>>()?;
    Ok((rows, spread.without(bracket)))
}

fn row(image: &Image, counts: &Counts, calls: &[Call], bracket: u32) -> Result<Row> {
    let name = &counts.name;
    let counted: Vec<u32> = counts
        .calls
        .iter()
        .map(|count| count.saturating_sub(bracket))
        .collect();
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
    let function = image
        .function(&format!("rows::{name}"))
        .context("a row without a function")?;
    let stack_bytes = memory::bounded_depth(image, function.code.start)?.bytes;
    let stack_seen = calls.iter().map(|call| call.stack_bytes).max().unwrap_or(0);
    ensure!(
        stack_seen <= stack_bytes,
        "`{name}` was seen {stack_seen} B deep, beyond its bound of {stack_bytes} B: the walk is wrong"
    );
    // The first call only fills the modelled caches.
    let steady = calls.get(1..).unwrap_or_default();
    let mean = |of: fn(&Call) -> u64| {
        steady.iter().map(of).sum::<u64>() as f64 / steady.len().max(1) as f64
    };
    let mut mix = std::collections::HashMap::new();
    for (name, count) in steady.iter().flat_map(|call| &call.mix) {
        *mix.entry(*name).or_insert(0) += count;
    }
    let mut mix: Vec<_> = mix.into_iter().collect();
    mix.sort_by_key(|&(name, count)| (std::cmp::Reverse(count), name));
    Ok(Row {
        name: name.clone(),
        instructions: counted.iter().map(|&n| f64::from(n)).sum::<f64>()
            / counted.len().max(1) as f64,
        worst: counted.iter().copied().max().unwrap_or(0),
        cycles: mean(|call| call.cycles.estimate),
        flash_cycles: mean(|call| call.cycles.flash),
        stack_bytes,
        stack_seen,
        mix,
    })
}

/// Everything that has a budget.
fn quantities(rows: &[Row], spread: &Spread, memory: &Memory, drive: &Memory) -> Vec<Measured> {
    let mut measured = Vec::new();
    let mut add = |quantity: String, value: u64, how| {
        measured.push(Measured {
            quantity,
            value,
            how,
            allowed: None,
        });
    };
    for row in rows {
        add(
            row.instructions_quantity(),
            row.instructions.ceil() as u64,
            "emulator, counted by TIM2 under -icount",
        );
        add(
            row.cycles_quantity(),
            row.cycles.ceil() as u64,
            "estimate over the traced instructions",
        );
    }
    for (name, bytes, how) in [
        ("flash", memory.flash_bytes, "sections of `joint`"),
        ("static RAM", memory.ram_bytes, "sections of `joint`"),
        (
            "stack of the tick",
            memory.stack_bytes,
            "bound from the code of `joint`, exception frame included",
        ),
        (
            "stack of everything nested",
            memory.nested_bytes,
            "bound from the code of `joint`: main and every handler",
        ),
    ] {
        add(format!("{name}, bytes"), u64::from(bytes), how);
    }
    add(
        format!("static RAM of {DRIVE}, bytes"),
        u64::from(drive.ram_bytes),
        "sections of `joint-drive`",
    );
    add(
        format!("stack of the tick of {DRIVE}, bytes"),
        u64::from(drive.stack_bytes),
        "bound from the code of `joint-drive`, exception frame included",
    );
    add(
        format!("flash of {DRIVE}, bytes"),
        u64::from(drive.flash_bytes),
        "sections of `joint-drive`",
    );
    measured.push(Measured {
        quantity: spread.quantity(),
        value: spread.permille(),
        how: "emulator, 100000 different ticks with the learner at work",
        allowed: Some(PERMILLE_LIMIT),
    });
    measured
}
