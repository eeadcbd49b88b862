//! The safety through the C interface, called as C calls it: memory uninitialised, flags of any value.

use foretorque_capi::*;
use foretorque_link::safety::{SafetyReason, SafetyState};
use std::mem::MaybeUninit;
use std::ptr;

/// An arm in the memory of a C program.
struct Program {
    it: *mut Foretorque,
    _memory: Vec<MaybeUninit<u64>>,
}

impl Program {
    fn new() -> Self {
        let mut memory = vec![MaybeUninit::uninit(); foretorque_size().div_ceil(8)];
        let mut it = ptr::null_mut();
        // SAFETY: the memory is large enough, aligned and outlives the program.
        let made = unsafe {
            foretorque_init(
                memory.as_mut_ptr().cast(),
                8 * memory.len(),
                1e-3,
                &raw mut it,
            )
        };
        assert_eq!(made, ForetorqueStatus::Ok);
        Self {
            it,
            _memory: memory,
        }
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

    fn safety(&self) -> ForetorqueSafety {
        self.written(foretorque_safety)
    }

    fn armed() -> Self {
        let mut program = Self::new();
        (0..3).for_each(|_| _ = program.tick(Some(0.0), 1));
        assert_eq!(program.arm(), SafetyReason::None);
        (0..40).for_each(|_| _ = program.tick(Some(0.0), 255));
        program
    }
}

#[test]
fn torque_needs_fresh_samples_and_arming() {
    let mut program = Program::new();
    assert_eq!(program.arm(), SafetyReason::NoSample);
    for _ in 0..10 {
        // Not measured, so nothing to arm on.
        assert_eq!(program.tick(Some(0.0), 0).total_nm, [0.0; 6]);
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
    assert_eq!(program.tick(Some(0.0), 1).total_nm, [0.0; 6]);
}

#[test]
fn a_stop_is_immediate_and_a_brake_gets_its_time() {
    let mut program = Program::armed();
    // SAFETY: `it` lives in all these calls.
    unsafe {
        use ForetorqueStatus::{Armed, Null, Ok};
        assert_eq!(foretorque_set_brake(program.it, 100_000), Armed);
        foretorque_stop(program.it, 0);
        let safety = program.safety();
        let stopped = SafetyReason::Stopped.code();
        assert_eq!((safety.enabled, safety.latched), (0, stopped));
        assert_eq!(program.tick(Some(0.0), 1).total_nm, [0.0; 6]);
        assert_eq!(program.arm(), SafetyReason::Stopped);
        let mut reason = 255;
        assert_eq!(foretorque_clear_fault(program.it, &raw mut reason), Ok);
        assert_eq!(foretorque_set_brake(program.it, 100_000), Ok);
        (0..3).for_each(|_| _ = program.tick(Some(0.0), 1));
        assert_eq!(program.arm(), SafetyReason::None);
        (0..40).for_each(|_| _ = program.tick(Some(0.0), 1));
        assert_eq!(program.safety().brake_released, 1);
        foretorque_disarm(program.it);
        let mut held = 0;
        while program.safety().enabled == 1 {
            assert_eq!(program.safety().brake_released, 0);
            held += u32::from(program.tick(None, 0).total_nm[1].abs() > 30.0);
        }
        assert!((98..=106).contains(&held), "{held}");
        foretorque_temperature(program.it, 2, 101);
        (0..3).for_each(|_| _ = program.tick(Some(0.0), 1));
        assert_eq!(program.arm(), SafetyReason::MotorHot);
        assert_eq!(foretorque_disarm(ptr::null_mut()), Null);
    }
}
