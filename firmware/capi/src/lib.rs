//! foretorque for firmware in C: tick, safety and learner of one arm, in memory that the caller owns.
//!
//! The header is `include/foretorque.h`, generated from this file; `example/main.c` is a whole program. Nothing allocates,
//! nothing blocks, nothing panics: linking the static library proves the last.
//!
//! Another arm is another `use` below: see docs/arms.md.
#![cfg_attr(target_os = "none", no_std)]

use core::mem::{MaybeUninit, align_of, size_of};
use core::{ptr, slice};

use foretorque::arm::Arm as _;
use foretorque::arm::ur5::{
    Exchange, FeedForward, JOINTS, Learner, LearnerConfig, ParameterSet, Ur5 as Arm,
};
use foretorque::feedforward::{FeedForwardConfig, gravity};
use foretorque::joint::{JointMeasurement, JointMotion, JointSample, JointVector};
use foretorque::learning::LearningSample;
use foretorque::limits::Flags;
use foretorque_link::bank::{NETWORK_SEED, ParameterBank};
use foretorque_link::safety::{Safety, SafetyLimits, SafetyReason};
#[cfg(target_os = "none")]
use panic_never as _;

/// Joints of the arm that this library was built for.
pub const FORETORQUE_JOINTS: usize = 6;

const _: () = assert!(FORETORQUE_JOINTS == JOINTS);

/// Shortest and longest period of the tick, s, as on the boards' link.
const PERIODS_S: core::ops::RangeInclusive<f32> = 1e-4..=0.1;

/// Result of a call.
#[repr(i32)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ForetorqueStatus {
    /// Done.
    Ok = 0,
    /// A pointer is null.
    Null = 1,
    /// The memory is smaller than `foretorque_size`, or the buffer too small for the bank.
    TooSmall = 2,
    /// The memory is not aligned to `foretorque_alignment`.
    Misaligned = 3,
    /// The period is not between 0.1 ms and 100 ms.
    Period = 4,
    /// The bytes are no parameter bank for this arm, or one with limits beyond the arm's.
    Bank = 5,
    /// Only while learning is off.
    LearningOn = 6,
    /// The safety refuses, with the reason.
    Refused = 7,
    /// Only while no torque flows.
    Armed = 8,
}

/// Input of one tick.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ForetorqueSample {
    /// Positions that the arm shall have in the tick in which the torque takes effect, rad.
    pub q_rad: [f32; FORETORQUE_JOINTS],
    /// Velocities, rad/s.
    pub qd_rad_s: [f32; FORETORQUE_JOINTS],
    /// Accelerations, rad/s^2.
    pub qdd_rad_s2: [f32; FORETORQUE_JOINTS],
    /// Measured positions, rad. Read only if `measured`.
    pub measured_q_rad: [f32; FORETORQUE_JOINTS],
    /// Measured torques, link side, N m. Read only if `measured`.
    pub measured_tau_nm: [f32; FORETORQUE_JOINTS],
    /// The measurement is fresh, unless 0.
    pub measured: u8,
}

impl ForetorqueSample {
    /// The sample at `place`; fields that are not to be read may be uninitialised.
    ///
    /// # Safety
    /// `place` is aligned, and the fields of the desired motion, `measured` and those that it announces may be read.
    unsafe fn read(place: *const Self) -> JointSample<JOINTS> {
        // SAFETY: field by field, as the caller promises.
        unsafe {
            let vector = |field: *const [f32; JOINTS]| field.read().into();
            let measured = (&raw const (*place).measured).read() != 0;
            JointSample {
                desired: JointMotion {
                    q: vector(&raw const (*place).q_rad),
                    qd: vector(&raw const (*place).qd_rad_s),
                    qdd: vector(&raw const (*place).qdd_rad_s2),
                },
                measured: measured.then(|| JointMeasurement {
                    q: vector(&raw const (*place).measured_q_rad),
                    tau: vector(&raw const (*place).measured_tau_nm),
                }),
            }
        }
    }
}

