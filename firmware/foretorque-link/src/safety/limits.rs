use foretorque::arm::Arm;
use foretorque::joint::JointVector;

/// A board that hears no usable sample for this long ends the torque, s. The torque has been held for 10 ms and is on its
/// way to zero by then; this also disarms.
pub const COMMAND_TIMEOUT_S: f32 = 0.05;
/// From zero to the torque limit takes this long at least, s: half the time of the tick's own slew limit, so that no
/// stored or uploaded configuration can be faster, and a sound tick never meets it.
const HARD_SLEW_TIME_S: f32 = 0.01;
/// Speeds beyond this many times the data sheet's are no motion but a broken sensor or command.
const SPEED_MARGIN: f32 = 1.5;
/// A jump that is always believed, rad: steps of a coarse encoder, noise, play.
const JUMP_MARGIN: f32 = 0.02;
/// Measured positions are believed this far outside the joint's range, rad: zero offsets, overtravel.
const RANGE_MARGIN: f32 = 0.1;
/// Measured efforts are believed up to this many torque limits: impacts and braking reach a few.
const EFFORT_MARGIN: f32 = 3.0;

/// Limits that no configuration, bank or command changes: constants of the arm and of this firmware.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SafetyLimits<const N: usize> {
    /// Largest torque, N × N·m.
    pub torque: JointVector<N>,
    /// Largest change of the torque in one tick, N × N·m.
    pub slew_per_tick: JointVector<N>,
    /// Lowest measured position that is believed, N × rad.
    pub lowest: JointVector<N>,
    /// Highest measured position that is believed, N × rad.
    pub highest: JointVector<N>,
    /// Largest change of a position in one period that is believed, N × rad, [`jump_margin`](Self::jump_margin) besides.
    pub step_per_tick: JointVector<N>,
    /// Change of a position that is always believed, rad.
    pub jump_margin: f32,
    /// Largest measured torque that is believed, N × N·m.
    pub effort: JointVector<N>,
    /// Ticks without a usable sample after which the torque ends.
    pub timeout_ticks: u32,
}

impl<const N: usize> SafetyLimits<N> {
    /// The limits of an arm for ticks of `period_s`, s.
    pub fn for_arm<A: Arm<N, P>, const P: usize>(period_s: f32) -> Self {
        let of = |value: fn(&foretorque::arm::JointLimits) -> f32| {
            JointVector::from(A::LIMITS.map(|limits| value(&limits)))
        };
        let torque = of(|limits| limits.torque);
        Self {
            torque,
            slew_per_tick: torque * (period_s / HARD_SLEW_TIME_S),
            lowest: of(|limits| limits.position.0 - RANGE_MARGIN),
            highest: of(|limits| limits.position.1 + RANGE_MARGIN),
            step_per_tick: of(|limits| limits.velocity) * (SPEED_MARGIN * period_s),
            jump_margin: JUMP_MARGIN,
            effort: torque * EFFORT_MARGIN,
            timeout_ticks: (COMMAND_TIMEOUT_S / period_s) as u32 + 1,
        }
    }
}
