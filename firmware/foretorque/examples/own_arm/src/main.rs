//! Firmware of a crate outside the workspace: an arm of its own, a critical section of its own. It shows that the library
//! links without a board or an executor; it has no vector table, so no board starts it.
//!
//! `src/arm.rs` of your crate is the output of `host-sim generate --robot FILE --out src/arm.rs`; the Panda stands for it here.
#![no_std]
#![no_main]

#[path = "../../../src/arm/panda.rs"]
mod arm;

use core::arch::asm;
use core::cell::RefCell;
use core::hint::black_box;

use arm::{Exchange, FeedForward, Learner, LearnerConfig, Panda, ParameterSet};
use critical_section::{Mutex, RawRestoreState};
use foretorque::feedforward::FeedForwardConfig;
use foretorque::joint::{JointMotion, JointSample};

/// Masks all interrupts by PRIMASK.
struct Masked;
critical_section::set_impl!(Masked);

// SAFETY: on one core nothing runs beside code with its interrupts masked.
unsafe impl critical_section::Impl for Masked {
    unsafe fn acquire() -> RawRestoreState {
        let masked: u32;
        // SAFETY: reads PRIMASK and masks interrupts.
        unsafe { asm!("mrs {}, PRIMASK", "cpsid i", out(reg) masked) };
        masked == 0
    }

    unsafe fn release(unmask: RawRestoreState) {
        if unmask {
            // SAFETY: interrupts were not masked before.
            unsafe { asm!("cpsie i") };
        }
    }
}

static EXCHANGE: Mutex<RefCell<Exchange>> = Mutex::new(RefCell::new(Exchange::new()));
/// On the stack there is no room for a learner.
static LEARNER: Mutex<RefCell<Learner>> = Mutex::new(RefCell::new(Learner::EMPTY));

/// Entry of the linker's default script.
#[unsafe(no_mangle)]
extern "C" fn _start() -> ! {
    run();
    loop {}
}

fn run() -> Option<()> {
    let set = ParameterSet::nominal::<Panda>(1);
    let config = FeedForwardConfig::for_arm::<Panda, _>(1e-3);
    let mut feed_forward = FeedForward::new(config, set).ok()?;
    let learner = LearnerConfig::for_arm::<Panda>(1e-3);
    critical_section::with(|token| LEARNER.borrow_ref_mut(token).restart(learner, &set)).ok()?;
    loop {
        let sample = black_box(JointSample {
            desired: JointMotion::zero(),
            measured: None,
        });
        critical_section::with(|token| {
            let exchange = &mut *EXCHANGE.borrow_ref_mut(token);
            let mut learner = LEARNER.borrow_ref_mut(token);
            feed_forward.adopt(exchange);
            black_box(feed_forward.step(&sample));
            learner.learn(&feed_forward.learning_sample(sample.measured), exchange);
        });
    }
}

#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    loop {}
}
