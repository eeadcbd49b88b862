//! The schedule: who may interrupt whom.

#[rtic::app(device = stm32f4xx_hal::pac, peripherals = true)]
mod app {
    use heapless::spsc::{Consumer, Producer, Queue};
    use stm32f4xx_hal::pac::Interrupt;
    use stm32f4xx_hal::prelude::*;

    use crate::clock::{self, ClockSource};
    use crate::fault::{self, EnablePin};
    use crate::link::{self, RECEIVE_RING, RECEIVED, TRANSMIT_RING, Wire};
    use crate::{counter, log};
    use foretorque::edge::hal::TorqueEnable;

    #[shared]
    struct Shared {}

    #[local]
    struct Local {
        wire: Wire,
        received: Consumer<'static, u8>,
        waiting: Producer<'static, u8>,
        enable: TorqueEnable<EnablePin>,
        drain: Option<log::Drain>,
    }

    #[init(local = [
        receive_ring: Queue<u8, RECEIVE_RING> = Queue::new(),
        transmit_ring: Queue<u8, TRANSMIT_RING> = Queue::new(),
    ])]
    fn init(cx: init::Context) -> (Shared, Local) {
        let (reason, place) = fault::take();
        let clocks = clock::start(&cx.device.RCC, &cx.device.FLASH);
        let emulated = clocks.source == ClockSource::Emulated;

        // Torque off before anything else can go wrong; the pin is driven low before it becomes an output.
        let Ok(enable) = TorqueEnable::new(EnablePin);
        cx.device.RCC.apb1enr().modify(|_, w| {
            w.usart2en()
                .enabled()
                .usart3en()
                .enabled()
                .tim2en()
                .enabled()
        });
        let mut rcc = cx.device.RCC.constrain();
        let gpioa = cx.device.GPIOA.split(&mut rcc);
        let gpiob = cx.device.GPIOB.split(&mut rcc);
        gpiob
            .pb12
            .into_push_pull_output_in_state(stm32f4xx_hal::gpio::PinState::Low);
        gpioa.pa2.into_alternate::<7>();
        gpioa.pa3.into_alternate::<7>().internal_pull_up(true);

        let mut core = cx.core;
        counter::start(&mut core, &cx.device.TIM2, emulated);
        let drain = emulated.then(|| log::Drain::start(cx.device.USART3));
        defmt::info!(
            "boot: clock {=u8} at {=u32} Hz, last reset {=u8} at {=u32:#x}",
            clocks.source as u8,
            clocks.cpu_hz,
            reason as u8,
            place
        );

        let (receive_in, received) = cx.local.receive_ring.split();
        let (mut waiting, transmit_out) = cx.local.transmit_ring.split();
        let wire = Wire::start(cx.device.USART2, clocks.apb1_hz, receive_in, transmit_out);
        link::send(&mut waiting, b"hello\0");
        (
            Shared {},
            Local {
                wire,
                received,
                waiting,
                enable,
                drain,
            },
        )
    }

    #[task(binds = USART2, priority = 4, local = [wire])]
    fn byte(cx: byte::Context) {
        if cx.local.wire.interrupt() {
            rtic::pend(Interrupt::EXTI1);
        }
    }

    #[task(binds = EXTI1, priority = 3, local = [received, waiting, enable])]
    fn tick(cx: tick::Context) {
        while let Some(byte) = cx.local.received.dequeue() {
            link::send(cx.local.waiting, &[byte]);
        }
    }

    #[idle(local = [drain])]
    fn idle(cx: idle::Context) -> ! {
        let mut said = 0;
        loop {
            let bytes = RECEIVED.bytes.load(core::sync::atomic::Ordering::Relaxed);
            if bytes - said > 1000 {
                said = bytes;
                defmt::info!(
                    "received {=u32} bytes, counts {=u32}, max {=u32}",
                    bytes,
                    RECEIVED.counts.load(core::sync::atomic::Ordering::Relaxed),
                    RECEIVED
                        .counts_max
                        .load(core::sync::atomic::Ordering::Relaxed)
                );
            }
            if let Some(drain) = cx.local.drain {
                drain.empty();
            }
            cortex_m::asm::wfi();
        }
    }
}
