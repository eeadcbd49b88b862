//! A linked ELF of the board: its functions, its code, its memory.

use std::fs;
use std::ops::Range;
use std::path::Path;

use anyhow::{Context as _, Result, ensure};
use elf::ElfBytes;
use elf::abi::{PT_LOAD, SHF_ALLOC, SHT_NOBITS, STT_FUNC};
use elf::endian::LittleEndian;

use crate::thumb::{self, Instruction};

/// Flash and static RAM of the STM32F405 (memory.x).
const FLASH: Range<u32> = 0x0800_0000..0x0810_0000;
pub(crate) const RAM: Range<u32> = 0x2000_0000..0x2002_0000;

/// A function of the symbol table.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Function {
    /// Path in the source, without the hash.
    pub(crate) name: String,
    pub(crate) code: Range<u32>,
}

/// A linked ELF, as far as the measurements need it.
#[derive(Debug)]
pub(crate) struct Image {
    /// Sorted by address; a function with two names is listed twice.
    functions: Vec<Function>,
    segments: Vec<(u32, Vec<u8>)>,
    /// Bytes in flash: code, constants, and the start values of variables.
    pub(crate) flash_bytes: u32,
    /// Bytes of static variables.
    pub(crate) ram_bytes: u32,
    /// Bytes that memory.x leaves for the stack.
    pub(crate) stack_limit: u32,
}

impl Image {
    pub(crate) fn read(path: &Path) -> Result<Self> {
        let bytes = fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
        Self::parse(&bytes).with_context(|| format!("{} is not a linked ELF", path.display()))
    }

    fn parse(bytes: &[u8]) -> Result<Self> {
        let file = ElfBytes::<LittleEndian>::minimal_parse(bytes)?;
        let mut segments = Vec::new();
        for header in file.segments().context("no program headers")? {
            if header.p_type == PT_LOAD && header.p_filesz > 0 {
                let data = file.segment_data(&header)?;
                segments.push((u32::try_from(header.p_vaddr)?, data.to_vec()));
            }
        }
        let (mut flash_bytes, mut ram_bytes) = (0, 0);
        for header in file.section_headers().context("no section headers")? {
            if header.sh_flags & u64::from(SHF_ALLOC) == 0 {
                continue;
            }
            let size = u32::try_from(header.sh_size)?;
            if RAM.contains(&u32::try_from(header.sh_addr)?) {
                ram_bytes += size;
            }
            if header.sh_type != SHT_NOBITS {
                flash_bytes += size;
            }
        }
        let (symbols, names) = file.symbol_table()?.context("no symbol table")?;
        let mut functions = Vec::new();
        let (mut stack_start, mut stack_end) = (RAM.end, RAM.start);
        for symbol in symbols {
            let name = names.get(symbol.st_name as usize)?;
            match name {
                "_stack_start" => stack_start = u32::try_from(symbol.st_value)?,
                "_stack_end" => stack_end = u32::try_from(symbol.st_value)?,
                _ => {}
            }
            if symbol.st_symtype() != STT_FUNC || symbol.is_undefined() {
                continue;
            }
            // The lowest bit marks Thumb.
            let start = u32::try_from(symbol.st_value)? & !1;
            let end = start + u32::try_from(symbol.st_size)?;
            functions.push(Function {
                name: format!("{:#}", rustc_demangle::demangle(name)),
                code: start..end,
            });
        }
        functions.sort_by(|a, b| (a.code.start, &a.name).cmp(&(b.code.start, &b.name)));
        // Assembler gives some functions no size: they reach to the next one.
        let starts: Vec<u32> = functions.iter().map(|f| f.code.start).collect();
        for function in functions.iter_mut().filter(|f| f.code.is_empty()) {
            let next = starts.iter().find(|&&start| start > function.code.start);
            function.code.end = next.copied().unwrap_or(FLASH.end);
        }
        ensure!(!functions.is_empty(), "no function symbols");
        Ok(Self {
            functions,
            segments,
            flash_bytes,
            ram_bytes,
            stack_limit: stack_start.saturating_sub(stack_end),
        })
    }

