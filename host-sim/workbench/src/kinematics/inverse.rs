//! The inverse of the chain: closed form where there is one, numeric elsewhere.

use super::ur::{UrArm, out_of_reach};
use super::{Chain, Twist, pose_error};
use crate::Refusal;
use crate::dynamics::Joints;
use crate::robot::{Placement, Robot};
use nalgebra::SMatrix;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::TAU;

/// A closed-form solution must put the tip this near to the target, m and rad.
const VERIFIED: f64 = 1e-9;
/// Starts of the numeric search for a pose of which nothing is known.
const STARTS: usize = 48;

/// Finds joint positions for poses of the tip.
#[derive(Clone, Debug)]
pub struct Inverse<const N: usize> {
    /// The chain that is inverted.
    pub chain: Chain<N>,
    closed: Option<UrArm>,
    ranges: [(f64, f64); N],
}

impl<const N: usize> Inverse<N> {
    /// The inverse of a robot with `tool` on its flange; `None` when it has not `N` joints.
    pub fn new(robot: &Robot, tool: &Placement) -> Option<Self> {
        let chain = Chain::<N>::new(robot, tool)?;
        Some(Self {
            closed: UrArm::of(&chain.placements, &chain.tip),
            ranges: robot.each(|joint| joint.limits.position)?,
            chain,
        })
    }

    /// All joint positions that put the tip at `target`, rad within ±π; of an arm without closed form those that a search
    /// from `near` and from seeded random starts finds.
    ///
    /// * `near` decides what the target leaves open: joint 6 where axes 4 and 6 are parallel
    ///
    /// Every solution is checked against the forward kinematics to 1e-9 m and rad.
    ///
    /// Errors: a line with the reason why the target is out of reach.
    pub fn solutions(
        &self,
        target: &Placement,
        near: &Joints<N>,
    ) -> Result<Vec<Joints<N>>, Refusal> {
        let Some(arm) = &self.closed else {
            return self.searched(target, near);
        };
        let free = near.as_slice().last().copied().unwrap_or(0.0);
        let mut solutions = Vec::with_capacity(8);
        for solution in arm.solutions(target, free)? {
            let q = Joints::<N>::from_column_slice(&solution);
            let left = pose_error(&self.chain.forward(&q), target).amax();
            // Where two solutions meet, rounding of the sine is a root of rounding: Newton's steps finish it.
            let q = if left < VERIFIED {
                q
            } else {
                solve_from(&self.chain, target, &q).map_err(|left| missed(&left))?
            };
            solutions.push(q);
        }
        Ok(solutions)
    }

    /// The joint positions inside the ranges that are nearest to `near`, by the largest step of a joint.
    ///
    /// Errors: as of [`solutions`](Self::solutions); all of them are outside the ranges.
    pub fn nearest(&self, target: &Placement, near: &Joints<N>) -> Result<Joints<N>, Refusal> {
        let solutions = self.solutions(target, near)?;
        let inside = solutions.iter().filter_map(|q| self.inside(q, near));
        let step = |q: &Joints<N>| (q - near).amax();
        let nearest = inside.min_by(|a, b| step(a).total_cmp(&step(b)));
        nearest.ok_or_else(|| outside_ranges(solutions.len()))
    }

    /// The joint positions that go on from `predicted`: the same branch, whatever the ranges.
    ///
    /// * `jump` largest step of a joint that still counts as going on, rad
    ///
    /// Errors: as of [`solutions`](Self::solutions); [`singular`](Self::singular) where no solution goes on.
    pub fn onwards(
        &self,
        target: &Placement,
        predicted: &Joints<N>,
        jump: f64,
    ) -> Result<Joints<N>, Refusal> {
        let q = if self.closed.is_some() {
            let solutions = self.solutions(target, predicted)?;
            let turned = solutions
                .iter()
                .map(|q| q.zip_map(predicted, |q, p| q + ((p - q) / TAU).round() * TAU));
            let step = |q: &Joints<N>| (q - predicted).amax();
            let nearest = turned.min_by(|a, b| step(a).total_cmp(&step(b)));
            nearest.ok_or_else(|| outside_ranges(0))?
        } else {
            solve_from(&self.chain, target, predicted).map_err(|left| missed(&left))?
        };
        if (q - predicted).amax() > jump {
            return Err(self.singular(predicted));
        }
        Ok(q)
    }

    /// The refusal of a posture in which the way on is not determined.
    pub fn singular(&self, q: &Joints<N>) -> Refusal {
        let six: Option<[f64; 6]> = q.as_slice().try_into().ok();
        let posture = match (&self.closed, six) {
            (Some(arm), Some(q)) => arm.posture(&q),
            _ => "the Jacobian has lost a direction",
        };
        Refusal::of("singular", posture)
    }

