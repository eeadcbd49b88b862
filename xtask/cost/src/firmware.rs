//! Flash, static RAM and the worst stack of a flashable firmware, and the functions that none of its interrupts may reach: from
//! its linked ELF alone.

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

/// Whether a function of this name belongs to a family.
type Belongs = fn(&str) -> bool;

/// Families of functions that no handler may reach.
const FORBIDDEN: [(&str, Belongs); 3] = [
    ("a panic", is_panic),
    ("software f64", is_soft_double),
    ("an allocator", is_allocator),
];

fn is_panic(name: &str) -> bool {
    const PARTS: [&str; 6] = [
        "core::panicking",
        "rust_begin_unwind",
        "panic_handler",
        "unwrap_failed",
        "expect_failed",
        "core::slice::index",
    ];
    PARTS.iter().any(|part| name.contains(part))
}

/// Names of the run-time ABI (ARM IHI 0043, section 5.1.2) and those of compiler-builtins.
fn is_soft_double(name: &str) -> bool {
    match name.strip_prefix("__aeabi_") {
        Some("f2d" | "i2d" | "ui2d" | "l2d" | "ul2d") => true,
        Some(rest) => rest.starts_with('d') || rest.starts_with("cd"),
        None => name.starts_with("__") && name.contains("df"),
    }
}

fn is_allocator(name: &str) -> bool {
    const PARTS: [&str; 5] = [
        "__rust_alloc",
        "__rust_realloc",
        "__rg_alloc",
        "alloc::alloc",
        "GlobalAlloc",
    ];
    PARTS.iter().any(|part| name.contains(part))
}

/// Fails if a handler of `image` can reach what is forbidden; returns the number of functions in reach.
pub(crate) fn check(image: &Image) -> Result<usize> {
    let entries: Vec<u32> = image.handlers().iter().map(|(_, f)| f.code.start).collect();
    ensure!(!entries.is_empty(), "the firmware binds no interrupt");
    reach(image, &entries)
}

fn reach(image: &Image, entries: &[u32]) -> Result<usize> {
    let walk = Walk::from(image, entries);
    // A pointer may lead anywhere: a handler that cannot be followed cannot be cleared.
    if let Some(unknown) = walk.unknowns.first() {
        bail!("a handler cannot be followed: {unknown}");
    }
    for (family, belongs) in FORBIDDEN {
        if let Some(name) = walk.names().find(|name| belongs(name)) {
            let path = walk.path_to(name).join(" → ");
            bail!("a handler can reach {family}: {path}");
        }
    }
    Ok(walk.names().count())
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

    #[test]
    fn functions_belong_to_a_family_by_their_names() {
        let families: [(&str, Belongs); 3] = [
            (
                "core::panicking::panic_fmt core::panicking::panic_bounds_check core::option::unwrap_failed \
                 core::slice::index::slice_end_index_len_fail __rustc::rust_begin_unwind",
                is_panic,
            ),
            (
                "__aeabi_dmul __aeabi_cdcmple __aeabi_f2d __adddf3 __truncdfsf2 __extendsfdf2",
                is_soft_double,
            ),
            ("__rust_alloc", is_allocator),
        ];
        for (names, belongs) in families {
            assert!(names.split(' ').all(belongs), "{names}");
        }
        let others = "__aeabi_memcpy4 __aeabi_uldivmod __udivmoddi4 EXTI1 foretorque::dynamics::rnea::rnea \
                      joint::app::app::main::__rtic_init_resources";
        for (_, belongs) in FORBIDDEN {
            assert!(!others.split(' ').any(belongs), "{others}");
        }
    }

    #[test]
    fn a_panic_behind_a_handler_is_refused_with_the_path_to_it() {
        const PANIC: u32 = 0x0800_1000;
        const HANDLER: u32 = 0x0800_1100;
        // push {r7, lr}; bl panic; udf
        let handler = [0xB580, 0xF7FF, 0xFF7D, 0xDE00];
        let image = Image::of_code(&[
            ("core::panicking::panic", PANIC, &[0xE7FE]),
            ("EXTI1", HANDLER, &handler),
        ]);
        let error = reach(&image, &[HANDLER]).unwrap_err().to_string();
        let message = "a handler can reach a panic: EXTI1 → core::panicking::panic";
        assert_eq!(error, message);
        let image = Image::of_code(&[("EXTI1", HANDLER, &[0x4770])]);
        assert_eq!(reach(&image, &[HANDLER]).unwrap(), 1);
    }
}
