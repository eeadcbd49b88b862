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
    it: *mut Foretorque,
    _memory: Vec<MaybeUninit<u64>>,
}

impl Program {
    fn new() -> Self {
        let mut memory = vec![MaybeUninit::uninit(); foretorque_size().div_ceil(8)];
        let mut it = ptr::null_mut();
        let (place, size) = (memory.as_mut_ptr().cast(), 8 * memory.len());
        // SAFETY: the memory is large enough, aligned and outlives the program.
        let made = unsafe { foretorque_init(place, size, 1e-3, &raw mut it) };
        assert_eq!(made, ForetorqueStatus::Ok);
        let _memory = memory;
        Self { it, _memory }
    }

    /// One tick with a still sample, or with none.
    fn tick(&mut self, q: Option<f32>, measured: u8) -> ForetorqueTorque {
        let mut sample = MaybeUninit::<ForetorqueSample>::uninit();
        let place = sample.as_mut_ptr();
        let mut out = MaybeUninit::uninit();
        // SAFETY: fields are written before they are read; measured ones only where they are to be.
        unsafe {
            let q_rad = [q.unwrap_or_default(); FORETORQUE_JOINTS];
            (&raw mut (*place).q_rad).write(q_rad);
            (&raw mut (*place).qd_rad_s).write([0.0; FORETORQUE_JOINTS]);
            (&raw mut (*place).qdd_rad_s2).write([0.0; FORETORQUE_JOINTS]);
            (&raw mut (*place).measured).write(measured);
            if measured != 0 {
                (&raw mut (*place).measured_q_rad).write(q_rad);
                (&raw mut (*place).measured_tau_nm).write([0.0; FORETORQUE_JOINTS]);
            }
            let given = if q.is_some() {
                place.cast_const()
            } else {
                ptr::null()
            };
            let status = foretorque_tick(self.it, given, out.as_mut_ptr());
            assert_eq!(status, ForetorqueStatus::Ok);
            out.assume_init()
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
        let mut out = MaybeUninit::uninit();
        // SAFETY: `it` lives, and both other pointers are those of variables.
        unsafe {
            foretorque_tick(self.it, &raw const sample, out.as_mut_ptr());
            foretorque_learn(self.it);
        }
    }

    fn arm(&mut self) -> SafetyReason {
        let mut reason = 255;
        // SAFETY: both pointers are those of variables.
        let status = unsafe { foretorque_arm(self.it, &raw mut reason) };
        assert_eq!(status == ForetorqueStatus::Ok, reason == 0);
        SafetyReason::from_code(reason)
    }

    /// Output of `call`.
    fn written<T>(
        &self,
        call: unsafe extern "C" fn(*mut Foretorque, *mut T) -> ForetorqueStatus,
    ) -> T {
        let mut out = MaybeUninit::uninit();
        // SAFETY: written before it is read.
        unsafe {
            assert_eq!(call(self.it, out.as_mut_ptr()), ForetorqueStatus::Ok);
            out.assume_init()
        }
    }

    /// Bytes of the bank in force.
    fn bank(&self) -> Vec<u8> {
        let (mut bank, mut length) = (vec![0_u8; FORETORQUE_BANK_BYTES], 0);
        // SAFETY: `it` lives; every other pointer is to a variable.
        let saved = unsafe {
            foretorque_save_bank(self.it, bank.as_mut_ptr(), bank.len(), &raw mut length)
        };
        assert_eq!(saved, ForetorqueStatus::Ok);
        bank.truncate(length);
        bank
    }

    fn safety(&self) -> ForetorqueSafety {
        self.written(foretorque_safety)
    }

    /// Decision `number`, where it is made and kept.
    fn decision(&self, number: u32) -> Option<ForetorqueDecision> {
        let mut out = MaybeUninit::uninit();
        // SAFETY: `it` lives; written before it is read.
        unsafe {
            match foretorque_decision(self.it, number, out.as_mut_ptr()) {
                ForetorqueStatus::Ok => Some(out.assume_init()),
                status => {
                    assert_eq!(status, ForetorqueStatus::NoDecision);
                    None
                }
            }
        }
    }

    /// The newest decision for `reason`.
    fn decided(&self, reason: Reason) -> Option<ForetorqueDecision> {
        let made = (0..self.written(foretorque_quality).decisions).rev();
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
    // SAFETY: `it` lives.
    let status = unsafe { foretorque_load_bank(program.it, [0].as_ptr(), 1) };
    assert_eq!(status, ForetorqueStatus::Armed);
}

#[test]
fn a_time_out_ramps_within_the_limits_and_only_arming_brings_torque_back() {
    let mut program = Program::armed();
    let limits = program.written(foretorque_limits);
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
    let mut program = Program::armed();
    // SAFETY: `it` lives in all these calls.
    unsafe {
        use ForetorqueStatus::{Armed, Joint, Null, Ok};
        assert_eq!(foretorque_set_brake(program.it, 100_000), Armed);
        foretorque_stop(program.it, 0);
        let safety = program.safety();
        let stopped = SafetyReason::Stopped.code();
        assert_eq!((safety.enabled, safety.latched), (0, stopped));
        assert_eq!(program.tick(Some(0.0), 1).total_nm, NO_TORQUE);
        assert_eq!(program.arm(), SafetyReason::Stopped);
        let mut reason = 255;
        assert_eq!(foretorque_clear_fault(program.it, &raw mut reason), Ok);
        assert_eq!(foretorque_set_brake(program.it, 100_000), Ok);
        program.start();
        assert_eq!(program.safety().brake_released, 1);
        foretorque_disarm(program.it);
        let mut held = 0;
        while program.safety().enabled == 1 {
            assert_eq!(program.safety().brake_released, 0);
            held += u32::from(program.tick(None, 0).total_nm[1].abs() > 30.0);
        }
        assert!((98..=106).contains(&held), "{held}");
        let beyond = FORETORQUE_JOINTS as u32;
        assert_eq!(foretorque_temperature(program.it, beyond, 101), Joint);
        assert_eq!(foretorque_temperature(program.it, 2, 101), Ok);
        (0..3).for_each(|_| _ = program.tick(Some(0.0), 1));
        assert_eq!(program.arm(), SafetyReason::MotorHot);
        assert_eq!(foretorque_disarm(ptr::null_mut()), Null);
    }
}

/// A load of the saved bank, its parameters times `factor`.
#[test]
fn a_bank_that_no_board_takes_is_refused() {
    let program = Program::new();
    let saved = program.bank();
    for (factor, status) in [(1.1, ForetorqueStatus::Ok), (-3.0, ForetorqueStatus::Bank)] {
        let mut bank = ParameterBank::empty();
        bank.decode_into(&saved).expect("a bank");
        bank.columns.iter_mut().for_each(|it| it.value *= factor);
        let mut buffer = [0; ParameterBank::MAX_BYTES];
        let bytes = bank.encode(&mut buffer).expect("it has room");
        // SAFETY: `it` lives, and the bytes are as many.
        let loaded = unsafe { foretorque_load_bank(program.it, bytes.as_ptr(), bytes.len()) };
        assert_eq!(loaded, status, "{factor}");
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
        let program = Program::armed();
        // SAFETY: `it` lives.
        unsafe { foretorque_stop(program.it, code) };
        assert_eq!(program.safety().latched, latched.code(), "{code}");
    }
}

#[test]
fn an_emergency_stop_ends_learning_too() {
    for (reason, learns) in [(3, false), (13, true)] {
        let mut program = Program::armed();
        // SAFETY: `it` lives.
        unsafe {
            foretorque_set_learning(program.it, 1);
            foretorque_stop(program.it, reason);
        }
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
        let it = program.it;
        // SAFETY: `it` lives.
        unsafe {
            assert_eq!(foretorque_request(it, 1), ForetorqueStatus::Ok);
            foretorque_stop(it, reason);
        }
        (0..100).for_each(|tick| program.swing(tick));
        let snapshot = program.decided(Reason::SnapshotTaken);
        assert_eq!(snapshot.is_some(), taken, "reason {reason}");
    }
}

#[test]
fn the_learner_reports_its_state_and_takes_requests() {
    use ForetorqueStatus::{Null, Ok, Pending, Request};
    let mut program = Program::new();
    let fresh = program.written(foretorque_quality);
    assert_eq!((fresh.trust, fresh.payload_kg), (1.0, 0.0));
    assert_eq!(fresh.decisions, 0);
    let it = program.it;
    // SAFETY: `it` lives in all these calls.
    unsafe {
        foretorque_set_learning(it, 1);
        (0..1000).for_each(|tick| program.swing(tick));
        for (request, wanted) in [
            (0, Request),
            (5, Request),
            (6, Request),
            (1, Ok),
            (2, Pending),
        ] {
            assert_eq!(foretorque_request(it, request), wanted, "{request}");
        }
        assert_eq!(foretorque_request(ptr::null_mut(), 1), Null);
        (1000..1100).for_each(|tick| program.swing(tick));
        assert_eq!(foretorque_request(it, 2), Ok);
        (1100..1200).for_each(|tick| program.swing(tick));
    }
    let quality = program.written(foretorque_quality);
    assert!(quality.residual_rms[1] > 0.0 && quality.information > 0.0);
    for reason in [Reason::SnapshotTaken, Reason::RolledBack] {
        let joint = program.decided(reason).map(|made| made.joint);
        assert_eq!(joint, Some(255), "{reason:?}");
    }
    assert!(program.decision(quality.decisions).is_none());
    // SAFETY: null is what is tried.
    assert_eq!(unsafe { foretorque_decision(it, 0, ptr::null_mut()) }, Null);
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
    let program = Program::new();
    let it = program.it;
    let mut sample = ForetorqueSample::default();
    let mut torque = ForetorqueTorque::default();
    let mut numbers = Numbers(1);
    let mut lines = Vec::new();
    // SAFETY: `it` lives; every other pointer is to a variable.
    unsafe {
        foretorque_set_learning(it, 1);
        for tick in 0..TICKS {
            numbers.fill(&mut sample, tick);
            let lost = tick % 10 == 9;
            let given = if lost { ptr::null() } else { &raw const sample };
            foretorque_step(it, given, &raw mut torque);
            lines.push(line(&torque.total_nm));
            foretorque_learn(it);
        }
        foretorque_set_learning(it, 0);
        let bank = program.bank();
        let loaded = foretorque_load_bank(it, bank.as_ptr(), bank.len());
        assert_eq!(loaded, ForetorqueStatus::Ok);
        foretorque_step(it, &raw const sample, &raw mut torque);
    }
    lines.push(line(&torque.rigid_nm));
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
    let mut memory = vec![0_u64; foretorque_size().div_ceil(8)];
    let size = 8 * memory.len();
    let place: *mut core::ffi::c_void = memory.as_mut_ptr().cast();
    let mut it = ptr::null_mut();
    // SAFETY: as above; the null pointers are what is tried.
    unsafe {
        use ForetorqueStatus::{Bank, LearningOn, Misaligned, Null, Ok, Period, TooSmall};
        let nowhere = ptr::null_mut();
        assert_eq!(foretorque_init(nowhere, size, 1e-3, &raw mut it), Null);
        assert_eq!(foretorque_init(place, size, 1e-3, ptr::null_mut()), Null);
        assert_eq!(foretorque_init(place, 100, 1e-3, &raw mut it), TooSmall);
        let odd = place.byte_add(1);
        assert_eq!(foretorque_init(odd, size, 1e-3, &raw mut it), Misaligned);
        for period in [0.0, -1.0, 1e-9, 1.0, f32::INFINITY, f32::NAN] {
            assert_eq!(foretorque_init(place, size, period, &raw mut it), Period);
        }
        assert!(it.is_null());
        assert_eq!(foretorque_init(place, size, 1e-3, &raw mut it), Ok);
        let junk = [1_u8; 64];
        assert_eq!(foretorque_load_bank(it, junk.as_ptr(), junk.len()), Bank);
        assert_eq!(foretorque_load_bank(it, ptr::null(), 0), Null);
        foretorque_set_learning(it, 1);
        let refused = foretorque_load_bank(it, junk.as_ptr(), junk.len());
        assert_eq!(refused, LearningOn);
        let (mut buffer, mut length) = ([0_u8; 16], 0);
        let saved = foretorque_save_bank(it, buffer.as_mut_ptr(), buffer.len(), &raw mut length);
        assert_eq!((saved, length), (TooSmall, 0));
        assert_eq!(foretorque_learn(ptr::null_mut()), Null);
        assert_eq!(foretorque_step(it, ptr::null(), ptr::null_mut()), Null);
    }
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
