//! The interrupts of an image.

/// The firmware of a board for an arm of `N` joints and `P` base parameters: its interrupts and fault handlers.
#[macro_export]
macro_rules! image {
    ($board:ty, $arm:ty, $n:expr, $p:expr) => {
        $crate::fault_handlers!($board);

        #[rtic::app(device = stm32f4xx_hal::pac, peripherals = true)]
        mod app {
            use foretorque::learning::Learner;
            use foretorque_link::session::Mailboxes;
            use $crate::app::{Idle, Started, Statics, Tick, byte, learn, start, timer};
            use $crate::link::Wire;

            #[shared]
            struct Shared {
                mailboxes: &'static mut Mailboxes<{ $n }, { $p }>,
            }

            #[local]
            struct Local {
                wire: Wire,
                tick: Tick<$board, $arm, { $n }, { $p }>,
                learner: &'static mut Learner<$arm, { $n }, { $p }>,
                idle: Idle<$arm, { $n }, { $p }>,
            }

            #[init(local = [statics: Statics<$arm, { $n }, { $p }> = Statics::empty()])]
            fn init(cx: init::Context) -> (Shared, Local) {
                let Started {
                    mailboxes,
                    wire,
                    tick,
                    learner,
                    idle,
                } = start::<$board, $arm, { $n }, { $p }>(cx.device, cx.core, cx.local.statics);
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
