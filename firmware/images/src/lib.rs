//! Shared by the images that only tests load: two streams through the emulator's semihosting. Empty on the host.
#![no_std]
#![cfg(target_os = "none")]

use cortex_m_semihosting::{debug, nr, syscall1};

/// Modes of SYS_OPEN: "rb" and "wb" (Arm semihosting specification, section 6.13).
const READ: usize = 1;
const WRITE: usize = 5;
/// Result of a failed SYS_OPEN.
const NO_HANDLE: usize = usize::MAX;
/// Longest command line: program and two names.
const COMMAND_LINE: usize = 256;

/// The two open streams.
pub struct Streams {
    input: usize,
    output: usize,
}

impl Streams {
    /// Opens the two files named on the command line: the one to read first, the one to write second.
    pub fn open() -> Option<Self> {
        let mut line = [0u8; COMMAND_LINE];
        let mut words = words(&mut line)?.skip(1);
        let input = open(words.next()?, READ)?;
        let output = open(words.next()?, WRITE)?;
        Some(Self { input, output })
    }

    /// Waits for bytes. `None` when the host has closed its end.
    pub fn read<'a>(&self, buffer: &'a mut [u8]) -> Option<&'a [u8]> {
        let block = [self.input, buffer.as_mut_ptr() as usize, buffer.len()];
        // SAFETY: the block names a handle, a buffer and its length; the host writes inside the buffer only.
        let missing = unsafe { syscall1(nr::READ, block.as_ptr() as usize) };
        let count = buffer.len().checked_sub(missing)?;
        buffer.get(..count).filter(|read| !read.is_empty())
    }

    /// Sends all bytes. False when the host has closed its end.
    pub fn write(&self, bytes: &[u8]) -> bool {
        let block = [self.output, bytes.as_ptr() as usize, bytes.len()];
        // SAFETY: the block names a handle, a buffer and its length; the host only reads the buffer.
        unsafe { syscall1(nr::WRITE, block.as_ptr() as usize) == 0 }
    }
}

/// The words of the command line, for which `line` has room.
pub fn words(line: &mut [u8]) -> Option<impl Iterator<Item = &[u8]>> {
    let mut block = [line.as_mut_ptr() as usize, line.len()];
    // SAFETY: the block names a buffer and its length; the host stays inside and writes the length back.
    if unsafe { syscall1(nr::GET_CMDLINE, block.as_mut_ptr() as usize) } != 0 {
        return None;
    }
    let line = line.get(..block[1])?;
    Some(line.split(|&byte| byte == b' ' || byte == 0))
}

/// Opens one file; `name` is not terminated, so it is copied.
fn open(name: &[u8], mode: usize) -> Option<usize> {
    let mut path = [0u8; COMMAND_LINE];
    path.get_mut(..name.len())?.copy_from_slice(name);
    let block = [path.as_ptr() as usize, mode, name.len()];
    // SAFETY: the path is terminated by the zeros it was made of (names are shorter than the line they came on), and
    // outlives the call.
    let handle = unsafe { syscall1(nr::OPEN, block.as_ptr() as usize) };
    (handle != NO_HANDLE).then_some(handle)
}

/// Ends the emulator.
pub fn exit(well: bool) -> ! {
    let status = if well {
        debug::EXIT_SUCCESS
    } else {
        debug::EXIT_FAILURE
    };
    debug::exit(status);
    loop {
        cortex_m::asm::wfi();
    }
}
