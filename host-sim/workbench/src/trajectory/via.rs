//! Paths through via points and through the rows of a table.

use crate::Refusal;
use crate::dynamics::{Joints, ReferenceModel, State};
use crate::robot::Robot;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Time between two via points of a random path, s.
const SEGMENT_S: f64 = 1.5;
/// Range of its via points around zero, rad.
pub(super) const VIA_RANGE_RAD: f64 = 2.0;

/// Points of a segment at which torques are looked at.
const TORQUE_POINTS: usize = 10;
/// Most steps of 15 % by which swings shrink for the torque limits.
const MOST_SHRINKS: usize = 12;
/// Share of the torque limits for the described arm: the true one may be a quarter heavier.
pub(crate) const TORQUE_SHARE: f64 = 0.75;
/// Share of the torque limits for gravity alone at the centre of the swings, and poses among which a centre is looked for.
const GRAVITY_SHARE: f64 = 0.5;
const CENTRES: usize = 400;

/// Nearest of some random poses to `centre` in which gravity needs half of the torque limits at most, or the one in which it
/// needs least; `None` where `centre` is such a pose.
fn held<const N: usize>(
    robot: &Robot,
    centre: &Joints<N>,
    random: &mut ChaCha8Rng,
) -> Option<Joints<N>> {
    let model = ReferenceModel::<N>::new(robot)?;
    let share = |q: &Joints<N>| {
        let torques = model.gravity_torques(q);
        let joints = robot.joints.iter().zip(&torques);
        let shares = joints.map(|(joint, torque)| torque.abs() / joint.limits.torque);
        shares.fold(0.0, f64::max)
    };
    if share(centre) <= GRAVITY_SHARE {
        return None;
    }
    let poses = (0..CENTRES).map(|_| {
        Joints::from_fn(|j, _| {
            let (low, high) = robot.joints[j].limits.position;
            let aside = 0.2 * (high - low);
            random.random_range(low + aside..=high - aside)
        })
    });
    // Poses that gravity allows come first, by their distance; the others by their torque.
    let cost = |q: &Joints<N>| match share(q) {
        share if share <= GRAVITY_SHARE => (0.0, (q - centre).norm()),
        share => (share, 0.0),
    };
    let costs = poses.map(|q| (cost(&q), q));
    let order = |a: &(f64, f64), b: &(f64, f64)| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1));
    costs.min_by(|a, b| order(&a.0, &b.0)).map(|(_, q)| q)
}

/// A path through via points, one quintic a segment and joint: continuous up to the acceleration.
#[derive(Clone, Debug, PartialEq)]
pub struct ViaPath<const N: usize> {
    segment_s: f64,
    /// Positions, rad, and velocities, rad/s, at the via points; the acceleration is zero there.
    via: Vec<(Joints<N>, Joints<N>)>,
}

impl<const N: usize> ViaPath<N> {
    /// Through `points` at even times, at rest at both ends.
    ///
    /// Via velocities are the slopes of the neighbours (Catmull–Rom). Fewer than two points: at rest at the only one, or at
    /// zero.
    pub fn through(points: &[Joints<N>], duration_s: f64) -> Self {
        let ends =
            [points.first(), points.last()].map(|end| end.copied().unwrap_or_else(Joints::zeros));
        let points = if points.len() < 2 { &ends } else { points };
        let last = points.len() - 1;
        let segment_s = duration_s / last as f64;
        let slope = |k: usize| match k == 0 || k == last {
            true => Joints::zeros(),
            false => (points[k + 1] - points[k - 1]) / (2.0 * segment_s),
        };
        Self {
            segment_s,
            via: (0..=last).map(|k| (points[k], slope(k))).collect(),
        }
    }

