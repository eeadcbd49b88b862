//! Motions to play: the excitation, a via-point validation path, a path of the tool, or samples from a table.

pub mod cartesian;
pub mod via;

use crate::Refusal;
use crate::dynamics::{Joints, State};
use crate::excitation::Excitation;
use crate::files::text_of;
use crate::robot::Robot;
use crate::table::read_states;
use std::fmt::Display;
use std::path::Path;
use via::{ViaPath, agree, between};

/// Length of the validation path, s.
const VALIDATION_S: f64 = 30.0;
/// Fastest joint of the validation path, rad/s.
pub const VALIDATION_PEAK_RAD_S: f64 = 2.7;

/// Longest motion, s: every millisecond of it is a row.
pub const MOST_DURATION_S: f64 = 1e5;
/// Excess over a limit, or over the range of positions, by a rounding in a file of six digits.
const ROUNDED: f64 = 1e-6;
/// Excess between two rows: a cubic through rows at the limits leaves these a little.
const CURVED: f64 = 1e-2;

/// A motion to play, with its own clock.
#[derive(Clone, Debug, PartialEq)]
pub enum Trajectory<const N: usize> {
    /// Fourier series, repeated for as long as asked.
    Excitation {
        /// The series.
        series: Excitation,
        /// Playing time, s.
        duration_s: f64,
    },
    /// Quintics through via points.
    Via(ViaPath<N>),
    /// Samples of a table, joined by cubics.
    Sampled(Vec<(f64, State<N>)>),
}

impl<const N: usize> Trajectory<N> {
    /// The unseen path on which torques are judged: 30 s, peak 2.7 rad/s, seeded.
    pub fn validation(robot: &Robot, seed: u64) -> Self {
        Self::unseen(robot, seed, VALIDATION_S)
    }

    /// A validation path of another length.
    fn unseen(robot: &Robot, seed: u64, length_s: f64) -> Self {
        let path = ViaPath::random(robot, seed, length_s, VALIDATION_PEAK_RAD_S);
        Self::Via(path)
    }

