//! foretorque for firmware in C: tick, safety and learner of one arm, in memory that the caller owns.
//!
//! The header is `include/foretorque.h`, generated from this file; `example/main.c` is a whole program. Nothing allocates,
//! nothing blocks, nothing panics: linking the static library proves the last.
//!
//! The sections Safety are for the caller in C.
//!
//! Another arm is another `use` and another `FORETORQUE_JOINTS` below: see docs/board.md.
#![cfg_attr(target_os = "none", no_std)]

mod safety;
mod types;

pub use safety::*;
use safety::{act, answer};
pub use types::*;

use core::mem::{MaybeUninit, align_of, size_of};
use core::{ptr, slice};

use foretorque::arm::Arm as _;
use foretorque::arm::ur5::{Exchange, FeedForward, JOINTS, Learner, ParameterSet, Ur5 as Arm};
use foretorque::feedforward::FeedForwardConfig;
use foretorque::joint::{JointSample, JointVector};
use foretorque::learning::{LearningSample, Request, RequestPending, StartDeviations};
use foretorque_link::bank::{NETWORK_SEED, ParameterBank};
use foretorque_link::safety::{Safety, SafetyLimits, SafetyReason};
use foretorque_link::wire::Configuration;
#[cfg(target_os = "none")]
use panic_never as _;

/// Joints of the arm that this library was built for.
// A literal, because the generator of the header evaluates nothing.
pub const FORETORQUE_JOINTS: usize = 6;

/// Bytes of a buffer that is large enough for every bank.
pub const FORETORQUE_BANK_BYTES: usize = 4096;

const _: () = assert!(ParameterBank::MAX_BYTES <= FORETORQUE_BANK_BYTES);
const _: () = assert!(
    FORETORQUE_JOINTS == JOINTS,
    "set FORETORQUE_JOINTS to the joints of the arm, and write the header by `cargo xtask capi`"
);

