//! The C interface, called as C calls it: memory uninitialised, flags of any value. The C program in the emulator gives the
//! bits of the library in this process, and the committed header is the one that the source gives.
//!
//! `cargo xtask test` builds the C program first, `cargo xtask capi` does so alone.

use foretorque::learning::Reason;
use foretorque_capi::*;
use foretorque_link::bank::ParameterBank;
use foretorque_link::safety::{SafetyReason, SafetyState};
use std::fs;
use std::mem::MaybeUninit;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::ptr;

const TICKS: u32 = 300;
const NO_TORQUE: [f32; FORETORQUE_JOINTS] = [0.0; FORETORQUE_JOINTS];
/// Seconds after which the emulator is stopped; it needs less than one.
const TIMEOUT_S: &str = "60";

/// An arm in the memory of a C program.
struct Program {
    arm: &'static mut Foretorque,
}

impl Program {
    fn new() -> Self {
        let memory = vec![MaybeUninit::<u64>::uninit(); foretorque_size().div_ceil(8)].leak();
        let (place, size) = (memory.as_mut_ptr().cast(), 8 * memory.len());
        let mut arm = MaybeUninit::uninit();
        // SAFETY: the memory is large enough, aligned and never freed; the pointer is written where the call succeeds.
        let arm = unsafe {
            let made = foretorque_init(place, size, 1e-3, Some(&mut arm));
            assert_eq!(made, ForetorqueStatus::Ok);
            &mut *arm.assume_init()
        };
        Self { arm }
    }

    fn it(&mut self) -> Option<&mut Foretorque> {
        Some(&mut *self.arm)
    }

    /// One tick with a still sample, or with none.
    fn tick(&mut self, q: Option<f32>, measured: u8) -> ForetorqueTorque {
        let q_rad = [q.unwrap_or_default(); FORETORQUE_JOINTS];
        let still = [0.0; FORETORQUE_JOINTS];
        let mut sample = MaybeUninit::<ForetorqueSample>::uninit();
        let place = sample.as_mut_ptr();
        // SAFETY: fields are written before they are read; measured ones only where they are to be.
        unsafe {
            (&raw mut (*place).q_rad).write(q_rad);
            (&raw mut (*place).qd_rad_s).write(still);
            (&raw mut (*place).qdd_rad_s2).write(still);
            (&raw mut (*place).measured).write(measured);
            if measured != 0 {
                (&raw mut (*place).measured_q_rad).write(q_rad);
                (&raw mut (*place).measured_tau_nm).write(still);
            }
            let given = q.map(|_| &sample);
            self.written(|it, out| foretorque_tick(it, given, out))
        }
    }

    /// One tick of a swing with torques that no parameters of the description give, and a learning step.
    fn swing(&mut self, tick: u32) {
        let time = tick as f32 * 1e-3;
        let mut sample = ForetorqueSample {
            measured: 1,
            ..ForetorqueSample::default()
        };
        for joint in 0..FORETORQUE_JOINTS {
            let omega = 1.0 + 0.2 * joint as f32;
            let (sin, cos) = (omega * time).sin_cos();
            sample.q_rad[joint] = 0.5 * sin;
            sample.qd_rad_s[joint] = 0.5 * omega * cos;
            sample.qdd_rad_s2[joint] = -0.5 * omega * omega * sin;
            sample.measured_tau_nm[joint] = 20.0 * cos;
        }
        sample.measured_q_rad = sample.q_rad;
        let sample = MaybeUninit::new(sample);
        // SAFETY: the sample is initialised.
        self.written(|it, out| unsafe { foretorque_tick(it, Some(&sample), out) });
        foretorque_learn(self.it());
    }

    fn arm(&mut self) -> SafetyReason {
        let mut reason = MaybeUninit::new(255);
        let status = foretorque_arm(self.it(), Some(&mut reason));
        // SAFETY: initialised above.
        let reason = unsafe { reason.assume_init() };
        assert_eq!(status == ForetorqueStatus::Ok, reason == 0);
        SafetyReason::from_code(reason)
    }

