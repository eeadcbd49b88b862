//! Arming, time-out, stop, restart and watchdog of the flashable firmware in the emulator, as the pins and the line show it.

use crate::trial::{Dialogue, Trial, patched, scratch, sealed, started, still};
use foretorque::arm::ur5::JOINTS;
use foretorque::joint::JointVector;
use foretorque::limits::Flags;
use foretorque_link::safety::{SafetyReason, SafetyState};
use foretorque_link::wire::{
    BoardMessage, Configuration, Decoder, Field, HostMessage, ImageStatus, NackReason, Pacing,
    ResetReason, SampleFrame,
};
use foretorque_link::write_key::WriteKey;
use foretorque_workbench::board::BoardError;
use foretorque_workbench::board::qemu::{Image, QemuOptions};
use std::fs;
use std::path::PathBuf;

/// Trace of a write to the set/reset register of GPIOB that switches the torque enable, PB12, on or off (RM0090 8.4.7).
const ON: &str = "write (size 4, offset 0x018, value 0x00001000)";
const OFF: &str = "write (size 4, offset 0x018, value 0x10000000)";

fn start(name: &str) -> Trial {
    Trial::start(name, QemuOptions::new(Image::Joint))
}

/// Likewise for GPIOA and the brake release, PA1.
const OPEN: &str = "write (size 4, offset 0x018, value 0x00000002)";
const CLOSED: &str = "write (size 4, offset 0x018, value 0x00020000)";

/// The torque enable as it was switched last.
fn enabled(trace: &str) -> bool {
    last(trace, "GPIOB", [OFF, ON]).expect("the pin was set at start-up")
}

/// A pin as it was written last, low or high.
fn last(trace: &str, port: &str, [low, high]: [&str; 2]) -> Option<bool> {
    let mut writes = trace.lines().rev().filter(|line| line.contains(port));
    let found = writes.find(|line| line.contains(low) || line.contains(high));
    found.map(|line| line.contains(high))
}

/// Arms the board: its torque rises, its pin is on.
fn arm(trial: &mut Trial) {
    trial.arm();
    let torque = trial.sample(&still()).total;
    assert!(torque.norm() > 10.0, "{torque}");
    assert!(enabled(&trial.trace()));
}

#[test]
fn the_enable_pin_follows_arming_disarming_and_stopping() {
    let mut trial = start("enable");
    for _ in 0..20 {
        let reply = trial.sample(&still());
        assert_eq!(reply.total, JointVector::<JOINTS>::zeros());
    }
    assert!(!enabled(&trial.trace()), "it was never armed");
    arm(&mut trial);
    trial.client.disarm().expect("it obeys");
    assert!(!enabled(&trial.trace()));
    arm(&mut trial);
    trial.client.stop().expect("it obeys");
    // The pin is switched after the answer; the answer to the next sample comes after that.
    let after = trial.sample(&still());
    assert!(!enabled(&trial.trace()));
    assert_eq!(after.total, JointVector::<JOINTS>::zeros());
    assert_eq!(trial.refusal(), SafetyReason::Stopped);
    trial.client.clear_fault().expect("the torque is off");
    arm(&mut trial);
}

#[test]
fn a_board_paced_by_its_timer_ends_the_torque_when_samples_stay_away() {
    let mut trial = start("timeout");
    trial.arm_paced_by_timer();
    assert!(trial.trace().contains(ON), "it was armed");
    trial.silence_until(|trace| !enabled(trace));
    let after = trial.sample(&still());
    assert_eq!(after.total, JointVector::<JOINTS>::zeros());
    assert_eq!(after.safety.state, SafetyState::Disarmed);
    assert_eq!(after.safety.reason, SafetyReason::CommandTimeout);
    assert!(!enabled(&trial.trace()), "samples do not arm");
}

