use foretorque::arm::Arm;
use foretorque::joint::JointVector;

/// Time without a usable sample after which the torque ends and the board disarms, µs. The feed-forward holds its torque
/// for 10 ms and ramps it to zero before that.
pub const COMMAND_TIMEOUT_US: u32 = 50_000;
/// Time without a plausible measurement after which the torque ends, µs.
pub const MEASUREMENT_TIMEOUT_US: u32 = 100_000;
/// Time without a temperature of a motor that reported one before, after which the motor counts as warm, µs.
const TEMPERATURE_TIMEOUT_US: u32 = 10_000_000;
/// Shortest time from zero to the torque limit, s: half that of the tick's own slew limit. No configuration is faster, and
/// a sound tick never reaches it.
const HARD_SLEW_TIME_S: f32 = 0.01;
/// Largest plausible speed, parts of the data sheet's.
const SPEED_MARGIN: f32 = 1.5;
/// Position step that is always plausible, rad: steps of a coarse encoder, noise, backlash.
const JUMP_MARGIN: f32 = 0.02;
/// Plausible measured position beyond the joint's range, rad: zero offsets, overtravel.
const RANGE_MARGIN: f32 = 0.1;
/// Largest plausible measured effort, torque limits: impacts and braking reach a few.
const EFFORT_MARGIN: f32 = 3.0;

/// Limits that no configuration, bank or command changes: constants of the arm and of this firmware.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SafetyLimits<const N: usize> {
    /// Largest torque, N × N·m.
    pub torque: JointVector<N>,
    /// Largest change of the torque in one tick, N × N·m.
    pub slew_per_tick: JointVector<N>,
    /// Lowest plausible measured position, N × rad.
    pub lowest: JointVector<N>,
    /// Highest plausible measured position, N × rad.
    pub highest: JointVector<N>,
    /// Largest plausible change of a position in one period, N × rad, without [`jump_margin`](Self::jump_margin).
    pub step_per_tick: JointVector<N>,
    /// Position step that is always plausible, rad.
    pub jump_margin: f32,
    /// Largest plausible measured torque, N × N·m.
    pub effort: JointVector<N>,
    /// Periods without a usable sample after which the torque ends.
    pub timeout_ticks: u32,
    /// Periods that a brake takes to close, during which the torque of gravity is kept; 0 without a brake.
    pub brake_ticks: u32,
    /// Periods without a plausible measurement after which the torque ends.
    pub measurement_ticks: u32,
    /// Periods after which a temperature that no longer arrives counts as warm; twice as many at most.
    pub temperature_ticks: u32,
}

impl<const N: usize> SafetyLimits<N> {
    /// The limits of an arm for ticks of `period_us`, µs, which is not 0.
    pub fn for_arm<A: Arm<N, P>, const P: usize>(period_us: u32) -> Self {
        let period_s = period_us as f32 * 1e-6;
        let ticks = |time_us| ticks(time_us, period_us);
        let of = |value: fn(&foretorque::arm::JointLimits) -> f32| {
            JointVector::from(A::limits().map(|limits| value(&limits)))
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
            timeout_ticks: ticks(COMMAND_TIMEOUT_US),
            brake_ticks: 0,
            measurement_ticks: ticks(MEASUREMENT_TIMEOUT_US),
            temperature_ticks: ticks(TEMPERATURE_TIMEOUT_US),
        }
    }

    /// These limits for ticks of `period_us`, µs, with brakes that close within `close_us`, µs; 0 is without brakes.
    pub fn with_brake(self, close_us: u32, period_us: u32) -> Self {
        Self {
            brake_ticks: if close_us > 0 {
                ticks(close_us, period_us)
            } else {
                0
            },
            ..self
        }
    }
}

/// At least `time_us`: whole periods, and one that may have begun before.
fn ticks(time_us: u32, period_us: u32) -> u32 {
    time_us.checked_div(period_us).unwrap_or_default() + 1
}
