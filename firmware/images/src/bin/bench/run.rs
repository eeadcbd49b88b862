//! The emulated machine and its program: counter, command line, rows, long run, way out.

use core::hint::black_box;
use core::mem::MaybeUninit;
use core::panic::PanicInfo;

use cortex_m_semihosting::hprintln;
use foretorque_f405::arm::Learner;
use foretorque_images::{exit, words};
use stm32f4xx_hal::pac::TIM2;

use crate::bus::Bus;
use crate::commands::Link;
use crate::stage::{
    ARM_ROWS, LINK_ROWS, LINKS, Paper, Parts, Row, Stage, feedforward_step, learning_step,
};

/// Calls of each row when the command line names no number.
const CALLS: u32 = 64;

#[cortex_m_rt::entry]
fn main() -> ! {
    start_counter();
    let (calls, ticks) = numbers();
    let done = run(calls, ticks).is_some();
    if !done {
        hprintln!("the configuration of the tick does not validate");
    }
    exit(done)
}

fn run(calls: u32, ticks: u32) -> Option<()> {
    /// Too large for the stack, and for code that would build it: it lies in the image.
    static mut LEARNER: Learner = Stage::LEARNER;
    // SAFETY: this function runs once, nothing else names the static, and no interrupt is enabled.
    let mut learner = unsafe { &mut *core::ptr::addr_of_mut!(LEARNER) };
    let link = cortex_m::singleton!(: [MaybeUninit<Link>; LINKS] = [const { MaybeUninit::uninit() }; LINKS])?;
    let mut link = link
        .each_mut()
        .map(|place| Link::init(place).expect("a board of the UR5"));
    let bus = cortex_m::singleton!(: [MaybeUninit<Bus>; LINKS] = [const { MaybeUninit::uninit() }; LINKS])?;
    let mut bus = bus
        .each_mut()
        .map(|place| Bus::init(place).expect("a bus of the UR5"));
    let mut paper = cortex_m::singleton!(: Paper = Paper::zeros())?;
    let links: &[_] = if LINKS > 0 { LINK_ROWS } else { &[] };
    for row in ARM_ROWS.iter().chain(links) {
        (learner, link, bus, paper) = count_row(row, calls, (learner, link, bus, paper))?;
    }
    if ticks > 0 {
        count_long_run(ticks, (learner, link, bus, paper))?;
    }
    Some(())
}

/// Counts the calls of a row from a new stage, so that a row added or removed does not move the others. A function of its
/// own: the stack has no room for two stages.
#[inline(never)]
fn count_row(row: &Row, calls: u32, parts: Parts) -> Option<Parts> {
    let mut place = Stage::new(parts);
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
        hprintln!("{} {}", row.name, count(row.run, stage));
    }
    place.map(|stage| (stage.learner, stage.link, stage.bus, stage.paper))
}

/// Instructions of `FeedForward::step` and of the learning step after it over `ticks` samples, no two alike: least, sum and
/// most of each. It shows whether their cost depends on the input, and on what the learner decides.
///
/// The arm's smooth motion is broken every third tick by a random state, which leaves the range that was learnt and
/// slews the torque, every eleventh by a missing measurement. Ticks whose desired motion is no number do less and are
/// no part of it.
#[inline(never)]
fn count_long_run(ticks: u32, parts: Parts) -> Option<()> {
    let mut place = Stage::new(parts);
    let stage = place.as_mut()?;
    stage.warm_up();
    let (mut tick_cost, mut learning_cost) = (Spread::NONE, Spread::NONE);
    for tick in 0..ticks {
        stage.vary();
        if tick % 3 == 2 {
            stage.sample.desired = stage.motion;
        }
        if tick % 11 == 10 {
            stage.sample.measured = None;
        }
        stage.feedforward.adopt(&mut stage.exchange);
        tick_cost.add(count(feedforward_step, stage));
        stage.learning_sample = stage.feedforward.learning_sample(stage.sample.measured);
        learning_cost.add(count(learning_step, stage));
    }
    tick_cost.print("feedforward_step");
    learning_cost.print("learning_step");
    Some(())
}

/// Least, sum and most of some counts.
struct Spread(u32, u64, u32);

impl Spread {
    const NONE: Self = Self(u32::MAX, 0, 0);

    fn add(&mut self, count: u32) {
        *self = Self(
            self.0.min(count),
            self.1 + u64::from(count),
            self.2.max(count),
        );
    }

    fn print(&self, row: &str) {
        hprintln!("{} {} {} {}", row, self.0, self.1, self.2);
    }
}

/// Lets TIM2 run freely.
fn start_counter() {
    // SAFETY: nothing else in this program touches the timer.
    let timer = unsafe { &*TIM2::ptr() };
    timer.psc().reset();
    // SAFETY: every value of the reload register is allowed; the largest makes differences wrap at 2^32.
    timer.arr().write(|w| unsafe { w.bits(u32::MAX) });
    timer.cr1().write(|w| w.cen().enabled());
}

fn now() -> u32 {
    // SAFETY: a read of a counter nobody writes after `start_counter`; it has no side effect.
    unsafe { &*TIM2::ptr() }.cnt().read().bits()
}

/// Counts between two readings around one call. Not inlined: every row has the same bracket.
#[inline(never)]
fn count(run: fn(&mut Stage), stage: &mut Stage) -> u32 {
    let before = now();
    black_box(run)(black_box(stage));
    now().wrapping_sub(before)
}

/// The numbers on the command line that the host passes by semihosting: calls of each row, ticks of the long run.
fn numbers() -> (u32, u32) {
    let mut text = [0u8; 32];
    let mut words = words(&mut text).into_iter().flatten();
    let mut number = || core::str::from_utf8(words.next()?).ok()?.parse().ok();
    (number().unwrap_or(CALLS), number().unwrap_or(0))
}

#[panic_handler]
fn panic(info: &PanicInfo) -> ! {
    hprintln!("{}", info);
    exit(false)
}
