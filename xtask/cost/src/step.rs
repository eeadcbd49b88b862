//! The processor before one instruction, as the emulator logs it.

use crate::thumb::PC;

/// The processor before one instruction.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Step {
    registers: [u32; 16],
    status: u32,
}

impl Step {
    pub(crate) fn pc(&self) -> u32 {
        self.registers[PC as usize]
    }

    pub(crate) fn register(&self, number: u32) -> u32 {
        self.registers[number as usize & 15]
    }

    /// Whether the instruction is in an if-then block and its condition does not hold (DDI 0403E.e, A7.3).
    pub(crate) fn condition_failed(&self) -> bool {
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
    pub(crate) fn read_line(&mut self, line: &[u8]) -> bool {
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

    /// At `pc`, everything else zero.
    #[cfg(test)]
    pub(crate) fn at(pc: u32) -> Self {
        let mut step = Self::default();
        step.registers[PC as usize] = pc;
        step
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
    use crate::thumb::SP;

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
