//! Distances of the links from the table and from each other, and how fast they can change.

use crate::dynamics::PerJoint;
use crate::robot::{Capsule, Joint, MAX_JOINTS, Placement, Robot, segment_distance};

/// Two bodies that keep their distance.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Pair {
    Table { link: usize },
    Links { inner: usize, outer: usize },
}

/// All distances that an arm must keep.
#[derive(Clone, Debug)]
pub(super) struct Clearances {
    joints: Vec<Joint>,
    pairs: Vec<Pair>,
    table_height: f64,
    /// Required distance, m.
    pub(super) required: f64,
    /// For each pair and joint: metres by which the distance changes, at most, for one radian.
    levers: Vec<PerJoint<f64>>,
}

impl Clearances {
    /// Links two or more apart keep clear of each other (neighbours share a joint housing), all but the first of the
    /// table (it carries the arm and keeps its height).
    pub(super) fn new(robot: &Robot) -> Self {
        let (own, joints) = (&robot.joints, robot.joint_count());
        let solid = |k: &usize| !own[*k].capsules.is_empty();
        let mut pairs = Vec::new();
        if robot.workspace.table_height.is_some() {
            pairs.extend((1..joints).filter(solid).map(|link| Pair::Table { link }));
        }
        for inner in (0..joints).filter(solid) {
            let outer = (inner + 2..joints).filter(solid);
            pairs.extend(outer.map(|outer| Pair::Links { inner, outer }));
        }
        let levers = pairs.iter().map(|pair| {
            let (first, link) = match *pair {
                Pair::Table { link } => (0, link),
                Pair::Links { inner, outer } => (inner + 1, outer),
            };
            let reaches = own[link].capsules.iter().map(Capsule::reach);
            let reach = reaches.fold(0.0, f64::max);
            PerJoint::from_fn(joints, |i| match (first..=link).contains(&i) {
                true => reach + chain(&own[i + 1..=link]),
                false => 0.0,
            })
        });
        Self {
            joints: own.clone(),
            levers: levers.collect(),
            pairs,
            table_height: robot.workspace.table_height.unwrap_or(f64::NEG_INFINITY),
            required: robot.workspace.clearance,
        }
    }

    pub(super) fn count(&self) -> usize {
        self.pairs.len()
    }

    /// Names of the two bodies of distance `index`.
    pub(super) fn name(&self, index: usize) -> String {
        let name = |link: usize| &self.joints[link].name;
        match self.pairs[index] {
            Pair::Table { link } => format!("{} to table", name(link)),
            Pair::Links { inner, outer } => format!("{} to {}", name(inner), name(outer)),
        }
    }

    /// Upper bound of the distance `index` over all poses, m; infinity for two links.
    ///
    /// The links after the first joint rise no higher than that joint plus the stretched chain.
    pub(super) fn upper_bound(&self, index: usize) -> f64 {
        let Pair::Table { link } = self.pairs[index] else {
            return f64::INFINITY;
        };
        let (first, chain) = (
            self.joints[0].placement.origin.z,
            chain(&self.joints[1..=link]),
        );
        let highest = |capsule: &Capsule| {
            let lower_end = capsule.ends[0].norm().min(capsule.ends[1].norm());
            first + chain + lower_end - capsule.radius - self.table_height
        };
        let heights = self.joints[link].capsules.iter().map(highest);
        heights.fold(f64::INFINITY, f64::min)
    }

    /// Largest speed of the distance `index` at joint speeds bounded by `speeds`, m/s.
    ///
    /// A turn of joint i by dq moves a carried point by at most dq times its distance from the axis. No pose makes that
    /// distance longer than the stretched chain.
    pub(super) fn rate(&self, index: usize, speeds: &[f64]) -> f64 {
        let levers = self.levers[index].iter();
        levers.zip(speeds.iter()).map(|(r, qd)| r * qd.abs()).sum()
    }

    /// All distances at positions `q`, m; negative where the table is cut, never below −(radii) where links meet.
    pub(super) fn write(&self, q: &[f64], out: &mut [f64]) {
        let mut poses = [Placement::identity(); MAX_JOINTS];
        let mut pose = Placement::identity();
        for (k, joint) in self.joints.iter().enumerate() {
            pose = pose.then(&joint.placement).turned(q[k]);
            poses[k] = pose;
        }
        let placed = |k: usize, capsule: &Capsule| capsule.ends.map(|end| poses[k].point(&end));
        for (distance, pair) in out.iter_mut().zip(&self.pairs) {
            *distance = f64::INFINITY;
            match *pair {
                Pair::Table { link } => {
                    for capsule in &self.joints[link].capsules {
                        let [a, b] = placed(link, capsule);
                        let height = a.z.min(b.z) - capsule.radius - self.table_height;
                        *distance = distance.min(height);
                    }
                }
                Pair::Links { inner, outer } => {
                    for near in &self.joints[inner].capsules {
                        let near_ends = placed(inner, near);
                        for far in &self.joints[outer].capsules {
                            let between = segment_distance(&near_ends, &placed(outer, far));
                            *distance = distance.min(between - near.radius - far.radius);
                        }
                    }
                }
            }
        }
    }
}

/// Length of the stretched chain of these joints, m.
fn chain(joints: &[Joint]) -> f64 {
    joints
        .iter()
        .map(|joint| joint.placement.origin.norm())
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};

    fn ur5() -> Clearances {
        Clearances::new(&Robot::load("ur5").expect("built in"))
    }

    fn distances(clearances: &Clearances, q: &[f64]) -> Vec<f64> {
        let mut distances = vec![0.0; clearances.count()];
        clearances.write(q, &mut distances);
        distances
    }

    #[test]
    fn a_hanging_ur5_cuts_the_table_and_a_standing_one_is_clear() {
        let half = std::f64::consts::FRAC_PI_2;
        let least = |q: [f64; 6]| {
            let distances = distances(&ur5(), &q);
            distances.into_iter().fold(f64::INFINITY, f64::min)
        };
        assert!(least([0.0, half, 0.0, 0.0, 0.0, 0.0]) < -0.5);
        assert!(least([0.0, -half, 0.0, -half, 0.3, 0.0]) > 0.005);
        // The elbow folded: the first wrist lies on the upper arm.
        assert!(least([0.0, -half, 3.1, 0.0, 0.3, 0.0]) < 0.0);
    }

    #[test]
    fn no_pose_exceeds_the_upper_bound_and_no_distance_changes_faster_than_its_rate() {
        let clearances = ur5();
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(1);
        for _ in 0..2000 {
            let q = PerJoint::from_fn(6, |_| random.random_range(-3.0..3.0));
            let step = PerJoint::from_fn(6, |_| random.random_range(-0.05..0.05));
            let moved = PerJoint::from_fn(6, |j| q[j] + step[j]);
            let (before, after) = (distances(&clearances, &q), distances(&clearances, &moved));
            for i in 0..clearances.count() {
                let (name, change) = (clearances.name(i), (after[i] - before[i]).abs());
                assert!(before[i] <= clearances.upper_bound(i) + 1e-12, "{name}");
                assert!(change <= clearances.rate(i, &step) + 1e-12, "{name}");
            }
        }
        // The stretched arm stands nearly that high.
        let table = clearances.upper_bound(1);
        assert!(table.is_finite() && table < 1.0, "{table}");
    }
}
