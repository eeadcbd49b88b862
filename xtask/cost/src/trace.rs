//! The executed instructions of every call of a row, from the emulator's log of the processor before each instruction.

use std::collections::HashMap;
use std::io::BufRead;

use anyhow::{Context as _, Result, bail};

use crate::cycles::Model;
use crate::image::Image;
use crate::step::Step;
use crate::thumb::{Instruction, LR, SP};

/// One traced call.
#[derive(Clone, Debug, Default)]
pub(crate) struct Call {
    pub(crate) instructions: u32,
    /// Estimated.
    pub(crate) cycles: u64,
    /// Bytes of stack below the caller's.
    pub(crate) stack_bytes: u32,
}

/// The calls of the functions named in `rows`, in that order, from the log.
pub(crate) fn follow(
    mut log: impl BufRead,
    image: &Image,
    rows: &[&str],
) -> Result<Vec<Vec<Call>>> {
    let mut starts = HashMap::new();
    for (row, name) in rows.iter().enumerate() {
        let function = image
            .function(&format!("rows::{name}"))
            .with_context(|| format!("the ELF has no function for row `{name}`"))?;
        starts.insert(function.code.start, row);
    }
    let mut follower = Follower {
        image,
        starts,
        decoded: HashMap::new(),
        calls: vec![Vec::new(); rows.len()],
        open: None,
    };
    let (mut line, mut step) = (Vec::new(), Step::default());
    loop {
        line.clear();
        if log.read_until(b'\n', &mut line)? == 0 {
            return Ok(follower.calls);
        }
        if step.read_line(&line) {
            follower.see(&step)?;
        }
    }
}

struct Follower<'a> {
    image: &'a Image,
    /// Row of a function, by its address.
    starts: HashMap<u32, usize>,
    decoded: HashMap<u32, Instruction>,
    /// Of each row; code between two calls does not count.
    calls: Vec<Vec<Call>>,
    open: Option<Open>,
}

/// The call under way.
struct Open {
    row: usize,
    back: u32,
    sp: u32,
    last: Step,
    call: Call,
    model: Model,
}

impl Follower<'_> {
    fn see(&mut self, step: &Step) -> Result<()> {
        let Some(mut open) = self.open.take() else {
            if let Some(&row) = self.starts.get(&step.pc()) {
                self.open = Some(Open {
                    row,
                    back: step.register(LR) & !1,
                    sp: step.register(SP),
                    last: *step,
                    call: Call::default(),
                    model: Model::default(),
                });
            }
            return Ok(());
        };
        let address = open.last.pc();
        let instruction = match self.decoded.get(&address) {
            Some(known) => *known,
            None => {
                let Some(new) = self.image.instruction(address) else {
                    bail!("the emulator executed {address:#010x}, which the ELF does not have");
                };
                self.decoded.insert(address, new);
                new
            }
        };
        open.model.execute(&instruction, &open.last, step.pc());
        open.call.instructions += 1;
        let depth = open.sp.saturating_sub(step.register(SP));
        open.call.stack_bytes = open.call.stack_bytes.max(depth);
        if step.pc() == open.back && step.register(SP) == open.sp {
            open.call.cycles = open.model.spent();
            self.calls[open.row].push(open.call);
        } else {
            open.last = *step;
            self.open = Some(open);
        }
        Ok(())
    }
}
