//! Everything that can be broken, and the way out: whatever fails, the torque goes off. The store on simulated flash, and
//! the board that begins with what its flash holds. `cargo xtask faults` runs the whole campaign.
//!
//! `faults` is a firmware that carries the fault handlers of the flashable one and fails on request. The emulator has no
//! flash interface, but it can be given flash that was written by the same store on the host.

use foretorque::arm::Arm;
use foretorque::arm::ur5::{PARAMETERS, Ur5};
use foretorque_flash::SimulatedFlash;
use foretorque_link::bank::ParameterBank;
use foretorque_link::store::{SLOT_BYTES, Store, StoreError, saves, slots};
use foretorque_link::wire::ResetReason;
use foretorque_studies::faults::machine::{Crash, Trial};
use foretorque_studies::faults::store::{SECTOR, SMALL_SECTOR, set};
use foretorque_studies::faults::{Lengths, scenarios};
use foretorque_workbench::board::Client;
use foretorque_workbench::board::qemu::{Emulator, Image, QemuOptions};
use foretorque_workbench::parallel::{cores, in_parallel};
use std::path::PathBuf;
use std::time::Duration;

#[test]
fn every_crash_switches_the_torque_off_and_is_reported_once() {
    let source = include_str!("../../firmware/images/src/bin/faults.rs");
    let panics = |line: usize| {
        let line = source.lines().nth(line - 1);
        line.is_some_and(|line| line.contains("panic!()"))
    };
    for crash in Crash::ALL {
        let scratch = PathBuf::from(env!("CARGO_TARGET_TMPDIR"));
        let trace = scratch.join(format!("{}.trace", crash.name));
        let mut trial = Trial::start(trace).unwrap_or_else(|error| panic!("{error}"));
        let hello = |trial: &mut Trial| {
            let hello = trial.hello().expect("the board lives");
            hello.expect("the board sends its hello")
        };
        let first = hello(&mut trial);
        // Nothing is kept over power-on.
        let kept = (first.reset_reason, first.counter_hz);
        assert_eq!(kept, (ResetReason::Unknown, 0));
        let on = [false, true];
        assert_eq!(trial.switched(), on, "the torque goes on after start-up");
        trial.fail(crash).expect("the board listens");
        let second = hello(&mut trial);
        assert_eq!(second.reset_reason, crash.reason);
        // A line of the source, an address in the flash, and EXTI0 (RM0090 table 62).
        let place = second.counter_hz;
        let named = match crash.name {
            "panic" => panics(place as usize),
            "hard fault" => (0x0800_0000..0x0810_0000).contains(&place),
            "stack overflow" => place == 0,
            _ => place == 6,
        };
        assert!(named, "{crash:?} at {place:#x}");
        // The torque goes off before the reset.
        assert_eq!(trial.switched(), [false, true, false, false, true]);
        // The kept reason is reported once: a board that fails again gives the new reason.
        let [panic, ..] = Crash::ALL;
        trial.fail(panic).expect("the board listens");
        assert_eq!(hello(&mut trial).reset_reason, ResetReason::Panic);
    }
}

#[test]
fn every_kind_of_fault_is_survived_on_every_board() {
    let scratch = PathBuf::from(env!("CARGO_TARGET_TMPDIR"));
    let all = scenarios(Lengths::SHORT, 1, &scratch);
    let campaigns = in_parallel(cores(), &all, |scenario| scenario.run(), || {});
    for (scenario, campaign) in all.iter().zip(campaigns) {
        let name = scenario.name;
        let campaign = campaign.unwrap_or_else(|error| panic!("{name}: {error}"));
        assert!(campaign.is_survived(), "{campaign:?}");
        let timed_out = name != "no samples" || campaign.timeouts > 5;
        assert!(timed_out, "{campaign:?}");
    }
}

type Flash = SimulatedFlash<SECTOR>;

fn loaded<const S: usize>(store: &mut Store<SimulatedFlash<S>>) -> Result<Vec<u8>, StoreError> {
    let mut buffer = [0; ParameterBank::MAX_BYTES];
    store.load(Ur5::HASH, &mut buffer).map(<[u8]>::to_vec)
}

#[test]
fn absence_is_told_apart() {
    let mut store = Store::new(SimulatedFlash::<SMALL_SECTOR>::new(1));
    assert_eq!(loaded(&mut store), Err(StoreError::Empty));
    store.save(7, &set(1)).unwrap();
    assert_eq!(loaded(&mut store), Err(StoreError::WrongArm { found: 7 }));
    store.flash_mut().rot(40, 3);
    assert_eq!(loaded(&mut store), Err(StoreError::Damaged));
    assert_eq!(store.save(7, &vec![0; 5000]), Err(StoreError::TooLong));
}

#[test]
fn saves_wear_both_sectors_alike_and_rewrite_no_word() {
    let mut store = Store::new(SimulatedFlash::<SECTOR>::new(1));
    let rounds = 5;
    let each = 2 * slots(SECTOR as u32);
    for number in 1..=rounds * each {
        store.save(Ur5::HASH, &set(number)).unwrap();
    }
    assert_eq!(loaded(&mut store), Ok(set(rounds * each)));
    assert_eq!(store.flash().rewritten(), 0);
    assert_eq!(store.flash().erases(), [u64::from(rounds); 2]);
    // The budget that the documentation states, from what was counted.
    assert_eq!(saves(SECTOR as u32), each * 10_000);
}

/// The bank in force on a board that boots with `flash`.
fn booted(name: &str, flash: Option<&Flash>) -> ParameterBank {
    let mut options = QemuOptions::new(Image::Joint);
    options.store = flash.map(|flash| {
        let file = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("{name}.flash"));
        std::fs::write(&file, flash.bytes()).expect("the directory is there");
        file
    });
    let board = Emulator::start(&options).unwrap_or_else(|error| panic!("{error}"));
    let client = Client::<6>::connect::<Ur5, PARAMETERS>(Box::new(board), Duration::from_secs(5));
    let mut client = client.unwrap_or_else(|error| panic!("{error}"));
    client.read_bank().unwrap_or_else(|error| panic!("{error}"))
}

fn bank(number: u32) -> ParameterBank {
    ParameterBank::decode(&set(number)).expect("it was just encoded")
}

#[test]
fn the_board_boots_with_the_newest_whole_set_of_its_arm() {
    let mut store = Store::new(Flash::new(1));
    for number in 1..=3 {
        store.save(Ur5::HASH, &set(number)).unwrap();
    }
    store.save(!Ur5::HASH, &set(4)).unwrap();
    assert_eq!(booted("whole", Some(store.flash())), bank(3));
    store.flash_mut().rot(2 * SLOT_BYTES as usize + 100, 5);
    assert_eq!(booted("rotten", Some(store.flash())), bank(2));
}

#[test]
fn without_a_set_the_board_boots_with_that_of_the_firmware() {
    let nominal = ParameterBank::nominal::<Ur5, 6, PARAMETERS>();
    assert_eq!(booted("none", None), nominal);
    assert_eq!(booted("blank", Some(&Flash::new(1))), nominal);
}
