//! Feed-forward and learning in two RTIC tasks: the tick in the timer's interrupt, the learning step below it.
#![no_std]
#![no_main]

#[rtic::app(device = stm32f4xx_hal::pac, dispatchers = [EXTI1])]
mod app {
    use cortex_m::peripheral::syst::SystClkSource;
    use foretorque::arm::ur5::{Exchange, FeedForward, Learner, LearnerConfig, ParameterSet, Ur5};
    use foretorque::feedforward::FeedForwardConfig;
    use foretorque::joint::{JointMeasurement, JointMotion, JointSample};
    use foretorque::learning::LearningSample;

    #[shared]
    struct Shared {
        exchange: Exchange,
    }

    #[local]
    struct Local {
        feedforward: FeedForward,
        learner: &'static mut Learner,
    }

    // A static: on the stack there is no room for a learner.
    #[init(local = [empty: Learner = Learner::EMPTY])]
    fn init(mut cx: init::Context) -> (Shared, Local) {
        let set = ParameterSet::nominal::<Ur5>(1);
        let config = FeedForwardConfig::for_arm::<Ur5, _>(1e-3);
        let mut feedforward = FeedForward::new(config, set).expect("a sound configuration");
        feedforward.set_learning(true);
        let learner = cx.local.empty;
        learner
            .restart(LearnerConfig::for_arm::<Ur5>(1e-3), &set)
            .expect("a sound configuration");
        // A millisecond at 168 MHz, as in the emulator; a real board starts its PLL first.
        cx.core.SYST.set_clock_source(SystClkSource::Core);
        cx.core.SYST.set_reload(168_000 - 1);
        cx.core.SYST.clear_current();
        cx.core.SYST.enable_counter();
        cx.core.SYST.enable_interrupt();
        (
            Shared {
                exchange: Exchange::new(),
            },
            Local {
                feedforward,
                learner,
            },
        )
    }

    /// Every millisecond: drives → feed-forward → drives.
    #[task(binds = SysTick, priority = 2, shared = [exchange], local = [feedforward])]
    fn tick(mut cx: tick::Context) {
        // Replace both by your drives and your trajectory.
        let measured = Some(JointMeasurement::zero());
        let desired = JointMotion::zero();

        cx.shared
            .exchange
            .lock(|exchange| cx.local.feedforward.adopt(exchange));
        let torque = cx
            .local
            .feedforward
            .step(&JointSample { desired, measured });
        core::hint::black_box(torque.total);
        let _still_busy = learn::spawn(cx.local.feedforward.learning_sample(measured));
    }

    /// In the rest of the period; the tick preempts `study`.
    #[task(priority = 1, shared = [exchange], local = [learner])]
    async fn learn(mut cx: learn::Context, sample: LearningSample<6>) {
        let learner = cx.local.learner;
        cx.shared
            .exchange
            .lock(|exchange| learner.collect(&sample, exchange));
        learner.study(&sample);
        cx.shared
            .exchange
            .lock(|exchange| learner.publish(exchange));
    }
}

#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    cortex_m::peripheral::SCB::sys_reset()
}
