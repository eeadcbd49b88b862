//! Motions to play: the excitation, a via-point validation path, or samples from a table.

use crate::dynamics::{Joints, State};
use crate::excitation::Excitation;
use crate::robot::Robot;
use crate::table::StateRow;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::fmt;

/// Length of the validation path, s.
pub const VALIDATION_S: f64 = 30.0;
/// Fastest joint of the validation path, rad/s.
pub const VALIDATION_PEAK_RAD_S: f64 = 2.7;
/// Time between two via points, s.
const SEGMENT_S: f64 = 1.5;
/// Range of the via points around zero, rad.
const VIA_RANGE_RAD: f64 = 2.0;

/// A motion that asks a joint for more than it can do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BeyondLimits {
    /// The joint, from 1.
    pub joint: usize,
    /// When, s after the trajectory's start.
    pub t_s: f64,
    /// What is asked, in `unit`.
    pub asked: f64,
    /// The limit, in `unit`.
    pub limit: f64,
    /// `rad`, `rad/s` or `rad/s²`.
    pub unit: &'static str,
}

impl fmt::Display for BeyondLimits {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            joint,
            t_s,
            asked,
            limit,
            unit,
        } = self;
        write!(
            f,
            "joint {joint} is asked for {asked:.3} {unit} at {t_s:.3} s, its limit is {limit:.3} {unit}"
        )
    }
}

impl std::error::Error for BeyondLimits {}

/// Something to play, with its own clock.
#[derive(Clone, Debug, PartialEq)]
pub enum Trajectory<const N: usize> {
    /// Fourier series, repeated for as long as asked.
    Excitation {
        /// The series.
        series: Excitation,
        /// How long it is played, s.
        duration_s: f64,
    },
    /// Quintics through via points.
    Via(ViaPath<N>),
    /// Samples of a table, held until the next one is due.
    Sampled(Vec<(f64, State<N>)>),
}

impl<const N: usize> Trajectory<N> {
    /// The unseen path on which torques are judged: 30 s, peak 2.7 rad/s, seeded.
    pub fn validation(robot: &Robot, seed: u64) -> Self {
        Self::Via(ViaPath::random(
            robot,
            seed,
            VALIDATION_S,
            VALIDATION_PEAK_RAD_S,
        ))
    }

    /// The rows of a table; its clock starts at the first row. Rows without time are `period_s` apart.
    pub fn sampled(rows: &[StateRow<N>], period_s: f64) -> Self {
        let start_s = rows.first().and_then(|row| row.t_s).unwrap_or(0.0);
        Self::Sampled(
            rows.iter()
                .enumerate()
                .map(|(k, row)| {
                    let t_s = row.t_s.map_or(k as f64 * period_s, |t_s| t_s - start_s);
                    (t_s, row.motion)
                })
                .collect(),
        )
    }

    /// How long it lasts, s.
    pub fn duration_s(&self) -> f64 {
        match self {
            Self::Excitation { duration_s, .. } => *duration_s,
            Self::Via(path) => path.duration_s(),
            Self::Sampled(samples) => samples.last().map_or(0.0, |(t_s, _)| *t_s),
        }
    }

    /// The motion at `t_s`; at rest in the last position afterwards.
    pub fn at(&self, t_s: f64) -> State<N> {
        let end_s = self.duration_s();
        let mut state = match self {
            Self::Excitation { series, .. } => series.at(t_s.min(end_s)),
            Self::Via(path) => path.at(t_s.min(end_s)),
            Self::Sampled(samples) => {
                // Half a microsecond of slack: a sample due now must not be missed by rounding.
                let next = samples.partition_point(|(due_s, _)| *due_s <= t_s + 5e-7);
                let zero = State {
                    q: Joints::zeros(),
                    qd: Joints::zeros(),
                    qdd: Joints::zeros(),
                };
                samples
                    .get(next.saturating_sub(1))
                    .map_or(zero, |(_, state)| *state)
            }
        };
        if t_s > end_s + 5e-7 {
            state.qd = Joints::zeros();
            state.qdd = Joints::zeros();
        }
        state
    }

    /// Every motion keeps the joints' limits of position, speed and acceleration.
    ///
    /// * `period_s` step in which a series or a path is looked at; of a table every row is
    ///
    /// Errors: the first motion that does not.
    pub fn check(&self, robot: &Robot, period_s: f64) -> Result<(), BeyondLimits> {
        let every = |length_s: f64| {
            (0..=(length_s / period_s).round() as usize).map(move |k| k as f64 * period_s)
        };
        match self {
            Self::Excitation { series, duration_s } => every(series.period_s.min(*duration_s))
                .try_for_each(|t_s| within::<N>(robot, t_s, &series.at(t_s))),
            Self::Via(path) => {
                every(path.duration_s()).try_for_each(|t_s| within(robot, t_s, &path.at(t_s)))
            }
            Self::Sampled(samples) => samples
                .iter()
                .try_for_each(|(t_s, state)| within(robot, *t_s, state)),
        }
    }

