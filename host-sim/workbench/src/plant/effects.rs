//! Effects of real drives that a rigid arm with steady friction has not. All are off by default.

use super::Measurement;
use crate::Refusal;
use crate::dynamics::Joints;
use crate::files::at;
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

/// Period of the sensor drift, s.
const DRIFT_PERIOD_S: f64 = 300.0;

impl PlantEffects {
    /// The table in a TOML file.
    ///
    /// Errors: one line that names the file.
    pub fn load(path: &Path) -> Result<Self, Refusal> {
        let text = std::fs::read_to_string(path);
        let text = text.map_err(|error| Refusal(at(path, error).to_string()))?;
        let effects: Self = toml::from_str(&text).map_err(|error| {
            let words: Vec<&str> = error.message().split_whitespace().collect();
            Refusal::of(path.display(), words.join(" "))
        })?;
        match effects.problem() {
            Some(problem) => Err(Refusal::of(path.display(), problem)),
            None => Ok(effects),
        }
    }

    /// First value without a meaning.
    fn problem(&self) -> Option<&'static str> {
        let values = serde_json::to_value(self).ok();
        let values = values.as_ref().and_then(serde_json::Value::as_object);
        // A number that is none becomes null.
        let sound = |value: &serde_json::Value| value.as_f64().is_some_and(|value| value >= 0.0);
        let elastic = self.twist_mrad > 0.0;
        let checks = [
            (
                values.is_some_and(|values| values.values().all(sound)),
                "every value must be a number and not negative",
            ),
            (
                (0.0..1.0).contains(&self.drive_gain_spread),
                "drive_gain_spread must be below 1",
            ),
            (
                (0.0..1.0).contains(&self.warm_viscous_fall),
                "warm_viscous_fall must be below 1",
            ),
            (
                elastic || (self.backlash_mrad == 0.0 && self.torque_loop_gain == 0.0),
                "backlash_mrad and torque_loop_gain need twist_mrad above 0",
            ),
            (
                self.warm_viscous_fall == 0.0 || self.warm_up_s > 0.0,
                "warm_viscous_fall needs warm_up_s above 0",
            ),
        ];
        let bad = checks.into_iter().find(|(met, _)| !met);
        bad.map(|(_, problem)| problem)
    }
}

/// Errors of the drives of one plant, drawn with its seed.
#[derive(Clone, Debug)]
pub(super) struct DriveErrors<const N: usize> {
    /// Ratio of delivered to asked torque.
    pub(super) gain: Joints<N>,
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
            found
                .or(self.sent.back())
                .map_or(fresh, |(_, report)| *report)
        };
        Measurement {
            q: before(self.newest_s).q,
            tau: before(self.newest_s - 1e-3 * effects.torque_lag_ms).tau,
        }
    }
}