/// The time-out in ticks, as the replies of the board count them.
#[test]
fn silence_disarms_a_board_paced_by_its_timer_after_the_time_out_and_not_before() {
    let mut dialogue = Dialogue::begin(started(&QemuOptions::new(Image::Joint)));
    dialogue.send(&HostMessage::Configure(Configuration {
        period_us: 250,
        pacing: Pacing::SysTick,
        ..Configuration::default()
    }));
    let sample = HostMessage::Sample(SampleFrame::new(&still()));
    // Ticks of the last reply to a sample, of the one that was armed last, and of the next one.
    let (mut used, mut armed, mut ended) = (0, None, None);
    for k in 0..10_000 {
        let message = match armed {
            // It may have been silent for long since the samples before: the emulator leaps.
            None if k % 8 == 7 => &HostMessage::Arm,
            None => &sample,
            Some(_) => &HostMessage::Statistics,
        };
        dialogue.send(message);
        loop {
            let (number, frame) = dialogue.receive();
            if let BoardMessage::Torque(torque) = message_of(&frame) {
                if !Flags(torque.flags).contains(Flags::STALE_SAMPLE) {
                    used = torque.tick;
                }
                match torque.safety.state {
                    SafetyState::Armed => armed = Some(torque.tick),
                    _ if armed.is_some() && ended.is_none() => ended = Some(torque.tick),
                    _ => {}
                }
            }
            if number == dialogue.sequence {
                break;
            }
        }
        if let (Some(armed), Some(ended)) = (armed, ended) {
            assert_eq!(ended, armed + 1, "a reply is missing");
            // 50 ms, and a period that may have begun before.
            assert!((200..=202).contains(&(ended - used)), "{used} {ended}");
            return;
        }
    }
    panic!("the board stays armed");
}

fn message_of(frame: &[u8]) -> BoardMessage<JOINTS> {
    let mut decoder = Decoder::new();
    for &byte in frame {
        if let Some(frame) = decoder.push(byte) {
            return frame.expect("it was whole").message().expect("of a board");
        }
    }
    panic!("a frame has an end");
}

#[test]
fn a_restart_disarms_and_keeps_the_latched_fault() {
    let mut trial = start("restart");
    arm(&mut trial);
    trial.client.reboot().expect("it is received");
    let error = trial.client.statistics().expect_err("a new hello");
    let restarted = matches!(error, BoardError::Restarted(ResetReason::Software));
    assert!(restarted, "{error}");
    assert!(!enabled(&trial.trace()));
    for _ in 0..20 {
        let reply = trial.sample(&still());
        assert_eq!(reply.total, JointVector::<JOINTS>::zeros());
        assert_eq!(reply.safety.state, SafetyState::Disarmed);
    }
    arm(&mut trial);
    trial.client.stop().expect("it obeys");
    trial.client.reboot().expect("it is received");
    trial.client.statistics().expect_err("a new hello");
    assert_eq!(trial.client.safety().reason, SafetyReason::Stopped);
    assert_eq!(trial.refusal(), SafetyReason::Stopped);
    trial.client.clear_fault().expect("the torque is off");
    arm(&mut trial);
}

#[test]
fn the_brake_closes_first_and_gravity_is_kept_meanwhile() {
    let mut trial = start("brake");
    let configuration = Configuration {
        brake_close_ms: 100,
        ..Configuration::default()
    };
    trial.client.configure(configuration).expect("at rest");
    let released = |trial: &Trial| last(&trial.trace(), "GPIOA", [CLOSED, OPEN]) == Some(true);
    assert!(!released(&trial));
    arm(&mut trial);
    assert!(released(&trial));
    // 100 samples, one that may have begun, and the ramp, which is short for the torque of gravity.
    let before = trial.sample(&still()).tick;
    trial.client.disarm().expect("it obeys");
    let after = trial.sample(&still());
    assert!((102..=114).contains(&(after.tick - before)), "{after:?}");
    assert_eq!(after.total, JointVector::<JOINTS>::zeros());
    assert!(!enabled(&trial.trace()) && !released(&trial));
    let trace = trial.trace();
    assert!(trace.rfind(CLOSED) < trace.rfind(OFF), "the brake first");
}

#[test]
fn a_sealed_program_is_sound_and_one_with_a_flipped_bit_cannot_be_armed() {
    let elf = Image::Joint.default_elf();
    for (damaged, status) in [(false, ImageStatus::Sound), (true, ImageStatus::Damaged)] {
        let name = format!("sealed-{damaged}");
        let mut options = QemuOptions::new(Image::Joint);
        options.elf = sealed(&elf, &format!("{name}.elf"), damaged);
        let mut trial = Trial::start(&name, options);
        assert_eq!(trial.client.hello().chip.image, status);
        if !damaged {
            arm(&mut trial);
            continue;
        }
        (0..10).for_each(|_| _ = trial.sample(&still()));
        assert_eq!(trial.refusal(), SafetyReason::Image);
        let cleared = trial.client.clear_fault().expect_err("it stays");
        let refused = NackReason::Unsafe(SafetyReason::Image);
        let stays = matches!(cleared, BoardError::Refused(reason) if reason == refused);
        assert!(stays, "{cleared}");
        assert!(!enabled(&trial.trace()));
    }
}