    /// Output of `call`.
    fn written<T>(
        &mut self,
        call: impl FnOnce(Option<&mut Foretorque>, Option<&mut MaybeUninit<T>>) -> ForetorqueStatus,
    ) -> T {
        let mut out = MaybeUninit::uninit();
        assert_eq!(call(self.it(), Some(&mut out)), ForetorqueStatus::Ok);
        // SAFETY: a call that succeeds has written it.
        unsafe { out.assume_init() }
    }

    /// Bytes of the bank in force.
    fn bank(&mut self) -> Vec<u8> {
        let mut bank = vec![0_u8; FORETORQUE_BANK_BYTES];
        let (buffer, size) = (bank.as_mut_ptr(), bank.len());
        // SAFETY: the buffer has `size` bytes.
        let length =
            self.written(|it, length| unsafe { foretorque_save_bank(it, buffer, size, length) });
        bank.truncate(length);
        bank
    }

    fn load(&mut self, bank: &[u8]) -> ForetorqueStatus {
        // SAFETY: the bytes are as many.
        unsafe { foretorque_load_bank(self.it(), bank.as_ptr(), bank.len()) }
    }

    fn safety(&mut self) -> ForetorqueSafety {
        self.written(|it, out| foretorque_safety(it, out))
    }

    fn quality(&mut self) -> ForetorqueQuality {
        self.written(|it, out| foretorque_quality(it, out))
    }

    /// Decision `number`, where it is made and kept.
    fn decision(&mut self, number: u32) -> Option<ForetorqueDecision> {
        let mut out = MaybeUninit::uninit();
        match foretorque_decision(self.it(), number, Some(&mut out)) {
            // SAFETY: a call that succeeds has written it.
            ForetorqueStatus::Ok => Some(unsafe { out.assume_init() }),
            status => {
                assert_eq!(status, ForetorqueStatus::NoDecision);
                None
            }
        }
    }

    /// The newest decision for `reason`.
    fn decided(&mut self, reason: Reason) -> Option<ForetorqueDecision> {
        let made = (0..self.quality().decisions).rev();
        let mut kept = made.filter_map(|number| self.decision(number));
        kept.find(|decision| decision.reason == reason as u8)
    }

    /// Arms, and lets the torque come.
    fn start(&mut self) {
        (0..3).for_each(|_| _ = self.tick(Some(0.0), 1));
        assert_eq!(self.arm(), SafetyReason::None);
        (0..40).for_each(|_| _ = self.tick(Some(0.0), 255));
    }

    fn armed() -> Self {
        let mut program = Self::new();
        program.start();
        program
    }
}

#[test]
fn torque_needs_fresh_samples_and_arming() {
    let mut program = Program::new();
    assert_eq!(program.arm(), SafetyReason::NoSample);
    for _ in 0..10 {
        // Not measured, so nothing to arm on.
        assert_eq!(program.tick(Some(0.0), 0).total_nm, NO_TORQUE);
    }
    assert_eq!(program.arm(), SafetyReason::NoSample);
    let mut program = Program::armed();
    let shoulder = program.tick(Some(0.0), 1).total_nm[1];
    assert!(shoulder.abs() > 30.0, "{shoulder}");
    let safety = program.safety();
    assert_eq!(safety.state, SafetyState::Armed as u8);
    assert_eq!(safety.enabled, 1);
    assert_eq!(program.load(&[0]), ForetorqueStatus::Armed);
}

#[test]
fn a_time_out_ramps_within_the_limits_and_only_arming_brings_torque_back() {
    let mut program = Program::armed();
    let limits = program.written(|it, out| foretorque_limits(it, out));
    assert_eq!((limits.timeout_ticks, limits.measurement_ticks), (51, 101));
    let mut before = program.tick(Some(0.0), 1).total_nm;
    for k in 1..=60 {
        let now = program.tick(None, 0).total_nm;
        for joint in 0..FORETORQUE_JOINTS {
            let step = (now[joint] - before[joint]).abs();
            assert!(step <= 1.0001 * limits.slew_nm[joint], "tick {k}");
        }
        before = now;
        let armed = program.safety().state == SafetyState::Armed as u8;
        assert_eq!(armed, k < limits.timeout_ticks, "tick {k}");
    }
    let reason = program.safety().reason;
    assert_eq!(reason, SafetyReason::CommandTimeout.code());
    assert_eq!(program.tick(Some(0.0), 1).total_nm, NO_TORQUE);
}

