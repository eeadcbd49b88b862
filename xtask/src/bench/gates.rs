//! What must not be reachable from any interrupt of the flashable firmware: the linked ELF is judged, not the source.

use anyhow::{Result, bail, ensure};

use super::calls::Walk;
use super::image::Image;

/// A family of functions that no handler may reach.
struct Forbidden {
    what: &'static str,
    belongs: fn(&str) -> bool,
}

const FORBIDDEN: [Forbidden; 3] = [
    Forbidden {
        what: "a panic",
        belongs: is_panic,
    },
    Forbidden {
        what: "software f64",
        belongs: is_soft_double,
    },
    Forbidden {
        what: "an allocator",
        belongs: is_allocator,
    },
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
    const CONVERSIONS: [&str; 5] = [
        "__aeabi_f2d",
        "__aeabi_i2d",
        "__aeabi_ui2d",
        "__aeabi_l2d",
        "__aeabi_ul2d",
    ];
    let builtin = name.starts_with("__") && name.contains("df") && !name.contains("aeabi");
    name.starts_with("__aeabi_d")
        || name.starts_with("__aeabi_cd")
        || CONVERSIONS.contains(&name)
        || builtin
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

/// Every handler of `image` stays clear of what is forbidden; how many functions were seen.
pub(crate) fn check(image: &Image) -> Result<usize> {
    let entries: Vec<u32> = image
        .handlers()
        .iter()
        .map(|(_, function)| function.code.start)
        .collect();
    ensure!(!entries.is_empty(), "the firmware binds no interrupt");
    judge(image, &entries)
}

fn judge(image: &Image, entries: &[u32]) -> Result<usize> {
    let walk = Walk::from(image, entries);
    // A pointer may lead anywhere: what cannot be followed cannot be cleared.
    if let Some(doubt) = walk.doubts.first() {
        bail!("a handler cannot be judged: {doubt}");
    }
    for Forbidden { what, belongs } in &FORBIDDEN {
        if let Some(name) = walk.names().find(|name| belongs(name)) {
            let way = walk.way_to(name, entries).join(" → ");
            bail!("a handler can reach {what}: {way}");
        }
    }
    Ok(walk.names().count())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_forbidden_are_known_by_their_names() {
        for name in [
            "core::panicking::panic_fmt",
            "core::panicking::panic_bounds_check",
            "core::option::unwrap_failed",
            "core::slice::index::slice_end_index_len_fail",
            "__rustc::rust_begin_unwind",
        ] {
            assert!(is_panic(name), "{name}");
        }
        for name in [
            "__aeabi_dmul",
            "__aeabi_cdcmple",
            "__aeabi_f2d",
            "__adddf3",
            "__truncdfsf2",
            "__extendsfdf2",
        ] {
            assert!(is_soft_double(name), "{name}");
        }
        assert!(is_allocator("__rust_alloc"));
    }

    #[test]
    fn a_panic_behind_a_handler_is_refused_with_the_way_to_it() {
        const PANIC: u32 = 0x0800_1000;
        const HANDLER: u32 = 0x0800_1100;
        // push {r7, lr}; bl panic; udf
        let handler = [0xB580, 0xF7FF, 0xFF7D, 0xDE00];
        let image = Image::of_code(&[
            ("core::panicking::panic", PANIC, &[0xE7FE]),
            ("EXTI1", HANDLER, &handler),
        ]);
        let error = judge(&image, &[HANDLER]).unwrap_err().to_string();
        assert_eq!(
            error,
            "a handler can reach a panic: EXTI1 → core::panicking::panic"
        );
        let image = Image::of_code(&[("EXTI1", HANDLER, &[0x4770])]);
        assert_eq!(judge(&image, &[HANDLER]).unwrap(), 1);
    }

    #[test]
    fn the_harmless_pass() {
        for name in [
            "__aeabi_memcpy4",
            "__aeabi_uldivmod",
            "__udivmoddi4",
            "foretorque::dynamics::rnea::rnea",
            "EXTI1",
            "joint::app::app::main::__rtic_init_resources",
        ] {
            let families = FORBIDDEN.iter().filter(|family| (family.belongs)(name));
            assert_eq!(families.count(), 0, "{name}");
        }
    }
}
