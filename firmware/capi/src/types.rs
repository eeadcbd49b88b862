//! Types that pass between C and the library.

use core::mem::MaybeUninit;

use foretorque::joint::{JointMeasurement, JointMotion, JointSample};
use foretorque::learning::{Decision, ModelQuality};

use crate::{FORETORQUE_JOINTS, JOINTS};

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
    /// The period is not between 0.1 ms and 20 ms.
    Period = 4,
    /// The bytes are no parameter bank for this arm, or one with limits beyond the arm's or with implausible torques.
    Bank = 5,
    /// Only while learning is off.
    LearningOn = 6,
    /// The safety refuses, with the reason.
    Refused = 7,
    /// Only while no torque flows.
    Armed = 8,
    /// The brakes take longer to close than 1 s.
    Brake = 9,
    /// The arm has no such joint; the first is 0.
    Joint = 10,
    /// There is no such request.
    Request = 11,
    /// The request before still waits for the next tick and `foretorque_learn`.
    Pending = 12,
    /// This decision is not made yet, or no longer kept.
    NoDecision = 13,
}

/// Input of one tick.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
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
    /// The fields of the desired motion, `measured` and those that it announces may be read.
    pub(crate) unsafe fn read(place: &MaybeUninit<Self>) -> JointSample<JOINTS> {
        let place = place.as_ptr();
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
#[derive(Clone, Copy, Debug, Default, PartialEq)]
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
    /// Reason for which the torque is, or may soon be, less than wanted.
    pub reason: u8,
    /// The fault that has to be cleared before arming; 0 is none. Keep it over a reset, and give it back by `foretorque_stop`.
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

/// Quality of the model over the last seconds in motion, and the payload.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ForetorqueQuality {
    /// RMS error of the torque, as a part of the joint's torque limit.
    pub residual_rms: [f32; FORETORQUE_JOINTS],
    /// RMS of the shares of rigid body, friction and network, as parts of the torque limit.
    pub share_rms: [f32; 3],
    /// Part of the prior variance that measurements have removed, 0 to 1.
    pub information: f32,
    /// Trust in the torque, 0 to 1; 1 until the arm has moved.
    pub trust: f32,
    /// Mass of the payload, kg; 0 without one.
    pub payload_kg: f32,
    /// Standard deviation of the mass, kg.
    pub payload_sigma_kg: f32,
    /// Centre of mass of the payload in the frame of the last link, m.
    pub payload_com_m: [f32; 3],
    /// Number of decisions so far.
    pub decisions: u32,
    /// 1 while the trust is low.
    pub low_trust: u8,
    /// State of the learner: 0 healthy, 1 payload test, 2 relearning, 3 stopped.
    pub phase: u8,
}

impl ForetorqueQuality {
    pub(crate) fn new(quality: &ModelQuality<JOINTS>, decisions: u32) -> Self {
        Self {
            residual_rms: quality.residual_rms,
            share_rms: quality.share_rms,
            information: quality.information,
            trust: quality.trust,
            payload_kg: quality.payload.mass,
            payload_sigma_kg: quality.payload.mass_sigma,
            payload_com_m: quality.payload.com,
            decisions,
            low_trust: quality.low_trust.into(),
            phase: quality.phase as u8,
        }
    }
}

/// Decision of the learner.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ForetorqueDecision {
    /// Tick.
    pub tick: u32,
    /// Figure that docs/learning.md names for the reason.
    pub figure: f32,
    /// Reason code of docs/learning.md.
    pub reason: u8,
    /// Joint that caused it, from 0; 255 if it concerns the arm.
    pub joint: u8,
}

impl From<Decision> for ForetorqueDecision {
    fn from(decision: Decision) -> Self {
        Self {
            tick: decision.tick,
            figure: decision.figure,
            reason: decision.reason as u8,
            joint: decision.joint.unwrap_or(u8::MAX),
        }
    }
}