    /// `q` with whole turns added so that it is inside the ranges and as near to `near` as they allow.
    fn inside(&self, q: &Joints<N>, near: &Joints<N>) -> Option<Joints<N>> {
        let mut out = *q;
        for (j, (low, high)) in self.ranges.iter().enumerate() {
            let first = ((low - q[j]) / TAU).ceil();
            let last = ((high - q[j]) / TAU).floor();
            if first > last {
                return None;
            }
            let turns = ((near[j] - q[j]) / TAU).round();
            out[j] = q[j] + turns.clamp(first, last) * TAU;
        }
        Some(out)
    }

    fn searched(&self, target: &Placement, near: &Joints<N>) -> Result<Vec<Joints<N>>, Refusal> {
        let mut random = ChaCha8Rng::seed_from_u64(0);
        let mut found: Vec<Joints<N>> = Vec::new();
        let mut least: Option<Twist> = None;
        let size = |left: &Twist| parts(left).iter().sum::<f64>();
        for start in 0..STARTS {
            let from = if start == 0 {
                *near
            } else {
                Joints::from_fn(|j, _| {
                    let (low, high) = self.ranges[j];
                    random.random_range(low..=high)
                })
            };
            match solve_from(&self.chain, target, &from) {
                Ok(q) if self.inside(&q, near).is_some() => {
                    found.push(q);
                    // The near solution suffices; random starts follow only when it fails.
                    if start == 0 {
                        break;
                    }
                }
                Ok(_) => {}
                Err(left) => {
                    if least.is_none_or(|before| size(&left) < size(&before)) {
                        least = Some(left);
                    }
                }
            }
        }
        match least {
            Some(left) if found.is_empty() => Err(missed(&left)),
            _ => Ok(found),
        }
    }
}

/// Most steps from one start. Starts that arrive take about ten.
const STEPS: usize = 120;
/// Admissible error of the pose, m and rad.
const ARRIVED: f64 = 1e-10;

/// Joint positions near `start` that put the tip of `chain` at `target`.
///
/// `q += Jᵀ (J Jᵀ + λ 1)⁻¹ e` with `λ = ½ eᵀe`: the damping goes with the error, so that a target out of reach does not
/// make the steps explode and the last steps are Newton's                            [Sugihara 2011, eq. 20 without bias]
///
/// Errors: what is left to the target.
fn solve_from<const N: usize>(
    chain: &Chain<N>,
    target: &Placement,
    start: &Joints<N>,
) -> Result<Joints<N>, Twist> {
    let mut q = *start;
    let mut left = pose_error(&chain.forward(&q), target);
    for _ in 0..STEPS {
        if left.amax() < ARRIVED {
            break;
        }
        let jacobian = chain.jacobian(&q);
        let damping = 0.5 * left.norm_squared();
        let square = jacobian * jacobian.transpose() + SMatrix::<f64, 6, 6>::identity() * damping;
        let Some(square) = square.cholesky() else {
            break;
        };
        q += jacobian.tr_mul(&square.solve(&left));
        left = pose_error(&chain.forward(&q), target);
    }
    (left.amax() < ARRIVED).then_some(q).ok_or(left)
}

/// Lengths of the linear and the angular part, m and rad.
fn parts(left: &Twist) -> [f64; 2] {
    [
        left.fixed_rows::<3>(0).norm(),
        left.fixed_rows::<3>(3).norm(),
    ]
}

fn missed(left: &Twist) -> Refusal {
    let [left_m, left_rad] = parts(left);
    out_of_reach(format!(
        "the nearest pose found is {left_m:.3} m and {left_rad:.3} rad away"
    ))
}

