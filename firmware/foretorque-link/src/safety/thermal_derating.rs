/// Above this motor temperature the torque limit is reduced, °C: below the 120 °C of class-E windings' hot spot by the
/// difference between a sensor on the case and the copper inside.
pub const WARM_C: i8 = 80;
/// At this motor temperature the torque is withdrawn, °C.
pub const HOT_C: i8 = 100;
/// A motor that cools is taken for this much warmer than it says, °C, so that the limit does not swing.
pub const HYSTERESIS_C: i8 = 5;
/// Readings outside this range are those of a broken sensor, °C, and are not believed.
const PLAUSIBLE_C: core::ops::RangeInclusive<i8> = -40..=125;

/// Temperatures of the motors as the limits see them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct ThermalDerating<const N: usize> {
    /// °C; `None` while nothing is known, which limits nothing.
    taken: [Option<i8>; N],
}

impl<const N: usize> ThermalDerating<N> {
    /// Nothing is known.
    pub(super) const fn new() -> Self {
        Self { taken: [None; N] }
    }

    /// Takes a reading of one motor, °C. One that cannot be true changes nothing: what was known stays in force.
    pub(super) fn note(&mut self, joint: usize, celsius: i8) {
        let Some(taken) = self.taken.get_mut(joint) else {
            return;
        };
        if !PLAUSIBLE_C.contains(&celsius) {
            return;
        }
        *taken = Some(match *taken {
            // Warmer counts at once, cooler only beyond the hysteresis.
            Some(before) => celsius.max(before.min(celsius.saturating_add(HYSTERESIS_C))),
            None => celsius,
        });
    }

    /// Part of its torque limit that `joint` may use, 0 to 1.
    pub(super) fn part(&self, joint: usize) -> f32 {
        match self.taken.get(joint).copied().flatten() {
            Some(celsius) => {
                let left = f32::from(HOT_C) - f32::from(celsius);
                (left * (1.0 / (HOT_C - WARM_C) as f32)).clamp(0.0, 1.0)
            }
            None => 1.0,
        }
    }

    /// A motor is at [`HOT_C`] or above.
    pub(super) fn hot(&self) -> bool {
        self.any(HOT_C)
    }

    /// A motor is above [`WARM_C`].
    pub(super) fn warm(&self) -> bool {
        self.any(WARM_C + 1)
    }

    fn any(&self, celsius: i8) -> bool {
        self.taken.iter().flatten().any(|&taken| taken >= celsius)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_limit_falls_with_heat_and_comes_back_later_than_it_went() {
        let mut heat = ThermalDerating::<2>::new();
        let mut part = |celsius| {
            heat.note(1, celsius);
            heat.part(1)
        };
        assert_eq!(part(25), 1.0);
        assert_eq!(part(80), 1.0);
        assert_eq!(part(90), 0.5);
        assert_eq!(part(87), 0.5, "cooler by less than the hysteresis");
        assert_eq!(part(83), 0.6, "88 °C are taken for 83 °C");
        assert_eq!(part(100), 0.0);
        assert_eq!(part(127), 0.0);
        assert_eq!(part(20), 1.0);
        assert_eq!(heat.part(0), 1.0);
    }

    #[test]
    fn a_reading_that_cannot_be_true_changes_nothing() {
        let mut heat = ThermalDerating::<1>::new();
        heat.note(0, 95);
        for absurd in [i8::MIN, -100, 126, 127] {
            heat.note(0, absurd);
            assert_eq!(heat.part(0), 0.25);
        }
    }
}
