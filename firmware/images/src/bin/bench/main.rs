//! The kernels of the tick, called over seeded inputs: what `cargo xtask bench` counts and traces in the emulator.
//!
//! One line `name count` leaves over semihosting for every call of every row. The count is that of TIM2, which under
//! `-icount shift=0` advances by one for each executed instruction. The semihosting command line is the number of
//! calls of each row, then the number of ticks of the long run, of which one line `name least sum most` leaves.
//!
//! Rows of the UR5 are those of another arm where `FORETORQUE_ARM` names one to the build.
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
use foretorque_f405::arm::Learner;
#[cfg(target_os = "none")]
use stage::LINKS;

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
    let link = cortex_m::singleton!(: [MaybeUninit<commands::Link>; LINKS] = [const { MaybeUninit::uninit() }; LINKS])?;
    let mut link = link
        .each_mut()
        .map(|place| commands::Link::init(place).expect("a board of the UR5"));
    let bus = cortex_m::singleton!(: [MaybeUninit<bus::Bus>; LINKS] = [const { MaybeUninit::uninit() }; LINKS])?;
    let mut bus = bus
        .each_mut()
        .map(|place| bus::Bus::init(place).expect("a bus of the UR5"));
    let mut paper = cortex_m::singleton!(: stage::Paper = stage::Paper::zeros())?;
    let links: &[_] = if LINKS > 0 { rows::LINK_ROWS } else { &[] };
    for row in rows::ARM_ROWS.iter().chain(links) {
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
    let mut place = stage::Stage::new(parts);
    let stage = place.as_mut()?;
    stage.warm_up();
    for _ in 0..calls {
        stage.vary();
        for link in &mut stage.link {
            match row.name {
                "command" => link.next(false),
                "configure" => link.next(true),
                _ => {}
            }
        }
        let count = machine::count(row.run, stage);
        cortex_m_semihosting::hprintln!("{} {}", row.name, count);
    }
    place.map(|stage| (stage.learner, stage.link, stage.bus, stage.paper))
}

/// Counts the ticks of the long run.
#[cfg(target_os = "none")]
#[inline(never)]
fn count_long_run(ticks: u32, parts: stage::Parts) -> Option<()> {
    let mut place = stage::Stage::new(parts);
    let stage = place.as_mut()?;
    stage.warm_up();
    let spread = long_run::of_step(stage, ticks);
    cortex_m_semihosting::hprintln!(
        "feedforward_step {} {} {}",
        spread.least,
        spread.sum,
        spread.most
    );
    Some(())
}

foretorque_f405::on_the_host!();
