//! Cost of the firmware: instructions, estimated cycles, flash, RAM and stack, against the committed budget.
//!
//! Two runs of one ELF in the emulator: one counts the instructions of every call, the other logs the processor before
//! each instruction. The log is decoded here and priced. The two must agree, call by call.

mod budget;
mod calls;
mod emulator;
mod firmware;
mod image;
mod row;
mod thumb;
mod trace;

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};

use budget::{Budget, Measured};
use emulator::{PERMILLE_LIMIT, Spread};
use firmware::Memory;
use image::Image;
use row::Row;

/// The firmware with a budget.
pub const JOINT: &str = "joint";
/// The one that drives its joint: a motor stage and an encoder more.
pub const DRIVE: &str = "joint-drive";
/// The one on a drive bus: all codecs more.
pub const CAN: &str = "joint-can";

/// The program that measures rows.
const BENCH: &str = "bench";

/// The row whose calls are commands of the link, and a tenth of a tick of 1 ms at 168 MHz, cycles.
const COMMAND: &str = "command";
const COMMAND_CYCLES: u64 = 16_800;

/// Place of the figures, from the workspace's root.
const OUT: &str = "target/foretorque/bench.json";

/// Measures the ELF files `bench`, `joint`, `joint-drive` and `joint-can` in `elf_dir`, prints the table, writes `bench.json`
/// below `root`, and compares with the budget; `accept` writes the budget anew.
///
/// * `arms` numbers of joints of other arms, and directories with their `bench` and `joint`
/// * `toolchain` version line of the compiler that built them
pub fn bench(
    elf_dir: &Path,
    arms: &[(usize, PathBuf)],
    root: &Path,
    toolchain: &str,
    accept: bool,
) -> Result<()> {
    let (rows, spreads) = row::measure(&elf_dir.join(BENCH))?;
    let joint = Image::read(&elf_dir.join(JOINT))?;
    let reached = firmware::check(&joint)?;
    let memory = Memory::of(&joint)?;
    let drive = firmware(elf_dir, DRIVE)?;
    let can = firmware(elf_dir, CAN)?;

    let arms = arms.iter();
    let arms = arms.map(|(joints, elf_dir)| Arm::measure(*joints, elf_dir));
    let arms = arms.collect::<Result<Vec<_>>>()?;

    let images = [(JOINT, &memory), (DRIVE, &drive), (CAN, &can)];
    let measured = quantities(&rows, &spreads, &images, &arms);
    let mut budget = Budget::read(root)?;
    if accept {
        budget = budget.accept(toolchain, &measured)?;
        budget.write(root)?;
    }
    println!("\n{}", row::table(&rows, &memory, &budget));
    println!(
        "{DRIVE}: {} B flash, {} B static RAM; worst stack of the tick {} B\n",
        drive.flash_bytes, drive.ram_bytes, drive.stack_bytes
    );
    println!("{}", firmware::by_module_table(&joint));
    println!(
        "{}\n{}\n",
        row::spread(&spreads[0]),
        row::spread(&spreads[1])
    );
    println!(
        "gates: no handler reaches a panic, software f64 or an allocator ({reached} functions seen)"
    );
    let out = root.join(OUT);
    if let Some(parent) = out.parent() {
        fs::create_dir_all(parent)?;
    }
    let json = row::json(toolchain, &rows, &spreads[0], &memory, &budget);
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

/// The gates on the linked firmware `names` in `elf_dir`: no handler reaches a forbidden function, and the stack fits.
pub fn check_firmware(elf_dir: &Path, names: &[&str]) -> Result<()> {
    let mut names = names.iter();
    names.try_for_each(|name| firmware(elf_dir, name).map(|_| ()))
}

/// Check that the bench program in `elf_dir` has every row of the budget below `root`.
pub fn check_bench(elf_dir: &Path, root: &Path) -> Result<()> {
    let bench = Image::read(&elf_dir.join(BENCH))?;
    let budget = Budget::read(root)?;
    budget.rows().try_for_each(|row| bench.row(row).map(|_| ()))
}

/// Bytes of flash and of static RAM of any firmware.
pub fn sizes(elf: &Path) -> Result<(u32, u32)> {
    let image = Image::read(elf)?;
    Ok((image.flash_bytes, image.ram_bytes))
}

/// Memory of one firmware, after its gates.
fn firmware(elf_dir: &Path, name: &str) -> Result<Memory> {
    let check = || -> Result<_> {
        let image = Image::read(&elf_dir.join(name))?;
        Ok((firmware::check(&image)?, Memory::of(&image)?))
    };
    let (reached, memory) = check().with_context(|| format!("firmware `{name}`"))?;
    println!(
        "{name}: {reached} functions reachable from interrupts: no panic, no software f64, no allocator; stack bounded by \
         {} B, the tick's by {} B",
        memory.nested_bytes, memory.stack_bytes
    );
    Ok(memory)
}

/// Cost of an arm with another number of joints than the UR5.
struct Arm {
    joints: usize,
    /// Estimated cycles of a tick and of a learning step.
    cycles: [u64; 2],
    memory: Memory,
}

/// Rows of a tick and of a learning step.
const STEPS: [&str; 2] = ["feedforward_step", "learning_step"];

impl Arm {
    /// Measures the ELF files `bench` and `joint` in `elf_dir`.
    fn measure(joints: usize, elf_dir: &Path) -> Result<Self> {
        let (rows, _) = row::measure(&elf_dir.join(BENCH))?;
        let mut cycles = [0; 2];
        for (cycles, name) in cycles.iter_mut().zip(STEPS) {
            let row = rows.iter().find(|row| row.name == name);
            let row = row.with_context(|| format!("`bench` has no row `{name}`"))?;
            *cycles = row.cycles.ceil() as u64;
        }
        let memory = firmware(elf_dir, JOINT)?;
        Ok(Self {
            joints,
            cycles,
            memory,
        })
    }

    fn quantities(&self) -> Vec<Measured> {
        let of = format!(" of {} joints", self.joints);
        let [tick, learning] = self.cycles;
        let [tick_row, learning_row] = STEPS;
        let both = ("tick and learning step", tick + learning);
        let cycles = [(tick_row, tick), (learning_row, learning), both].map(|(what, value)| {
            measured(format!("{what}{of}, est. cycles"), value, TRACED.into())
        });
        let bytes = bytes(&of, JOINT, &self.memory);
        cycles.into_iter().chain(bytes).collect()
    }
}

/// Method of the long run, as the page has it.
const LONG_RUN: &str = "emulator, 100000 different ticks with the learner at work";
/// Means of estimated cycles.
const TRACED: &str = "estimate over the traced instructions";

fn measured(quantity: String, value: u64, how: String) -> Measured {
    Measured {
        quantity,
        value,
        how,
        allowed: None,
    }
}

/// Bytes of a firmware; `of` is the end of their names in the budget.
fn bytes(of: &str, image: &str, memory: &Memory) -> [Measured; 4] {
    let sections = format!("sections of `{image}`");
    let bound = format!("bound from the code of `{image}`");
    let tick = format!("{bound}, exception frame included");
    let nested = format!("{bound}: main and every handler");
    [
        ("flash", memory.flash_bytes, sections.clone()),
        ("static RAM", memory.ram_bytes, sections),
        ("stack of the tick", memory.stack_bytes, tick),
        ("stack of everything nested", memory.nested_bytes, nested),
    ]
    .map(|(what, bytes, how)| measured(format!("{what}{of}, bytes"), bytes.into(), how))
}

/// Every quantity with a budget.
fn quantities(
    rows: &[Row],
    [tick, learning]: &[Spread; 2],
    images: &[(&str, &Memory)],
    arms: &[Arm],
) -> Vec<Measured> {
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
        let how = "emulator, counted by TIM2 under -icount";
        [
            measured(instructions, counted, how.into()),
            measured(cycles, priced, TRACED.into()),
        ]
    });
    let images = images.iter().flat_map(|(image, memory)| {
        let of = match *image {
            JOINT => String::new(),
            other => format!(" of {other}"),
        };
        bytes(&of, image, memory)
    });
    let arms = arms.iter().flat_map(Arm::quantities);
    let long_run = Measured {
        allowed: Some(PERMILLE_LIMIT),
        ..measured(
            format!("{}, permille off its mean", tick.row),
            tick.permille(),
            LONG_RUN.into(),
        )
    };
    let dearest_step = measured(
        "dearest learning step".into(),
        learning.most.into(),
        format!("instructions, {LONG_RUN}"),
    );
    let all = rows.chain(dearest).chain(images).chain(arms);
    all.chain([long_run, dearest_step]).collect()
}
