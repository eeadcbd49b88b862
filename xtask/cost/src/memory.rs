//! Flash, static RAM and the worst stack of a flashable firmware, from its linked ELF alone.

use anyhow::{Context as _, Result, bail, ensure};

use crate::calls::{Depth, Walk};
use crate::image::Image;

/// The interrupt of the tick.
const TICK: &str = "EXTI1";

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
    /// Bound of the whole stack: the main program and one of every handler on top of each other.
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
        let main = image.function("main").context("there is no main")?;
        let mut nested_bytes = bounded_depth(image, main.code.start)?.bytes;
        for (_, handler) in image.handlers() {
            nested_bytes += EXCEPTION_FRAME + bounded_depth(image, handler.code.start)?.bytes;
        }
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
