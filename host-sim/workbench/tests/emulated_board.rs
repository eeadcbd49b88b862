//! The firmware in the emulator, through its real links.

use crate::trial::{
    Dialogue, TIMEOUT, connected, credible, native, paced, sample, scratch, started,
};
use foretorque::arm::ur5::JOINTS;
use foretorque_f405::chip;
use foretorque_link::wire::{Configuration, CounterKind, Pacing};
use foretorque_workbench::board::Client;
use foretorque_workbench::board::qemu::{Emulator, Image, QemuOptions};
use nix::sys::signal::kill;
use nix::unistd::Pid;

fn emulator(image: Image) -> Emulator {
    started(&QemuOptions::new(image))
}

fn client(image: Image) -> Client<JOINTS> {
    connected(emulator(image))
}

#[test]
fn the_flashable_firmware_boots_when_time_is_that_of_the_wall() {
    let mut options = QemuOptions::new(Image::Joint);
    options.icount_shift = None;
    let mut client = connected(started(&options));
    assert_eq!(client.hello().counter, CounterKind::None);
    assert_eq!(client.sample(&sample(0)).expect("a torque").tick, 0);
}

#[test]
fn the_flashable_firmware_gives_the_same_bytes_as_the_native_board_while_it_learns() {
    let expected = Dialogue::begin(native()).learn(600);
    let shared = QemuOptions::new(Image::Joint);
    let mut apart = shared.clone();
    // A host on another core goes on the moment it is answered.
    apart.core = None;
    for options in [shared, apart] {
        let answered = Dialogue::begin(started(&options)).learn(600);
        assert!(answered == expected, "joint and native board differ");
    }
}

#[test]
fn the_second_board_answers_as_the_first_and_holds_its_own_enable_low() {
    // What goes to the set/reset register of GPIOB to switch PB8 off (RM0090 8.4.7).
    const OFF: &str = "write (size 4, offset 0x018, value 0x01000000)";
    let trace = scratch("pyboard.trace");
    let mut options = QemuOptions::new(Image::Joint);
    options.elf.set_file_name("joint-pyboard");
    options.trace = Some(trace.clone());
    let expected = Dialogue::begin(native()).learn(100);
    let answered = Dialogue::begin(started(&options)).learn(100);
    assert!(answered == expected, "the two boards differ");
    let trace = std::fs::read_to_string(trace).expect("the emulator writes a trace");
    let off = |line: &str| line.contains("GPIOB") && line.contains(OFF);
    assert!(trace.lines().any(off));
}

#[test]
fn the_bulk_firmware_gives_the_same_bytes_as_the_native_board_while_it_learns() {
    let expected = Dialogue::begin(native()).learn(10_000);
    let answered = Dialogue::begin(emulator(Image::Bulk)).learn(10_000);
    assert!(answered == expected, "bulk and native board differ");
    let frozen = Dialogue::begin(native()).learn(0);
    let learnt = expected[expected.len() - 60..] != frozen[frozen.len() - 60..];
    assert!(learnt, "nothing was learnt");
}

#[test]
fn costs_repeat_from_run_to_run() {
    let run = |image| {
        let mut client = client(image);
        client.learning(true).expect("the board learns");
        for k in 0..200 {
            client.sample(&sample(k)).expect("a torque");
        }
        client.statistics().expect("counters")
    };
    let (first, second) = (run(Image::Joint), run(Image::Joint));
    println!("joint {first:?}");
    assert_eq!(first.tick_cost, second.tick_cost);
    assert_eq!(first.learn_cost, second.learn_cost);
    assert_eq!(first.receive_cost, second.receive_cost);
    assert!(first.tick_cost.mean > 1000 && first.receive_cost.mean > 10);
    // What docs/protocol.md allots to the interrupt.
    assert!(u64::from(first.receive_cost.max) <= chip::RECEIVE_INSTRUCTIONS);
    let lost = [first.late_sets, first.learning_samples_lost, first.overruns];
    assert_eq!(lost, [0; 3]);
    let (first, second) = (run(Image::Bulk), run(Image::Bulk));
    println!("bulk {first:?}");
    assert_eq!(first.tick_cost, second.tick_cost);
    assert_eq!(first.learn_cost, second.learn_cost);
}

#[test]
fn the_timer_runs_the_tick_at_its_period_when_it_paces() {
    let mut client = client(Image::Joint);
    client.timeout = TIMEOUT;
    paced(&mut client, 2000, Pacing::SysTick);
    let mut last = None;
    for k in 0..20 {
        let reply = client.sample(&sample(k)).expect("an answer");
        assert!(last.is_none_or(|last| reply.tick > last), "ticks go on");
        last = Some(reply.tick);
    }
    // And back: the link paces again.
    client.configure(Configuration::default()).expect("a board");
    assert_eq!(client.sample(&sample(0)).expect("a torque").tick, 0);
    assert_eq!(client.sample(&sample(1)).expect("a torque").tick, 1);
}

#[test]
fn a_board_out_of_scope_leaves_no_process() {
    let joint = emulator(Image::Joint);
    let id = Pid::from_raw(joint.process_id() as i32);
    drop(joint);
    assert!(kill(id, None).is_err(), "the process is reaped");
}

#[test]
fn a_firmware_that_is_missing_or_none_is_reported() {
    let none = concat!(env!("CARGO_MANIFEST_DIR"), "/Cargo.toml");
    let missing = ["no firmware at /nowhere/joint", "`cargo xtask arm`"];
    for (elf, words) in [("/nowhere/joint", missing), (none, ["died", "fatal"])] {
        let mut options = QemuOptions::new(Image::Joint);
        options.elf = elf.into();
        let text = Emulator::start(&options).expect_err(elf).to_string();
        assert!(words.iter().all(|word| text.contains(word)), "{text}");
    }
    let elf = Image::Bulk.elf_of("an arm without images");
    assert!(!elf.display().to_string().contains(".."), "{elf:?}");
}

#[test]
fn no_learning_sample_is_lost_and_no_set_late_at_a_thousand_ticks_a_second() {
    // A board paced by its timer runs some twenty ticks for each sample that reaches it from here, one each millisecond of
    // its own time: there the learner has to be fast enough. Where the link paces the answer waits for it.
    for (pacing, samples) in [(Pacing::Link, 700), (Pacing::SysTick, 100)] {
        let mut client = client(Image::Joint);
        client.timeout = TIMEOUT;
        paced(&mut client, 1000, pacing);
        client.learning(true).expect("the board learns");
        for k in 0..samples {
            client.sample(&credible(k)).expect("a torque");
        }
        let seen = client.statistics().expect("counters");
        println!("{pacing:?} {seen:?}");
        assert!(seen.ticks >= samples);
        assert!(pacing == Pacing::SysTick || seen.learn_cost.mean > 10_000);
        let lost = [seen.late_sets, seen.learning_samples_lost, seen.overruns];
        assert_eq!(lost, [0; 3]);
    }
}
