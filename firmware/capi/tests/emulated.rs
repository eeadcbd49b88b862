//! The C program in the emulator gives the same bits as the library in this process.
//!
//! `cargo xtask test` builds it first, `cargo xtask capi` does so alone.

use foretorque_capi::*;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::ptr;

const TICKS: u32 = 300;
/// Seconds after which the emulator is stopped; it needs less than one.
const PATIENCE: &str = "60";

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
    let mut memory = vec![0_u64; foretorque_size().div_ceil(8)];
    let mut sample = ForetorqueSample::default();
    let mut torque = ForetorqueTorque::default();
    let mut numbers = Numbers(1);
    let mut lines = Vec::new();
    let mut it = ptr::null_mut();
    let (mut bank, mut length) = ([0_u8; 4096], 0);
    // SAFETY: the memory is large enough, aligned and outlives the last call; every pointer is to a variable above.
    unsafe {
        let size = 8 * memory.len();
        let made = foretorque_init(memory.as_mut_ptr().cast(), size, 1e-3, &raw mut it);
        assert_eq!(made, ForetorqueStatus::Ok);
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
        let saved = foretorque_save_bank(it, bank.as_mut_ptr(), bank.len(), &raw mut length);
        assert_eq!(saved, ForetorqueStatus::Ok);
        let loaded = foretorque_load_bank(it, bank.as_ptr(), length);
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
        .args([PATIENCE, "qemu-system-arm", "-machine", "netduinoplus2"])
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
