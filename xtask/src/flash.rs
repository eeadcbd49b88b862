//! From the linked ELF to the board: images for any programmer, and the ELF itself through probe-rs.

use std::fs;
use std::path::PathBuf;

use anyhow::{Context as _, Result, bail, ensure};
use crc::{CRC_32_ISO_HDLC, Crc};
use elf::ElfBytes;
use elf::abi::PT_LOAD;
use elf::endian::LittleEndian;
use ihex::Record;

use crate::runs::ELF_COPY;
use crate::setup::{self, Way};
use crate::shell::{self, capture, command, shown};
use crate::toolchain;

/// Where the images go, from the workspace's root.
const OUT: &str = "target/foretorque/flash";
/// Name of the boards' chip for probe-rs.
const CHIP: &str = "STM32F405RGTx";
/// First byte of the flash.
const FLASH_START: u32 = 0x0800_0000;
/// Symbol of the words for length and checksum of the program, and their bytes (`foretorque_f405::image`).
const SEAL: &str = "FORETORQUE_SEAL";
const SEAL_BYTES: usize = 8;
/// Value of an erased byte of flash.
const ERASED: u8 = 0xff;
/// Bytes of a line of Intel HEX.
const HEX_LINE: usize = 16;

/// Names of the boards that have a firmware here, and their binaries: ODrive v3 class; pyboard v1.1, the second one drives its
/// own joint, the third one is on the bus of CAN drives.
const BOARDS: [(&str, &str); 4] = [
    ("odrive", "joint"),
    ("pyboard", "joint-pyboard"),
    ("drive", "joint-drive"),
    ("can", "joint-can"),
];

/// Binary of a board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Board(&'static str);

impl Default for Board {
    fn default() -> Self {
        Self(BOARDS[0].1)
    }
}

impl std::str::FromStr for Board {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let known = BOARDS.iter().find(|(name, _)| *name == text);
        let unknown = || format!("unknown board `{text}`: choose odrive, pyboard, drive or can");
        known.map(|(_, binary)| Self(binary)).ok_or_else(unknown)
    }
}

/// Sets up, builds the firmware as the demo does, writes its images, and unless `image_only` flashes the ELF.
pub(crate) fn run(forced: Option<Way>, board: Board, image_only: bool) -> Result<()> {
    let tools = setup::run(forced)?;
    let mut firmware = tools.board.board_cargo("build");
    shell::run(firmware.args(["--bin", board.0]))?;
    let elf = toolchain::elf(board.0);
    let bytes = shell::read(&elf)?;
    let mut sealed = bytes.clone();
    seal(&mut sealed)?;
    write_images(&loadable(&sealed)?, board.0)?;
    let sealed_elf = image(board.0, "elf");
    shell::write(&sealed_elf, &sealed)?;
    println!("ELF:  {} ({} bytes)", shown(&elf), bytes.len());
    println!("      {} (likewise, with its checksum)", shown(&sealed_elf));
    if board == Board::default() {
        println!("demo: {}", compared(&bytes));
    }
    if image_only {
        return Ok(());
    }
    if capture(command("probe-rs").arg("--version")).is_none() {
        bail!(
            "probe-rs is not installed (https://probe.rs/docs/getting-started/installation); use the \
             images above with any other programmer"
        );
    }
    let mut download = command("probe-rs");
    download.args(["download", "--chip", CHIP, "--verify"]);
    shell::run(download.arg(&sealed_elf))?;
    shell::run(command("probe-rs").args(["reset", "--chip", CHIP]))
}

/// Whether the ELF is byte for byte the one that the last demo emulated.
fn compared(bytes: &[u8]) -> String {
    let copy = shell::root().join(ELF_COPY);
    match fs::read(copy) {
        Ok(emulated) if emulated == bytes => {
            format!("the same bytes as {}, which it emulated", ELF_COPY)
        }
        Ok(_) => format!("other bytes than {}: the source has changed", ELF_COPY),
        Err(_) => "has not run here; `cargo xtask demo` emulates this very file".into(),
    }
}

/// Writes length and checksum of the program into an ELF file.
///
/// The board checks them at its start. One whose file has none starts too, and reports so.
fn seal(elf: &mut [u8]) -> Result<()> {
    let program = loadable(elf)?;
    let base = program.first().map_or(0, |(address, _)| *address);
    ensure!(
        base == FLASH_START,
        "the program does not begin with the flash"
    );
    let (address, offset) = place_of_seal(elf)?;
    let words = seal_of(&flat(&program), (address - base) as usize)?;
    let place = elf.get_mut(offset..offset + SEAL_BYTES);
    place
        .context("the ELF file is too short")?
        .copy_from_slice(&words);
    Ok(())
}

