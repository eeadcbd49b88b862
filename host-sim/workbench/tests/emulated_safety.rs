//! Arming, time-out, stop, restart and watchdog of the flashable firmware in the emulator, as the pins and the line show it.

mod patched;

use foretorque::arm::ur5::{JOINTS, PARAMETERS, Ur5};
use foretorque::joint::{JointMeasurement, JointMotion, JointSample, JointVector};
use foretorque_link::safety::{SafetyReason, SafetyState};
use foretorque_link::wire::{Configuration, Field, NackReason, Pacing, ResetReason};
use foretorque_link::write_key::WriteKey;
use foretorque_workbench::board::qemu::{Emulator, Image, QemuOptions};
use foretorque_workbench::board::{BoardError, Client};
use patched::patched;
use std::fs;
use std::path::PathBuf;
use std::time::Duration;

const BOOT: Duration = Duration::from_secs(5);
/// Trace of a write to the set/reset register of GPIOB that switches the torque enable, PB12, on or off (RM0090 8.4.7).
const ON: &str = "write (size 4, offset 0x018, value 0x00001000)";
const OFF: &str = "write (size 4, offset 0x018, value 0x10000000)";

/// The firmware in the emulator, and the trace of its pins.
struct Trial {
    client: Client<JOINTS>,
    trace: PathBuf,
}

impl Trial {
    fn start(name: &str) -> Self {
        Self::of(name, QemuOptions::new(Image::Joint))
    }

    fn of(name: &str, mut options: QemuOptions) -> Self {
        let trace = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("{name}.trace"));
        options.trace = Some(trace.clone());
        let emulator = Emulator::start(&options).unwrap_or_else(|error| panic!("{error}"));
        let mut client = Client::connect::<Ur5, PARAMETERS>(Box::new(emulator), BOOT)
            .unwrap_or_else(|error| panic!("{error}"));
        client.set_timeout(BOOT);
        Self { client, trace }
    }

    fn lines(&self, device: &str) -> Vec<String> {
        let trace = fs::read_to_string(&self.trace).expect("the emulator writes a trace");
        let lines = trace.lines().filter(|line| line.contains(device));
        lines.map(str::to_owned).collect()
    }

    /// The torque enable as it was switched last.
    fn enabled(&self) -> bool {
        let lines = self.lines("GPIOB");
        let last = lines
            .iter()
            .rfind(|line| line.contains(ON) || line.contains(OFF));
        last.expect("the pin was set at start-up").contains(ON)
    }

    /// Arms the board and lets its torque rise.
    fn arm(&mut self) {
        self.client.arm(&sample()).expect("it can be armed");
        for _ in 0..40 {
            self.client.sample(&sample()).expect("a torque");
        }
        let torque = self.client.sample(&sample()).expect("a torque").total;
        assert!(torque.norm() > 10.0, "{torque}");
        assert!(self.enabled());
    }
}

/// The arm stretched out, at rest.
fn sample() -> JointSample<JOINTS> {
    JointSample {
        desired: JointMotion::zero(),
        measured: Some(JointMeasurement {
            q: JointVector::zeros(),
            tau: JointVector::zeros(),
        }),
    }
}

fn refusal(trial: &mut Trial) -> SafetyReason {
    match trial.client.arm(&sample()) {
        Err(BoardError::Refused(NackReason::Unsafe(reason))) => reason,
        other => panic!("{other:?}"),
    }
}

#[test]
fn the_enable_pin_follows_arming_disarming_and_stopping() {
    let mut trial = Trial::start("enable");
    for _ in 0..20 {
        let reply = trial.client.sample(&sample()).expect("an answer");
        assert_eq!(reply.total, JointVector::<JOINTS>::zeros());
    }
    assert!(!trial.enabled(), "nobody has armed it");
    trial.arm();
    trial.client.disarm().expect("it obeys");
    assert!(!trial.enabled());
    trial.arm();
    trial.client.stop().expect("it obeys");
    // The pin is switched after the answer; the answer to the next sample comes after that.
    let after = trial.client.sample(&sample()).expect("an answer");
    assert!(!trial.enabled());
    assert_eq!(after.total, JointVector::<JOINTS>::zeros());
    assert_eq!(refusal(&mut trial), SafetyReason::Stopped);
    trial.client.clear_fault().expect("the torque is off");
    trial.arm();
}

#[test]
fn a_board_paced_by_its_timer_ends_the_torque_when_samples_stay_away() {
    let mut trial = Trial::start("timeout");
    let configuration = Configuration {
        // The time-out is some two hundred ticks then. Whenever the board is idle the emulator leaps to its next tick: a
        // host that gets its turn late has been silent for a while.
        period_us: 250,
        pacing: Pacing::SysTick,
        ..Configuration::default()
    };
    trial
        .client
        .configure(configuration)
        .expect("it has a timer");
    let armed = (0..100).any(|_| trial.client.arm(&sample()).is_ok());
    assert!(armed, "it can be armed");
    trial.client.sample(&sample()).expect("a torque");
    let pins = trial.lines("GPIOB");
    assert!(pins.iter().any(|line| line.contains(ON)), "it was armed");
    // The time of the emulator moves on with traffic on its link; this traffic has no sample.
    let silence = (0..10_000).find(|_| {
        trial.client.statistics().expect("counters");
        !trial.enabled()
    });
    assert!(silence.is_some(), "the torque ends");
    let after = trial.client.sample(&sample()).expect("an answer");
    assert_eq!(after.total, JointVector::<JOINTS>::zeros());
    assert_eq!(after.safety.state, SafetyState::Disarmed);
    assert_eq!(after.safety.reason, SafetyReason::CommandTimeout);
    assert!(!trial.enabled(), "samples do not arm");
}

