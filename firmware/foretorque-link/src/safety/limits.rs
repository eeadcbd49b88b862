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
pub const JUMP_MARGIN: f32 = 0.02;
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
    /// Largest plausible change of a position in one period, N × rad, without [`JUMP_MARGIN`].
    pub step_per_tick: JointVector<N>,
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
            effort: torque * EFFORT_MARGIN,
            timeout_ticks: ticks(COMMAND_TIMEOUT_US),
            brake_ticks: 0,
            measurement_ticks: ticks(MEASUREMENT_TIMEOUT_US),
            temperature_ticks: ticks(TEMPERATURE_TIMEOUT_US),
        }
    }

    /// Lowers the torques to `most`, N × N·m.
    pub fn limit_torques(&mut self, most: &[f32; N]) {
        for (torque, &most) in self.torque.iter_mut().zip(most) {
            *torque = if most < *torque { most } else { *torque };
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

/// Motor temperature above which the torque limit falls, °C: the 120 °C of class-E windings, less the difference between the
/// copper and a sensor on the case.
pub const WARM_C: i8 = 80;
/// Motor temperature at which the torque ends, °C.
pub const HOT_C: i8 = 100;
/// Surplus over the reading while a motor cools, °C, so that the limit does not oscillate.
pub const HYSTERESIS_C: i8 = 5;
/// Temperature as which a motor counts, at least, whose temperature no longer arrives, °C.
const OVERDUE_C: i8 = 85;
/// Plausible readings, °C; others come from a broken sensor.
pub(crate) const PLAUSIBLE_C: core::ops::RangeInclusive<i8> = -40..=125;

/// Reduction of the torque limits by the motor temperatures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct ThermalDerating<const N: usize> {
    /// Temperatures with hysteresis, °C; `None` is unknown, which limits nothing.
    effective_c: [Option<i8>; N],
    /// Motors with a reading since the last look at the ages.
    read: [bool; N],
    /// Periods since then.
    periods: u32,
}

impl<const N: usize> ThermalDerating<N> {
    pub(super) const fn new() -> Self {
        Self {
            effective_c: [None; N],
            read: [false; N],
            periods: 0,
        }
    }

    /// Takes one period of time. A motor without a reading for `overdue` to twice as many periods counts as warm, unless
    /// its temperature was never known.
    pub(super) fn age(&mut self, overdue: u32, periods: u32) {
        self.periods = self.periods.saturating_add(periods);
        if self.periods < overdue {
            return;
        }
        self.periods = 0;
        for (read, effective) in self.read.iter_mut().zip(&mut self.effective_c) {
            if let Some(celsius) = effective
                && !*read
            {
                *celsius = OVERDUE_C.max(*celsius);
            }
            *read = false;
        }
    }

    /// Takes a reading of one motor, °C. An implausible one changes nothing.
    pub(super) fn record(&mut self, joint: usize, celsius: i8) {
        let (Some(effective), Some(read)) =
            (self.effective_c.get_mut(joint), self.read.get_mut(joint))
        else {
            return;
        };
        if !PLAUSIBLE_C.contains(&celsius) {
            return;
        }
        *effective = Some(match *effective {
            // Warmer counts at once, cooler only beyond the hysteresis.
            Some(before) => celsius.max(before.min(celsius.saturating_add(HYSTERESIS_C))),
            None => celsius,
        });
        *read = true;
    }

    /// Usable part of the torque limit of `joint`, 0 to 1.
    pub(super) fn factor(&self, joint: usize) -> f32 {
        match self.effective_c.get(joint).copied().flatten() {
            Some(celsius) => {
                let left = f32::from(HOT_C) - f32::from(celsius);
                (left * (1.0 / (HOT_C - WARM_C) as f32)).clamp(0.0, 1.0)
            }
            None => 1.0,
        }
    }

    pub(super) fn hot(&self) -> bool {
        self.any(HOT_C)
    }

    pub(super) fn warm(&self) -> bool {
        self.any(WARM_C + 1)
    }

    fn any(&self, celsius: i8) -> bool {
        let mut known = self.effective_c.iter().flatten();
        known.any(|&effective| effective >= celsius)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_limit_falls_with_temperature_and_returns_with_hysteresis() {
        let mut derating = ThermalDerating::<2>::new();
        for (celsius, factor) in [
            (25, 1.0),
            (80, 1.0),
            (90, 0.5),
            (87, 0.5), // cooler by less than the hysteresis
            (83, 0.6), // counts as 88 °C
            (100, 0.0),
            (127, 0.0), // implausible
            (20, 1.0),
            (95, 0.25),
            (i8::MIN, 0.25),
            (-100, 0.25),
            (126, 0.25),
        ] {
            derating.record(1, celsius);
            assert_eq!(derating.factor(1), factor, "{celsius} °C");
            assert_eq!(derating.factor(0), 1.0);
        }
    }

    #[test]
    fn a_temperature_that_stops_arriving_counts_as_warm() {
        let mut derating = ThermalDerating::<3>::new();
        for k in 0..30 {
            derating.record(0, 40);
            if k < 10 {
                derating.record(1, 40);
            }
            derating.age(10, 1);
            assert_eq!(derating.warm(), k >= 19, "period {k}");
        }
        assert_eq!([0, 1, 2].map(|j| derating.factor(j)), [1.0, 0.75, 1.0]);
        // Cooler by more than the hysteresis.
        derating.record(1, 40);
        assert_eq!(derating.factor(1), 1.0);
    }
}