    /// Number of ticks of `period_s` it lasts.
    pub fn ticks(&self, period_s: f64) -> usize {
        (self.duration_s() / period_s).round() as usize
    }
}

/// One motion keeps the limits, up to a rounding in a file of six digits.
fn within<const N: usize>(robot: &Robot, t_s: f64, state: &State<N>) -> Result<(), BeyondLimits> {
    for (j, joint) in robot.joints.iter().take(N).enumerate() {
        let limits = &joint.limits;
        let (low, high) = limits.position;
        let end = if state.q[j] < low { low } else { high };
        let past_end = (low - state.q[j]).max(state.q[j] - high);
        for (asked, limit, broken, unit) in [
            (state.q[j], end, past_end, "rad"),
            (
                state.qd[j],
                limits.velocity,
                state.qd[j].abs() - limits.velocity,
                "rad/s",
            ),
            (
                state.qdd[j],
                limits.acceleration,
                state.qdd[j].abs() - limits.acceleration,
                "rad/s²",
            ),
        ] {
            if broken > 1e-6 * limit.abs() {
                return Err(BeyondLimits {
                    joint: j + 1,
                    t_s,
                    asked,
                    limit,
                    unit,
                });
            }
        }
    }
    Ok(())
}

/// A path through via points, one quintic a segment and joint: continuous up to the acceleration.
#[derive(Clone, Debug, PartialEq)]
pub struct ViaPath<const N: usize> {
    segment_s: f64,
    /// Positions, rad, and velocities, rad/s, at the via points; the acceleration is zero there.
    via: Vec<(Joints<N>, Joints<N>)>,
}

impl<const N: usize> ViaPath<N> {
    /// Random via points inside the limits, at rest at both ends; the fastest joint reaches `peak_rad_s`.
    ///
    /// Via velocities are the slopes of the neighbours (Catmull–Rom), zero at the ends. Swings are shrunk about the path's
    /// middle until speed and acceleration fit, so positions stay inside the range of the via points.
    pub fn random(robot: &Robot, seed: u64, duration_s: f64, peak_rad_s: f64) -> Self {
        let segments = (duration_s / SEGMENT_S).round().max(2.0) as usize;
        let segment_s = duration_s / segments as f64;
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let points: Vec<Joints<N>> = (0..=segments)
            .map(|_| Joints::from_fn(|_, _| random.random_range(-VIA_RANGE_RAD..=VIA_RANGE_RAD)))
            .collect();
        let mut path = Self {
            segment_s,
            via: (0..=segments)
                .map(|k| {
                    let slope = if k == 0 || k == segments {
                        Joints::zeros()
                    } else {
                        (points[k + 1] - points[k - 1]) / (2.0 * segment_s)
                    };
                    (points[k], slope)
                })
                .collect(),
        };
        let (mut qd, mut qdd) = (Joints::<N>::zeros(), Joints::<N>::zeros());
        for k in 0..=segments * 400 {
            let state = path.at(k as f64 * segment_s / 400.0);
            qd = qd.sup(&state.qd.abs());
            qdd = qdd.sup(&state.qdd.abs());
        }
        for (j, joint) in robot.joints.iter().take(N).enumerate() {
            let fits = (peak_rad_s.min(0.95 * joint.limits.velocity) / qd[j])
                .min(0.95 * joint.limits.acceleration / qdd[j]);
            for (q, slope) in &mut path.via {
                q[j] *= fits.min(1.0);
                slope[j] *= fits.min(1.0);
            }
        }
        path
    }

    /// The same path of `joint` alone; the others stay where they begin.
    pub fn of_joint(mut self, joint: usize) -> Self {
        let start = self.via.first().map_or(Joints::zeros(), |(q, _)| *q);
        for (q, slope) in &mut self.via {
            for other in (0..N).filter(|&other| other != joint) {
                q[other] = start[other];
                slope[other] = 0.0;
            }
        }
        self
    }

    /// Length, s.
    pub fn duration_s(&self) -> f64 {
        self.segment_s * (self.via.len() - 1) as f64
    }

