//! Departures from a rigid arm with sound sensors: effects of real drives, faults of the reports.

use super::Measurement;
use crate::Refusal;
use crate::dynamics::Joints;
use crate::files::{from_toml, text_of};
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::f64::consts::TAU;
use std::path::Path;

/// Effects of real drives. A field of 0 switches its effect off.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct PlantEffects {
    /// Twist of every gear under the joint's torque limit, mrad: its stiffness is limit over twist.
    pub twist_mrad: f64,
    /// Damping ratio of the rotor on that spring.
    pub twist_damping: f64,
    /// Width of the backlash of every gear, mrad, link side.
    pub backlash_mrad: f64,
    /// Displacement at which the LuGre friction of a joint slides, mrad.
    pub presliding_mrad: f64,
    /// Fall of viscous friction in a warm drive, share.
    pub warm_viscous_fall: f64,
    /// Time in which a drive becomes warm, s.
    pub warm_up_s: f64,
    /// Gain of a torque loop around a sensor behind the gear: it divides friction and rotor inertia by 1 + gain. The
    /// measured torque is then that of the sensor, without friction and rotor.
    pub torque_loop_gain: f64,
    /// The measured torque is the commanded one of the torque loop, with the part of friction and rotor that the loop
    /// leaves, not that of its sensor.
    pub reports_commanded_torque: bool,
    /// Largest relative error of each joint's drive gain, drawn with the plant's seed.
    pub drive_gain_spread: f64,
    /// Largest zero error of each joint's current sensor, share of the torque limit, drawn with the plant's seed.
    pub torque_offset: f64,
    /// Amplitude of its slow drift (period 300 s), share of the torque limit.
    pub torque_offset_drift: f64,
    /// Delay of the reports, ms.
    pub delay_ms: f64,
    /// Largest further delay of a report, ms; the newest report that has arrived counts.
    pub delay_jitter_ms: f64,
    /// Largest error of the instant at which positions are sampled, ms.
    pub sampling_jitter_ms: f64,
    /// Delay of the reported torque behind the reported position, ms.
    pub torque_lag_ms: f64,
}

const DRIFT_PERIOD_S: f64 = 300.0;

impl PlantEffects {
    /// The table in a TOML file.
    ///
    /// Errors: one line that names the file.
    pub fn load(path: &Path) -> Result<Self, Refusal> {
        let refused = |problem: String| Refusal::of(path.display(), problem);
        let effects: Self = from_toml(&text_of(path)?).map_err(refused)?;
        let problem = effects.problem();
        problem.map_or(Ok(effects), |problem| Err(refused(problem.to_owned())))
    }

    /// First value without a meaning.
    fn problem(&self) -> Option<&'static str> {
        let values = serde_json::to_value(self).ok();
        let values = values.as_ref().and_then(serde_json::Value::as_object);
        // A number that is none becomes null.
        let sound = |value: &serde_json::Value| {
            value.is_boolean() || value.as_f64().is_some_and(|value| value >= 0.0)
        };
        let positive = values.is_some_and(|values| values.values().all(sound));
        let (spread, fall) = (self.drive_gain_spread, self.warm_viscous_fall);
        let rigid = self.twist_mrad == 0.0;
        let elastic_only = self.backlash_mrad > 0.0 || self.torque_loop_gain > 0.0;
        let no_loop = self.torque_loop_gain == 0.0;
        let problems = [
            (!positive, "every value must be a number and not negative"),
            (spread >= 1.0, "drive_gain_spread must be below 1"),
            (fall >= 1.0, "warm_viscous_fall must be below 1"),
            (
                rigid && elastic_only,
                "backlash_mrad and torque_loop_gain need twist_mrad above 0",
            ),
            (
                no_loop && self.reports_commanded_torque,
                "reports_commanded_torque needs torque_loop_gain above 0",
            ),
            (
                fall > 0.0 && self.warm_up_s == 0.0,
                "warm_viscous_fall needs warm_up_s above 0",
            ),
        ];
        let found = problems.into_iter().find(|(is_there, _)| *is_there);
        found.map(|(_, problem)| problem)
    }
}

/// Errors of the drives of one plant, drawn with its seed.
#[derive(Clone, Debug)]
pub(super) struct DriveErrors<const N: usize> {
    /// Ratio of delivered to asked torque.
    gain: Joints<N>,
    /// Zero error of the current sensor, N·m; amplitude, N·m, and phase, rad, of its drift.
    offset: Joints<N>,
    drift: Joints<N>,
    phase: Joints<N>,
}

