//! Speeds that torque limits and friction allow.

use super::*;
use crate::trajectory::via::TORQUE_SHARE;

/// Random series by which feasible speeds are found, and instants of each.
const TRIALS: usize = 256;
const TRIAL_INSTANTS: usize = 50;
/// Factor on the speed of a joint whose torque is too large, and steps before a joint counts as too weak: to 2 %.
const SLOWER: f64 = 0.7;
const SLOWDOWNS: usize = 12;
/// Shares of the torque limits for the described arm: the true one may be a quarter heavier; and where that leaves no path,
/// what bounds on the rates between points leave.
pub(super) const TORQUE_SHARES: [f64; 2] = [TORQUE_SHARE, 0.9];

impl Search<'_> {
    /// Slows the joints whose torque limits allow no motion at full speed, until one of [`TRIALS`] random series keeps all of
    /// them. Gravity, friction and inertia are those of the description.
    ///
    /// Errors: a line that names the joints that need more however slow they are.
    pub(super) fn adapt_speed(&mut self) -> Result<(), Refusal> {
        let full = self.objective.limits.clone();
        for torque_share in TORQUE_SHARES {
            self.objective.torque = torques(self.robot, torque_share);
            self.objective.limits.clone_from(&full);
            self.speed_share.fill(1.0);
            for _ in 0..SLOWDOWNS {
                let needed = self.least_torques();
                let share = |j: usize| needed[j] / self.objective.torque[j];
                if (0..full.len()).all(|j| share(j) <= 1.0) {
                    return Ok(());
                }
                for (j, limits) in full.iter().enumerate() {
                    // The joints before a weak one shake it, too: they slow down half as much.
                    let beyond = (j + 1..full.len()).any(|k| share(k) > 1.0);
                    let factor = match (share(j) > 1.0, beyond) {
                        (true, _) => SLOWER,
                        (false, true) => SLOWER.sqrt(),
                        (false, false) => 1.0,
                    };
                    self.speed_share[j] *= factor;
                    let speed = self.speed_share[j];
                    self.objective.limits[j].qd = limits.qd * speed;
                    self.objective.limits[j].qdd = limits.qdd * speed;
                }
            }
        }
        let needed = self.least_torques();
        let joints = self.robot.joints.iter().zip(needed.iter());
        let weak = joints.zip(self.objective.torque.iter());
        let weak = weak.filter(|((_, needed), allowed)| needed > allowed);
        let weak = weak.map(|((joint, needed), _)| {
            format!(
                "joint '{}' needs {needed:.3} N·m even where it hardly moves, of which {:.3} N·m are friction, its limit is {} N·m",
                joint.name, joint.friction.coulomb, joint.limits.torque
            )
        });
        match weak.collect::<Vec<_>>() {
            weak if weak.is_empty() => Ok(()),
            weak => {
                let weak = weak.join("; ");
                Err(refused(format!("{weak}: correct it with --torque-limits")))
            }
        }
    }

    /// Largest torque of every joint, N·m, on the random series that comes nearest to keeping all torque limits.
    fn least_torques(&self) -> PerJoint<f64> {
        let width = self.objective.rows.count();
        let joints = self.objective.rows.joints();
        let mut block = vec![0.0; joints * width];
        let mut best = (f64::INFINITY, PerJoint::repeat(joints, f64::INFINITY));
        for trial in 0..TRIALS {
            let (period_s, series) = (self.config.period_s, self.random_series(trial as u64));
            let excitation = Excitation::of(self.robot, period_s, self.config.seed, series);
            let mut most = PerJoint::repeat(joints, 0.0_f64);
            for k in 0..TRIAL_INSTANTS {
                let state = excitation.motion(period_s * k as f64 / TRIAL_INSTANTS as f64);
                self.objective.rows.write(&state, SIGN_WIDTH, &mut block);
                for (most, row) in most.iter_mut().zip(block.chunks_exact(width)) {
                    let parameters = self.objective.parameters.iter();
                    let tau: f64 = row.iter().zip(parameters).map(|(y, x)| y * x).sum();
                    *most = most.max(tau.abs());
                }
            }
            let shares = most.iter().zip(self.objective.torque.iter());
            let share = shares.fold(0.0_f64, |worst, (tau, limit)| worst.max(tau / limit));
            if share < best.0 {
                best = (share, most);
            }
        }
        best.1
    }
}

/// Torque that friction leaves each joint of `share` of its limit, N·m; a tenth of the limit at least.
pub(super) fn torques(robot: &Robot, share: f64) -> PerJoint<f64> {
    PerJoint::from_fn(robot.joint_count(), |j| {
        let (friction, limit) = (&robot.joints[j].friction, robot.joints[j].limits.torque);
        let beyond = friction.coulomb * friction.stribeck_ratio + friction.cogging;
        (share * limit - beyond).max(0.1 * limit)
    })
}