    /// The motion at `t_s`.
    pub fn at(&self, t_s: f64) -> State<N> {
        let last = self.via.len() - 2;
        let segment = ((t_s / self.segment_s).max(0.0) as usize).min(last);
        let t = (t_s - segment as f64 * self.segment_s).clamp(0.0, self.segment_s);
        let ((q0, v0), (q1, v1)) = (self.via[segment], self.via[segment + 1]);
        let h = self.segment_s;
        // Quintic with q, qd given and qdd = 0 at both ends; c1 = 0, c2 = 0 for the constant part of the algebra:
        // with D = q1 − q0 − v0 h and E = (v1 − v0) h, c3 = 10 D − 4 E, c4 = −15 D + 7 E, c5 = 6 D − 3 E over h³, h⁴, h⁵.
        let d = q1 - q0 - v0 * h;
        let e = (v1 - v0) * h;
        let (c3, c4, c5) = (10.0 * d - 4.0 * e, 7.0 * e - 15.0 * d, 6.0 * d - 3.0 * e);
        let s = t / h;
        State {
            q: q0 + v0 * t + (c3 + (c4 + c5 * s) * s) * s.powi(3),
            qd: v0 + (3.0 * c3 + (4.0 * c4 + 5.0 * c5 * s) * s) * (s * s / h),
            qdd: (6.0 * c3 + (12.0 * c4 + 20.0 * c5 * s) * s) * (s / (h * h)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn validation_path_keeps_its_limits_and_reaches_its_peak() {
        let robot = Robot::load("ur5").expect("built in");
        for seed in 0..10 {
            let path = Trajectory::<6>::validation(&robot, seed);
            assert_eq!(path.ticks(1e-3), 30_000);
            let mut peak = 0.0_f64;
            for k in 0..=30_000 {
                let state = path.at(f64::from(k) * 1e-3);
                assert!(state.q.amax() < 1.25 * VIA_RANGE_RAD, "seed {seed}");
                assert!(state.qdd.amax() <= 10.0, "seed {seed}");
                peak = peak.max(state.qd.amax());
            }
            assert!((2.4..=2.7 + 1e-4).contains(&peak), "seed {seed}: {peak}");
            let (start, end) = (path.at(0.0), path.at(30.0));
            assert!(start.qd.amax() < 1e-9 && end.qd.amax() < 1e-9);
        }
    }

    #[test]
    fn a_motion_beyond_a_limit_is_named_with_joint_and_time() {
        let robot = Robot::load("ur5").expect("built in");
        let still = State {
            q: Joints::<6>::zeros(),
            qd: Joints::zeros(),
            qdd: Joints::zeros(),
        };
        let (mut far, mut fast, mut hard) = (still, still, still);
        far.q[1] = -6.4;
        fast.qd[2] = -3.2;
        hard.qdd[5] = 10.5;
        for (motion, joint, unit) in [(far, 2, "rad"), (fast, 3, "rad/s"), (hard, 6, "rad/s²")] {
            let path = Trajectory::Sampled(vec![(0.0, still), (0.1, motion)]);
            let broken = path.check(&robot, 1e-3).expect_err(unit);
            assert_eq!((broken.joint, broken.t_s, broken.unit), (joint, 0.1, unit));
        }
        assert!(
            Trajectory::Sampled(vec![(0.0, still)])
                .check(&robot, 1e-3)
                .is_ok()
        );
        assert!(
            Trajectory::<6>::validation(&robot, 1)
                .check(&robot, 1e-3)
                .is_ok()
        );
    }

    #[test]
    fn quintics_join_without_a_step_up_to_the_acceleration() {
        let robot = Robot::load("ur5").expect("built in");
        let path = ViaPath::<6>::random(&robot, 3, 30.0, 2.7);
        for k in 1..20 {
            let t_s = f64::from(k) * SEGMENT_S;
            let (before, after) = (path.at(t_s - 1e-9), path.at(t_s + 1e-9));
            assert!((before.q - after.q).amax() < 1e-7);
            assert!((before.qd - after.qd).amax() < 1e-6);
            assert!((before.qdd - after.qdd).amax() < 1e-5);
        }
        let h = 1e-5;
        for k in 0..100 {
            let t_s = 0.17 + 0.29 * f64::from(k);
            let slope = (path.at(t_s + h).q - path.at(t_s - h).q) / (2.0 * h);
            assert!((slope - path.at(t_s).qd).amax() < 1e-5);
            let bend = (path.at(t_s + h).qd - path.at(t_s - h).qd) / (2.0 * h);
            assert!((bend - path.at(t_s).qdd).amax() < 1e-3, "{t_s}");
        }
    }

    #[test]
    fn samples_are_held_until_the_next_is_due_and_rest_afterwards() {
        let state = |v: f64| State {
            q: Joints::<1>::repeat(v),
            qd: Joints::repeat(v),
            qdd: Joints::zeros(),
        };
        let path = Trajectory::Sampled(vec![(0.0, state(1.0)), (0.1, state(2.0))]);
        for (t_s, q, qd) in [
            (0.0, 1.0, 1.0),
            (0.05, 1.0, 1.0),
            (0.1, 2.0, 2.0),
            (0.3, 2.0, 0.0),
        ] {
            assert_eq!((path.at(t_s).q[0], path.at(t_s).qd[0]), (q, qd), "{t_s}");
        }
    }
}
