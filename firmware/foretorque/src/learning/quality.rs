use super::ud::UdFilter;
use crate::dynamics::FRICTION_COLUMNS;

/// State of the learning supervisor; the diagram is in `docs/learning.md`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum Phase {
    /// No change detected; the active set may follow the estimate.
    #[default]
    Healthy = 0,
    /// A change was detected: the active set is frozen during the payload test.
    PayloadTest = 1,
    /// The change is no payload: the estimate learns it, and the shares follow the evidence.
    Relearning = 2,
    /// Emergency stop: nothing is learnt.
    Stopped = 3,
}

impl Phase {
    /// True if the estimate is updated.
    pub(super) fn learns(self) -> bool {
        matches!(self, Self::Healthy | Self::Relearning)
    }
}

/// Estimate of the payload.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PayloadEstimate {
    /// Mass, kg; 0 without a payload.
    pub mass: f32,
    /// Centre of mass, measured from and expressed in the frame of the last link, m.
    pub com: [f32; 3],
    /// Standard deviation of the mass, kg, with the inflated measurement variance of the payload filter.
    pub mass_sigma: f32,
}

/// Agreement of the active set with the measured torques.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ModelQuality<const N: usize> {
    /// RMS residual of the active set in motion, over the last seconds, in units of the joint's torque limit.
    pub residual_rms: [f32; N],
    /// RMS of the rigid-body, friction and network share over the last seconds and all joints, in units of the torque
    /// limit.
    pub share_rms: [f32; 3],
    /// Mean over the linear parameters of `1 − P_ii`: part of the prior variance removed by measurements.
    ///
    /// It stays below 1 if no motion excites a column: cogging of a drive without cogging, load of an upright axis.
    pub information: f32,
    /// Trust, 0 to 1; 1 until the arm has moved.
    ///
    /// ```text
    /// trust = 1 − sqrt(max_j (residual_j² − noise_j²) / (torque_j² − noise_j² + floor²))     mean squares of moving joints
    /// ```
    /// The worst joint decides. The noise is that of successive residuals: half the mean square of their differences, so
    /// slow errors are no noise. The floor is the configured noise of a measurement.
    pub trust: f32,
    /// True if trust has fallen below the threshold.
    pub low_trust: bool,
    /// State of the supervisor.
    pub phase: Phase,
    /// Payload in the torque.
    pub payload: PayloadEstimate,
}

impl<const N: usize> ModelQuality<N> {
    /// Quality before the first row.
    pub const fn new() -> Self {
        Self {
            residual_rms: [0.0; N],
            share_rms: [0.0; 3],
            information: 0.0,
            trust: 1.0,
            low_trust: false,
            phase: Phase::Healthy,
            payload: PayloadEstimate {
                mass: 0.0,
                com: [0.0; 3],
                mass_sigma: 0.0,
            },
        }
    }
}

impl<const N: usize> Default for ModelQuality<N> {
    fn default() -> Self {
        Self::new()
    }
}

/// Fading of the sums with each row of a joint: 37 % after 512 rows.
const FADE: f32 = 1.0 - 1.0 / 512.0;
/// Margin above the threshold at which the trust flag is cleared.
const HYSTERESIS: f32 = 0.05;

/// Least faded number of rows of a joint that decides the trust.
const TRUST_ROWS: f32 = 16.0;

/// One row of a joint under the active set, in units of the joint's torque limit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Observation {
    pub(super) measured: f32,
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
    /// Half the squares of differences of successive residuals, and the last residual.
    noise: f32,
    last: f32,
    shares: [f32; 3],
}

/// Computation of [`ModelQuality`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Monitor<const N: usize> {
    joints: [Sums; N],
    /// Next parameter for the information, and the sum over those before.
    index: usize,
    removed: f32,
}

impl<const N: usize> Monitor<N> {
    pub(super) const fn new() -> Self {
        const EMPTY: Sums = Sums {
            weight: 0.0,
            measured: 0.0,
            residual: 0.0,
            noise: 0.0,
            last: 0.0,
            shares: [0.0; 3],
        };
        Self {
            joints: [EMPTY; N],
            index: 0,
            removed: 0.0,
        }
    }

    /// Add the variance of one parameter; after the last one, update the information of `quality`.
    ///
    /// Cost: one row of U, `P + FRICTION_COLUMNS` multiply-adds at most.
    pub(super) fn update_information<const P: usize>(
        &mut self,
        filter: &UdFilter<N, P>,
        quality: &mut ModelQuality<N>,
    ) {
        let friction = N * FRICTION_COLUMNS;
        let (joint, column) = (self.index / FRICTION_COLUMNS, self.index % FRICTION_COLUMNS);
        let variance = match self.index.checked_sub(friction) {
            None => filter.friction_variance(joint, column),
            Some(column) => filter.rigid_variance(column),
        };
        // Process noise may have raised a variance above the prior's.
        let removed = 1.0 - variance.unwrap_or(1.0);
        self.removed += if removed > 0.0 { removed } else { 0.0 };
        self.index += 1;
        if self.index >= friction + P {
            quality.information = self.removed / self.index as f32;
            self.index = 0;
            self.removed = 0.0;
        }
    }