/// Output of one tick. Always finite.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ForetorqueTorque {
    /// The torque to add to the drives' set-points, after limits, N m; positive accelerates +q.
    pub total_nm: [f32; FORETORQUE_JOINTS],
    /// Rigid-body share, before limits, N m.
    pub rigid_nm: [f32; FORETORQUE_JOINTS],
    /// Friction share, before limits, N m.
    pub friction_nm: [f32; FORETORQUE_JOINTS],
    /// Network share, clipped, N m.
    pub network_nm: [f32; FORETORQUE_JOINTS],
    /// Flags of the tick, as bits; see docs/safety.md.
    pub flags: u32,
    /// Counter of the tick.
    pub tick: u32,
}

/// State of the safety, with the codes of docs/safety.md.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ForetorqueSafety {
    /// 0 disarmed, 1 armed, 2 ramp down, 3 fault.
    pub state: u8,
    /// Why the torque is, or may soon be, less than wanted.
    pub reason: u8,
    /// The fault that has to be cleared before arming; 0 is none. Keep it over a reset.
    pub latched: u8,
    /// 1 where the enable of the motor stages may be on.
    pub enabled: u8,
    /// 1 where brakes may be open.
    pub brake_released: u8,
}

/// Hard limits, which no bank and no call exceeds.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ForetorqueLimits {
    /// Largest torque, N m.
    pub torque_nm: [f32; FORETORQUE_JOINTS],
    /// Largest change of the torque in one tick, N m.
    pub slew_nm: [f32; FORETORQUE_JOINTS],
    /// Ticks without a usable sample after which the torque ends.
    pub timeout_ticks: u32,
    /// Ticks without a plausible measurement after which the torque ends.
    pub measurement_ticks: u32,
}

/// Feed-forward, safety and learner of one arm. Opaque: C has a pointer into its own memory.
pub struct Foretorque {
    feed_forward: FeedForward,
    safety: Safety<JOINTS>,
    /// Time that brakes take to close, ticks.
    brake_ticks: u32,
    learner: Learner,
    exchange: Exchange,
    /// Learning sample of the last tick, until the learner takes it.
    lesson: Option<LearningSample<JOINTS>>,
    bank: ParameterBank,
    /// Buffer for a bank on its way in, which has no effect before all of it is checked.
    incoming: ParameterBank,
    period_s: f32,
}

impl Foretorque {
    /// Makes a feed-forward at tick 0 in `place`, part by part: as a whole it would lie on the stack first. `None` if the
    /// period cannot work; then `place` is worth nothing.
    ///
    /// # Safety
    /// `place` is aligned, may be written and is not shared.
    unsafe fn init_in_place(place: *mut Self, period_s: f32) -> Option<()> {
        /// A learner of zeros, until it is restarted: the image of one with a single other number in it would take 33 kB.
        const BLANK: Learner = {
            // SAFETY: zeros are a value of every field. The compiler looks at the value of a constant, and takes none that
            // is not valid.
            unsafe { MaybeUninit::zeroed().assume_init() }
        };
        if !PERIODS_S.contains(&period_s) {
            return None;
        }
        let set = ParameterSet::nominal::<Arm>(NETWORK_SEED);
        let config = FeedForwardConfig::for_arm::<Arm, _>(period_s);
        // SAFETY: every part of `place` may be written, and the learner is read only after it was.
        unsafe {
            (&raw mut (*place).feed_forward).write(FeedForward::new(config, set).ok()?);
            let limits = SafetyLimits::for_arm::<Arm, _>((period_s * 1e6 + 0.5) as u32);
            (&raw mut (*place).safety).write(Safety::new(limits, SafetyReason::None));
            (&raw mut (*place).brake_ticks).write(0);
            (&raw mut (*place).exchange).write(Exchange::new());
            (&raw mut (*place).lesson).write(None);
            (&raw mut (*place).bank).write(ParameterBank::nominal::<Arm, _, _>());
            (&raw mut (*place).incoming).write(ParameterBank::empty());
            (&raw mut (*place).period_s).write(period_s);
            let learner = &raw mut (*place).learner;
            learner.write(BLANK);
            (*learner)
                .restart(LearnerConfig::for_arm::<Arm>(period_s), &set)
                .ok()
        }
    }

