//! Faults of the drives' reports.

use super::Measurement;
use crate::dynamics::Joints;
use rand::Rng;
use rand_chacha::ChaCha8Rng;

/// Faults of the reports. The drives' own loops use [`super::Plant::measure`] and are not affected.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReportFaults {
    /// Factor on every reported torque: a wrong current sensor; negative = wrong sign.
    pub torque_gain: f64,
    /// Share of torque values that are outliers.
    pub outliers: f64,
    /// Size of an outlier, share of the torque limit.
    pub outlier_size: f64,
    /// Share of position values in which one of the encoder's upper bits has flipped.
    pub glitches: f64,
    /// Share of reports with a non-finite number.
    pub not_a_number: f64,
    /// Share of reports that never arrive.
    pub lost: f64,
    /// Share of reports that are late: the one before arrives once more in their place.
    pub late: f64,
}

impl ReportFaults {
    /// No fault; an outlier would be 20 % of the limit, twenty times the usual noise.
    pub const NONE: Self = Self {
        torque_gain: 1.0,
        outliers: 0.0,
        outlier_size: 0.2,
        glitches: 0.0,
        not_a_number: 0.0,
        lost: 0.0,
        late: 0.0,
    };
}

impl Default for ReportFaults {
    fn default() -> Self {
        Self::NONE
    }
}

/// The encoder bits that flip: from an eighth of a turn down to a thousandth.
const FLIPPED_BITS: std::ops::Range<i32> = 3..11;

impl ReportFaults {
    /// `measured` with the faults of sensors and frames.
    pub(super) fn damaged<const N: usize>(
        &self,
        measured: &Measurement<N>,
        torque_limit: &Joints<N>,
        random: &mut ChaCha8Rng,
    ) -> Measurement<N> {
        let mut seen = *measured;
        seen.tau *= self.torque_gain;
        for j in 0..N {
            if happens(self.outliers, random) {
                let sign = if random.random::<bool>() { 1.0 } else { -1.0 };
                seen.tau[j] += sign * self.outlier_size * torque_limit[j];
            }
            if happens(self.glitches, random) {
                let bit = random.random_range(FLIPPED_BITS);
                seen.q[j] += std::f64::consts::TAU * f64::exp2(f64::from(-bit));
            }
        }
        if happens(self.not_a_number, random) {
            let joint = random.random_range(0..N);
            let bad = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY][random.random_range(0..3)];
            if random.random::<bool>() {
                seen.q[joint] = bad;
            } else {
                seen.tau[joint] = bad;
            }
        }
        seen
    }

    /// Report that arrives: the `fresh` one, the one `before`, or none.
    pub(super) fn delivered<const N: usize>(
        &self,
        fresh: Measurement<N>,
        before: Option<Measurement<N>>,
        random: &mut ChaCha8Rng,
    ) -> Option<Measurement<N>> {
        if happens(self.lost, random) {
            return None;
        }
        if happens(self.late, random) {
            return before;
        }
        Some(fresh)
    }
}

/// True with this probability. Draws nothing at probability 0, so that one fault does not shift another.
fn happens(probability: f64, random: &mut ChaCha8Rng) -> bool {
    probability > 0.0 && random.random::<f64>() < probability
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::{Plant, PlantConfig};
    use crate::robot::Robot;

    const REPORTS: usize = 4000;

    /// Measured and reported values of an arm that stands still.
    fn reports(faults: ReportFaults) -> Vec<(Measurement<6>, Option<Measurement<6>>)> {
        let robot = Robot::load("ur5").expect("built in");
        let plant = Plant::<6>::new(&robot, PlantConfig::default(), 3).expect("six joints");
        let mut plant = plant.with_faults(faults);
        (0..REPORTS)
            .map(|_| {
                let measured = plant.measure();
                (measured, plant.report(&measured))
            })
            .collect()
    }

    fn share(found: usize, of: usize) -> f64 {
        found as f64 / of as f64
    }

    #[test]
    fn reports_equal_measurements_and_faults_keep_the_noise() {
        let clean = reports(ReportFaults::default());
        let bad = reports(ReportFaults {
            outliers: 0.01,
            lost: 0.1,
            ..ReportFaults::default()
        });
        for ((measured, report), (same, _)) in clean.iter().zip(&bad) {
            assert_eq!(Some(*measured), *report);
            assert_eq!(measured, same);
        }
    }

    #[test]
    fn faults_have_their_configured_shares() {
        let seen = reports(ReportFaults {
            torque_gain: -1.0,
            outliers: 0.01,
            glitches: 0.02,
            ..ReportFaults::default()
        });
        let (mut outliers, mut glitches) = (0, 0);
        for (measured, report) in &seen {
            let report = report.expect("none is lost");
            outliers += (0..6)
                .filter(|&j| report.tau[j] != -measured.tau[j])
                .count();
            glitches += (0..6).filter(|&j| report.q[j] != measured.q[j]).count();
        }
        assert!((share(outliers, 6 * REPORTS) - 0.01).abs() < 2e-3);
        assert!((share(glitches, 6 * REPORTS) - 0.02).abs() < 3e-3);
    }

    #[test]
    fn late_lost_and_broken_reports_have_their_shares() {
        let seen = reports(ReportFaults {
            lost: 0.05,
            late: 0.05,
            not_a_number: 0.03,
            ..ReportFaults::default()
        });
        let lost = seen.iter().filter(|(_, report)| report.is_none()).count();
        let late = seen.windows(2).filter(|pair| Some(pair[0].0) == pair[1].1);
        let late = late.count();
        let broken = |m: &Measurement<6>| !m.q.iter().chain(m.tau.iter()).all(|x| x.is_finite());
        let broken = seen.iter().filter(|(_, r)| r.as_ref().is_some_and(broken));
        assert!((share(lost, REPORTS) - 0.05).abs() < 0.012);
        assert!((share(late, REPORTS) - 0.05).abs() < 0.012, "{late}");
        assert!((share(broken.count(), REPORTS) - 0.03).abs() < 0.012);
    }
}
