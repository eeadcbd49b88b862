//! Which room of the house takes how much of the flash, by the names of the functions in the linked ELF.
//!
//! What the compiler has inlined counts where it was inlined: the tick's interrupt has the decoder and the session's
//! commands in it, one joint's row of the regressor all six.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use super::image::Image;

/// What is no function: constants, vectors, start values.
const CONSTANTS: &str = "constants";

/// Bytes of each room, most first; together the bytes in flash.
pub(crate) fn by_room(image: &Image) -> Vec<(String, u32)> {
    let mut rooms = BTreeMap::new();
    let mut code = 0;
    for function in image.distinct_functions() {
        let bytes = function.code.end - function.code.start;
        code += bytes;
        *rooms.entry(room(&function.name)).or_insert(0) += bytes;
    }
    rooms.insert(CONSTANTS.to_owned(), image.flash_bytes.saturating_sub(code));
    let mut rooms: Vec<_> = rooms.into_iter().collect();
    rooms.sort_by_key(|(name, bytes)| (std::cmp::Reverse(*bytes), name.clone()));
    rooms
}

/// The lines for the terminal.
pub(crate) fn table(image: &Image) -> String {
    let mut text = String::from("flash by room, bytes\n");
    for (room, bytes) in by_room(image) {
        let _ = writeln!(text, "{room:<20} {bytes:>7}");
    }
    text
}

/// The room of a function: the module of the two libraries; the crate of anything else.
fn room(name: &str) -> String {
    const LIBRARIES: [(&str, &str); 2] = [("foretorque::", ""), ("foretorque_link::", "link::")];
    let found = LIBRARIES.iter().filter_map(|(library, prefix)| {
        let (before, path) = name.split_once(library)?;
        Some((before.len(), prefix, path))
    });
    if let Some((_, prefix, path)) = found.min() {
        let module = path.split("::").next().unwrap_or_default();
        return format!("{prefix}{module}");
    }
    let foreign = [
        ("serde", "serialisation"),
        ("postcard", "serialisation"),
        ("siphasher", "siphasher"),
        ("crc::", "crc"),
        ("nalgebra", "nalgebra"),
        ("defmt", "defmt"),
        ("compiler_builtins", "compiler"),
        ("core::", "core"),
    ];
    let found = foreign.iter().find(|(part, _)| name.contains(part));
    match found {
        Some((_, room)) => (*room).to_owned(),
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
    fn functions_are_counted_where_they_live_and_constants_are_the_rest() {
        let mut image = Image::of_code(&[
            ("foretorque_link::wire::codec::push", 0x0800_1000, &[0; 8]),
            ("foretorque::dynamics::rnea::rnea", 0x0800_1100, &[0; 4]),
            ("EXTI1", 0x0800_1200, &[0; 2]),
            (
                "<&mut postcard::ser::S as serde_core::ser::Serializer>::x",
                0x0800_1300,
                &[0; 1],
            ),
            ("__aeabi_memcpy", 0x0800_1400, &[0; 1]),
            ("memcpy", 0x0800_1400, &[0; 1]),
        ]);
        image.flash_bytes = 132;
        let rooms = by_room(&image);
        let expected = [
            ("constants", 100),
            ("link::wire", 16),
            ("dynamics", 8),
            ("bin", 4),
            ("compiler", 2),
            ("serialisation", 2),
        ];
        let expected = expected.map(|(room, bytes)| (room.to_owned(), bytes));
        assert_eq!(rooms, expected);
    }
}
