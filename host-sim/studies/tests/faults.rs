//! Ten seconds of each kind of fault (`cargo xtask faults` runs the whole campaign), and the way out of the firmware: whatever fails, the torque goes off, and the restarted board reports why it restarted.
//!
//! `faults` is a firmware that carries the fault handlers of the flashable one and fails on request.

use foretorque_link::wire::ResetReason;
use foretorque_studies::faults::machine::{Crash, Trial};
use foretorque_studies::faults::{Lengths, scenarios};
use std::path::PathBuf;

/// Fails in the way of `crash`; reason and place that the restarted board gives.
fn fail(name: &str, crash: Crash) -> (ResetReason, u32) {
    let trace = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("{name}.trace"));
    let mut trial = Trial::start(trace).unwrap_or_else(|error| panic!("{error}"));
    let hello = |trial: &mut Trial| {
        let hello = trial.hello().expect("the board lives");
        hello.expect("the board sends its hello")
    };
    let first = hello(&mut trial);
    assert_eq!(
        (first.reset_reason, first.counter_hz),
        (ResetReason::Unknown, 0),
        "nothing is kept over power-on"
    );
    assert_eq!(
        trial.switched(),
        [false, true],
        "the torque goes on after start-up"
    );
    trial.fail(crash).expect("the board listens");
    let second = hello(&mut trial);
    assert_eq!(
        trial.switched(),
        [false, true, false, false, true],
        "the torque goes off before the reset"
    );
    // The kept reason is reported once: a board that fails again gives the new reason.
    trial.fail(Crash::Panic).expect("the board listens");
    assert_eq!(hello(&mut trial).reset_reason, ResetReason::Panic);
    (second.reset_reason, second.counter_hz)
}

#[test]
fn a_panic_switches_the_torque_off_and_is_reported() {
    let (reason, line) = fail("panic", Crash::Panic);
    assert_eq!(reason, ResetReason::Panic);
    let source = include_str!("../../../firmware/images/src/bin/faults.rs");
    let panics = source
        .lines()
        .nth(line as usize - 1)
        .expect("a line of the source");
    assert!(panics.contains("panic!()"), "line {line}: {panics}");
}

#[test]
fn an_undefined_instruction_switches_the_torque_off_and_is_reported() {
    let (reason, place) = fail("udf", Crash::UndefinedInstruction);
    assert_eq!(reason, ResetReason::Fault);
    assert!(
        (0x0800_0000..0x0810_0000).contains(&place),
        "{place:#x} is in the flash"
    );
}

#[test]
fn a_stack_overflow_switches_the_torque_off_and_is_reported() {
    assert_eq!(fail("stack", Crash::StackOverflow), (ResetReason::Fault, 0));
}

#[test]
fn an_interrupt_without_a_handler_switches_the_torque_off_and_is_reported() {
    // EXTI0 is interrupt 6 (RM0090 table 62).
    assert_eq!(
        fail("interrupt", Crash::StrayInterrupt),
        (ResetReason::Fault, 6)
    );
}

#[test]
fn every_kind_of_fault_is_survived_on_every_board() {
    let scratch = PathBuf::from(env!("CARGO_TARGET_TMPDIR"));
    for scenario in scenarios(Lengths::SHORT, 1, &scratch) {
        let name = scenario.name;
        let campaign = scenario
            .run()
            .unwrap_or_else(|error| panic!("{name}: {error}"));
        assert!(campaign.is_survived(), "{campaign:?}");
    }
}