#[test]
fn a_stop_is_immediate_and_a_brake_gets_its_time() {
    use ForetorqueStatus::{Armed, Joint, Null, Ok};
    let mut program = Program::armed();
    assert_eq!(foretorque_set_brake(program.it(), 100_000), Armed);
    foretorque_stop(program.it(), 0);
    let safety = program.safety();
    let stopped = SafetyReason::Stopped.code();
    assert_eq!((safety.enabled, safety.latched), (0, stopped));
    assert_eq!(program.tick(Some(0.0), 1).total_nm, NO_TORQUE);
    assert_eq!(program.arm(), SafetyReason::Stopped);
    // The tick of a caller that has a safety of its own, too.
    let sample = MaybeUninit::new(ForetorqueSample::default());
    // SAFETY: the sample is initialised.
    let step = |it: Option<&mut Foretorque>, out: Option<&mut MaybeUninit<ForetorqueTorque>>| unsafe {
        foretorque_step(it, Some(&sample), out)
    };
    assert_eq!(program.written(step).total_nm, NO_TORQUE);
    program.written(|it, out| foretorque_clear_fault(it, out));
    assert_ne!(program.written(step).total_nm, NO_TORQUE);
    assert_eq!(foretorque_set_brake(program.it(), 100_000), Ok);
    program.start();
    assert_eq!(program.safety().brake_released, 1);
    foretorque_disarm(program.it());
    let mut held = 0;
    while program.safety().enabled == 1 {
        assert_eq!(program.safety().brake_released, 0);
        held += u32::from(program.tick(None, 0).total_nm[1].abs() > 30.0);
    }
    assert!((98..=106).contains(&held), "{held}");
    let beyond = FORETORQUE_JOINTS as u32;
    assert_eq!(foretorque_temperature(program.it(), beyond, 101), Joint);
    assert_eq!(foretorque_temperature(program.it(), 2, 101), Ok);
    (0..3).for_each(|_| _ = program.tick(Some(0.0), 1));
    assert_eq!(program.arm(), SafetyReason::MotorHot);
    assert_eq!(foretorque_disarm(None), Null);
}

/// A load of the saved bank, its parameters times `factor`.
#[test]
fn a_bank_that_no_board_takes_is_refused() {
    let mut program = Program::new();
    let saved = program.bank();
    for (factor, status) in [(1.1, ForetorqueStatus::Ok), (-3.0, ForetorqueStatus::Bank)] {
        let mut bank = ParameterBank::empty();
        bank.decode_into(&saved).expect("a bank");
        bank.columns.iter_mut().for_each(|it| it.value *= factor);
        let mut buffer = [0; ParameterBank::MAX_BYTES];
        let bytes = bank.encode(&mut buffer).expect("it has room");
        assert_eq!(program.load(bytes), status, "{factor}");
    }
}

#[test]
fn a_stop_latches_a_fault_and_nothing_else() {
    use SafetyReason::{Drive, Image, MotorWarm, Restarted, Stopped};
    for (code, latched) in [
        (Drive.code(), Drive),
        (Restarted.code(), Restarted),
        (1, Stopped),
        (MotorWarm.code(), Stopped),
        (Image.code(), Stopped),
        (99, Stopped),
    ] {
        let mut program = Program::armed();
        foretorque_stop(program.it(), code);
        assert_eq!(program.safety().latched, latched.code(), "{code}");
    }
}

#[test]
fn an_emergency_stop_ends_learning_too() {
    for (reason, learns) in [(3, false), (13, true)] {
        let mut program = Program::armed();
        foretorque_set_learning(program.it(), 1);
        foretorque_stop(program.it(), reason);
        let before = program.bank();
        let mut changed = false;
        for tick in 0..10_000 {
            program.swing(tick);
            changed |= tick % 100 == 0 && program.bank() != before;
        }
        assert_eq!(changed, learns, "reason {reason}");
    }
}