/// Address of the seal, and its place in the file.
fn place_of_seal(elf: &[u8]) -> Result<(u32, usize)> {
    let file = ElfBytes::<LittleEndian>::minimal_parse(elf)?;
    let table = file
        .symbol_table()?
        .context("the firmware has no symbols")?;
    let (symbols, names) = table;
    let mut symbols = symbols.iter();
    let symbol = symbols.find(|symbol| {
        names
            .get(symbol.st_name as usize)
            .is_ok_and(|name| name == SEAL)
    });
    let address = symbol
        .with_context(|| format!("the firmware has no {SEAL}"))?
        .st_value;
    let segments = file.segments().context("the firmware is not linked")?;
    let holds = |start: u64, bytes: u64| (start..start + bytes).contains(&address);
    let segment = segments
        .iter()
        .find(|it| it.p_type == PT_LOAD && holds(it.p_vaddr, it.p_filesz));
    let segment = segment.with_context(|| format!("{SEAL} is not in the flash"))?;
    let offset = segment.p_offset + (address - segment.p_vaddr);
    Ok((u32::try_from(address)?, usize::try_from(offset)?))
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

/// Address and bytes for the flash, in ascending order.
type Segment = (u32, Vec<u8>);

fn loadable(elf: &[u8]) -> Result<Vec<Segment>> {
    let file =
        ElfBytes::<LittleEndian>::minimal_parse(elf).context("the firmware is not an ELF file")?;
    let mut segments = Vec::new();
    for header in file.segments().context("the firmware is not linked")? {
        if header.p_type == PT_LOAD && header.p_filesz > 0 {
            // The address in the file of start values of variables is in flash; they are copied to RAM at boot.
            let address = u32::try_from(header.p_paddr)?;
            segments.push((address, file.segment_data(&header)?.to_vec()));
        }
    }
    segments.sort_by_key(|(address, _)| *address);
    let overlap = segments
        .windows(2)
        .any(|two| two[0].0 as usize + two[0].1.len() > two[1].0 as usize);
    ensure!(
        !segments.is_empty() && !overlap,
        "the firmware has no segments to load, or two that overlap"
    );
    Ok(segments)
}

/// Writes both images, reads them back, and compares them with the segments of the ELF.
fn write_images(segments: &[Segment], name: &str) -> Result<()> {
    let (bin, hex) = (image(name, "bin"), image(name, "hex"));
    shell::write(&bin, flat(segments))?;
    shell::write(&hex, intel_hex(segments)?)?;

    let base = segments.first().map_or(0, |(address, _)| *address);
    let image = fs::read(&bin)?;
    let in_bin = |address: u32| image.get((address - base) as usize).copied();
    let lines = read_hex(&fs::read_to_string(&hex)?)?;
    let loaded: Vec<(u32, u8)> = bytes_of(segments).collect();
    ensure!(
        lines == loaded && loaded.iter().all(|&(at, byte)| in_bin(at) == Some(byte)),
        "an image differs from the segments of the ELF"
    );
    println!(
        "bin:  {} ({} bytes from {base:#010x}, read back and compared with the ELF)",
        shown(&bin),
        image.len()
    );
    println!("hex:  {} (likewise)", shown(&hex));
    Ok(())
}

fn bytes_of(segments: &[Segment]) -> impl Iterator<Item = (u32, u8)> {
    segments
        .iter()
        .flat_map(|(address, bytes)| (*address..).zip(bytes.iter().copied()))
}

/// One block from the first segment's address; the space between two segments stays erased.
fn flat(segments: &[Segment]) -> Vec<u8> {
    let mut image = Vec::new();
    let base = segments.first().map_or(0, |(address, _)| *address);
    for (address, bytes) in segments {
        image.resize((address - base) as usize, ERASED);
        image.extend_from_slice(bytes);
    }
    image
}

fn intel_hex(segments: &[Segment]) -> Result<String> {
    let mut records = Vec::new();
    let mut upper = None;
    for (address, bytes) in segments {
        let mut at = *address;
        let mut rest = bytes.as_slice();
        while !rest.is_empty() {
            if upper != Some(at >> 16) {
                upper = Some(at >> 16);
                records.push(Record::ExtendedLinearAddress((at >> 16) as u16));
            }
            // A line ends where the upper half of the address changes.
            let left = 0x1_0000 - (at & 0xffff) as usize;
            let (line, later) = rest.split_at(HEX_LINE.min(left).min(rest.len()));
            records.push(Record::Data {
                offset: at as u16,
                value: line.to_vec(),
            });
            at += line.len() as u32;
            rest = later;
        }
    }
    records.push(Record::EndOfFile);
    let text = ihex::create_object_file_representation(&records);
    Ok(text.context("a line of the HEX file is too long")? + "\n")
}

/// Every byte of a HEX file with its address, in the order of the file.
fn read_hex(text: &str) -> Result<Vec<(u32, u8)>> {
    let mut bytes = Vec::new();
    let mut upper = 0;
    for record in ihex::Reader::new(text) {
        match record.context("a line of the HEX file is damaged")? {
            Record::ExtendedLinearAddress(half) => upper = u32::from(half) << 16,
            Record::Data { offset, value } => {
                bytes.extend((upper | u32::from(offset)..).zip(value))
            }
            Record::EndOfFile => break,
            other => bail!("unexpected record in the HEX file: {other:?}"),
        }
    }
    Ok(bytes)
}

/// Place of an image.
fn image(binary: &str, kind: &str) -> PathBuf {
    let out = shell::root().join(OUT);
    out.join(binary).with_extension(kind)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn segments() -> Vec<Segment> {
        let code = (0..70_000_u32).map(|k| (k * 7) as u8).collect();
        vec![(0x0800_0000, code), (0x0802_0005, vec![1, 2, 3])]
    }

    #[test]
    fn hex_holds_every_byte_at_its_address_across_the_64_k_lines() {
        let text = intel_hex(&segments()).unwrap();
        let expected: Vec<_> = bytes_of(&segments()).collect();
        assert_eq!(read_hex(&text).unwrap(), expected);
        assert!(text.starts_with(":020000040800F2\n"), "{}", &text[..40]);
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
    fn a_flipped_digit_of_a_hex_file_is_seen() {
        let text = intel_hex(&segments()).unwrap();
        let wrong = text.replacen("0007", "0008", 1);
        assert_ne!(wrong, text);
        assert!(read_hex(&wrong).is_err());
    }

    #[test]
    fn the_flat_image_is_erased_between_segments() {
        let image = flat(&segments());
        assert_eq!(image.len(), 0x2_0008);
        assert_eq!(image[70_000], ERASED);
        assert_eq!(image[0x2_0004..], [ERASED, 1, 2, 3]);
    }
}
