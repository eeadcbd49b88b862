//! Functions that no interrupt of the flashable firmware may reach, found in the linked ELF and not in the source.

use anyhow::{Result, bail, ensure};

use crate::calls::Walk;
use crate::image::Image;

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
    let handlers = image.handlers();
    let entries: Vec<u32> = handlers.iter().map(|(_, f)| f.code.start).collect();
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
            let path = walk.path_to(name, entries).join(" → ");
            bail!("a handler can reach {family}: {path}");
        }
    }
    Ok(walk.names().count())
}

#[cfg(test)]
mod tests {
    use super::*;

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
