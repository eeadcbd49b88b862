//! Commands and state of the safety.

use core::mem::MaybeUninit;

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
pub extern "C" fn foretorque_arm(
    it: Option<&mut Foretorque>,
    reason: Option<&mut MaybeUninit<u8>>,
) -> ForetorqueStatus {
    command(it, reason, Safety::arm)
}

/// Clears a latched fault; the board is disarmed then. `FORETORQUE_STATUS_REFUSED` while the torque still ramps to zero, or a
/// motor is hot.
///
/// # Safety
/// As those of `foretorque_arm`.
#[unsafe(no_mangle)]
pub extern "C" fn foretorque_clear_fault(
    it: Option<&mut Foretorque>,
    reason: Option<&mut MaybeUninit<u8>>,
) -> ForetorqueStatus {
    command(it, reason, Safety::clear)
}

fn command(
    it: Option<&mut Foretorque>,
    reason: Option<&mut MaybeUninit<u8>>,
    request: fn(&mut Safety<JOINTS>) -> Result<(), SafetyReason>,
) -> ForetorqueStatus {
    let mut refused = None;
    let status = answer(it, reason, |it| {
        refused = request(&mut it.safety).err();
        refused.unwrap_or_default().code()
    });
    refused.map_or(status, |_| ForetorqueStatus::Refused)
}

/// Ramps the torque to zero over the ticks to come, then disarms.
///
/// # Safety
/// `it` comes from `foretorque_init`, and no other call on it is under way.
#[unsafe(no_mangle)]
pub extern "C" fn foretorque_disarm(it: Option<&mut Foretorque>) -> ForetorqueStatus {
    act(it, |it| it.safety.disarm())
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
pub extern "C" fn foretorque_stop(it: Option<&mut Foretorque>, reason: u8) -> ForetorqueStatus {
    let reason = SafetyReason::ALL.get(usize::from(reason)).copied();
    let latches = reason.filter(|reason| reason.latches());
    let fault = latches.unwrap_or(SafetyReason::Stopped);
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

/// Takes the temperature of the motor of `joint`, counted from 0, degrees C. From 80 to 100 the torque limit falls to zero.
///
/// # Safety
/// As those of `foretorque_disarm`.
#[unsafe(no_mangle)]
pub extern "C" fn foretorque_temperature(
    it: Option<&mut Foretorque>,
    joint: u32,
    celsius: i8,
) -> ForetorqueStatus {
    if joint as usize >= JOINTS {
        return ForetorqueStatus::Joint;
    }
    act(it, |it| it.safety.note_temperature(joint as usize, celsius))
}

/// Sets the time that the brakes take to close, microseconds up to 1 s; 0 without brakes. Only while no torque flows; arming
/// needs three samples after it.
///
/// # Safety
/// As those of `foretorque_disarm`.
#[unsafe(no_mangle)]
pub extern "C" fn foretorque_set_brake(
    it: Option<&mut Foretorque>,
    close_us: u32,
) -> ForetorqueStatus {
    let Some(it) = it else {
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
pub extern "C" fn foretorque_safety(
    it: Option<&mut Foretorque>,
    out: Option<&mut MaybeUninit<ForetorqueSafety>>,
) -> ForetorqueStatus {
    answer(it, out, |it| {
        let status = it.safety.status();
        ForetorqueSafety {
            state: status.state as u8,
            reason: status.reason.code(),
            latched: it.safety.latched().code(),
            enabled: it.safety.enabled().into(),
            brake_released: it.safety.brake_released().into(),
        }
    })
}

/// Writes the hard limits.
///
/// # Safety
/// As those of `foretorque_safety`.
#[unsafe(no_mangle)]
pub extern "C" fn foretorque_limits(
    it: Option<&mut Foretorque>,
    out: Option<&mut MaybeUninit<ForetorqueLimits>>,
) -> ForetorqueStatus {
    answer(it, out, |it| {
        let limits = it.safety.limits();
        ForetorqueLimits {
            torque_nm: limits.torque.into(),
            slew_nm: limits.slew_per_tick.into(),
            timeout_ticks: limits.timeout_ticks,
            measurement_ticks: limits.measurement_ticks,
        }
    })
}

/// Writes the result of `action` into `out`.
pub(crate) fn answer<T>(
    it: Option<&mut Foretorque>,
    out: Option<&mut MaybeUninit<T>>,
    action: impl FnOnce(&mut Foretorque) -> T,
) -> ForetorqueStatus {
    let (Some(it), Some(out)) = (it, out) else {
        return ForetorqueStatus::Null;
    };
    out.write(action(it));
    ForetorqueStatus::Ok
}

pub(crate) fn act(
    it: Option<&mut Foretorque>,
    action: impl FnOnce(&mut Foretorque),
) -> ForetorqueStatus {
    answer(it, Some(&mut MaybeUninit::uninit()), action)
}