    /// Random via points inside the limits, at rest at both ends; the fastest joint reaches `peak_rad_s`.
    ///
    /// Via points lie within 2 rad of zero, or nearer about the nearest centre that leaves 10 % of the joint's range. Swings
    /// shrink about that centre until speed and acceleration fit, then together until the described arm needs at most 75 %
    /// of its torque limits. Where gravity needs half of a limit at the centre, the centre is the nearest of some random
    /// poses where it does not, or the one where it needs least.
    pub fn random(robot: &Robot, seed: u64, duration_s: f64, peak_rad_s: f64) -> Self {
        let segments = (duration_s / SEGMENT_S).round().max(2.0) as usize;
        let segment_s = duration_s / segments as f64;
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut points: Vec<Joints<N>> = (0..=segments)
            .map(|_| Joints::from_fn(|_, _| random.random_range(-VIA_RANGE_RAD..=VIA_RANGE_RAD)))
            .collect();
        let (mut centre, mut reach) = (Joints::<N>::zeros(), Joints::<N>::zeros());
        for (j, joint) in robot.joints.iter().take(N).enumerate() {
            let (low, high) = joint.limits.position;
            // Between via points the path leaves their range by five sixteenths of it at most, seldom by a quarter.
            reach[j] = (0.45 * (high - low)).min(1.25 * VIA_RANGE_RAD);
            let aside = 0.05 * (high - low) + reach[j];
            centre[j] = 0.0_f64
                .max(low + aside)
                .min((high - aside).max(0.5 * (low + high)));
        }
        if let Some(pose) = held(robot, &centre, &mut random) {
            centre = pose;
            for (j, joint) in robot.joints.iter().take(N).enumerate() {
                let (low, high) = joint.limits.position;
                let room = (pose[j] - low).min(high - pose[j]) - 0.05 * (high - low);
                reach[j] = reach[j].min(room);
            }
        }
        for point in &mut points {
            let share = reach / (1.25 * VIA_RANGE_RAD);
            *point = centre + share.component_mul(point);
        }
        let mut path = Self::through(&points, duration_s);
        let (mut qd, mut qdd) = (Joints::<N>::zeros(), Joints::<N>::zeros());
        for k in 0..=segments * 400 {
            let state = path.at(k as f64 * segment_s / 400.0);
            qd = qd.sup(&state.qd.abs());
            qdd = qdd.sup(&state.qdd.abs());
        }
        let mut fits = Joints::<N>::repeat(1.0);
        for (j, joint) in robot.joints.iter().take(N).enumerate() {
            fits[j] = (peak_rad_s.min(0.95 * joint.limits.velocity) / qd[j])
                .min(0.95 * joint.limits.acceleration / qdd[j])
                .min(1.0);
        }
        path.shrink(&centre, &fits);
        for _ in 0..MOST_SHRINKS {
            if path.torque_share(robot) <= TORQUE_SHARE {
                break;
            }
            path.shrink(&centre, &Joints::repeat(0.85));
        }
        path
    }

    /// Swings times `fits`, about `centre`.
    fn shrink(&mut self, centre: &Joints<N>, fits: &Joints<N>) {
        for (q, slope) in &mut self.via {
            *q = centre + (*q - centre).component_mul(fits);
            slope.component_mul_assign(fits);
        }
    }

    /// Largest torque of the described arm along the path, friction included, over the joint's torque limit.
    fn torque_share(&self, robot: &Robot) -> f64 {
        let Some(model) = ReferenceModel::<N>::new(robot) else {
            return 0.0;
        };
        let points = (self.via.len() - 1) * TORQUE_POINTS;
        let share = |k: usize| {
            let state = self.at(k as f64 * self.segment_s / TORQUE_POINTS as f64);
            let torque = model.inverse_dynamics(&state);
            let joints = robot.joints.iter().zip(torque.iter().zip(state.qd.iter()));
            let shares = joints.map(|(joint, (torque, qd))| {
                let friction = &joint.friction;
                let resisted = friction.viscous * qd + friction.coulomb * qd.signum();
                (torque + resisted).abs() / joint.limits.torque
            });
            shares.fold(0.0, f64::max)
        };
        (0..=points).map(share).fold(0.0, f64::max)
    }

    /// This path, `factor` times slower.
    pub fn stretched(mut self, factor: f64) -> Self {
        self.segment_s *= factor;
        for (_, slope) in &mut self.via {
            *slope /= factor;
        }
        self
    }

    /// This path, `factor` times slower until `until_s`, then as fast as it was.
    pub fn slow_until(mut self, factor: f64, until_s: f64) -> Self {
        let path = self.clone();
        for (k, (q, slope)) in self.via.iter_mut().enumerate() {
            let t_s = k as f64 * path.segment_s;
            let (at_s, factor) = if t_s <= until_s {
                (t_s / factor, factor)
            } else {
                (t_s - until_s + until_s / factor, 1.0)
            };
            let state = path.at(at_s);
            (*q, *slope) = (state.q, state.qd / factor);
        }
        self
    }

