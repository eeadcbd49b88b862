//! What the firmware costs.
mod cycles;
mod emulator;
mod image;
mod thumb;
mod trace;

use anyhow::Result;
use std::path::Path;

pub(crate) fn run() -> Result<()> {
    let elf = Path::new("target/thumbv7em-none-eabihf/firmware/bench");
    let image = image::Image::read(elf)?;
    let counts = emulator::count(elf, 64)?;
    let names: Vec<String> = counts.iter().map(|c| c.name.clone()).collect();
    let calls = emulator::trace(elf, &image, 8, &names)?;
    for (count, calls) in counts.iter().zip(&calls) {
        let matches = count.calls.iter().zip(calls).all(|(a, b)| *a == b.instructions);
        let steady = &calls[1..];
        let mean = |f: fn(&trace::Call) -> u64| steady.iter().map(f).sum::<u64>() as f64 / steady.len() as f64;
        println!(
            "{:<20} {:>9.1} {:>7} | {:>9.1} {:>9.1} {:>9.1} {:>9.1} stack {} agree {matches} {:?} {:?}",
            count.name, count.mean(), count.max(),
            mean(|c| c.cycles.low), mean(|c| c.cycles.estimate), mean(|c| c.cycles.high), mean(|c| c.cycles.flash),
            calls[0].stack_bytes, &count.calls[..8], calls.iter().map(|c|c.instructions).collect::<Vec<_>>()
        );
        let mut mix: Vec<_> = calls[1].mix.iter().collect();
        mix.sort_by_key(|(_, n)| std::cmp::Reverse(**n));
    }
    println!("{} {}", image.flash_bytes, image.ram_bytes);
    Ok(())
}