    /// Duration, s.
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
                match (samples.get(next.saturating_sub(1)), samples.get(next)) {
                    (Some(last), Some(next)) if t_s > last.0 + 5e-7 => between(last, next, t_s),
                    (Some((_, state)), _) => *state,
                    (None, _) => State::rest(Joints::zeros()),
                }
            }
        };
        if t_s > end_s + 5e-7 {
            state = State::rest(state.q);
        }
        state
    }

    /// Every motion keeps the joints' limits of position, speed and acceleration.
    ///
    /// * `period_s` sampling step; of a table every row is checked, too, and that its velocities are those of its positions
    ///
    /// Errors: the first motion that does not.
    pub fn check(&self, robot: &Robot, period_s: f64) -> Result<(), Refusal> {
        let duration_s = self.duration_s();
        if duration_s > MOST_DURATION_S {
            return Err(Refusal(format!(
                "the trajectory takes {duration_s:.0} s, at most {MOST_DURATION_S} are played: are its times seconds from its begin?"
            )));
        }
        let every = |length_s: f64| -> Vec<f64> {
            let steps = 0..=(length_s / period_s).round() as usize;
            steps.map(|k| k as f64 * period_s).collect()
        };
        let times_s = match self {
            Self::Excitation { series, duration_s } => every(series.period_s.min(*duration_s)),
            Self::Via(path) => every(path.duration_s()),
            Self::Sampled(samples) => samples.iter().map(|(t_s, _)| *t_s).collect(),
        };
        let mut times_s = times_s.into_iter();
        times_s.try_for_each(|t_s| within(robot, t_s, &self.at(t_s), ROUNDED))?;
        if let Self::Sampled(samples) = self {
            agree(robot, samples)?;
            for rows in samples.windows(2) {
                let steps = 1..((rows[1].0 - rows[0].0) / period_s) as usize;
                for t_s in steps.map(|k| rows[0].0 + k as f64 * period_s) {
                    within(robot, t_s, &self.at(t_s), CURVED)?;
                }
            }
        }
        Ok(())
    }

    /// Duration in ticks of `period_s`.
    pub fn ticks(&self, period_s: f64) -> usize {
        (self.duration_s() / period_s).round() as usize
    }

    /// Loads the argument of `--trajectory`: `validation`; an excitation (`.json`); a path of the tool (`.toml`); else a table with
    /// time, q, qd and qdd. Limits are checked.
    ///
    /// * `seed` of the validation path
    /// * `duration_s` for which an excitation is repeated, one period where it is `None`; a longer validation path is made as
    ///   long
    /// * `period_s` step of the limit checks and of the samples of a tool path
    ///
    /// Errors: one line that names the file.
    pub fn load(
        name: &str,
        robot: &Robot,
        seed: u64,
        duration_s: Option<f64>,
        period_s: f64,
    ) -> Result<Self, Refusal> {
        if name == "validation" {
            let length_s = duration_s.unwrap_or(VALIDATION_S).max(VALIDATION_S);
            return Ok(Self::unseen(robot, seed, length_s));
        }
        let path = Path::new(name);
        if path.extension().is_none() && !path.exists() {
            return Err(Refusal::of(name, "neither `validation` nor a file"));
        }
        let trajectory = match path.extension().and_then(|extension| extension.to_str()) {
            Some("json") => {
                let series = excitation(path, robot)?;
                let duration_s = duration_s.unwrap_or(series.period_s);
                Self::Excitation { series, duration_s }
            }
            Some("toml") => {
                if robot.coupling.is_some() {
                    let reason = "paths of the tool are not planned for coupled joints";
                    return Err(Refusal::of(name, reason));
                }
                let samples = cartesian::plan(robot, &text_of(path)?, period_s);
                // Every sample was checked when it was laid out, so that the message names the move.
                return samples.map(Self::Sampled).map_err(in_file(name));
            }
            _ => {
                let mut rows = read_states(path).map_err(|error| Refusal(error.to_string()))?;
                // The clock starts at the first row.
                let start_s = rows.first().map_or(0.0, |row| row.0);
                rows.iter_mut().for_each(|row| row.0 -= start_s);
                Self::Sampled(rows)
            }
        };
        trajectory.check(robot, period_s).map_err(in_file(name))?;
        Ok(trajectory)
    }
}

/// The excitation for `robot` in a file.
///
/// Errors: one line that names the file.
pub fn excitation(path: &Path, robot: &Robot) -> Result<Excitation, Refusal> {
    let name = &path.display().to_string();
    let none = |error| Refusal(format!("{name}: no excitation.json of `excite`: {error}"));
    let series: Excitation = serde_json::from_str(&text_of(path)?).map_err(none)?;
    series.check(robot).map_err(in_file(name))?;
    Ok(series)
}

/// One motion keeps the limits, but for a share of them.
fn within<const N: usize>(
    robot: &Robot,
    t_s: f64,
    state: &State<N>,
    share: f64,
) -> Result<(), Refusal> {
    for (j, joint) in robot.joints.iter().take(N).enumerate() {
        let limits = &joint.limits;
        let ((low, high), q) = (limits.position, state.q[j]);
        let end = if q < low { low } else { high };
        let past_end = (low - q).max(q - high);
        let speed = |asked: f64, limit: f64, unit| (asked, limit, asked.abs() - limit, limit, unit);
        for (asked, limit, broken, size, unit) in [
            (q, end, past_end, high - low, "rad"),
            speed(state.qd[j], limits.velocity, "rad/s"),
            speed(state.qdd[j], limits.acceleration, "rad/s²"),
        ] {
            if broken > share * size {
                let joint = j + 1;
                // So many decimals that the two differ.
                let decimals = if broken < 1e-3 { 6 } else { 3 };
                return Err(Refusal(format!(
                    "joint {joint} is asked for {asked:.decimals$} {unit} at {t_s:.3} s, its limit is {limit:.decimals$} {unit}"
                )));
            }
        }
    }
    Ok(())
}