#[test]
fn an_emergency_stop_replaces_a_request_that_waits() {
    for (reason, taken) in [(3, false), (13, true)] {
        let mut program = Program::armed();
        let asked = foretorque_request(program.it(), 1);
        assert_eq!(asked, ForetorqueStatus::Ok);
        foretorque_stop(program.it(), reason);
        (0..100).for_each(|tick| program.swing(tick));
        let snapshot = program.decided(Reason::SnapshotTaken);
        assert_eq!(snapshot.is_some(), taken, "reason {reason}");
    }
}

#[test]
fn the_learner_reports_its_state_and_takes_requests() {
    use ForetorqueStatus::{Null, Ok, Pending, Request};
    let mut program = Program::new();
    let fresh = program.quality();
    assert_eq!((fresh.trust, fresh.payload_kg), (1.0, 0.0));
    assert_eq!(fresh.decisions, 0);
    foretorque_set_learning(program.it(), 1);
    (0..1000).for_each(|tick| program.swing(tick));
    for (request, wanted) in [
        (0, Request),
        (5, Request),
        (6, Request),
        (1, Ok),
        (2, Pending),
    ] {
        let asked = foretorque_request(program.it(), request);
        assert_eq!(asked, wanted, "{request}");
    }
    assert_eq!(foretorque_request(None, 1), Null);
    (1000..1100).for_each(|tick| program.swing(tick));
    assert_eq!(foretorque_request(program.it(), 2), Ok);
    (1100..1200).for_each(|tick| program.swing(tick));
    let quality = program.quality();
    assert!(quality.residual_rms[1] > 0.0 && quality.information > 0.0);
    for reason in [Reason::SnapshotTaken, Reason::RolledBack] {
        let joint = program.decided(reason).map(|made| made.joint);
        assert_eq!(joint, Some(255), "{reason:?}");
    }
    assert!(program.decision(quality.decisions).is_none());
    assert_eq!(foretorque_decision(program.it(), 0, None), Null);
}

/// The numbers of main.c.
struct Numbers(u32);

impl Numbers {
    fn any(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        self.0.cast_signed() as f32 * (1.0 / 2_147_483_648.0)
    }

    fn fill(&mut self, sample: &mut ForetorqueSample, tick: u32) {
        for joint in 0..FORETORQUE_JOINTS {
            let way = tick as f32 * 0.002 + 0.1 * joint as f32;
            sample.q_rad[joint] = way;
            sample.qd_rad_s[joint] = 2.0 + 0.1 * self.any();
            sample.qdd_rad_s2[joint] = self.any();
            sample.measured_q_rad[joint] = way;
            sample.measured_tau_nm[joint] = 10.0 * self.any();
        }
        sample.measured = 1;
    }
}

fn line(values: &[f32]) -> String {
    let words = values.iter().map(|v| format!("{:08x}", v.to_bits()));
    words.collect::<Vec<_>>().join(" ")
}

/// The computation of main.c on the host.
fn native() -> Vec<String> {
    let mut program = Program::new();
    let mut sample = ForetorqueSample::default();
    let step = |program: &mut Program, sample: Option<ForetorqueSample>| {
        let sample = sample.map(MaybeUninit::new);
        // SAFETY: the sample is initialised.
        program.written(|it, out| unsafe { foretorque_step(it, sample.as_ref(), out) })
    };
    let mut numbers = Numbers(1);
    let mut lines = Vec::new();
    foretorque_set_learning(program.it(), 1);
    for tick in 0..TICKS {
        numbers.fill(&mut sample, tick);
        let lost = tick % 10 == 9;
        let torque = step(&mut program, (!lost).then_some(sample));
        lines.push(line(&torque.total_nm));
        foretorque_learn(program.it());
    }
    foretorque_set_learning(program.it(), 0);
    let bank = program.bank();
    assert_eq!(program.load(&bank), ForetorqueStatus::Ok);
    lines.push(line(&step(&mut program, Some(sample)).rigid_nm));
    lines
}