fn outside_ranges(solutions: usize) -> Refusal {
    out_of_reach(format!(
        "all {solutions} solutions are outside the joints' ranges"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    fn ur5() -> Robot {
        Robot::load("ur5").expect("built in")
    }

    /// The arm in frames turned about and moved along the joint axes, as a URDF may have them.
    fn reframed(robot: &Robot) -> Robot {
        let mut other = robot.clone();
        let along = |angle: f64, shift: f64| {
            Placement::from_xyz_rpy(Vector3::new(0.0, 0.0, shift), Vector3::new(0.0, 0.0, angle))
        };
        let moves: Vec<Placement> = (0..6)
            .map(|k| along(0.7 * f64::from(k) - 1.0, 0.05 * f64::from(k) - 0.1))
            .collect();
        for (k, joint) in other.joints.iter_mut().enumerate() {
            joint.placement = joint.placement.then(&moves[k]);
            if k > 0 {
                joint.placement = moves[k - 1].inverse().then(&joint.placement);
            }
        }
        other.flange = moves[5].inverse().then(&other.flange);
        other
    }

    /// All eight solutions put the tool on its target.
    fn all_eight_are_right(robot: &Robot) {
        let tool = Placement::from_xyz_rpy(Vector3::new(0.02, 0.1, 0.15), Vector3::repeat(0.4));
        let inverse = Inverse::<6>::new(robot, &tool).expect("six joints");
        assert!(inverse.closed.is_some());
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let mut eights = 0;
        for case in 0..2000 {
            let q = Joints::<6>::from_fn(|_, _| random.random_range(-3.1..=3.1));
            let target = inverse.chain.forward(&q);
            let solutions = inverse.solutions(&target, &q).expect("it is there");
            eights += usize::from(solutions.len() == 8);
            for solution in &solutions {
                let left = pose_error(&inverse.chain.forward(solution), &target).amax();
                assert!(left < 1e-9, "case {case}: {left}");
            }
            let turn = |d: f64| (d + 3.0 * TAU + 0.5 * TAU) % TAU - 0.5 * TAU;
            let apart = solutions
                .iter()
                .map(|solution| (solution - q).map(turn).amax());
            let own = apart.fold(f64::INFINITY, f64::min);
            assert!(own < 1e-6, "case {case}: {own}");
            for (k, one) in solutions.iter().enumerate() {
                let mut others = solutions[k + 1..].iter();
                let twin = others.any(|other| (one - other).amax() < 1e-6);
                assert!(!twin, "case {case}: a solution comes twice");
            }
        }
        assert!(eights > 1000, "{eights} of 2000 poses have all eight");
    }

    #[test]
    fn the_eight_solutions_of_the_ur5_put_the_tool_on_its_target_in_frames_of_any_kind() {
        let robots = [ur5(), reframed(&ur5())];
        robots.iter().for_each(all_eight_are_right);
        let q = Joints::<6>::from_fn(|j, _| 0.3 * j as f64 - 0.5);
        let [own, other] = robots.map(|robot| {
            let chain = Chain::<6>::new(&robot, &Placement::identity());
            chain.expect("six joints").forward(&q)
        });
        assert!(pose_error(&own, &other).amax() < 1e-12);
    }

    #[test]
    fn an_arm_without_closed_form_is_solved_by_steps() {
        let robot = Robot::load("panda").expect("built in");
        let inverse = Inverse::<7>::new(&robot, &Placement::identity()).expect("seven joints");
        assert!(inverse.closed.is_none());
        let mut random = ChaCha8Rng::seed_from_u64(4);
        for case in 0..20 {
            let q = Joints::<7>::from_fn(|j, _| {
                let (low, high) = inverse.ranges[j];
                random.random_range(0.8 * low..=0.8 * high)
            });
            let target = inverse.chain.forward(&q);
            let near = Joints::from_fn(|j, _| 0.5 * (inverse.ranges[j].0 + inverse.ranges[j].1));
            let found = inverse.nearest(&target, &near).expect("it is there");
            let left = pose_error(&inverse.chain.forward(&found), &target).amax();
            assert!(left < 1e-9, "case {case}: {left}");
            for (q, (low, high)) in found.iter().zip(inverse.ranges) {
                assert!((low..=high).contains(q), "case {case}");
            }
        }
    }

    #[test]
    fn an_unreachable_pose_is_refused_with_its_reason() {
        let inverse = Inverse::<6>::new(&ur5(), &Placement::identity()).expect("six joints");
        let down = Vector3::new(std::f64::consts::PI, 0.0, 0.0);
        let at = |x, y, z| Placement::from_xyz_rpy(Vector3::new(x, y, z), down);
        for (target, wanted) in [
            (at(1.2, 0.0, 0.3), "the arm is 0.817 m long"),
            (
                at(0.0, 0.05, 0.3),
                "from the axis of joint 1, the arm passes it at 0.109 m",
            ),
        ] {
            let error = inverse.nearest(&target, &Joints::zeros());
            let text = error.expect_err("nowhere").to_string();
            assert!(text.contains(wanted), "{text}");
        }
        let panda = Robot::load("panda").expect("built in");
        let inverse = Inverse::<7>::new(&panda, &Placement::identity()).expect("seven joints");
        let error = inverse.nearest(&at(1.5, 0.0, 0.3), &Joints::zeros());
        let text = error.expect_err("nowhere").to_string();
        let away = "out of reach: the nearest pose found is ";
        assert!(text.starts_with(away) && !text.contains("is 0.0"), "{text}");
    }
}