    /// Add a row of `joint`; a row that is not finite is ignored.
    pub(super) fn add_row(&mut self, joint: usize, row: &Observation) {
        let Some(sums) = self.joints.get_mut(joint) else {
            return;
        };
        let [rigid, friction, network] = row.shares;
        let finite = row.measured + row.residual + rigid + friction + network;
        if !finite.is_finite() {
            return;
        }
        let fade = |sum: &mut f32, value: f32| *sum = FADE * *sum + value * value;
        fade(&mut sums.weight, 1.0);
        fade(&mut sums.measured, row.measured);
        fade(&mut sums.residual, row.residual);
        let change = row.residual - sums.last;
        fade(&mut sums.noise, core::f32::consts::FRAC_1_SQRT_2 * change);
        sums.last = row.residual;
        for (sum, share) in sums.shares.iter_mut().zip(row.shares) {
            fade(sum, share);
        }
    }

    /// Update residuals, shares and trust of `quality`; returns the trust flag if it has changed.
    ///
    /// * `threshold` trust below which the flag is set      * `noise` configured noise, in units of the torque limit
    pub(super) fn update_trust(
        &self,
        quality: &mut ModelQuality<N>,
        threshold: f32,
        noise: f32,
    ) -> Option<bool> {
        let mut worst = 0.0;
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
            let [wrong, needed] = [sums.residual, sums.measured].map(|sum| {
                let square = (sum - sums.noise) * inverse;
                if square > 0.0 { square } else { 0.0 }
            });
            let ratio = wrong / (needed + noise * noise);
            if sums.weight >= TRUST_ROWS && ratio > worst {
                worst = ratio;
            }
            moved += 1.0;
        }
        if moved == 0.0 {
            return None;
        }
        quality.share_rms = shares.map(|sum| libm::sqrtf(sum / moved));
        let trust = 1.0 - libm::sqrtf(worst);
        quality.trust = if trust > 0.0 { trust } else { 0.0 };
        let before = quality.low_trust;
        quality.low_trust = if before {
            quality.trust < threshold + HYSTERESIS
        } else {
            quality.trust < threshold
        };
        (quality.low_trust != before).then_some(quality.low_trust)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learning::parameters::LinearParameters;

    fn row(residual: f32) -> Observation {
        Observation {
            measured: 0.3,
            residual,
            shares: [0.2, 0.1, -0.05],
        }
    }

    #[test]
    fn loss_and_return_of_trust_are_reported_once() {
        let mut monitor = Monitor::<2>::new();
        let mut quality = ModelQuality::new();
        assert_eq!(monitor.update_trust(&mut quality, 0.7, 0.01), None);
        assert_eq!(quality.trust, 1.0);
        let mut changes = std::vec::Vec::new();
        for round in 0..6000 {
            let wrong = (1000..3000).contains(&round);
            monitor.add_row(0, &row(if wrong { 0.2 } else { 0.01 }));
            monitor.add_row(1, &row(0.01));
            changes.extend(monitor.update_trust(&mut quality, 0.7, 0.01));
        }
        assert_eq!(changes, [true, false]);
        assert!(quality.trust > 0.9, "{quality:?}");
        assert!((quality.share_rms[0] - 0.2).abs() < 1e-3);
        assert!((quality.residual_rms[1] - 0.01).abs() < 1e-4);
    }

    #[test]
    fn noise_costs_no_trust_and_one_wrong_joint_costs_it_all() {
        let (mut monitor, mut quality) = (Monitor::<6>::new(), ModelQuality::new());
        for round in 0..2000 {
            let noise = if round % 2 == 0 { 0.2 } else { -0.2 };
            monitor.add_row(0, &row(noise));
            (1..6).for_each(|joint| monitor.add_row(joint, &row(0.01)));
        }
        monitor.update_trust(&mut quality, 0.7, 0.01);
        assert!(quality.trust > 0.95, "{quality:?}");
        for _ in 0..2000 {
            for joint in 0..6 {
                monitor.add_row(joint, &row(if joint == 1 { 0.15 } else { 0.01 }));
            }
        }
        monitor.update_trust(&mut quality, 0.7, 0.01);
        assert!(quality.trust < 0.55, "{quality:?}");
    }

    #[test]
    fn a_row_that_is_not_finite_is_ignored() {
        let mut monitor = Monitor::<2>::new();
        monitor.add_row(0, &row(0.1));
        let before = monitor;
        monitor.add_row(0, &row(f32::NAN));
        monitor.add_row(7, &row(0.1));
        assert_eq!(monitor, before);
    }

    #[test]
    fn information_is_the_mean_removed_part_of_the_variance() {
        const PARAMETERS: usize = 2 * FRICTION_COLUMNS + 3;
        let mut filter = UdFilter::<2, 3>::new();
        let mut gain = LinearParameters::filled(0.0);
        let mut phi = LinearParameters::filled(0.0);
        (phi.friction[1][2], phi.rigid[0]) = (3.0, 4.0);
        filter.update(1, &phi, 1.0, &mut gain);
        let (mut monitor, mut quality) = (Monitor::<2>::new(), ModelQuality::new());
        for _ in 0..PARAMETERS {
            assert_eq!(quality.information, 0.0);
            monitor.update_information(&filter, &mut quality);
        }
        // P = I − φφᵀ/(φᵀφ + 1): the trace has lost 25/26.
        let wanted = 25.0 / 26.0 / PARAMETERS as f32;
        assert!((quality.information - wanted).abs() < 1e-6, "{quality:?}");
    }
}
