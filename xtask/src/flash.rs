//! From the linked ELF to the board: images for any programmer, and the ELF itself through probe-rs.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail, ensure};
use crc::{CRC_32_ISO_HDLC, Crc};
use elf::ElfBytes;
use elf::abi::PT_LOAD;
use elf::endian::LittleEndian;
use ihex::Record;

use crate::setup::{self, Way};
use crate::shell::{self, capture, command, shown};

/// The flashable ELF that the demo emulated, kept beside its report for comparison with the one that is flashed.
pub(crate) const ELF_COPY: &str = "target/foretorque/demo/joint.elf";
/// Where the images go, from the workspace's root.
const OUT: &str = "target/foretorque/flash";
/// Name of the boards' chip for probe-rs.
const CHIP: &str = "STM32F405RGTx";
/// First byte of the flash.
const FLASH_START: u32 = 0x0800_0000;
/// Symbol of the words for length and checksum of the program, and their bytes (`foretorque_f405::image`).
const SEAL: &str = "FORETORQUE_SEAL";
const SEAL_BYTES: usize = 8;
const ERASED: u8 = 0xff;
/// Bytes of a line of Intel HEX.
const HEX_LINE: usize = 16;

/// Names of the boards that have a firmware here, and their binaries: ODrive v3 class; pyboard v1.1, the second one drives its
/// own joint, the third one is on the bus of CAN drives.
pub(crate) const BOARDS: [(&str, &str); 4] = [
    ("odrive", "joint"),
    ("pyboard", "joint-pyboard"),
    ("drive", "joint-drive"),
    ("can", "joint-can"),
];

/// Binary of the board of this name.
pub(crate) fn binary(board: &str) -> Result<&'static str, String> {
    let known = BOARDS.iter().find(|(name, _)| *name == board);
    let unknown = || format!("unknown board `{board}`: choose odrive, pyboard, drive or can");
    known.map(|(_, binary)| *binary).ok_or_else(unknown)
}

/// Sets up, builds the firmware as the demo does, writes its images, and unless `image_only` flashes the ELF.
///
/// * `binary` that of a board; the first board's by default
pub(crate) fn run(
    forced: Option<Way>,
    binary: Option<&'static str>,
    image_only: bool,
) -> Result<()> {
    let binary = binary.unwrap_or(BOARDS[0].1);
    let board = setup::run(forced)?.board;
    shell::run(&mut board.board_cargo(&format!("build --bin {binary}")))?;
    // The arm may be another one than that of the gates.
    foretorque_cost::check_firmware(&shell::elf_dir(), &[binary])?;
    let elf = shell::elf(binary);
    let bytes = shell::read(&elf)?;
    println!("ELF:  {} ({} bytes)", shown(&elf), bytes.len());
    let sealed_elf = write_images(&bytes, &shell::root().join(OUT).join(binary))?;
    if binary == BOARDS[0].1 {
        println!("demo: {}", compared(&bytes));
    }
    if image_only {
        return Ok(());
    }
    if capture(&mut command("probe-rs --version")).is_none() {
        bail!(
            "probe-rs is not installed (https://probe.rs/docs/getting-started/installation); use the \
             images above with any other programmer"
        );
    }
    let mut download = command(&format!("probe-rs download --chip {CHIP} --verify"));
    shell::run(download.arg(&sealed_elf))?;
    shell::run(&mut command(&format!("probe-rs reset --chip {CHIP}")))
}

/// Whether the ELF is byte for byte the one that the last demo emulated.
fn compared(bytes: &[u8]) -> String {
    match fs::read(shell::root().join(ELF_COPY)) {
        Ok(emulated) if emulated == bytes => {
            format!("the same bytes as {}, which it emulated", ELF_COPY)
        }
        Ok(_) => format!("other bytes than {}: the source has changed", ELF_COPY),
        Err(_) => "has not run here; `cargo xtask demo` emulates this very file".into(),
    }
}

/// Writes length and checksum of the program into an ELF file, and returns the program.
///
/// The board checks them at its start. One whose file has none starts too, and reports so.
fn seal(elf: &mut [u8]) -> Result<Vec<u8>> {
    let file = ElfBytes::minimal_parse(elf).context("the firmware is not an ELF file")?;
    let mut program = program(&file)?;
    let (place, offset) = places_of_seal(&file)?;
    let words = seal_of(&program, place)?;
    for (bytes, at) in [(&mut program[..], place), (elf, offset)] {
        let seal = bytes.get_mut(at..at + SEAL_BYTES);
        let seal = seal.context("the ELF file is too short")?;
        seal.copy_from_slice(&words);
    }
    Ok(program)
}

/// Places of the seal in the program and in the file.
fn places_of_seal(file: &ElfBytes<'_, LittleEndian>) -> Result<(usize, usize)> {
    let table = file.symbol_table()?;
    let (symbols, names) = table.context("the firmware has no symbols")?;
    let is_seal = |name: usize| names.get(name).is_ok_and(|name| name == SEAL);
    let symbol = symbols.iter().find(|it| is_seal(it.st_name as usize));
    let symbol = symbol.with_context(|| format!("the firmware has no {SEAL}"))?;
    let address = symbol.st_value;
    let segments = file.segments().context("the firmware is not linked")?;
    let holds = |start: u64, bytes: u64| (start..start + bytes).contains(&address);
    let segment = segments
        .iter()
        .find(|it| it.p_type == PT_LOAD && holds(it.p_vaddr, it.p_filesz));
    let segment = segment.with_context(|| format!("{SEAL} is not in the flash"))?;
    let offset = segment.p_offset + (address - segment.p_vaddr);
    let place = address.saturating_sub(FLASH_START.into());
    Ok((usize::try_from(place)?, usize::try_from(offset)?))
}