    fn load(&mut self, bytes: &[u8]) -> Option<()> {
        self.incoming.decode_into(bytes).ok()?;
        let set = self.incoming.set::<Arm, _, _>().ok()?;
        let config = self
            .incoming
            .feed_forward_config::<Arm, _, _>(self.period_s)
            .ok()?;
        self.feed_forward.configure(config).ok()?;
        let start = self.incoming.start_deviations::<Arm, _, _>();
        self.feed_forward.load_with(set, start, &mut self.exchange);
        core::mem::swap(&mut self.bank, &mut self.incoming);
        Some(())
    }

    fn step(&mut self, sample: Option<JointSample<JOINTS>>, guarded: bool) -> ForetorqueTorque {
        self.feed_forward.adopt(&mut self.exchange);
        let mut sample = sample;
        if guarded {
            self.safety.period();
            self.safety.set_brake_ticks(self.brake_ticks);
            sample = self.safety.admit(sample, 1, SafetyReason::None);
        }
        let mut torque = match &sample {
            Some(sample) => self.feed_forward.step(sample),
            None => self.feed_forward.step_stale(),
        };
        if guarded {
            if torque.flags.contains(Flags::GRAVITY_LOST) {
                self.safety.check(SafetyReason::GravityLost);
            }
            let withdrawn = torque
                .flags
                .contains(Flags::STALE_SAMPLE | Flags::WITHDRAWN);
            if self.brake_ticks > 0
                && (withdrawn || self.safety.braking())
                && let Some(q) = self.safety.measured_q()
            {
                let gravity = gravity::<Arm, _, _>(&self.feed_forward.state().committed, q);
                self.safety.keep(&gravity);
                if withdrawn {
                    torque.total = gravity;
                }
            }
            torque.total = self.safety.release(&torque.total);
            self.feed_forward.applied(&torque.total);
        }
        let measured = sample.and_then(|sample| sample.measured);
        self.lesson = Some(self.feed_forward.learning_sample(measured));
        let array = |vector: JointVector<JOINTS>| vector.into();
        ForetorqueTorque {
            total_nm: array(torque.total),
            rigid_nm: array(torque.shares.rigid),
            friction_nm: array(torque.shares.friction),
            network_nm: array(torque.shares.network),
            flags: u32::from(torque.flags.0),
            tick: torque.tick,
        }
    }

    fn safety(&self) -> ForetorqueSafety {
        let status = self.safety.status();
        ForetorqueSafety {
            state: status.state as u8,
            reason: status.reason.code(),
            latched: self.safety.latched().code(),
            enabled: self.safety.enabled().into(),
            brake_released: self.safety.brake_released().into(),
        }
    }
}

/// Bytes of memory that `foretorque_init` requires.
#[unsafe(no_mangle)]
pub extern "C" fn foretorque_size() -> usize {
    size_of::<Foretorque>()
}

/// Alignment of that memory, in bytes.
#[unsafe(no_mangle)]
pub extern "C" fn foretorque_alignment() -> usize {
    align_of::<Foretorque>()
}

/// Identity of the arm: the same number as in its parameter banks.
#[unsafe(no_mangle)]
pub extern "C" fn foretorque_arm_hash() -> u32 {
    Arm::HASH
}

