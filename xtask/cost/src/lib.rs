//! Cost of the firmware: instructions, estimated cycles, flash, RAM and stack, against the committed budget.
//!
//! Two runs of one ELF in the emulator: one counts the instructions of every call, the other logs the processor before
//! each instruction. The log is decoded here and priced. The two must agree, call by call.

mod anchors;
mod budget;
mod calls;
mod cycles;
mod emulator;
mod gates;
mod image;
mod memory;
mod report;
mod row;
mod spread;
mod step;
mod thumb;
mod trace;

use std::fs;
use std::path::Path;

use anyhow::{Context as _, Result, bail};

use budget::{Budget, Measured};
use image::Image;
use memory::Memory;
use row::Row;
use spread::{PERMILLE_LIMIT, Spread};

/// The firmware with a budget.
pub const JOINT: &str = "joint";
/// The one that drives its joint: a motor stage and an encoder more.
pub const DRIVE: &str = "joint-drive";
/// The one on a drive bus: all codecs more.
pub const CAN: &str = "joint-can";

/// The row whose calls are commands of the link, and a tenth of a tick of 1 ms at 168 MHz, cycles.
const COMMAND: &str = "command";
const COMMAND_CYCLES: u64 = 16_800;

/// Place of the figures, from the workspace's root.
const OUT: &str = "target/foretorque/bench.json";

/// Measures the ELF files `bench`, `joint` and `joint-drive` in `elves`, prints the table, writes `bench.json` below `root`,
/// and compares with the budget; `accept` writes the budget anew.
///
/// `toolchain` is the version line of the compiler that built them.
pub fn bench(elves: &Path, root: &Path, toolchain: &str, accept: bool) -> Result<()> {
    let (rows, spread) = row::measure(&elves.join("bench"))?;
    let joint = Image::read(&elves.join(JOINT))?;
    let reached = gates::check(&joint)?;
    let memory = Memory::of(&joint)?;
    let drive = firmware(elves, DRIVE)?;
    let can = firmware(elves, CAN)?;

    let measured = quantities(&rows, &spread, &memory, &drive, &can);
    let mut budget = Budget::read(root);
    if accept {
        let accepted = budget.unwrap_or_default().accept(toolchain, &measured)?;
        accepted.write(root)?;
        budget = Ok(accepted);
    }
    let budget = budget?;
    println!("\n{}", report::table(&rows, &memory, &budget));
    println!(
        "{DRIVE}: {} B flash, {} B static RAM; worst stack of the tick {} B\n",
        drive.flash_bytes, drive.ram_bytes, drive.stack_bytes
    );
    println!("{}", memory::by_module_table(&joint));
    println!("{}\n", report::spread(&spread));
    println!("executed instructions by kind");
    for row in &rows {
        println!("{}", report::mix(row));
    }
    println!(
        "\ngates: no handler reaches a panic, software f64 or an allocator ({reached} functions seen)"
    );
    let out = root.join(OUT);
    if let Some(parent) = out.parent() {
        fs::create_dir_all(parent)?;
    }
    let json = report::json(toolchain, &rows, &spread, &memory, &budget);
    fs::write(&out, json).with_context(|| format!("cannot write {}", out.display()))?;
    println!("figures: {OUT}");

    let verdict = budget.compare(toolchain, &measured);
    for note in &verdict.notes {
        println!("budget: {note}");
    }
    for line in &verdict.exceeded {
        println!("budget: EXCEEDED: {line}");
    }
    if !verdict.exceeded.is_empty() {
        bail!("the budget of {} is exceeded", budget::PAGE);
    }
    println!("budget: kept");
    Ok(())
}

/// The gates on the linked firmware `names` in `elves`: no handler reaches a forbidden function, and the stack fits.
pub fn check_firmware(elves: &Path, names: &[&str]) -> Result<()> {
    let mut names = names.iter();
    names.try_for_each(|name| firmware(elves, name).map(|_| ()))
}

/// Bytes of flash and of static RAM of any firmware.
pub fn sizes(elf: &Path) -> Result<(u32, u32)> {
    let image = Image::read(elf)?;
    Ok((image.flash_bytes, image.ram_bytes))
}

/// Memory of one firmware, after its gates.
fn firmware(elves: &Path, name: &str) -> Result<Memory> {
    let check = || -> Result<_> {
        let image = Image::read(&elves.join(name))?;
        Ok((gates::check(&image)?, Memory::of(&image)?))
    };
    let (reached, memory) = check().with_context(|| format!("firmware `{name}`"))?;
    println!(
        "{name}: {reached} functions reachable from interrupts: no panic, no software f64, no allocator; stack bounded by \
         {} B, the tick's by {} B",
        memory.nested_bytes, memory.stack_bytes
    );
    Ok(memory)
}

/// Every quantity with a budget.
fn quantities(
    rows: &[Row],
    spread: &Spread,
    memory: &Memory,
    drive: &Memory,
    can: &Memory,
) -> Vec<Measured> {
    let measured = |quantity: String, value: u64, how: String| Measured {
        quantity,
        value,
        how,
        allowed: None,
    };
    let dearest = rows.iter().filter(|row| row.name == COMMAND);
    let dearest = dearest.map(|row| Measured {
        allowed: Some(COMMAND_CYCLES),
        ..measured(
            "dearest command, est. cycles".into(),
            row.worst_cycles,
            "estimate, the most of what an armed board takes: a tenth of 1 ms at 168 MHz".into(),
        )
    });
    let rows = rows.iter().flat_map(|row| {
        let [instructions, cycles] = row.quantities();
        let counted = row.instructions.ceil() as u64;
        let priced = row.cycles.ceil() as u64;
        [
            measured(
                instructions,
                counted,
                "emulator, counted by TIM2 under -icount".into(),
            ),
            measured(
                cycles,
                priced,
                "estimate over the traced instructions".into(),
            ),
        ]
    });
    let sections = |image| format!("sections of `{image}`");
    let bound = |image, what| format!("bound from the code of `{image}`{what}");
    let (tick, all) = (", exception frame included", ": main and every handler");
    let bytes = [
        ("flash", "", memory.flash_bytes, sections(JOINT)),
        ("static RAM", "", memory.ram_bytes, sections(JOINT)),
        (
            "stack of the tick",
            "",
            memory.stack_bytes,
            bound(JOINT, tick),
        ),
        (
            "stack of everything nested",
            "",
            memory.nested_bytes,
            bound(JOINT, all),
        ),
        ("static RAM", DRIVE, drive.ram_bytes, sections(DRIVE)),
        (
            "stack of the tick",
            DRIVE,
            drive.stack_bytes,
            bound(DRIVE, tick),
        ),
        ("flash", DRIVE, drive.flash_bytes, sections(DRIVE)),
        ("flash", CAN, can.flash_bytes, sections(CAN)),
        ("static RAM", CAN, can.ram_bytes, sections(CAN)),
        (
            "stack of everything nested",
            CAN,
            can.nested_bytes,
            bound(CAN, all),
        ),
    ];
    let bytes = bytes.map(|(what, image, bytes, how)| {
        let of = if image.is_empty() { "" } else { " of " };
        measured(format!("{what}{of}{image}, bytes"), bytes.into(), how)
    });
    let long_run = Measured {
        allowed: Some(PERMILLE_LIMIT),
        ..measured(
            format!("{}, permille off its mean", spread.row),
            spread.permille(),
            "emulator, 100000 different ticks with the learner at work".into(),
        )
    };
    rows.chain(dearest).chain(bytes).chain([long_run]).collect()
}