impl<const N: usize> DriveErrors<N> {
    pub(super) fn new(
        effects: &PlantEffects,
        drive_gain: f64,
        torque_limit: &Joints<N>,
        random: &mut ChaCha8Rng,
    ) -> Self {
        let mut draw = |size: f64| Joints::from_fn(|_, _| size * random.random_range(-1.0..1.0));
        Self {
            gain: (Joints::repeat(1.0) + draw(effects.drive_gain_spread)) * drive_gain,
            offset: draw(effects.torque_offset).component_mul(torque_limit),
            phase: draw(std::f64::consts::PI),
            drift: torque_limit * effects.torque_offset_drift,
        }
    }

    /// Torque of the drives, N·m, for the torque `asked` of them: an error of the current sensor is torque that the arm lacks.
    pub(super) fn delivered(&self, asked: &Joints<N>, t_s: f64) -> Joints<N> {
        asked.component_mul(&self.gain) - self.offset(t_s)
    }

    /// Torque to ask of the drives so that they deliver `wanted`, N·m.
    pub(super) fn asked(&self, wanted: &Joints<N>, t_s: f64) -> Joints<N> {
        (wanted + self.offset(t_s)).component_div(&self.gain)
    }

    fn offset(&self, t_s: f64) -> Joints<N> {
        let swing = self
            .phase
            .map(|phase| (TAU * t_s / DRIFT_PERIOD_S + phase).sin());
        self.offset + self.drift.component_mul(&swing)
    }
}

/// Reports on their way: delayed, at uneven instants.
#[derive(Clone, Debug, Default)]
pub(super) struct ReportQueue<const N: usize> {
    /// Measurements with their times, s, the newest first.
    sent: VecDeque<(f64, Measurement<N>)>,
    /// Time of the newest report that has arrived, s.
    newest_s: f64,
}

impl<const N: usize> ReportQueue<N> {
    /// Report that has arrived at `t_s`, with `fresh` on its way; `qd` is the velocity, rad/s.
    pub(super) fn pass(
        &mut self,
        effects: &PlantEffects,
        (t_s, mut fresh): (f64, Measurement<N>),
        qd: &Joints<N>,
        random: &mut ChaCha8Rng,
    ) -> Measurement<N> {
        let most_s = 1e-3 * (effects.delay_ms + effects.delay_jitter_ms + effects.torque_lag_ms);
        if most_s == 0.0 && effects.sampling_jitter_ms == 0.0 {
            return fresh;
        }
        fresh.q += qd * (1e-3 * effects.sampling_jitter_ms * random.random_range(-1.0..1.0));
        self.sent.push_front((t_s, fresh));
        while self.sent.len() > 2 && self.sent[self.sent.len() - 2].0 < t_s - most_s - 1e-9 {
            self.sent.pop_back();
        }
        let delay = effects.delay_ms + effects.delay_jitter_ms * random.random_range(0.0..1.0);
        self.newest_s = self.newest_s.max(t_s - 1e-3 * delay);
        let before = |s: f64| {
            let found = self.sent.iter().find(|(sent_s, _)| *sent_s <= s + 1e-9);
            let found = found.or(self.sent.back());
            found.map_or(fresh, |(_, report)| *report)
        };
        Measurement {
            q: before(self.newest_s).q,
            tau: before(self.newest_s - 1e-3 * effects.torque_lag_ms).tau,
        }
    }
}

/// Faults of the reports. The drives' own loops use [`super::Plant::measure`] and are not affected.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReportFaults {
    /// Factor on every reported torque: a wrong current sensor; negative = wrong sign.
    pub torque_gain: f64,
    /// Share of torque values that are outliers.
    pub outliers: f64,
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
    /// No fault.
    pub const NONE: Self = Self {
        torque_gain: 1.0,
        outliers: 0.0,
        glitches: 0.0,
        not_a_number: 0.0,
        lost: 0.0,
        late: 0.0,
    };
}

/// Size of an outlier, share of the torque limit: twenty times the usual noise.
const OUTLIER_SIZE: f64 = 0.2;
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
                seen.tau[j] += sign * OUTLIER_SIZE * torque_limit[j];
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
        let clean = reports(ReportFaults::NONE);
        let bad = reports(ReportFaults {
            outliers: 0.01,
            lost: 0.1,
            ..ReportFaults::NONE
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
            ..ReportFaults::NONE
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
        let seen = reports(ReportFaults {
            lost: 0.05,
            late: 0.05,
            not_a_number: 0.03,
            ..ReportFaults::NONE
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
