//! Flash, static RAM and the worst stack of a flashable firmware, from its linked ELF alone.

use crate::calls::{Depth, Walk};
use crate::image::Image;
use anyhow::{Context as _, Result, bail, ensure};
use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// The interrupt of the tick.
const TICK: &str = "EXTI1";

/// Set-up of RTIC: `main` masks all interrupts before it, and it unmasks them as its last step (rtic-macros 2.4,
/// codegen/main.rs). Critical sections in it restore the mask they found.
const SET_UP: &str = "__rtic_init_resources";

/// Bytes that the core pushes for an exception: 26 words with the float registers, and one to align
/// (DDI 0403E.e, B1.5.7).
const EXCEPTION_FRAME: u32 = 4 * (26 + 1);

/// Bytes of the firmware.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Memory {
    /// Code, constants and start values.
    pub(crate) flash_bytes: u32,
    /// Static variables.
    pub(crate) ram_bytes: u32,
    /// Bound of the tick's stack, its exception frame included.
    pub(crate) stack_bytes: u32,
    /// Bound of the whole stack: the main program and one of every handler on top of each other; the set-up, which no
    /// handler interrupts, by itself.
    pub(crate) nested_bytes: u32,
    /// Deepest calls of the tick.
    pub(crate) deepest: Depth,
}

impl Memory {
    pub(crate) fn of(image: &Image) -> Result<Self> {
        let tick = image
            .function(TICK)
            .with_context(|| format!("the firmware has no function `{TICK}` for the tick"))?;
        let deepest = bounded_depth(image, tick.code.start)?;
        let main = image
            .function("main")
            .context("there is no main")?
            .code
            .start;
        let start = bounded_depth(image, main)?;
        // Handlers wait until the end of the set-up, when only its own frame is left of it.
        let mut running = Walk::from(image, &[main]);
        running.leave_out_calls_of(SET_UP);
        let mut nested_bytes = running.depth(main).bytes;
        for (_, handler) in image.handlers() {
            nested_bytes += EXCEPTION_FRAME + bounded_depth(image, handler.code.start)?.bytes;
        }
        let nested_bytes = nested_bytes.max(start.bytes);
        // The linker checks that the variables fit beside the stack.
        let limit = image.stack_limit;
        ensure!(
            nested_bytes <= limit,
            "the stack may need {nested_bytes} bytes and has {limit}"
        );
        Ok(Self {
            flash_bytes: image.flash_bytes,
            ram_bytes: image.ram_bytes,
            stack_bytes: EXCEPTION_FRAME + deepest.bytes,
            nested_bytes,
            deepest,
        })
    }
}

/// The deepest stack from `entry` on; an error if the code does not fix it.
pub(crate) fn bounded_depth(image: &Image, entry: u32) -> Result<Depth> {
    let mut walk = Walk::from(image, &[entry]);
    let depth = walk.depth(entry);
    if let Some(unknown) = walk.unknowns.first() {
        bail!("the stack is not bounded: {unknown}");
    }
    Ok(depth)
}

/// Bytes of each module, most first, as lines for the terminal; together the bytes in flash.
pub(crate) fn by_module_table(image: &Image) -> String {
    let mut text = String::from("flash by module, bytes\n");
    for (module, bytes) in by_module(image) {
        let _ = writeln!(text, "{module:<20} {bytes:>7}");
    }
    text
}

fn by_module(image: &Image) -> Vec<(String, u32)> {
    let mut modules = BTreeMap::<String, u32>::new();
    for function in image.distinct_functions() {
        *modules.entry(module(&function.name)).or_default() += function.code.len() as u32;
    }
    // The rest is no function: constants, vectors, start values.
    let code: u32 = modules.values().sum();
    modules.insert("constants".into(), image.flash_bytes.saturating_sub(code));
    let mut modules: Vec<_> = modules.into_iter().collect();
    modules.sort_by_key(|(_, bytes)| Reverse(*bytes));
    modules
}

/// The module of a library's function, the crate of any other function.
fn module(name: &str) -> String {
    const LIBRARIES: [(&str, &str); 2] = [("foretorque::", ""), ("foretorque_link::", "link::")];
    let found = LIBRARIES.iter().filter_map(|(library, shown)| {
        let (before, path) = name.split_once(library)?;
        Some((before.len(), shown, path))
    });
    // The first name is the function's own, others are types it is made for.
    if let Some((_, shown, path)) = found.min() {
        return format!("{shown}{}", path.split("::").next().unwrap_or_default());
    }
    let foreign = [
        ("serde", "serialisation"),
        ("postcard", "serialisation"),
        ("siphasher", "siphasher"),
        ("crc::", "crc"),
        ("nalgebra", "nalgebra"),
        ("libm::", "libm"),
        ("defmt", "defmt"),
        ("compiler_builtins", "compiler"),
        ("core::", "core"),
    ];
    match foreign.iter().find(|(part, _)| name.contains(part)) {
        Some((_, shown)) => (*shown).to_owned(),
        // Memory and integer routines of the run-time ABI.
        None if name.starts_with("__") || name.starts_with("mem") => "compiler".to_owned(),
        // Handlers and the modules of the binary.
        None => "bin".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn functions_are_counted_in_their_modules_and_constants_are_the_rest() {
        let serializer = "<&mut postcard::ser::S as serde_core::ser::Serializer>::x";
        let mut image = Image::of_code(&[
            ("foretorque::dynamics::rnea::rnea", 0x0800_1100, &[0; 4]),
            ("EXTI1", 0x0800_1200, &[0; 2]),
            (serializer, 0x0800_1300, &[0; 1]),
            ("__aeabi_memcpy", 0x0800_1400, &[0; 1]),
            ("memcpy", 0x0800_1400, &[0; 1]),
            ("foretorque_link::wire::push", 0x0800_1500, &[0; 8]),
        ]);
        image.flash_bytes = 132;
        let expected = [
            ("constants", 100),
            ("link::wire", 16),
            ("dynamics", 8),
            ("bin", 4),
            ("compiler", 2),
            ("serialisation", 2),
        ];
        let expected = expected.map(|(module, bytes)| (module.to_owned(), bytes));
        assert_eq!(by_module(&image), expected);
    }
}
