//! foretorque for firmware in C: the tick and its learner of one arm, in memory that the caller owns.
//!
//! The header is `include/foretorque.h`, generated from this file; `example/main.c` is a whole program. Nothing allocates,
//! nothing blocks, nothing panics: linking the static library proves the last.
//!
//! Another arm is another `use` below: see docs/arms.md.
#![cfg_attr(target_os = "none", no_std)]

use core::mem::{MaybeUninit, align_of, size_of};
use core::slice;

use foretorque::arm::Arm as _;
use foretorque::arm::ur5::{
    Exchange, FeedForward, JOINTS, Learner, LearnerConfig, ParameterSet, Ur5 as Arm,
};
use foretorque::feedforward::FeedForwardConfig;
use foretorque::joint::{JointMeasurement, JointMotion, JointSample, JointVector};
use foretorque::learning::LearningSample;
use foretorque_link::bank::{NETWORK_SEED, ParameterBank};
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
    /// The memory is smaller than `foretorque_size` says, or the room too small for the bank.
    TooSmall = 2,
    /// The memory is not aligned as `foretorque_alignment` says.
    Misaligned = 3,
    /// The period is not between 0.1 ms and 100 ms.
    Period = 4,
    /// The bytes are no parameter bank for this arm, or one with limits beyond the arm's.
    Bank = 5,
    /// Only while learning is off.
    LearningOn = 6,
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
    /// The measurement is fresh.
    pub measured: bool,
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

/// Feed-forward and learner of one arm. Opaque: C sees a pointer into its own memory.
pub struct Foretorque {
    feed_forward: FeedForward,
    learner: Learner,
    exchange: Exchange,
    /// Learning sample of the last tick, until the learner takes it.
    lesson: Option<LearningSample<JOINTS>>,
    bank: ParameterBank,
    /// Room for a bank on its way in, which is not believed before all of it is.
    incoming: ParameterBank,
    period_s: f32,
}

impl Foretorque {
    /// Makes a feed-forward at tick 0 in `place`, part by part: as a whole it would lie on the stack first. `None` if the
    /// period cannot work; then `place` is worth nothing.
    ///
    /// # Safety
    /// `place` is aligned, may be written and is nobody else's.
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

    fn step(&mut self, sample: Option<&ForetorqueSample>) -> ForetorqueTorque {
        self.feed_forward.adopt(&mut self.exchange);
        let sample = sample.map(|given| JointSample {
            desired: JointMotion {
                q: given.q_rad.into(),
                qd: given.qd_rad_s.into(),
                qdd: given.qdd_rad_s2.into(),
            },
            measured: given.measured.then(|| JointMeasurement {
                q: given.measured_q_rad.into(),
                tau: given.measured_tau_nm.into(),
            }),
        });
        let torque = match &sample {
            Some(sample) => self.feed_forward.step(sample),
            None => self.feed_forward.step_stale(),
        };
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
}

/// Bytes of memory that `foretorque_init` wants.
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
/// `memory` points to `size` bytes that nobody else uses as long as the result is used; `out` may be written.
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
    // SAFETY: null or from `foretorque_init`, and used by nobody else meanwhile; `length` bytes lie at `bytes`.
    let (it, bytes) = unsafe { (it.as_mut(), slice::from_raw_parts(bytes, length)) };
    let Some(it) = it else {
        return ForetorqueStatus::Null;
    };
    if it.feed_forward.state().learning {
        return ForetorqueStatus::LearningOn;
    }
    match it.load(bytes) {
        Some(()) => ForetorqueStatus::Ok,
        None => ForetorqueStatus::Bank,
    }
}

/// Writes the bank in force, what was learnt included, into `room` of `size` bytes, and its length into `length`.
///
/// # Safety
/// `it` comes from `foretorque_init`, and no other call on it is under way; `room` points to `size` bytes; `length` may be
/// written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn foretorque_save_bank(
    it: *mut Foretorque,
    room: *mut u8,
    size: usize,
    length: *mut usize,
) -> ForetorqueStatus {
    if room.is_null() || length.is_null() {
        return ForetorqueStatus::Null;
    }
    // SAFETY: null or from `foretorque_init`, and used by nobody else meanwhile; `size` bytes lie at `room`.
    let (it, room) = unsafe { (it.as_mut(), slice::from_raw_parts_mut(room, size)) };
    let Some(it) = it else {
        return ForetorqueStatus::Null;
    };
    it.bank
        .refresh::<Arm, _, _>(&it.feed_forward.state().active);
    let Ok(bytes) = it.bank.encode(room) else {
        return ForetorqueStatus::TooSmall;
    };
    // SAFETY: not null, and may be written.
    unsafe { length.write(bytes.len()) };
    ForetorqueStatus::Ok
}

/// Switches learning on or off (frozen) from the next tick on.
///
/// # Safety
/// `it` comes from `foretorque_init`, and no other call on it is under way.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn foretorque_set_learning(
    it: *mut Foretorque,
    on: bool,
) -> ForetorqueStatus {
    // SAFETY: null or from `foretorque_init`, and used by nobody else meanwhile.
    let Some(it) = (unsafe { it.as_mut() }) else {
        return ForetorqueStatus::Null;
    };
    it.feed_forward.set_learning(on);
    ForetorqueStatus::Ok
}

/// Runs one tick. `sample` may be null: then none came, and the torque is held for 10 ms and goes to zero after that.
///
/// # Safety
/// `it` comes from `foretorque_init`, and no other call on it is under way; `sample` is null or may be read; `out` may be
/// written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn foretorque_step(
    it: *mut Foretorque,
    sample: *const ForetorqueSample,
    out: *mut ForetorqueTorque,
) -> ForetorqueStatus {
    // SAFETY: each null or what the caller says it is, and used by nobody else meanwhile.
    let (it, sample, out) = unsafe { (it.as_mut(), sample.as_ref(), out.as_mut()) };
    let (Some(it), Some(out)) = (it, out) else {
        return ForetorqueStatus::Null;
    };
    *out = it.step(sample);
    ForetorqueStatus::Ok
}

/// Learns from the tick that has just run, in the time that is left of it. Without this call nothing is learnt.
///
/// # Safety
/// `it` comes from `foretorque_init`, and no other call on it is under way: a tick must not interrupt it.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn foretorque_learn(it: *mut Foretorque) -> ForetorqueStatus {
    // SAFETY: null or from `foretorque_init`, and used by nobody else meanwhile.
    let Some(it) = (unsafe { it.as_mut() }) else {
        return ForetorqueStatus::Null;
    };
    if let Some(lesson) = it.lesson.take() {
        it.learner.learn(&lesson, &mut it.exchange);
    }
    ForetorqueStatus::Ok
}