/// Makes a feed-forward at tick 0 in `memory`, with the parameters of the description and learning off, and hands it out
/// through `out`. There is nothing to free: the memory is the caller's, and is free when the caller stops using it.
///
/// Every call takes a few kilobytes of stack.
///
/// # Safety
/// `memory` points to `size` bytes that nothing else uses as long as the result is used; `out` may be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn foretorque_init(
    memory: *mut core::ffi::c_void,
    size: usize,
    period_s: f32,
    out: *mut *mut Foretorque,
) -> ForetorqueStatus {
    if memory.is_null() || out.is_null() {
        return ForetorqueStatus::Null;
    }
    if size < size_of::<Foretorque>() {
        return ForetorqueStatus::TooSmall;
    }
    let place = memory.cast::<Foretorque>();
    if !place.is_aligned() {
        return ForetorqueStatus::Misaligned;
    }
    // SAFETY: not null, aligned and large enough, as just checked, and the caller's to give; `out` may be written.
    unsafe {
        if Foretorque::init_in_place(place, period_s).is_none() {
            return ForetorqueStatus::Period;
        }
        out.write(place);
    }
    ForetorqueStatus::Ok
}

/// Takes over a parameter bank from its bytes, whole or not at all, from the next tick on. Only while learning is off.
///
/// # Safety
/// `it` comes from `foretorque_init`, and no other call on it is under way; `bytes` points to `length` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn foretorque_load_bank(
    it: *mut Foretorque,
    bytes: *const u8,
    length: usize,
) -> ForetorqueStatus {
    if bytes.is_null() {
        return ForetorqueStatus::Null;
    }
    // SAFETY: null or from `foretorque_init`, and not shared meanwhile; `length` bytes lie at `bytes`.
    let (it, bytes) = unsafe { (it.as_mut(), slice::from_raw_parts(bytes, length)) };
    let Some(it) = it else {
        return ForetorqueStatus::Null;
    };
    if it.feed_forward.state().learning {
        return ForetorqueStatus::LearningOn;
    }
    if !it.safety.at_rest() {
        return ForetorqueStatus::Armed;
    }
    match it.load(bytes) {
        Some(()) => ForetorqueStatus::Ok,
        None => ForetorqueStatus::Bank,
    }
}

/// Writes the bank in force, what was learnt included, into `buffer` of `size` bytes, and its length into `length`.
///
/// # Safety
/// `it` comes from `foretorque_init`, and no other call on it is under way; `buffer` points to `size` bytes; `length` may be
/// written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn foretorque_save_bank(
    it: *mut Foretorque,
    buffer: *mut u8,
    size: usize,
    length: *mut usize,
) -> ForetorqueStatus {
    if buffer.is_null() || length.is_null() {
        return ForetorqueStatus::Null;
    }
    // SAFETY: null or from `foretorque_init`, and not shared meanwhile; `size` bytes lie at `buffer`, which are
    // initialised before there is a reference to them.
    let (it, buffer) = unsafe {
        ptr::write_bytes(buffer, 0, size);
        (it.as_mut(), slice::from_raw_parts_mut(buffer, size))
    };
    let Some(it) = it else {
        return ForetorqueStatus::Null;
    };
    it.bank
        .refresh::<Arm, _, _>(&it.feed_forward.state().active);
    let Ok(bytes) = it.bank.encode(buffer) else {
        return ForetorqueStatus::TooSmall;
    };
    // SAFETY: not null, and may be written.
    unsafe { length.write(bytes.len()) };
    ForetorqueStatus::Ok
}

/// Switches learning on or off (0, frozen) from the next tick on.
///
/// # Safety
/// `it` comes from `foretorque_init`, and no other call on it is under way.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn foretorque_set_learning(it: *mut Foretorque, on: u8) -> ForetorqueStatus {
    // SAFETY: null or from `foretorque_init`, and not shared meanwhile.
    let Some(it) = (unsafe { it.as_mut() }) else {
        return ForetorqueStatus::Null;
    };
    it.feed_forward.set_learning(on != 0);
    ForetorqueStatus::Ok
}

/// Runs one tick without the safety: its torque is for a caller that has a safety of its own. `sample` may be null: then none
/// came, and the torque is held for 10 ms and goes to zero after that.
///
/// # Safety
/// `it` comes from `foretorque_init`, and no other call on it is under way; `sample` is null or may be read, the measured
/// values only if `measured`; `out` may be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn foretorque_step(
    it: *mut Foretorque,
    sample: *const ForetorqueSample,
    out: *mut ForetorqueTorque,
) -> ForetorqueStatus {
    // SAFETY: as the caller promises.
    unsafe { step(it, sample, out, false) }
}

