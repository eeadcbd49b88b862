//! Limits of joints, and the first motion that does not keep them.

use crate::dynamics::State;
use crate::robot::Robot;

/// A motion beyond the limits of a joint.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error(
    "joint {joint} is asked for {asked:.3} {unit} at {t_s:.3} s, its limit is {limit:.3} {unit}"
)]
pub struct BeyondLimits {
    /// The joint, from 1.
    pub joint: usize,
    /// Time after the trajectory's start, s.
    pub t_s: f64,
    /// Value of the trajectory, in `unit`.
    pub asked: f64,
    /// The limit, in `unit`.
    pub limit: f64,
    /// `rad`, `rad/s` or `rad/s²`.
    pub unit: &'static str,
}

/// One motion keeps the limits, up to a rounding in a file of six digits.
pub(super) fn within<const N: usize>(
    robot: &Robot,
    t_s: f64,
    state: &State<N>,
) -> Result<(), BeyondLimits> {
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
