//! An estimate of Cortex-M4 cycles over the executed instructions. Never a measurement on silicon.
//!
//! Cycle counts: ARM DDI 0439 (Cortex-M4 r0p1 technical reference manual), table 3-1 for the core and table 7-1 for
//! the FPU; load pipelining from section 3.3.3. A branch refills the pipeline in 2 cycles; loads are pipelined unless an
//! address waits for the load before; a float result that is used at once costs one cycle. Memory has no wait states.

use crate::thumb::{Class, Flow, Instruction, Registers};

const REFILL: u64 = 2;

/// State of the pipeline.
#[derive(Debug, Default)]
pub(crate) struct Model {
    spent: u64,
    /// The instruction before was a single load or store and wrote these registers.
    pipelined: Option<Registers>,
    /// Float registers whose result the next instruction has to wait for.
    late: Registers,
}

impl Model {
    /// Cycles since the model was made.
    pub(crate) fn spent(&self) -> u64 {
        self.spent
    }

    /// Executes `instruction`.
    ///
    /// * `failed` its condition does not hold      * `taken` control does not go on behind it
    pub(crate) fn execute(&mut self, instruction: &Instruction, failed: bool, taken: bool) {
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

    /// Cycle estimate of instructions one after another, none of them a branch, in RAM.
    fn estimate(code: &[(u16, u16)]) -> u64 {
        let mut model = Model::default();
        for &(first, second) in code {
            model.execute(&decode(0x2000_0000, first, second), false, false);
        }
        model.spent()
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