fn in_file<E: Display>(name: &str) -> impl Fn(E) -> Refusal {
    move |error| Refusal::of(name, error)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trajectory::via::VIA_RANGE_RAD;

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
        for (asked_s, length_s) in [(None, 30.0), (Some(2.0), 30.0), (Some(45.0), 45.0)] {
            let path = Trajectory::<6>::load("validation", &robot, 1, asked_s, 1e-3);
            assert_eq!(path.expect("inside the limits").duration_s(), length_s);
        }
    }

    /// The validation path stays away from the ends of the ranges, and takes a `share` of the torque limits at most.
    fn stays_inside<const N: usize>(robot: &Robot, share: f64) {
        let model = crate::dynamics::ReferenceModel::<N>::new(robot).expect("its size");
        for seed in 0..10 {
            let path = Trajectory::<N>::validation(robot, seed);
            path.check(robot, 1e-3).expect("inside the limits");
            for k in 0..3000 {
                let state = path.at(f64::from(k) * 1e-2);
                let torque = model.inverse_dynamics(&state);
                for (j, joint) in robot.joints.iter().enumerate() {
                    let (low, high) = joint.limits.position;
                    let inside = (state.q[j] - low).min(high - state.q[j]);
                    assert!(inside >= 0.04 * (high - low), "seed {seed}, joint {j}");
                    let able = torque[j].abs() < share * joint.limits.torque;
                    assert!(able, "seed {seed}, joint {j}");
                }
            }
        }
    }

    #[test]
    fn a_weak_arm_moves_where_it_can_hold_itself() {
        let mut robot = Robot::load("ur5").expect("built in");
        // Stretched out, gravity takes 56 N·m of the shoulder.
        robot.joints[1].limits.torque = 45.0;
        stays_inside::<6>(&robot, 0.8);
    }

    #[test]
    fn the_validation_path_of_the_panda_stays_inside_its_ranges_and_torques() {
        stays_inside::<7>(&Robot::load("panda").expect("built in"), 1.0);
    }

    #[test]
    fn rows_too_far_apart_tell_no_motion() {
        let robot = Robot::load("ur5").expect("built in");
        let path = Trajectory::<6>::validation(&robot, 1);
        let table = |rate: f64| {
            let times_s = (0..100).map(|k| f64::from(k) * 0.01);
            let rows = times_s.map(|t_s| (rate * t_s, path.at(t_s)));
            Trajectory::Sampled(rows.collect()).check(&robot, 1e-3)
        };
        table(1.0).expect("inside the limits");
        let refused = table(1e3).expect_err("times in ms").to_string();
        assert!(refused.contains("is t_s in ms?"), "{refused}");
        // From rest to rest in any time.
        let (from, mut to) = (State::rest(Joints::zeros()), State::rest(Joints::zeros()));
        to.q[0] = 1.0;
        let rests = Trajectory::<6>::Sampled(vec![(0.0, from), (60.0, from), (90.0, to)]);
        rests.check(&robot, 1e-3).expect("slow enough");
    }

    /// Rows of a motion of joint 1 of a UR5 every `step_s`, with six decimals.
    fn table(step_s: f64) -> Vec<(f64, State<6>)> {
        let digits = |x: f64| (x * 1e6).round() / 1e6;
        let row = |k: usize| {
            let t_s = digits(k as f64 * step_s);
            let mut state = State::rest(Joints::zeros());
            state.q[0] = digits((2.0 * t_s).sin());
            state.qd[0] = digits(2.0 * (2.0 * t_s).cos());
            state.qdd[0] = digits(-4.0 * (2.0 * t_s).sin());
            (t_s, state)
        };
        (0..=(4.0 / step_s) as usize).map(row).collect()
    }

    #[test]
    fn samples_are_joined_by_cubics_and_rest_afterwards() {
        for step_s in [1e-3, 1.0 / 30.0, 0.1] {
            let samples = table(step_s);
            let path = Trajectory::Sampled(samples.clone());
            for (t_s, state) in &samples {
                assert_eq!(path.at(*t_s), *state);
            }
            for t_s in (0..3900).map(|k| 1e-3 * f64::from(k) + 4e-4) {
                let (state, (sin, cos)) = (path.at(t_s), (2.0 * t_s).sin_cos());
                assert!((state.q[0] - sin).abs() < 2e-5, "{t_s}");
                assert!((state.qd[0] - 2.0 * cos).abs() < 4e-3, "{t_s}");
            }
            let end = path.at(5.0);
            assert_eq!(end, State::rest(samples[samples.len() - 1].1.q));
        }
    }

    #[test]
    fn a_table_moves_within_the_limits_between_its_rows_and_as_its_velocities_say() {
        let robot = Robot::load("ur5").expect("built in");
        let check = |samples: &[_]| Trajectory::Sampled(samples.to_vec()).check(&robot, 1e-3);
        for step_s in [2.5e-4, 1e-3, 0.01, 1.0 / 30.0, 0.1, 0.25] {
            let sound = table(step_s);
            check(&sound).unwrap_or_else(|error| panic!("{step_s}: {error}"));
            for (factor, name) in [(-1.0, "turned"), (0.0, "zero"), (57.3, "degrees")] {
                let mut wrong = sound.clone();
                wrong.iter_mut().for_each(|row| row.1.qd[0] *= factor);
                assert!(check(&wrong).is_err() || step_s > 0.2, "{step_s}: {name}");
            }
        }
        check(&table(1e-3)[..1]).expect("a single row");
        // The clock goes on over rows that are missing.
        let mut hole = table(1e-3);
        hole.drain(500..900);
        hole.iter_mut().skip(500).for_each(|row| row.0 -= 0.4);
        let line = "row 501 at 0.500 s, joint 1: the position steps by 0.";
        let error = check(&hole).expect_err(line).to_string();
        assert!(error.starts_with(line), "{error}");
        let mut stamped = table(1e-3);
        stamped.iter_mut().skip(1).for_each(|row| row.0 += 1.7e9);
        let error = check(&stamped).expect_err("times of a clock").to_string();
        assert!(error.contains("at most 100000 are played"), "{error}");
        // Slow enough by its rows, but not on the way.
        let mut rows = table(1.0);
        for row in &mut rows {
            row.1 = State::rest(Joints::zeros());
        }
        rows[1].1.q[0] = 2.5;
        let error = check(&rows).expect_err("too fast").to_string();
        assert!(error.contains("is asked for 3."), "{error}");
        // Velocities that turn at once, rows from rest to rest in too short a time, and accelerations of the other sign.
        let mut turns = table(1e-3);
        for (t_s, state) in &mut turns {
            let (back, t_s) = ((*t_s / 0.5) as u32 % 2 == 1, *t_s % 0.5);
            state.q[0] = 1.0 + 3.0 * if back { 0.5 - t_s } else { t_s };
            state.qd[0] = if back { -3.0 } else { 3.0 };
            state.qdd[0] = 0.0;
        }
        let rest =
            |(t_s, q): (f64, f64)| (t_s, State::rest(Joints::from([q, 0.0, 0.0, 0.0, 0.0, 0.0])));
        let rests = [(0.0, 0.0), (1.0, 0.0), (1.3, 0.25), (2.3, 0.25)].map(rest);
        let mut turned = table(1e-3);
        turned.iter_mut().for_each(|row| row.1.qdd[0] *= -1.0);
        for (rows, words) in [
            (&turns[..], "the velocity changes by -6.000 rad/s"),
            (
                &rests,
                "on the way from the row before it is asked for 16.6",
            ),
            (&turned, "its accelerations give"),
        ] {
            let error = check(rows).expect_err(words).to_string();
            assert!(error.contains(words), "{error}");
        }
    }
}