/// Feed-forward, safety and learner of one arm. Opaque: C has a pointer into its own memory.
pub struct Foretorque {
    feed_forward: FeedForward,
    safety: Safety<JOINTS>,
    learner: Learner,
    exchange: Exchange,
    /// Learning sample of the last tick, until the learner takes it.
    pending: Option<LearningSample<JOINTS>>,
    bank: ParameterBank,
    /// Buffer for a bank on its way in, which has no effect before all of it is checked.
    incoming: ParameterBank,
    period_us: u32,
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
        // The periods that the boards take, one that is not a number as 0.
        let period_us = (period_s * 1e6 + 0.5) as u32;
        if !Configuration::PERIODS_US.contains(&period_us) {
            return None;
        }
        let period_s = seconds(period_us);
        let set = ParameterSet::nominal::<Arm>(NETWORK_SEED);
        let config = FeedForwardConfig::for_arm::<Arm, _>(period_s);
        // SAFETY: every part of `place` may be written, and the learner is read only after it was.
        unsafe {
            (&raw mut (*place).feed_forward).write(FeedForward::new(config, set).ok()?);
            let limits = SafetyLimits::for_arm::<Arm, _>(period_us);
            (&raw mut (*place).safety).write(Safety::new(limits, SafetyReason::None));
            (&raw mut (*place).exchange).write(Exchange::new());
            (&raw mut (*place).pending).write(None);
            (&raw mut (*place).bank).write(ParameterBank::nominal::<Arm, _, _>());
            (&raw mut (*place).incoming).write(ParameterBank::empty());
            (&raw mut (*place).period_us).write(period_us);
            let learner = &raw mut (*place).learner;
            learner.write(BLANK);
            (*learner)
                .restart_for_arm(period_s, &set, &StartDeviations::PRIOR)
                .ok()
        }
    }

    fn load(&mut self, bytes: &[u8]) -> Option<()> {
        self.incoming.decode_into(bytes).ok()?;
        let loaded = self.incoming.parameters::<Arm, _, _>().ok()?;
        let config = self
            .incoming
            .feed_forward_config::<Arm, _, _>(seconds(self.period_us))
            .ok()?;
        self.feed_forward.configure(config).ok()?;
        self.feed_forward
            .load_with(loaded.set, loaded.start, &mut self.exchange);
        core::mem::swap(&mut self.bank, &mut self.incoming);
        Some(())
    }

    fn step(&mut self, mut sample: Option<JointSample<JOINTS>>, guarded: bool) -> ForetorqueTorque {
        self.feed_forward.adopt(&mut self.exchange);
        let mut torque = if guarded {
            self.safety.period();
            sample = self.safety.admit(sample, 1, SafetyReason::None);
            self.safety.step(&mut self.feed_forward, sample.as_ref())
        } else {
            match &sample {
                Some(sample) => self.feed_forward.step(sample),
                None => self.feed_forward.step_stale(),
            }
        };
        if !guarded && self.safety.latched() != SafetyReason::None {
            torque.total = JointVector::zeros();
            self.feed_forward.applied(&torque.total);
        }
        let measured = sample.and_then(|sample| sample.measured);
        self.pending = Some(self.feed_forward.learning_sample(measured));
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

fn seconds(period_us: u32) -> f32 {
    period_us as f32 * 1e-6
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

/// Joints of the arm of this library. Where it is not `FORETORQUE_JOINTS`, the header is that of another arm: call nothing else.
#[unsafe(no_mangle)]
pub extern "C" fn foretorque_joints() -> u32 {
    JOINTS as u32
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
/// `memory` points to `size` bytes that nothing else uses as long as the result is used; `out` may be written, and is not in
/// `memory`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn foretorque_init(
    memory: *mut core::ffi::c_void,
    size: usize,
    period_s: f32,
    out: Option<&mut MaybeUninit<*mut Foretorque>>,
) -> ForetorqueStatus {
    let Some(out) = out.filter(|_| !memory.is_null()) else {
        return ForetorqueStatus::Null;
    };
    if size < size_of::<Foretorque>() {
        return ForetorqueStatus::TooSmall;
    }
    let place = memory.cast::<Foretorque>();
    if !place.is_aligned() {
        return ForetorqueStatus::Misaligned;
    }
    // SAFETY: not null, aligned and large enough, as just checked, and the caller's to give.
    if unsafe { Foretorque::init_in_place(place, period_s) }.is_none() {
        return ForetorqueStatus::Period;
    }
    out.write(place);
    ForetorqueStatus::Ok
}

/// Takes over a parameter bank from its bytes, whole or not at all, from the next tick on. Only while learning is off.
///
/// # Safety
/// `it` comes from `foretorque_init`, and no other call on it is under way; `bytes` points to `length` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn foretorque_load_bank(
    it: Option<&mut Foretorque>,
    bytes: *const u8,
    length: usize,
) -> ForetorqueStatus {
    let Some(it) = it.filter(|_| !bytes.is_null()) else {
        return ForetorqueStatus::Null;
    };
    // SAFETY: `length` bytes lie at `bytes`, as the caller promises.
    let bytes = unsafe { slice::from_raw_parts(bytes, length) };
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

/// Writes the bank in force, what was learnt included, into `buffer` of `size` bytes, and its length into `length`. A buffer of
/// `FORETORQUE_BANK_BYTES` is always large enough.
///
/// # Safety
/// `it` comes from `foretorque_init`, and no other call on it is under way; `buffer` points to `size` bytes; `length` may be
/// written, and is not in `buffer`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn foretorque_save_bank(
    it: Option<&mut Foretorque>,
    buffer: *mut u8,
    size: usize,
    length: Option<&mut MaybeUninit<usize>>,
) -> ForetorqueStatus {
    let (Some(it), Some(length), false) = (it, length, buffer.is_null()) else {
        return ForetorqueStatus::Null;
    };
    // SAFETY: `size` bytes lie at `buffer`, which are initialised before there is a reference to them.
    let buffer = unsafe {
        ptr::write_bytes(buffer, 0, size);
        slice::from_raw_parts_mut(buffer, size)
    };
    it.bank
        .refresh::<Arm, _, _>(&it.feed_forward.state().active);
    let Ok(bytes) = it.bank.encode(buffer) else {
        return ForetorqueStatus::TooSmall;
    };
    length.write(bytes.len());
    ForetorqueStatus::Ok
}

/// Switches learning on or off (0, frozen) from the next tick on.
///
/// # Safety
/// `it` comes from `foretorque_init`, and no other call on it is under way.
#[unsafe(no_mangle)]
pub extern "C" fn foretorque_set_learning(it: Option<&mut Foretorque>, on: u8) -> ForetorqueStatus {
    act(it, |it| it.feed_forward.set_learning(on != 0))
}

/// Asks the learner for what docs/learning.md describes, from the next tick on: 1 takes a snapshot, 2 returns to it, 3 commits
/// what is learnt, 4 sets the payload to zero. The outcome is a decision. `FORETORQUE_STATUS_PENDING` while the request before
/// still waits.
///
/// # Safety
/// `it` comes from `foretorque_init`, and no other call on it is under way.
#[unsafe(no_mangle)]
pub extern "C" fn foretorque_request(it: Option<&mut Foretorque>, request: u8) -> ForetorqueStatus {
    // An emergency stop is `foretorque_stop`.
    let request = Request::from_code(request).filter(|request| *request != Request::Stop);
    let Some(request) = request else {
        return ForetorqueStatus::Request;
    };
    let Some(it) = it else {
        return ForetorqueStatus::Null;
    };
    match it.feed_forward.request(request, &mut it.exchange) {
        Ok(()) => ForetorqueStatus::Ok,
        Err(RequestPending) => ForetorqueStatus::Pending,
    }
}

/// Writes the quality of the model and the payload.
///
/// # Safety
/// `it` comes from `foretorque_init`, and no other call on it is under way; `out` may be written.
#[unsafe(no_mangle)]
pub extern "C" fn foretorque_quality(
    it: Option<&mut Foretorque>,
    out: Option<&mut MaybeUninit<ForetorqueQuality>>,
) -> ForetorqueStatus {
    answer(it, out, |it| {
        let report = &it.feed_forward.state().report;
        ForetorqueQuality::new(&report.quality, report.decisions.count())
    })
}

/// Writes the decision of the learner with the number `number`, counted from 0. `FORETORQUE_STATUS_NO_DECISION` if it is not made
/// yet, or is no longer among the newest eight. `ForetorqueQuality` contains their number.
///
/// # Safety
/// As those of `foretorque_quality`.
#[unsafe(no_mangle)]
pub extern "C" fn foretorque_decision(
    it: Option<&mut Foretorque>,
    number: u32,
    out: Option<&mut MaybeUninit<ForetorqueDecision>>,
) -> ForetorqueStatus {
    let (Some(it), Some(out)) = (it, out) else {
        return ForetorqueStatus::Null;
    };
    match it.feed_forward.state().report.decisions.get(number) {
        Some(decision) => {
            out.write(decision.into());
            ForetorqueStatus::Ok
        }
        None => ForetorqueStatus::NoDecision,
    }
}

/// Runs one tick without the safety: its torque is for a caller that has a safety of its own. A null `sample` means that none
/// came: the torque is then held for 10 ms, and goes to zero after that. The time of the safety does not pass here: use either
/// this call or `foretorque_tick`. The torque is zero while `foretorque_stop` has latched a fault.
///
/// # Safety
/// `it` comes from `foretorque_init`, and no other call on it is under way; `sample` is null or a whole struct that may be read,
/// its measured values initialised only if `measured`; `out` may be written. Neither is in the memory of `it`, and they do not
/// overlap.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn foretorque_step(
    it: Option<&mut Foretorque>,
    sample: Option<&MaybeUninit<ForetorqueSample>>,
    out: Option<&mut MaybeUninit<ForetorqueTorque>>,
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
    it: Option<&mut Foretorque>,
    sample: Option<&MaybeUninit<ForetorqueSample>>,
    out: Option<&mut MaybeUninit<ForetorqueTorque>>,
) -> ForetorqueStatus {
    // SAFETY: as the caller promises.
    unsafe { step(it, sample, out, true) }
}

/// # Safety
/// As those of `foretorque_step`.
unsafe fn step(
    it: Option<&mut Foretorque>,
    sample: Option<&MaybeUninit<ForetorqueSample>>,
    out: Option<&mut MaybeUninit<ForetorqueTorque>>,
    guarded: bool,
) -> ForetorqueStatus {
    // SAFETY: as the caller promises.
    let sample = sample.map(|sample| unsafe { ForetorqueSample::read(sample) });
    answer(it, out, |it| it.step(sample, guarded))
}

/// Learns from the tick that has just run, in the time that is left of it. Without this call nothing is learnt.
///
/// # Safety
/// `it` comes from `foretorque_init`, and no other call on it is under way: a tick must not interrupt it.
#[unsafe(no_mangle)]
pub extern "C" fn foretorque_learn(it: Option<&mut Foretorque>) -> ForetorqueStatus {
    act(it, |it| {
        if let Some(pending) = it.pending.take() {
            it.learner.learn(&pending, &mut it.exchange);
        }
    })
}