    /// The function of this name; the last part of its path is enough if it is the only one.
    pub(crate) fn function(&self, name: &str) -> Option<&Function> {
        let tail = format!("::{name}");
        let mut found = self
            .functions
            .iter()
            .filter(|f| f.name == name || f.name.ends_with(&tail));
        let first = found.next()?;
        found
            .all(|other| other.code.start == first.code.start)
            .then_some(first)
    }

    /// The function of a row of the bench program.
    pub(crate) fn row(&self, name: &str) -> Result<&Function> {
        self.function(&format!("stage::{name}"))
            .with_context(|| format!("the ELF has no function for row `{name}`"))
    }

    /// Every function once, whatever its names.
    pub(crate) fn distinct_functions(&self) -> impl Iterator<Item = &Function> {
        let mut before = None;
        self.functions.iter().filter(move |function| {
            before.replace(function.code.start) != Some(function.code.start)
        })
    }

    /// The function that holds `address`.
    pub(crate) fn at(&self, address: u32) -> Option<&Function> {
        let end = self.functions.partition_point(|f| f.code.start <= address);
        self.functions[..end]
            .iter()
            .rev()
            .find(|f| f.code.contains(&address))
    }

    /// All names of the function that starts at `address`.
    pub(crate) fn names(&self, address: u32) -> impl Iterator<Item = &str> {
        let first = self.functions.partition_point(|f| f.code.start < address);
        self.functions[first..]
            .iter()
            .take_while(move |f| f.code.start == address)
            .map(|f| f.name.as_str())
    }

    fn bytes<const COUNT: usize>(&self, address: u32) -> Option<[u8; COUNT]> {
        self.segments.iter().find_map(|(start, data)| {
            let offset = address.checked_sub(*start)? as usize;
            data.get(offset..)?.first_chunk().copied()
        })
    }

    pub(crate) fn halfword(&self, address: u32) -> Option<u16> {
        self.bytes(address).map(u16::from_le_bytes)
    }

    /// The instruction at `address`.
    pub(crate) fn instruction(&self, address: u32) -> Option<Instruction> {
        let first = self.halfword(address)?;
        let second = if thumb::is_wide(first) {
            self.halfword(address + 2)?
        } else {
            0
        };
        Some(thumb::decode(address, first, second))
    }

    /// The handlers of the interrupts that this firmware binds, SysTick included: `(exception number, function)`.
    pub(crate) fn handlers(&self) -> Vec<(u32, &Function)> {
        const SYSTICK: u32 = 15;
        // RM0090 table 62: 82 interrupts behind the 16 words of the core.
        const VECTORS: u32 = 16 + 82;
        let default = self
            .function("DefaultHandler_")
            .or(self.function("DefaultHandler"));
        (SYSTICK..VECTORS)
            .filter_map(|number| {
                let address = self
                    .bytes(FLASH.start + 4 * number)
                    .map(u32::from_le_bytes)?;
                let function = self.at(address & !1)?;
                let bound = default.is_none_or(|d| d.code.start != function.code.start);
                (address != 0 && bound).then_some((number, function))
            })
            .collect()
    }

    /// An image of hand-written functions: name, address, halfwords.
    #[cfg(test)]
    pub(crate) fn of_code(functions: &[(&str, u32, &[u16])]) -> Self {
        let bytes = |code: &[u16]| code.iter().flat_map(|half| half.to_le_bytes()).collect();
        let function = |&(name, start, code): &(&str, u32, &[u16])| Function {
            name: name.into(),
            code: start..start + 2 * code.len() as u32,
        };
        Self {
            functions: functions.iter().map(function).collect(),
            segments: functions
                .iter()
                .map(|&(_, start, code)| (start, bytes(code)))
                .collect(),
            flash_bytes: 0,
            ram_bytes: 0,
            stack_limit: 0,
        }
    }
}