/// The flashable firmware with the handler of `symbol` replaced by a loop that never ends.
fn hung(symbol: &str) -> PathBuf {
    // `b .` (ARM DDI 0403, A7.7.12, encoding T2)
    let (elf, name) = (Image::Joint.default_elf(), format!("joint-hung-{symbol}"));
    patched(&elf, &name, &[(symbol, vec![0xE7FE])])
}

/// Feeds of the watchdog (RM0090 21.4.1) that the emulator saw.
fn feeds(trial: &Trial) -> usize {
    // The emulator calls the page at 0x4000_3000 by the name of a neighbour that other chips have there.
    let words = ["I2S2ext", "offset 0x000", "aaaa"];
    let fed = |line: &&str| words.iter().all(|word| line.contains(word));
    trial.trace().lines().filter(fed).count()
}

#[test]
fn the_watchdog_is_fed_while_every_task_answers() {
    let mut trial = start("fed");
    let start = feeds(&trial);
    for _ in 0..100 {
        trial.sample(&still());
        // Two samples that come close together are answered by one feed: a question leaves the board time between them.
        trial.client.statistics().expect("counters");
    }
    let statistics = trial.client.statistics().expect("counters");
    assert!(feeds(&trial) >= start + 90, "{} feeds", feeds(&trial));
    assert!(statistics.watchdog_feeds >= 90, "{statistics:?}");
}

#[test]
fn the_watchdog_is_not_fed_when_the_learner_hangs_although_the_tick_goes_on() {
    let mut options = QemuOptions::new(Image::Joint);
    options.elf = hung("EXTI2");
    let mut trial = Trial::start("unfed", options);
    trial.client.waits_for_learning = false;
    let start = feeds(&trial);
    for _ in 0..100 {
        trial.sample(&still());
    }
    assert_eq!(feeds(&trial), start, "no feed");
    let statistics = trial.client.statistics().expect("counters");
    assert_eq!(statistics.ticks, 100);
    assert!(statistics.watchdog_feeds <= 1, "{statistics:?}");
}

#[test]
fn a_board_with_a_key_in_its_flash_takes_signed_banks_only() {
    let (key, file) = ([0xA7; 16], scratch("board.key"));
    fs::write(&file, key).expect("the directory is there");
    let mut options = QemuOptions::new(Image::Joint);
    options.key = Some(file);
    let mut trial = Trial::start("key", options);
    let before = trial.client.read_bank().expect("reading is free");
    let mut bank = before.clone();
    bank.columns[0].value += 0.5;
    let error = trial.client.upload_bank(&bank).expect_err("it has a key");
    assert!(error.to_string().contains("--key-file"), "{error}");
    let stranger = WriteKey::from_slot([1; 16]).expect("a key");
    trial.client.key = Some(stranger);
    let error = trial.client.upload_bank(&bank).expect_err("a wrong key");
    let refused = matches!(error, BoardError::Refused(NackReason::Key));
    assert!(refused, "{error}");
    assert_eq!(trial.client.read_bank().expect("a bank"), before);
    let own = WriteKey::from_slot(key).expect("a key");
    trial.client.key = Some(own);
    trial.client.upload_bank(&bank).expect("the right key");
    assert_eq!(trial.client.read_bank().expect("a bank"), bank);
}

#[test]
fn telemetry_comes_over_the_line_beside_the_replies() {
    let mut trial = start("telemetry");
    let all = (1 << Field::ALL.len()) - 1;
    let error = trial.client.stream(all, 1).expect_err("the line is full");
    let BoardError::Refused(NackReason::Bandwidth { every }) = error else {
        panic!("{error}");
    };
    trial.client.stream(all, every).expect("so seldom it fits");
    for _ in 0..3 * every {
        trial.sample(&still());
    }
    let frames = trial.client.take_telemetry();
    let of_first = frames.iter().filter(|frame| frame.tick == frames[0].tick);
    let fields = of_first.fold(0, |fields, frame| fields | frame.fields);
    assert_eq!(fields, all);
}
