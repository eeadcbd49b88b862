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
static mut LEARNER: Learner = Learner::EMPTY;

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
    // SAFETY: this function runs once, and nothing else uses the static.
    let learner = unsafe { &mut *(&raw mut LEARNER) };
    let configured = learner.restart(LearnerConfig::for_arm::<Panda>(1e-3), &set);
    configured.ok()?;
    loop {
        let sample = black_box(JointSample {
            desired: JointMotion::zero(),
            measured: None,
        });
        critical_section::with(|token| feed_forward.adopt(&mut EXCHANGE.borrow_ref_mut(token)));
        black_box(feed_forward.step(&sample));
        // Interrupts are masked for two copies only, not while it studies.
        let sample = feed_forward.learning_sample(sample.measured);
        critical_section::with(|token| {
            learner.collect(&sample, &mut EXCHANGE.borrow_ref_mut(token))
        });
        learner.study(&sample);
        critical_section::with(|token| learner.publish(&mut EXCHANGE.borrow_ref_mut(token)));
    }
}

#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    loop {}
}