#[test]
fn a_restart_disarms_and_keeps_the_latched_fault() {
    let mut trial = Trial::start("restart");
    trial.arm();
    trial.client.reboot().expect("it is received");
    let error = trial
        .client
        .statistics()
        .expect_err("the board sends its hello anew");
    assert!(
        matches!(error, BoardError::Restarted(ResetReason::Software)),
        "{error}"
    );
    assert!(!trial.enabled());
    for _ in 0..20 {
        let reply = trial.client.sample(&sample()).expect("an answer");
        assert_eq!(reply.total, JointVector::<JOINTS>::zeros());
        assert_eq!(reply.safety.state, SafetyState::Disarmed);
    }
    trial.arm();
    trial.client.stop().expect("it obeys");
    trial.client.reboot().expect("it is received");
    trial
        .client
        .statistics()
        .expect_err("the board sends its hello anew");
    assert_eq!(trial.client.safety().reason, SafetyReason::Stopped);
    assert_eq!(refusal(&mut trial), SafetyReason::Stopped);
    trial.client.clear_fault().expect("the torque is off");
    trial.arm();
}

/// The flashable firmware with the handler of `symbol` replaced by a loop that never ends.
fn hung(symbol: &str) -> PathBuf {
    // `b .` (ARM DDI 0403, A7.7.12, encoding T2)
    let patches = [(symbol, vec![0xE7FE])];
    patched(
        &Image::Joint.default_elf(),
        &format!("joint-hung-{symbol}"),
        &patches,
    )
}

/// Feeds of the watchdog (RM0090 21.4.1) that the emulator saw.
fn feeds(trial: &Trial) -> usize {
    // The emulator calls the page at 0x4000_3000 by the name of a neighbour that other chips have there.
    let lines = trial.lines("I2S2ext");
    let fed = |line: &&String| line.contains("offset 0x000") && line.contains("aaaa");
    lines.iter().filter(fed).count()
}

#[test]
fn the_watchdog_is_fed_while_every_task_answers() {
    let mut trial = Trial::start("fed");
    let start = feeds(&trial);
    for _ in 0..100 {
        trial.client.sample(&sample()).expect("an answer");
        // Two samples that come close together are answered by one feed: a question leaves the board time between them.
        trial.client.statistics().expect("counters");
    }
    let statistics = trial.client.statistics().expect("counters");
    assert!(feeds(&trial) >= start + 90, "{} feeds", feeds(&trial));
    assert!(statistics.watchdog_feeds >= 90, "{statistics:?}");
}

#[test]
fn the_watchdog_goes_hungry_when_the_learner_hangs_although_the_tick_goes_on() {
    let mut options = QemuOptions::new(Image::Joint);
    options.elf = hung("EXTI2");
    let mut trial = Trial::of("hungry", options);
    trial.client.wait_for_learning(false);
    let start = feeds(&trial);
    for _ in 0..100 {
        trial.client.sample(&sample()).expect("the tick goes on");
    }
    assert_eq!(feeds(&trial), start, "nobody feeds it");
    let statistics = trial.client.statistics().expect("counters");
    assert_eq!(statistics.ticks, 100);
    assert!(statistics.watchdog_feeds <= 1, "{statistics:?}");
}

#[test]
fn a_board_with_a_key_in_its_flash_takes_signed_banks_only() {
    let key = [0xA7; 16];
    let file = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("board.key");
    fs::write(&file, key).expect("the directory is there");
    let mut options = QemuOptions::new(Image::Joint);
    options.key = Some(file);
    let mut trial = Trial::of("key", options);
    let before = trial.client.read_bank().expect("reading is free");
    let mut bank = before.clone();
    bank.columns[0].value += 0.5;
    let error = trial.client.upload_bank(&bank).expect_err("it has a key");
    assert!(error.to_string().contains("--key-file"), "{error}");
    let stranger = WriteKey::from_slot([1; 16]).expect("a key");
    trial.client.set_write_key(stranger);
    let error = trial.client.upload_bank(&bank).expect_err("a wrong key");
    assert!(
        matches!(error, BoardError::Refused(NackReason::Key)),
        "{error}"
    );
    assert_eq!(trial.client.read_bank().expect("a bank"), before);
    trial
        .client
        .set_write_key(WriteKey::from_slot(key).expect("a key"));
    trial.client.upload_bank(&bank).expect("the right key");
    assert_eq!(trial.client.read_bank().expect("a bank"), bank);
}

#[test]
fn telemetry_comes_over_the_line_beside_the_replies() {
    let mut trial = Trial::start("telemetry");
    let all = (1 << Field::ALL.len()) - 1;
    let error = trial.client.stream(all, 1).expect_err("the line is full");
    let BoardError::Refused(NackReason::Bandwidth { every }) = error else {
        panic!("{error}");
    };
    trial.client.stream(all, every).expect("so seldom it fits");
    for _ in 0..3 * every {
        trial.client.sample(&sample()).expect("an answer");
    }
    let frames = trial.client.take_telemetry();
    let of_first = frames.iter().filter(|frame| frame.tick == frames[0].tick);
    let fields = of_first.fold(0, |fields, frame| fields | frame.fields);
    assert_eq!(fields, all);
}
