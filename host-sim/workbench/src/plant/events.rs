//! Events on the arm, payloads and external torques; faults of the drives' reports.

use super::Measurement;
use crate::dynamics::Joints;
use crate::robot::Link;
use rand::Rng;
use rand_chacha::ChaCha8Rng;

/// A body that the hand holds for a while.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Payload {
    /// The body, in the frame of the last link.
    pub body: Link,
    /// Pick-up time, s.
    pub from_s: f64,
    /// Release time, s.
    pub to_s: f64,
}

/// An external torque on the joints, for example a contact or a collision.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Push<const N: usize> {
    /// Torque on every joint while it lasts, N·m; positive accelerates +q.
    pub torque: Joints<N>,
    /// Start, s.
    pub from_s: f64,
    /// End, s.
    pub to_s: f64,
}

/// Time in which a push rises, and falls again, s.
const RISE_S: f64 = 0.01;

/// All events of one run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Events<const N: usize> {
    /// Payloads; the first one whose interval contains the time counts.
    pub payloads: Vec<Payload>,
    /// Pushes; they add up.
    pub pushes: Vec<Push<N>>,
}

impl<const N: usize> Events<N> {
    /// Index of the payload in the hand at `t_s`.
    pub(super) fn payload_at(&self, t_s: f64) -> Option<usize> {
        // Half a nanosecond of slack: the sum of many steps is not exactly the time they make.
        let now = t_s + 5e-10;
        let held = |payload: &Payload| (payload.from_s..payload.to_s).contains(&now);
        self.payloads.iter().position(held)
    }

    /// Torque from outside at `t_s`, N·m.
    pub(super) fn push_at(&self, t_s: f64) -> Joints<N> {
        let mut torque = Joints::zeros();
        for push in &self.pushes {
            let inside = (t_s - push.from_s).min(push.to_s - t_s);
            torque += push.torque * (inside / RISE_S).clamp(0.0, 1.0);
        }
        torque
    }
}

impl Payload {
    /// A cube of `mass_kg` and of steel's third in density (2600 kg/m³), its centre at `com_m` in the last link's frame.
    pub fn cube(mass_kg: f64, com_m: [f64; 3], from_s: f64, to_s: f64) -> Self {
        let side = (mass_kg / 2600.0).cbrt();
        let moment = mass_kg * side * side / 6.0;
        Self {
            body: Link {
                mass: mass_kg,
                com: com_m.into(),
                inertia_com: nalgebra::Matrix3::identity() * moment,
            },
            from_s,
            to_s,
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
    use crate::dynamics::State;
    use crate::plant::{Plant, PlantConfig};
    use crate::robot::{Perturbation, Robot};

    fn arm(events: Events<6>) -> Plant<6> {
        let robot = Robot::load("ur5")
            .expect("built in")
            .perturbed(1, &Perturbation::PLANT);
        let plant = Plant::new(&robot, PlantConfig::default(), 1).expect("six joints");
        plant.with_events(events)
    }

    #[test]
    fn a_payload_loads_the_joints_only_while_it_is_held() {
        let body = Payload::cube(3.0, [0.02, -0.01, 0.05], 0.010, 0.020);
        let mut plant = arm(Events {
            payloads: vec![body],
            pushes: Vec::new(),
        });
        let still = State::rest(Joints::<6>::zeros());
        let before = plant.true_torque(&still);
        let mut loads = Vec::new();
        for _ in 0..30 {
            plant.advance(&before, 1e-3);
            loads.push((plant.carried().is_some(), plant.true_torque(&still)));
        }
        for (tick, (carried, torque)) in loads.iter().enumerate() {
            // The payload is looked at when a step begins: after tick 10 its first step has run.
            assert_eq!(*carried, (10..20).contains(&tick), "tick {tick}");
            if *carried {
                // Stretched out, the shoulder carries a lever of 0.82 m and more.
                assert!((torque[1] - before[1]).abs() > 3.0 * 9.81 * 0.75);
            } else {
                assert!((torque - before).amax() < 1e-9);
            }
        }
    }

    #[test]
    fn a_push_moves_the_arm_but_not_the_torque_of_a_motion() {
        let mut torque = Joints::zeros();
        torque[0] = 40.0;
        let push = Push {
            torque,
            from_s: 0.05,
            to_s: 0.15,
        };
        let events = Events {
            payloads: Vec::new(),
            pushes: vec![push],
        };
        assert_eq!(events.push_at(0.04), Joints::<6>::zeros());
        assert!(
            (events.push_at(0.055)[0] - 20.0).abs() < 1e-9,
            "half way up"
        );
        assert_eq!(events.push_at(0.1), torque);
        let (mut pushed, mut left) = (arm(events), arm(Events::default()));
        let hold = left.true_torque(&State::rest(Joints::zeros()));
        for _ in 0..150 {
            pushed.advance(&hold, 1e-3);
            left.advance(&hold, 1e-3);
        }
        assert!((pushed.q() - left.q())[0] > 0.01);
        let motion = State {
            q: Joints::repeat(0.3),
            qd: Joints::repeat(1.0),
            qdd: Joints::repeat(2.0),
        };
        assert_eq!(pushed.true_torque(&motion), left.true_torque(&motion));
    }

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
    }

    #[test]
    fn late_lost_and_broken_reports_have_their_shares() {
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