/// Runs one tick with the safety: exactly one call a period of the caller's timer. The torque is zero unless the board is
/// armed, and within the hard limits; docs/safety.md describes states, reasons and time-outs. `sample` is null in a period
/// in which none came.
///
/// # Safety
/// As those of `foretorque_step`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn foretorque_tick(
    it: *mut Foretorque,
    sample: *const ForetorqueSample,
    out: *mut ForetorqueTorque,
) -> ForetorqueStatus {
    // SAFETY: as the caller promises.
    unsafe { step(it, sample, out, true) }
}

/// # Safety
/// As those of `foretorque_step`.
unsafe fn step(
    it: *mut Foretorque,
    sample: *const ForetorqueSample,
    out: *mut ForetorqueTorque,
    guarded: bool,
) -> ForetorqueStatus {
    // SAFETY: null or what the caller guarantees, and not shared meanwhile.
    let it = unsafe { it.as_mut() };
    let (Some(it), false) = (it, out.is_null()) else {
        return ForetorqueStatus::Null;
    };
    // SAFETY: not null, and may be read as far as it is; `out` may be written and is never read.
    unsafe {
        let sample = (!sample.is_null()).then(|| ForetorqueSample::read(sample));
        out.write(it.step(sample, guarded));
    }
    ForetorqueStatus::Ok
}

/// Lets torque through from the next sample on. Only after three fresh, plausible samples; `Refused` otherwise, with the
/// reason of docs/safety.md at `reason`.
///
/// # Safety
/// `it` comes from `foretorque_init`, and no other call on it is under way; `reason` may be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn foretorque_arm(it: *mut Foretorque, reason: *mut u8) -> ForetorqueStatus {
    // SAFETY: as the caller promises.
    unsafe { command(it, reason, Safety::arm) }
}

/// Clears a latched fault; the board is disarmed then. `Refused` while the torque still ramps to zero or a motor is hot.
///
/// # Safety
/// As those of `foretorque_arm`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn foretorque_clear_fault(
    it: *mut Foretorque,
    reason: *mut u8,
) -> ForetorqueStatus {
    // SAFETY: as the caller promises.
    unsafe { command(it, reason, Safety::clear) }
}

/// # Safety
/// As those of `foretorque_arm`.
unsafe fn command(
    it: *mut Foretorque,
    reason: *mut u8,
    request: fn(&mut Safety<JOINTS>) -> Result<(), SafetyReason>,
) -> ForetorqueStatus {
    // SAFETY: null or from `foretorque_init`, and not shared meanwhile.
    let it = unsafe { it.as_mut() };
    let (Some(it), false) = (it, reason.is_null()) else {
        return ForetorqueStatus::Null;
    };
    let refused = request(&mut it.safety).err();
    // SAFETY: not null, and may be written.
    unsafe { reason.write(refused.unwrap_or_default().code()) };
    match refused {
        None => ForetorqueStatus::Ok,
        Some(_) => ForetorqueStatus::Refused,
    }
}

/// Ramps the torque to zero over the ticks to come, then disarms.
///
/// # Safety
/// `it` comes from `foretorque_init`, and no other call on it is under way.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn foretorque_disarm(it: *mut Foretorque) -> ForetorqueStatus {
    // SAFETY: as the caller promises.
    unsafe { act(it, |it| it.safety.disarm()) }
}