    /// This path, of `joint` alone until about `alone_s`; the others wait at their start.
    pub fn of_joint_until(mut self, joint: usize, alone_s: f64) -> Self {
        let start = self.via.first().map_or(Joints::zeros(), |(q, _)| *q);
        let waiting = (alone_s / self.segment_s) as usize + 1;
        for (q, slope) in self.via.iter_mut().take(waiting) {
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

/// Largest relative error of a number of six digits.
const DIGITS: f64 = 5e-6;
/// Largest acceleration between two rows over the limit: a cubic through rows of a motion at the limit is this much above it.
const CUBIC_EXCESS: f64 = 1.5;
/// Shortest time over which positions are compared with velocities, s, or a whole shorter table. Roundings, and positions
/// that a measured log repeats, count less in a longer one.
const SPAN_S: f64 = 0.1;

/// Largest acceleration of the cubic between two rows, beyond what an error of `rounding` in its positions makes, rad/s².
///
/// With the gain g of velocity and the distance r beyond that of a velocity which changes evenly, `|g| / h + 6 |r| / h²`.
fn cubic_acceleration<const N: usize>(
    (from_s, a): &(f64, State<N>),
    (to_s, b): &(f64, State<N>),
    j: usize,
    rounding: f64,
) -> f64 {
    let h = to_s - from_s;
    let rest = b.q[j] - a.q[j] - 0.5 * (a.qd[j] + b.qd[j]) * h;
    let gain = (b.qd[j] - a.qd[j]).abs() - 2.0 * rounding / h;
    gain / h + 6.0 * (rest.abs() - rounding) / (h * h)
}

/// Motion between two samples: the cubic with their positions and velocities; accelerations in proportion to the time.
pub(super) fn between<const N: usize>(
    (from_s, a): &(f64, State<N>),
    (to_s, b): &(f64, State<N>),
    t_s: f64,
) -> State<N> {
    let h = to_s - from_s;
    let s = (t_s - from_s) / h;
    let gain = b.qd - a.qd;
    // Distance beyond that of a velocity which changes evenly.
    let rest = b.q - a.q - (a.qd + b.qd) * (0.5 * h);
    State {
        q: a.q + (a.qd + gain * (0.5 * s)) * (s * h) + rest * (s * s * (3.0 - 2.0 * s)),
        qd: a.qd + gain * s + rest * (6.0 * s * (1.0 - s) / h),
        qdd: a.qdd + (b.qdd - a.qdd) * s,
    }
}

/// The positions of a table keep the velocity limit v from row to row, and follow the velocities.
///
/// `|Δq| ≤ v h` and `|Σ Δq − Σ ½ (qd + qd') h| ≤ Σ a h² / 4 + Σ |Δq| / 4` with the acceleration limit a: so much a trapezoid
/// errs at most, where the velocity rises and falls at the limit, and a quarter of the way for the noise of a measured log.
/// Digits of the file and two steps of the encoder come on top. Rows so far apart that the joint reaches its speed limit between
/// them must not swing.
///
/// The velocities keep the acceleration limit, `|Δqd| ≤ a Σ h`, and follow the accelerations,
/// `|Δqd − Σ ½ (qdd + qdd') h| ≤ ½ a Σ h`: a trapezoid errs by as much where the acceleration steps from one limit to the other. Two steps of the encoder in a row's
/// time come on top.
pub(super) fn agree<const N: usize>(
    robot: &Robot,
    samples: &[(f64, State<N>)],
) -> Result<(), Refusal> {
    for (j, joint) in robot.joints.iter().take(N).enumerate() {
        let limits = &joint.limits;
        let (mut first, mut followed, mut bound, mut gained) = (0, 0.0, 0.0, 0.0);
        for (row, rows) in samples.windows(2).enumerate() {
            let ((from_s, a), (to_s, b)) = (&rows[0], &rows[1]);
            let h = to_s - from_s;
            let (start_s, start) = &samples[first];
            let speed = a.qd[j].abs().max(b.qd[j].abs());
            let numbers = start.q[j].abs() + b.q[j].abs() + speed * (start_s + to_s);
            let rounding = 2.0 * joint.drive.encoder_step() + DIGITS * numbers;
            let (step, moved) = (b.q[j] - a.q[j], b.q[j] - start.q[j]);
            followed += 0.5 * (a.qd[j] + b.qd[j]) * h;
            gained += 0.5 * (a.qdd[j] + b.qdd[j]) * h;
            bound += 0.25 * (limits.acceleration * h * h + step.abs()) + DIGITS * speed * h;
            let place = format!("row {} at {to_s:.3} s, joint {}", row + 2, j + 1);
            // From rest to the speed limit and back. Over a longer time a cubic is monotone up to a slope of 3 Δq / h.
            let longest_s = 2.0 * limits.velocity / limits.acceleration;
            let swing = 3.0 * step.abs() + 0.25 * limits.acceleration * longest_s.powi(2);
            if h > longest_s && speed * h > swing + rounding {
                return Err(Refusal(format!(
                    "{place}: in the {h:.3} s since the row before its velocity makes {:.3} rad, its positions {step:.3} rad: write the rows between, or is t_s in ms?",
                    speed * h
                )));
            }
            if step.abs() > limits.velocity * h + rounding {
                let limit = limits.velocity;
                return Err(Refusal(format!(
                    "{place}: the position steps by {step:.3} rad in {h:.4} s, its limit is {limit:.3} rad/s: add the rows between, or slow the motion down"
                )));
            }
            let whole = to_s - start_s >= SPAN_S;
            let judged = whole || first == 0 && row + 2 == samples.len();
            if judged && (moved - followed).abs() > bound + rounding {
                return Err(Refusal(format!(
                    "{place}: the position moved by {moved:.6} rad since row {}, its velocities give {followed:.6} rad: write the derivative of the positions in their place",
                    first + 1
                )));
            }
            let (gain, noise) = (b.qd[j] - start.qd[j], 2.0 * rounding / h);
            let most = limits.acceleration * (to_s - start_s);
            if judged && gain.abs() > most + noise {
                return Err(Refusal(format!(
                    "{place}: the velocity changes by {gain:.3} rad/s in {:.4} s, its limit is {:.3} rad/s²: slow the motion down",
                    to_s - start_s,
                    limits.acceleration
                )));
            }
            if judged && (gain - gained).abs() > 0.5 * most + noise {
                return Err(Refusal(format!(
                    "{place}: the velocity changed by {gain:.6} rad/s since row {}, its accelerations give {gained:.6} rad/s: write the derivative of the velocities in their place",
                    first + 1
                )));
            }
            let peak = cubic_acceleration(&rows[0], &rows[1], j, rounding);
            let limit = limits.acceleration;
            // In closer rows the noise of a measured log makes most of it.
            if h >= SPAN_S && peak > CUBIC_EXCESS * limit {
                return Err(Refusal(format!(
                    "{place}: on the way from the row before it is asked for {peak:.3} rad/s², its limit is {limit:.3} rad/s²: add the rows between, or slow the motion down"
                )));
            }
            if whole {
                (first, followed, bound, gained) = (row + 1, 0.0, 0.0, 0.0);
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn path() -> ViaPath<6> {
        ViaPath::random(&Robot::load("ur5").expect("built in"), 3, 30.0, 2.7)
    }

    #[test]
    fn quintics_join_without_a_step_up_to_the_acceleration() {
        let path = path();
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
    fn a_path_of_one_joint_moves_the_others_only_afterwards() {
        let path = path();
        let alone = path.clone().of_joint_until(1, 15.0);
        for k in 0..=300 {
            let t_s = 0.1 * f64::from(k);
            let (all, one) = (path.at(t_s), alone.at(t_s));
            assert_eq!(all.qd[1], one.qd[1], "{t_s}");
            if t_s <= 15.0 {
                assert_eq!(one.q[0], path.at(0.0).q[0], "{t_s}");
            }
        }
        assert_eq!(alone.at(20.0), path.at(20.0));
    }

    #[test]
    fn a_path_is_slower_until_its_time_and_as_fast_as_before_afterwards() {
        let path = path();
        let (until_s, end_s) = (15.0, path.duration_s());
        let slow = path.clone().slow_until(8.0, until_s);
        let largest = |path: &ViaPath<6>, from_s: f64, to_s: f64| {
            (0..=300)
                .map(|k| path.at(from_s + (to_s - from_s) * f64::from(k) / 300.0))
                .fold(0.0_f64, |most, state| most.max(state.qd.amax()))
        };
        assert!(largest(&slow, 0.0, until_s) < 0.2 * largest(&path, 0.0, until_s));
        let from_s = until_s / 8.0;
        let as_before = largest(&path, from_s, from_s + end_s - until_s);
        assert!(largest(&slow, until_s, end_s) > 0.8 * as_before);
        // The end is a via point of both.
        let (end, before) = (slow.at(end_s), path.at(from_s + end_s - until_s));
        assert!((end.q - before.q).amax() < 1e-9 && (end.qd - before.qd).amax() < 1e-9);
    }
}
