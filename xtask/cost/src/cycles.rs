//! An estimate of Cortex-M4 cycles over the executed instructions. Never a measurement on silicon.
//!
//! Cycle counts: ARM DDI 0439 (Cortex-M4 r0p1 technical reference manual), table 3-1 for the core and table 7-1 for
//! the FPU; load pipelining from section 3.3.3. A branch refills the pipeline in 2 cycles; loads are pipelined unless an
//! address waits for the load before; a float result that is used at once costs one cycle.
//!
//! The flash model follows RM0090, section 3.5.2 (adaptive accelerator): 5 wait states at 168 MHz, lines of 16 bytes, 64
//! of them cached for code and 8 for data, the next line prefetched. Replacement and the timing of the prefetch are
//! assumptions.

use crate::image::FLASH;
use crate::step::Step;
use crate::thumb::{Class, Flow, Instruction, PC, Registers};

const WAIT_STATES: u64 = 5;
const LINE_BITS: u32 = 4;
const CODE_LINES: usize = 64;
const DATA_LINES: usize = 8;
const REFILL: u64 = 2;

/// Cycles of a piece of code.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Cycles {
    /// At zero wait states. The estimate that is quoted.
    pub(crate) estimate: u64,
    /// With the waits of the flash model.
    pub(crate) flash: u64,
}

impl std::ops::Sub for Cycles {
    type Output = Self;

    fn sub(self, before: Self) -> Self {
        Self {
            estimate: self.estimate - before.estimate,
            flash: self.flash - before.flash,
        }
    }
}

/// State of the pipeline and of the flash interface.
#[derive(Debug, Default)]
pub(crate) struct Model {
    spent: Cycles,
    /// The instruction before was a single load or store and wrote these registers.
    pipelined: Option<Registers>,
    /// Float registers whose result the next instruction has to wait for.
    late: Registers,
    line: Option<u32>,
    /// Line on its way and the cycle at which it arrives.
    prefetch: Option<(u32, u64)>,
    code: Cache<CODE_LINES>,
    data: Cache<DATA_LINES>,
}

impl Model {
    /// Cycles since the model was made.
    pub(crate) fn spent(&self) -> Cycles {
        self.spent
    }

    /// Empties the pipeline, as between two calls; caches keep their lines.
    pub(crate) fn drain(&mut self) {
        self.pipelined = None;
        self.late = Registers::NONE;
    }

    /// Executes `instruction`; control goes on at `next`.
    pub(crate) fn execute(&mut self, instruction: &Instruction, step: &Step, next: u32) {
        let failed = step.condition_failed();
        let taken = next != step.pc() + instruction.size;
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
        let mut stall = self.fetch(step.pc(), instruction.size);
        if !failed {
            stall += self.constant(instruction, step);
        }
        self.spent.estimate += estimate;
        self.spent.flash += estimate + stall;
    }

    /// Waits for the flash lines that hold `size` bytes of code at `address`.
    fn fetch(&mut self, address: u32, size: u32) -> u64 {
        let mut stall = 0;
        for line in address >> LINE_BITS..=(address + size - 1) >> LINE_BITS {
            if self.line == Some(line) {
                continue;
            }
            self.line = Some(line);
            let now = self.spent.flash + stall;
            if !self.code.touch(line) {
                stall += match self.prefetch {
                    Some((coming, ready)) if coming == line => ready.saturating_sub(now),
                    _ => WAIT_STATES,
                };
            }
            let next = line + 1;
            let coming = self.prefetch.is_some_and(|(coming, _)| coming == next);
            if !self.code.lines.contains(&next) && !coming {
                let ready = self.spent.flash + stall + WAIT_STATES + 1;
                self.prefetch = Some((next, ready));
            }
        }
        stall
    }

    /// Waits for a constant that a load reads from flash.
    fn constant(&mut self, instruction: &Instruction, step: &Step) -> u64 {
        let Some(place) = instruction.address else {
            return 0;
        };
        let base = match place.base {
            PC => (step.pc() + 4) & !3,
            base => step.register(base),
        };
        let index = place
            .index
            .map_or(0, |(index, shift)| step.register(index) << shift);
        let address = base.wrapping_add(index).wrapping_add_signed(place.offset);
        let hit = !FLASH.contains(&address) || self.data.touch(address >> LINE_BITS);
        if hit { 0 } else { WAIT_STATES }
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

/// Lines held, least recently used first.
#[derive(Debug, Default)]
struct Cache<const LINES: usize> {
    lines: Vec<u32>,
}

impl<const LINES: usize> Cache<LINES> {
    /// Uses `line`; returns whether it was held.
    fn touch(&mut self, line: u32) -> bool {
        let place = self.lines.iter().position(|&held| held == line);
        if let Some(place) = place {
            self.lines.remove(place);
        } else if self.lines.len() == LINES {
            self.lines.remove(0);
        }
        self.lines.push(line);
        place.is_some()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::thumb::decode;

    /// Cycle estimate of instructions one after another, none of them a branch, in RAM.
    fn estimate(code: &[(u16, u16)]) -> u64 {
        let mut model = Model::default();
        let mut address = 0x2000_0000;
        for &(first, second) in code {
            let instruction = decode(address, first, second);
            let step = Step::at(address);
            address += instruction.size;
            model.execute(&instruction, &step, address);
        }
        model.spent().estimate
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

    #[test]
    fn straight_code_in_flash_waits_once_a_line() {
        let mut model = Model::default();
        for number in 0..16 {
            let address = FLASH.start + 2 * number;
            let nop = decode(address, 0xBF00, 0);
            model.execute(&nop, &Step::at(address), address + 2);
        }
        // 5 for the first line; the second was prefetched with the first and is 8 cycles of code ahead.
        assert_eq!(model.spent().flash, 16 + 5);
    }
}