fn emulated() -> Vec<String> {
    let target = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../target");
    let elf = target.join("thumbv7em-none-eabihf/firmware/capi-example");
    let place = elf.display();
    assert!(
        elf.is_file(),
        "no C program at {place}: build it with `cargo xtask capi`"
    );
    let out = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("capi.txt");
    let status = Command::new("timeout")
        .args([TIMEOUT_S, "qemu-system-arm", "-machine", "netduinoplus2"])
        .args(["-display", "none", "-monitor", "none"])
        .args(["-serial", "none", "-icount", "shift=3,sleep=off"])
        .args(["-semihosting-config", "enable=on,target=native,chardev=out"])
        .arg("-chardev")
        .arg(format!("file,id=out,path={}", out.display()))
        .arg("-kernel")
        .arg(&elf)
        .stdin(Stdio::null())
        .status()
        .expect("qemu-system-arm is installed");
    assert!(status.success(), "main returned {status}");
    let text = fs::read_to_string(out).expect("it has written something");
    text.lines().map(str::to_owned).collect()
}

#[test]
fn the_c_program_gives_the_same_bits_as_the_library_here() {
    let (native, emulated) = (native(), emulated());
    assert_eq!(emulated.len(), TICKS as usize + 1);
    assert_eq!(emulated, native);
    assert_ne!(native[0], native[200], "nothing moves");
}

#[test]
fn bad_calls_are_answered_and_change_nothing() {
    use ForetorqueStatus::{Bank, LearningOn, Misaligned, Null, Period, TooSmall};
    let mut memory = vec![0_u64; foretorque_size().div_ceil(8)];
    let whole = 8 * memory.len();
    let place: *mut core::ffi::c_void = memory.as_mut_ptr().cast();
    let mut it = MaybeUninit::new(ptr::null_mut());
    // SAFETY: of the memory no more is used than there is.
    let mut init = |place, size, period, out: bool| unsafe {
        foretorque_init(place, size, period, out.then_some(&mut it))
    };
    assert_eq!(init(ptr::null_mut(), whole, 1e-3, true), Null);
    assert_eq!(init(place, whole, 1e-3, false), Null);
    assert_eq!(init(place, 100, 1e-3, true), TooSmall);
    let odd = place.wrapping_byte_add(1);
    assert_eq!(init(odd, whole, 1e-3, true), Misaligned);
    for period in [0.0, -1.0, 1e-9, 1.0, f32::INFINITY, f32::NAN] {
        assert_eq!(init(place, whole, period, true), Period);
    }
    // SAFETY: initialised above.
    assert!(unsafe { it.assume_init() }.is_null());
    let mut program = Program::new();
    let junk = [1_u8; 64];
    assert_eq!(program.load(&junk), Bank);
    foretorque_set_learning(program.it(), 1);
    assert_eq!(program.load(&junk), LearningOn);
    let (mut buffer, mut length) = ([0_u8; 16], MaybeUninit::new(0));
    // SAFETY: the buffer has 16 bytes, and the length is initialised; null is what is tried.
    unsafe {
        let saved = foretorque_save_bank(program.it(), buffer.as_mut_ptr(), 16, Some(&mut length));
        assert_eq!((saved, length.assume_init()), (TooSmall, 0));
        assert_eq!(foretorque_load_bank(program.it(), ptr::null(), 0), Null);
        assert_eq!(foretorque_step(program.it(), None, None), Null);
    }
    assert_eq!(foretorque_learn(None), Null);
}

#[test]
fn the_header_is_that_of_the_source() {
    let place = Path::new(env!("CARGO_MANIFEST_DIR"));
    let config = cbindgen::Config::from_file(place.join("cbindgen.toml")).expect("a configuration");
    let bindings = cbindgen::Builder::new()
        .with_config(config)
        .with_src(place.join("src/lib.rs"))
        .generate()
        .expect("the source has bindings");
    let mut generated = Vec::new();
    bindings.write(&mut generated);
    let generated = String::from_utf8(generated).expect("text");
    let header = place.join("include/foretorque.h");
    if std::env::var_os("UPDATE_HEADER").is_some() {
        fs::write(&header, &generated).expect("the header can be written");
    }
    let committed = fs::read_to_string(&header).expect("the header is there");
    assert!(
        committed == generated,
        "include/foretorque.h is not up to date: `cargo xtask capi` writes it"
    );
    let joints = format!("#define FORETORQUE_JOINTS {}\n", foretorque_joints());
    assert!(committed.contains(&joints), "no `{joints}`");
}
