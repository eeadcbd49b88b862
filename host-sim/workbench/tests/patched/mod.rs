//! A firmware with the code of some functions replaced: what hangs, and what stands in for parts the emulator lacks.

use elf::ElfBytes;
use elf::endian::LittleEndian;
use std::fs;
use std::path::{Path, PathBuf};

/// A copy of the firmware `elf`, called `name`, in which the one function whose symbol contains each `part` is `code`.
pub(crate) fn patched(elf: &Path, name: &str, patches: &[(&str, Vec<u16>)]) -> PathBuf {
    let mut bytes = fs::read(elf).expect("the firmware is built: `cargo firmware`");
    for (part, code) in patches {
        let code: Vec<u8> = code.iter().flat_map(|half| half.to_le_bytes()).collect();
        let (place, buffer) = function(&bytes, part);
        assert!(
            code.len() <= buffer,
            "{part} has {buffer} bytes, {} are needed",
            code.len()
        );
        bytes[place..place + code.len()].copy_from_slice(&code);
    }
    let file = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(name);
    fs::write(&file, bytes).expect("it can be written");
    file
}

/// Where the function is in the file, and its bytes.
fn function(bytes: &[u8], part: &str) -> (usize, usize) {
    let elf = ElfBytes::<LittleEndian>::minimal_parse(bytes).expect("it is an ELF");
    let (symbols, names) = elf
        .symbol_table()
        .expect("readable")
        .expect("it has symbols");
    let found: Vec<_> = symbols
        .iter()
        .filter(|entry| entry.st_symtype() == elf::abi::STT_FUNC)
        .filter(|entry| {
            names
                .get(entry.st_name as usize)
                .is_ok_and(|name| name.contains(part))
        })
        .collect();
    let [symbol] = found.as_slice() else {
        panic!("{} functions are called {part}", found.len());
    };
    // Bit 0 of the address of a function marks Thumb code.
    let address = symbol.st_value & !1;
    let section = elf
        .section_headers()
        .expect("it has sections")
        .get(usize::from(symbol.st_shndx))
        .expect("the function is in one");
    let place = (section.sh_offset + (address - section.sh_addr)) as usize;
    (place, symbol.st_size as usize)
}
