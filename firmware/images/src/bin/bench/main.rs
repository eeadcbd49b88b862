//! The kernels of the tick, called over seeded inputs: what `cargo xtask bench` counts and traces in the emulator.
//!
//! One line `name count` leaves over semihosting for every call of every row. The count is that of TIM2, which under
//! `-icount shift=0` advances by one for each executed instruction. The semihosting command line is the number of
//! calls of each row, then the number of ticks of the long run, of which one line `name least sum most` leaves.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod bus;
#[cfg(target_os = "none")]
mod commands;
#[cfg(target_os = "none")]
mod long_run;
#[cfg(target_os = "none")]
mod machine;
#[cfg(target_os = "none")]
mod rows;
#[cfg(target_os = "none")]
mod stage;

#[cfg(target_os = "none")]
use core::mem::MaybeUninit;

#[cfg(target_os = "none")]
use foretorque::arm::ur5::Learner;

#[cfg(target_os = "none")]
#[cortex_m_rt::entry]
fn main() -> ! {
    use cortex_m_semihosting::{debug, hprintln};

    machine::start_counter();
    let (calls, ticks) = machine::numbers();
    if run(calls, ticks).is_none() {
        hprintln!("the configuration of the tick does not validate");
        debug::exit(debug::EXIT_FAILURE);
    }
    debug::exit(debug::EXIT_SUCCESS);
    loop {
        cortex_m::asm::nop();
    }
}

#[cfg(target_os = "none")]
fn run(calls: u32, ticks: u32) -> Option<()> {
    /// Too large for the stack, and for code that would build it: it lies in the image.
    static mut LEARNER: Learner = stage::Stage::LEARNER;
    // SAFETY: this function runs once, nothing else names the static, and no interrupt is enabled.
    let mut learner = unsafe { &mut *core::ptr::addr_of_mut!(LEARNER) };
    let link = cortex_m::singleton!(: MaybeUninit<commands::Link> = MaybeUninit::uninit())?;
    let mut link = commands::Link::init(link)?;
    let bus = cortex_m::singleton!(: MaybeUninit<bus::Bus> = MaybeUninit::uninit())?;
    let mut bus = bus::Bus::init(bus)?;
    let mut paper = cortex_m::singleton!(: stage::Paper = stage::Paper::zeros())?;
    for row in rows::ROWS {
        (learner, link, bus, paper) = count_row(row, calls, (learner, link, bus, paper))?;
    }
    if ticks > 0 {
        count_long_run(ticks, (learner, link, bus, paper))?;
    }
    Some(())
}

/// Counts the calls of a row from a new stage, so that a row added or removed does not move the others. A function of its
/// own: the stack has no room for two stages.
#[cfg(target_os = "none")]
#[inline(never)]
fn count_row(row: &rows::Row, calls: u32, parts: stage::Parts) -> Option<stage::Parts> {
    let mut stage = stage::Stage::new(parts)?;
    for _ in 0..calls {
        stage.vary();
        match row.name {
            "command" => stage.link.next(false),
            "configure" => stage.link.next(true),
            _ => {}
        }
        let count = machine::count(row.run, &mut stage);
        cortex_m_semihosting::hprintln!("{} {}", row.name, count);
    }
    Some((stage.learner, stage.link, stage.bus, stage.paper))
}

/// Counts the ticks of the long run.
#[cfg(target_os = "none")]
#[inline(never)]
fn count_long_run(ticks: u32, parts: stage::Parts) -> Option<()> {
    let mut stage = stage::Stage::new(parts)?;
    let spread = long_run::of_step(&mut stage, ticks);
    cortex_m_semihosting::hprintln!(
        "feedforward_step {} {} {}",
        spread.least,
        spread.sum,
        spread.most
    );
    Some(())
}

foretorque_f405::on_the_host!();
