//! Fails on request, to prove the way out: the fault handlers of the flashable firmware, and nothing else of it.
//!
//! After start-up it switches the torque enable on, sends its hello, and waits for one letter on the link. Not for flashing:
//! a firmware that drives an arm has no command to fail.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
foretorque_f405::fault_handlers!(foretorque_f405::odrive_v3::OdriveV3);

#[cfg(target_os = "none")]
mod trial {
    use core::hint::black_box;

    use foretorque::arm::Arm as _;
    use foretorque::arm::ur5::{JOINTS, PARAMETERS, Ur5 as Arm};
    use foretorque_f405::board::EnablePin;
    use foretorque_f405::fault::{self, Reason};
    use foretorque_f405::odrive_v3::OdriveV3;
    use foretorque_link::hal::TorqueEnable;
    use foretorque_link::safety::SafetyStatus;
    use foretorque_link::wire::{
        BoardHello, BoardMessage, Capabilities, ChipStatus, Configuration, CounterKind,
        FrameBuffer, Name,
    };
    use stm32f4xx_hal::pac::{self, Interrupt, NVIC, USART2};

    #[cortex_m_rt::entry]
    fn main() -> ! {
        let Some(chip) = pac::Peripherals::take() else {
            fault::leave::<OdriveV3>(Reason::Setup, line!());
        };
        let (kept, place) = fault::take();
        let hello = BoardHello {
            arm_hash: Arm::HASH,
            arm: Name::new(),
            joints: JOINTS as u8,
            base_columns: PARAMETERS as u8,
            firmware: Name::new(),
            capabilities: Capabilities::default(),
            counter: CounterKind::None,
            // There is no counter; its field carries the record of the fault handler.
            counter_hz: place,
            configuration: Configuration::default(),
            reset_reason: fault::reset_reason(kept, &chip.RCC),
            safety: SafetyStatus::default(),
            boot_counts: 0,
            chip: ChipStatus::VIRTUAL,
        };
        chip.RCC.apb1enr().modify(|_, w| w.usart2en().enabled());
        let link = chip.USART2;
        link.cr1()
            .write(|w| w.ue().enabled().te().enabled().re().enabled());
        let Ok(mut enable) = TorqueEnable::new(EnablePin::<OdriveV3>::default());
        let Ok(()) = enable.on();
        let mut out = FrameBuffer::new();
        if out.push(0, &BoardMessage::<JOINTS>::Hello(hello)).is_err() {
            fault::leave::<OdriveV3>(Reason::Setup, line!());
        }
        for &byte in out.as_bytes() {
            while link.sr().read().txe().bit_is_clear() {}
            // SAFETY: the data register takes any byte.
            link.dr().write(|w| unsafe { w.bits(u16::from(byte)) });
        }
        loop {
            fail(letter(&link));
        }
    }

    fn letter(link: &USART2) -> u8 {
        while link.sr().read().rxne().bit_is_clear() {}
        link.dr().read().bits() as u8
    }

    /// Fails in the way of `letter`; any other letter is ignored.
    fn fail(letter: u8) {
        match letter {
            b'p' => panic!(),
            b'u' => cortex_m::asm::udf(),
            b's' => _ = dig(0),
            b'i' => {
                // SAFETY: nothing here relies on interrupts being masked.
                unsafe { NVIC::unmask(Interrupt::EXTI0) };
                NVIC::pend(Interrupt::EXTI0);
                cortex_m::asm::isb();
            }
            _ => {}
        }
    }

    /// Calls itself until the stack is at its end.
    #[inline(never)]
    fn dig(depth: u32) -> u32 {
        if black_box(depth) == u32::MAX {
            return 0;
        }
        let room = black_box([depth; 16]);
        dig(black_box(depth + 1)) + room[depth as usize % 16]
    }
}

foretorque_f405::on_the_host!();
