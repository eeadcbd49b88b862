//! The interrupts of an image.

/// The firmware of a board, for the arm of [`arm`](crate::arm): its interrupts and fault handlers.
#[macro_export]
macro_rules! image {
    ($board:ty) => {
        $crate::fault_handlers!($board);

        #[rtic::app(device = stm32f4xx_hal::pac, peripherals = true)]
        mod app {
            use $crate::app::{Idle, Started, Statics, Tick, byte, learn, start, timer};
            use $crate::arm::{BoardMailboxes, Learner};
            use $crate::link::Wire;

            #[shared]
            struct Shared {
                mailboxes: &'static mut BoardMailboxes,
            }

            #[local]
            struct Local {
                wire: Wire,
                tick: Tick<$board>,
                learner: &'static mut Learner,
                idle: Idle,
            }

            #[init(local = [statics: Statics = Statics::empty()])]
            fn init(cx: init::Context) -> (Shared, Local) {
                let Started {
                    mailboxes,
                    wire,
                    tick,
                    learner,
                    idle,
                } = start::<$board>(cx.device, cx.core, cx.local.statics);
                let local = Local {
                    wire,
                    tick,
                    learner,
                    idle,
                };
                (Shared { mailboxes }, local)
            }

            #[task(binds = USART2, priority = 5, local = [wire])]
            fn on_byte(cx: on_byte::Context) {
                byte(cx.local.wire);
            }

            #[task(binds = SysTick, priority = 5)]
            fn on_timer(_: on_timer::Context) {
                timer();
            }

            #[task(binds = EXTI1, priority = 3, local = [tick], shared = [mailboxes])]
            fn on_tick(mut cx: on_tick::Context) {
                cx.local.tick.run(&mut cx.shared.mailboxes);
            }

            #[task(binds = EXTI2, priority = 2, local = [learner], shared = [mailboxes])]
            fn on_learn(mut cx: on_learn::Context) {
                learn(cx.local.learner, &mut cx.shared.mailboxes);
            }

            #[idle(local = [idle], shared = [mailboxes])]
            fn on_idle(mut cx: on_idle::Context) -> ! {
                cx.local.idle.run::<$board>(&mut cx.shared.mailboxes)
            }
        }
    };
}