/// Sets the torque to zero at once, in any state, and latches `reason`: 3 for an emergency stop, 13 for a fault of a drive.
/// An unknown code, or 0, latches 3.
///
/// # Safety
/// As those of `foretorque_disarm`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn foretorque_stop(it: *mut Foretorque, reason: u8) -> ForetorqueStatus {
    let reason = SafetyReason::ALL.get(usize::from(reason)).copied();
    let fault = match reason {
        None | Some(SafetyReason::None) => SafetyReason::Stopped,
        Some(reason) => reason,
    };
    // SAFETY: as the caller promises.
    unsafe {
        act(it, |it| {
            it.safety.torque_off(fault);
            it.feed_forward.applied(it.safety.output());
        })
    }
}

/// Takes the temperature of the motor of `joint`, counted from 0, degrees C. The torque limit falls from 80 to 100.
///
/// # Safety
/// As those of `foretorque_disarm`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn foretorque_temperature(
    it: *mut Foretorque,
    joint: u32,
    celsius: i8,
) -> ForetorqueStatus {
    // SAFETY: as the caller promises.
    unsafe { act(it, |it| it.safety.note_temperature(joint as usize, celsius)) }
}

/// Sets the time that the brakes take to close, microseconds; 0 without brakes. Only while no torque flows.
///
/// # Safety
/// As those of `foretorque_disarm`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn foretorque_set_brake(
    it: *mut Foretorque,
    close_us: u32,
) -> ForetorqueStatus {
    // SAFETY: null or from `foretorque_init`, and not shared meanwhile.
    let Some(it) = (unsafe { it.as_mut() }) else {
        return ForetorqueStatus::Null;
    };
    if !it.safety.at_rest() {
        return ForetorqueStatus::Armed;
    }
    it.brake_ticks = (close_us as f32 * 1e-6 / it.period_s) as u32 + u32::from(close_us > 0);
    ForetorqueStatus::Ok
}

/// Writes the state of the safety.
///
/// # Safety
/// `it` comes from `foretorque_init`, and no other call on it is under way; `out` may be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn foretorque_safety(
    it: *mut Foretorque,
    out: *mut ForetorqueSafety,
) -> ForetorqueStatus {
    if out.is_null() {
        return ForetorqueStatus::Null;
    }
    // SAFETY: as the caller promises; `out` may be written.
    unsafe { act(it, |it| out.write(it.safety())) }
}

/// Writes the hard limits.
///
/// # Safety
/// As those of `foretorque_safety`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn foretorque_limits(
    it: *mut Foretorque,
    out: *mut ForetorqueLimits,
) -> ForetorqueStatus {
    if out.is_null() {
        return ForetorqueStatus::Null;
    }
    let write = |it: &mut Foretorque| {
        let limits = it.safety.limits();
        let limits = ForetorqueLimits {
            torque_nm: limits.torque.into(),
            slew_nm: limits.slew_per_tick.into(),
            timeout_ticks: limits.timeout_ticks,
            measurement_ticks: limits.measurement_ticks,
        };
        // SAFETY: not null, and may be written.
        unsafe { out.write(limits) }
    };
    // SAFETY: as the caller promises.
    unsafe { act(it, write) }
}

/// # Safety
/// As those of `foretorque_disarm`.
unsafe fn act(it: *mut Foretorque, action: impl FnOnce(&mut Foretorque)) -> ForetorqueStatus {
    // SAFETY: null or from `foretorque_init`, and not shared meanwhile.
    match unsafe { it.as_mut() } {
        Some(it) => {
            action(it);
            ForetorqueStatus::Ok
        }
        None => ForetorqueStatus::Null,
    }
}

/// Learns from the tick that has just run, in the time that is left of it. Without this call nothing is learnt.
///
/// # Safety
/// `it` comes from `foretorque_init`, and no other call on it is under way: a tick must not interrupt it.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn foretorque_learn(it: *mut Foretorque) -> ForetorqueStatus {
    // SAFETY: null or from `foretorque_init`, and not shared meanwhile.
    let Some(it) = (unsafe { it.as_mut() }) else {
        return ForetorqueStatus::Null;
    };
    if let Some(lesson) = it.lesson.take() {
        it.learner.learn(&lesson, &mut it.exchange);
    }
    ForetorqueStatus::Ok
}
