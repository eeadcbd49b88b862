//! The executed instructions of every call of a row, from the emulator's log of the processor before each instruction.

use std::collections::HashMap;
use std::io::BufRead;

use anyhow::{Context as _, Result, bail};

use crate::cycles::Model;
use crate::image::Image;
use crate::thumb::{Instruction, LR, PC, SP};

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
        let failed = open.last.condition_failed();
        let taken = step.pc() != address + instruction.size;
        open.model.execute(&instruction, failed, taken);
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

/// The processor before one instruction.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Step {
    registers: [u32; 16],
    status: u32,
}

impl Step {
    fn pc(&self) -> u32 {
        self.registers[PC as usize]
    }

    fn register(&self, number: u32) -> u32 {
        self.registers[number as usize & 15]
    }

    /// Whether the instruction is in an if-then block and its condition does not hold (DDI 0403E.e, A7.3).
    fn condition_failed(&self) -> bool {
        let flag = |number: u32| self.status >> number & 1 == 1;
        let (negative, zero, carry, overflow) = (flag(31), flag(30), flag(29), flag(28));
        // EPSR keeps ITSTATE in two pieces; its upper half is the condition.
        let block = self.status >> 25 & 0b11 | (self.status >> 10 & 0b11_1111) << 2;
        if block & 0xF == 0 {
            return false;
        }
        let condition = block >> 4;
        let holds = match condition >> 1 {
            0 => zero,
            1 => carry,
            2 => negative,
            3 => overflow,
            4 => carry && !zero,
            5 => negative == overflow,
            6 => negative == overflow && !zero,
            _ => return false,
        };
        holds == (condition & 1 == 1)
    }

    /// Takes the registers of one line of the log; returns whether the step is complete.
    fn read_line(&mut self, line: &[u8]) -> bool {
        let number = |at: usize| hexadecimal(line.get(at..at + 8)?);
        if let Some(status) = line.strip_prefix(b"XPSR=").and_then(|_| number(5)) {
            self.status = status;
            return true;
        }
        // `R04=00000000 R05=…`: four registers of 13 characters each.
        if let [b'R', tens, ones, b'=', ..] = line {
            let first =
                10 * usize::from(tens.wrapping_sub(b'0')) + usize::from(ones.wrapping_sub(b'0'));
            for (place, register) in self.registers.iter_mut().skip(first).take(4).enumerate() {
                if let Some(value) = number(4 + 13 * place) {
                    *register = value;
                }
            }
        }
        false
    }
}

fn hexadecimal(digits: &[u8]) -> Option<u32> {
    digits.iter().try_fold(0, |value, &digit| {
        Some(value << 4 | char::from(digit).to_digit(16)?)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_is_read_from_the_lines_of_the_log() {
        let mut step = Step::default();
        assert!(!step.read_line(b"R00=00000001 R01=0000000a R02=00000000 R03=ffffffff\n"));
        assert!(!step.read_line(b"R12=20016da8 R13=20016cb8 R14=0800552d R15=08000268\n"));
        assert!(step.read_line(b"XPSR=21004800 --C- T priv-thread\n"));
        assert_eq!(step.register(3), u32::MAX);
        assert_eq!(step.register(SP), 0x2001_6cb8);
        assert_eq!(step.pc(), 0x0800_0268);
    }

    #[test]
    fn a_condition_follows_from_the_flags_and_the_block() {
        let with = |status| Step {
            status,
            ..Step::default()
        };
        // MI in a block of one, without and with the negative flag; GT with N alone; no block at all.
        assert!(with(0x2100_4800).condition_failed());
        assert!(!with(0xA100_4800).condition_failed());
        assert!(with(0x8100_c800).condition_failed());
        assert!(!with(0x8100_0000).condition_failed());
    }
}