/// Length of the program and CRC-32 of it without the seal at `place`.
fn seal_of(program: &[u8], place: usize) -> Result<[u8; SEAL_BYTES]> {
    let outside = || format!("{SEAL} is not in the program");
    let before = program.get(..place).with_context(outside)?;
    let behind = program.get(place + SEAL_BYTES..).with_context(outside)?;
    let crc = Crc::<u32>::new(&CRC_32_ISO_HDLC);
    let mut digest = crc.digest();
    digest.update(before);
    digest.update(behind);
    let words = [u32::try_from(program.len())?, digest.finalize()];
    let mut seal = [0; SEAL_BYTES];
    seal.copy_from_slice(words.map(u32::to_le_bytes).as_flattened());
    Ok(seal)
}

/// The bytes for the flash from its start.
fn program(file: &ElfBytes<'_, LittleEndian>) -> Result<Vec<u8>> {
    let mut segments = Vec::new();
    for header in file.segments().context("the firmware is not linked")? {
        if header.p_type == PT_LOAD && header.p_filesz > 0 {
            // The address in the file of start values of variables is in flash; they are copied to RAM at boot.
            segments.push((u32::try_from(header.p_paddr)?, file.segment_data(&header)?));
        }
    }
    segments.sort_by_key(|(address, _)| *address);
    flat(&segments)
}

/// One block from the start of the flash; the space between two segments stays erased.
fn flat(segments: &[(u32, &[u8])]) -> Result<Vec<u8>> {
    let begins = segments.first().map(|(address, _)| *address);
    ensure!(
        begins == Some(FLASH_START),
        "the program does not begin with the flash"
    );
    let mut image = Vec::new();
    for (address, bytes) in segments {
        let place = (address - FLASH_START) as usize;
        ensure!(place >= image.len(), "two segments of the firmware overlap");
        image.resize(place, ERASED);
        image.extend_from_slice(bytes);
    }
    Ok(image)
}

/// Writes the program of the ELF file `elf` with its checksum to `place`.bin, .hex and .elf; returns the last.
pub(crate) fn write_images(elf: &[u8], place: &Path) -> Result<PathBuf> {
    let mut sealed = elf.to_vec();
    let program = seal(&mut sealed)?;
    let [bin, hex, elf] = ["bin", "hex", "elf"].map(|kind| place.with_extension(kind));
    shell::write(&bin, &program)?;
    shell::write(&hex, intel_hex(&program)?)?;
    shell::write(&elf, &sealed)?;
    println!("      {} (likewise, with its checksum)", shown(&elf));
    println!(
        "bin:  {} ({} bytes from {FLASH_START:#010x})",
        shown(&bin),
        program.len()
    );
    println!("hex:  {} (likewise)", shown(&hex));
    Ok(elf)
}

fn intel_hex(program: &[u8]) -> Result<String> {
    let mut records = Vec::new();
    for (line, address) in program
        .chunks(HEX_LINE)
        .zip((FLASH_START..).step_by(HEX_LINE))
    {
        if address & 0xffff == 0 {
            records.push(Record::ExtendedLinearAddress((address >> 16) as u16));
        }
        records.push(Record::Data {
            offset: address as u16,
            value: line.to_vec(),
        });
    }
    records.push(Record::EndOfFile);
    let text = ihex::create_object_file_representation(&records);
    Ok(text.context("a line of the HEX file is too long")? + "\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hex_holds_every_byte_at_its_address_across_the_64_k_lines() {
        let program: Vec<u8> = (0..70_001_u32).map(|k| (k * 7) as u8).collect();
        let text = intel_hex(&program).unwrap();
        assert!(text.starts_with(":020000040800F2\n"), "{}", &text[..40]);
        let (mut read, mut upper) = (Vec::new(), 0);
        for record in ihex::Reader::new(&text) {
            match record.unwrap() {
                Record::ExtendedLinearAddress(half) => upper = u32::from(half) << 16,
                Record::Data { offset, value } => {
                    read.extend((upper | u32::from(offset)..).zip(value));
                }
                _ => {}
            }
        }
        assert_eq!(read, (FLASH_START..).zip(program).collect::<Vec<_>>());
    }

    #[test]
    fn the_seal_covers_all_but_itself() {
        // The check value of this CRC, of the digits 1 to 9.
        let seal = [17, 0, 0, 0, 0x26, 0x39, 0xF4, 0xCB];
        for content in [0, 0xFF] {
            let mut program = b"1234\0\0\0\0\0\0\0\x0056789".to_vec();
            program[4..12].fill(content);
            assert_eq!(seal_of(&program, 4).unwrap(), seal);
        }
        assert!(seal_of(b"1234", 0).is_err());
    }

    #[test]
    fn the_flat_image_is_erased_between_segments() {
        let segments: [(u32, &[u8]); 2] = [(0x0800_0000, &[7; 100]), (0x0800_0065, &[1, 2])];
        assert_eq!(flat(&segments).unwrap()[99..], [7, ERASED, 1, 2]);
        assert!(flat(&segments[1..]).is_err() && flat(&[segments[1], segments[0]]).is_err());
        assert!(flat(&[segments[0], segments[0]]).is_err());
    }
}
