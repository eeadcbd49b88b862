//! Commands and state of the safety.

use foretorque::learning::Request;
use foretorque_link::safety::{Safety, SafetyReason};
use foretorque_link::wire::Configuration;

use crate::{Foretorque, ForetorqueLimits, ForetorqueSafety, ForetorqueStatus, JOINTS};

/// Lets torque through from the next sample on. Only after three fresh, plausible samples; `FORETORQUE_STATUS_REFUSED` otherwise,
/// with the reason of docs/safety.md at `reason`.
///
/// # Safety
/// `it` comes from `foretorque_init`, and no other call on it is under way; `reason` may be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn foretorque_arm(it: *mut Foretorque, reason: *mut u8) -> ForetorqueStatus {
    // SAFETY: as the caller promises.
    unsafe { command(it, reason, Safety::arm) }
}

/// Clears a latched fault; the board is disarmed then. `FORETORQUE_STATUS_REFUSED` while the torque still ramps to zero, or a
/// motor is hot.
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
    let mut refused = None;
    let command = |it: &mut Foretorque| {
        refused = request(&mut it.safety).err();
        refused.unwrap_or_default().code()
    };
    // SAFETY: as the caller promises.
    let status = unsafe { answer(it, reason, command) };
    refused.map_or(status, |_| ForetorqueStatus::Refused)
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
/// A code that is no fault of docs/safety.md latches 3. A stop that latches 3 also stops learning, until learning is switched off
/// and on.
///
/// After a reset, call it with the `latched` that was kept, unless that is 0.
///
/// # Safety
/// As those of `foretorque_disarm`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn foretorque_stop(it: *mut Foretorque, reason: u8) -> ForetorqueStatus {
    let reason = SafetyReason::ALL.get(usize::from(reason)).copied();
    let latches = reason.filter(|reason| reason.latches());
    let fault = latches.unwrap_or(SafetyReason::Stopped);
    // SAFETY: as the caller promises.
    unsafe {
        act(it, |it| {
            it.safety.torque_off(fault);
            it.feed_forward.applied(it.safety.output());
            // The data that led to it may not be fit to learn from. The stop replaces a request that still waits.
            if fault == SafetyReason::Stopped {
                it.feed_forward
                    .request_over(Request::Stop, &mut it.exchange);
            }
        })
    }
}

/// Takes the temperature of the motor of `joint`, counted from 0, degrees C. From 80 to 100 the torque limit falls to zero.
///
/// # Safety
/// As those of `foretorque_disarm`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn foretorque_temperature(
    it: *mut Foretorque,
    joint: u32,
    celsius: i8,
) -> ForetorqueStatus {
    if joint as usize >= JOINTS {
        return ForetorqueStatus::Joint;
    }
    // SAFETY: as the caller promises.
    unsafe { act(it, |it| it.safety.note_temperature(joint as usize, celsius)) }
}

/// Sets the time that the brakes take to close, microseconds up to 1 s; 0 without brakes. Only while no torque flows; arming
/// needs three samples after it.
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
    if close_us > 1000 * u32::from(Configuration::MAX_BRAKE_CLOSE_MS) {
        return ForetorqueStatus::Brake;
    }
    let limits = it.safety.limits().with_brake(close_us, it.period_us);
    it.safety.restart(limits);
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
    let state = |it: &mut Foretorque| {
        let status = it.safety.status();
        ForetorqueSafety {
            state: status.state as u8,
            reason: status.reason.code(),
            latched: it.safety.latched().code(),
            enabled: it.safety.enabled().into(),
            brake_released: it.safety.brake_released().into(),
        }
    };
    // SAFETY: as the caller promises.
    unsafe { answer(it, out, state) }
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
    let limits = |it: &mut Foretorque| {
        let limits = it.safety.limits();
        ForetorqueLimits {
            torque_nm: limits.torque.into(),
            slew_nm: limits.slew_per_tick.into(),
            timeout_ticks: limits.timeout_ticks,
            measurement_ticks: limits.measurement_ticks,
        }
    };
    // SAFETY: as the caller promises.
    unsafe { answer(it, out, limits) }
}

/// Writes the result of `action` into `out`.
///
/// # Safety
/// As those of `foretorque_safety`.
pub(crate) unsafe fn answer<T>(
    it: *mut Foretorque,
    out: *mut T,
    action: impl FnOnce(&mut Foretorque) -> T,
) -> ForetorqueStatus {
    if out.is_null() {
        return ForetorqueStatus::Null;
    }
    // SAFETY: as the caller promises; `out` is not null, and may be written.
    unsafe { act(it, |it| out.write(action(it))) }
}

/// # Safety
/// As those of `foretorque_disarm`.
pub(crate) unsafe fn act(
    it: *mut Foretorque,
    action: impl FnOnce(&mut Foretorque),
) -> ForetorqueStatus {
    // SAFETY: null or from `foretorque_init`, and not shared meanwhile.
    match unsafe { it.as_mut() } {
        Some(it) => {
            action(it);
            ForetorqueStatus::Ok
        }
        None => ForetorqueStatus::Null,
    }
}
