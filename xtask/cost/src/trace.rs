//! The executed instructions of every call of a row, from the emulator's log of the processor before each instruction, and an
//! estimate of their cycles.

use std::collections::HashMap;
use std::io::BufRead;

use anyhow::{Result, bail};

use crate::image::Image;
use crate::thumb::{Class, Flow, Instruction, LR, PC, Registers, SP};

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
        starts.insert(image.row(name)?.code.start, row);
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
            open.call.cycles = open.model.spent;
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

const REFILL: u64 = 2;

/// An estimate of Cortex-M4 cycles over the executed instructions. Never a measurement on silicon.
///
/// Cycle counts: ARM DDI 0439 (Cortex-M4 r0p1 technical reference manual), table 3-1 for the core and table 7-1 for
/// the FPU; load pipelining from section 3.3.3. A branch refills the pipeline in 2 cycles; loads are pipelined unless an
/// address waits for the load before; a float result that is used at once costs one cycle. Memory has no wait states.
#[derive(Debug, Default)]
struct Model {
    /// Cycles since the model was made.
    spent: u64,
    /// The instruction before was a single load or store and wrote these registers.
    pipelined: Option<Registers>,
    /// Float registers whose result the next instruction has to wait for.
    late: Registers,
}

impl Model {
    /// Executes `instruction`.
    ///
    /// * `failed` its condition does not hold      * `taken` control does not go on behind it
    fn execute(&mut self, instruction: &Instruction, failed: bool, taken: bool) {
        let single = !failed && !taken && is_single(instruction);
        let mut estimate = if failed { 1 } else { cost(instruction, taken) };
        let free = |written: Registers| single && !written.meets(instruction.reads);
        if estimate == 2 && self.pipelined.is_some_and(free) {
            estimate = 1;
        }
        if !failed && waits(instruction, self.late) {
            estimate += 1;
        }
        self.pipelined = single.then_some(instruction.writes);
        self.late = match instruction.class {
            Class::FloatArithmetic | Class::FloatAccumulate { .. } | Class::FloatDivide
                if !failed =>
            {
                instruction.writes
            }
            _ => Registers::NONE,
        };
        self.spent += estimate;
    }
}

/// Whether a late result delays `instruction`. The addition of a multiply-accumulate comes last, so its accumulator may
/// be late.
fn waits(instruction: &Instruction, late: Registers) -> bool {
    let needed = match instruction.class {
        Class::FloatAccumulate { accumulator } => Registers(instruction.reads.0 & !accumulator.0),
        _ => instruction.reads,
    };
    needed.meets(late)
}

fn is_single(instruction: &Instruction) -> bool {
    matches!(instruction.class, Class::Load | Class::Store { .. })
}

fn cost(instruction: &Instruction, taken: bool) -> u64 {
    let refill = if taken { REFILL } else { 0 };
    match instruction.class {
        Class::Branch => match instruction.flow {
            Flow::Call(_) | Flow::CallIndirect => 1 + REFILL,
            _ => 1 + refill,
        },
        Class::TableBranch => 2 + REFILL,
        Class::Multiple { words } => 1 + u64::from(words) + refill,
        Class::Load => 2 + refill,
        Class::Store { indexed } => 1 + u64::from(indexed),
        Class::Alu => 1 + refill,
        // 2 to 12 cycles, by the operands.
        Class::Divide => 7,
        Class::System | Class::FloatMovePair => 2,
        Class::FloatAccumulate { .. } => 3,
        Class::FloatDivide => 14,
        Class::FloatArithmetic | Class::FloatMove | Class::IfThen { .. } | Class::Undefined => 1,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::thumb::decode;

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

    /// Cycle estimate of instructions one after another, none of them a branch, in RAM.
    fn estimate(code: &[(u16, u16)]) -> u64 {
        let mut model = Model::default();
        for &(first, second) in code {
            model.execute(&decode(0x2000_0000, first, second), false, false);
        }
        model.spent
    }

    const VADD_S0_S1_S2: (u16, u16) = (0xEE30, 0x0A81);
    const VMUL_S3_S0_S0: (u16, u16) = (0xEE60, 0x1A00);
    const VMUL_S3_S4_S4: (u16, u16) = (0xEE62, 0x1A02);
    const VLDR_S0_R0: (u16, u16) = (0xED90, 0x0A00);
    const VLDR_S1_R0: (u16, u16) = (0xEDD0, 0x0A01);

    #[test]
    fn a_float_result_used_at_once_costs_one_cycle_more() {
        assert_eq!(estimate(&[VADD_S0_S1_S2, VMUL_S3_S4_S4]), 2);
        assert_eq!(estimate(&[VADD_S0_S1_S2, VMUL_S3_S0_S0]), 3);
    }

    #[test]
    fn loads_in_a_row_overlap_unless_an_address_waits() {
        assert_eq!(estimate(&[VLDR_S0_R0, VLDR_S1_R0, VLDR_S0_R0]), 4);
        let ldr_r0_r0 = (0x6800, 0);
        assert_eq!(estimate(&[ldr_r0_r0, ldr_r0_r0]), 4);
    }

    #[test]
    fn an_accumulator_may_be_late_but_a_factor_may_not() {
        let vmla_s0_s1_s2 = (0xEE00, 0x0A81);
        let vmla_s3_s0_s1 = (0xEE40, 0x1A20);
        assert_eq!(estimate(&[VADD_S0_S1_S2, vmla_s0_s1_s2]), 4);
        assert_eq!(estimate(&[VADD_S0_S1_S2, vmla_s3_s0_s1]), 5);
    }
}
