use super::quality::{ModelQuality, Phase};
use super::ud::UdFilter;
use crate::dynamics::FRICTION_COLUMNS;

/// Rows of a joint after which what was seen has faded to 37 %.
const FADE: f32 = 1.0 - 1.0 / 512.0;
/// Trust has to rise this far above the floor before the flag falls again.
const HYSTERESIS: f32 = 0.05;

/// What one row of a joint says of the model in force, all in units of the joint's torque limit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Observation {
    /// Measured torque.
    pub(super) measured: f32,
    /// What the active set leaves of it.
    pub(super) residual: f32,
    /// Rigid-body, friction and network share.
    pub(super) shares: [f32; 3],
}

/// Faded sums of squares.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Sums {
    weight: f32,
    measured: f32,
    residual: f32,
    shares: [f32; 3],
}

/// Watches how well the model in force explains the torques.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Monitor<const N: usize> {
    joints: [Sums; N],
    /// The parameter whose information is asked for next, and that of those before.
    place: usize,
    known: f32,
}

impl<const N: usize> Monitor<N> {
    /// Nothing seen.
    pub(super) const fn new() -> Self {
        const NOTHING: Sums = Sums {
            weight: 0.0,
            measured: 0.0,
            residual: 0.0,
            shares: [0.0; 3],
        };
        Self {
            joints: [NOTHING; N],
            place: 0,
            known: 0.0,
        }
    }

    /// Asks `filter` for one parameter and brings the information of `quality` up to date after the last of them.
    ///
    /// Cost: one row of U, `P + FRICTION_COLUMNS` multiply-adds at most.
    pub(super) fn ask<const P: usize>(
        &mut self,
        filter: &UdFilter<N, P>,
        quality: &mut ModelQuality<N>,
    ) {
        let friction = N * FRICTION_COLUMNS;
        let (joint, column) = (self.place / FRICTION_COLUMNS, self.place % FRICTION_COLUMNS);
        let variance = match self.place.checked_sub(friction) {
            None => filter.friction_variance(joint, column),
            Some(column) => filter.rigid_variance(column),
        };
        // Doubt may have been raised beyond the prior's.
        let known = 1.0 - variance.unwrap_or(1.0);
        self.known += if known > 0.0 { known } else { 0.0 };
        self.place += 1;
        if self.place >= friction + P {
            quality.information = self.known / self.place as f32;
            self.place = 0;
            self.known = 0.0;
        }
    }

    /// Takes a row of `joint`.
    pub(super) fn note(&mut self, joint: usize, seen: &Observation) {
        let Some(sums) = self.joints.get_mut(joint) else {
            return;
        };
        let [rigid, friction, network] = seen.shares;
        let finite = seen.measured + seen.residual + rigid + friction + network;
        if !finite.is_finite() {
            return;
        }
        let fade = |sum: &mut f32, value: f32| *sum = FADE * *sum + value * value;
        fade(&mut sums.weight, 1.0);
        fade(&mut sums.measured, seen.measured);
        fade(&mut sums.residual, seen.residual);
        for (sum, share) in sums.shares.iter_mut().zip(seen.shares) {
            fade(sum, share);
        }
    }

    /// Brings residuals, shares and trust of `quality` up to date. Returns whether trust was lost or regained.
    ///
    /// ```text
    /// trust = 1 − sqrt(mean_j (RMS residual_j / RMS torque_j)²), over the joints that have moved
    /// ```
    pub(super) fn tell(&self, quality: &mut ModelQuality<N>, floor: f32) -> Option<bool> {
        let mut unexplained = 0.0;
        let mut moved = 0.0;
        let mut shares = [0.0; 3];
        for (rms, sums) in quality.residual_rms.iter_mut().zip(&self.joints) {
            if sums.weight < 1.0 {
                continue;
            }
            let inverse = 1.0 / sums.weight;
            *rms = libm::sqrtf(sums.residual * inverse);
            for (total, share) in shares.iter_mut().zip(sums.shares) {
                *total += share * inverse;
            }
            if sums.measured > 0.0 {
                unexplained += sums.residual / sums.measured;
            }
            moved += 1.0;
        }
        if moved == 0.0 {
            return None;
        }
        quality.share_rms = shares.map(|sum| libm::sqrtf(sum / moved));
        let trust = 1.0 - libm::sqrtf(unexplained / moved);
        quality.trust = if trust > 0.0 { trust } else { 0.0 };
        let before = quality.low_trust;
        quality.low_trust = if before {
            quality.trust < floor + HYSTERESIS
        } else {
            quality.trust < floor
        };
        (quality.low_trust != before).then_some(quality.low_trust)
    }
}

impl<const N: usize> Default for Monitor<N> {
    fn default() -> Self {
        Self::new()
    }
}

impl Phase {
    /// The estimate learns.
    pub(super) fn learns(self) -> bool {
        matches!(self, Self::Healthy | Self::Relearning)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learning::stacked::LinearParameters;

    fn row(residual: f32) -> Observation {
        Observation {
            measured: 0.3,
            residual,
            shares: [0.2, 0.1, -0.05],
        }
    }

    #[test]
    fn trust_falls_when_a_joint_is_no_longer_explained_and_says_so_once() {
        let mut monitor = Monitor::<2>::new();
        let mut quality = ModelQuality::new();
        assert_eq!(monitor.tell(&mut quality, 0.7), None);
        assert_eq!(quality.trust, 1.0);
        let mut changes = std::vec::Vec::new();
        for round in 0..6000 {
            let residual = if (1000..3000).contains(&round) {
                0.2
            } else {
                0.01
            };
            monitor.note(0, &row(residual));
            monitor.note(1, &row(0.01));
            changes.extend(monitor.tell(&mut quality, 0.7));
        }
        assert_eq!(changes, [true, false]);
        assert!(quality.trust > 0.9, "{quality:?}");
        assert!((quality.share_rms[0] - 0.2).abs() < 1e-3);
        assert!((quality.residual_rms[1] - 0.01).abs() < 1e-4);
    }

    #[test]
    fn what_is_not_finite_is_not_seen() {
        let mut monitor = Monitor::<2>::new();
        monitor.note(0, &row(0.1));
        let before = monitor;
        monitor.note(0, &row(f32::NAN));
        monitor.note(7, &row(0.1));
        assert_eq!(monitor, before);
    }

    #[test]
    fn information_is_the_mean_part_of_the_doubt_that_rows_have_removed() {
        const PARAMETERS: usize = 2 * FRICTION_COLUMNS + 3;
        let mut filter = UdFilter::<2, 3>::new();
        let mut gain = LinearParameters::filled(0.0);
        let mut phi = LinearParameters::filled(0.0);
        (phi.friction[1][2], phi.rigid[0]) = (3.0, 4.0);
        filter.update(1, &phi, 1.0, &mut gain);
        let (mut monitor, mut quality) = (Monitor::<2>::new(), ModelQuality::new());
        for _ in 0..PARAMETERS {
            assert_eq!(quality.information, 0.0);
            monitor.ask(&filter, &mut quality);
        }
        // P = I − φφᵀ/(φᵀφ + 1): the trace has lost 25/26.
        let wanted = 25.0 / 26.0 / PARAMETERS as f32;
        assert!((quality.information - wanted).abs() < 1e-6, "{quality:?}");
    }
}
