//! What is known of the joints at one instant.

use nalgebra::SVector;

/// One value for each of `N` joints, base to tool.
pub type JointVector<const N: usize> = SVector<f32, N>;

/// Joint position, velocity and acceleration of one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointMotion<const N: usize> {
    /// Joint positions, N × rad.
    pub q: JointVector<N>,
    /// Joint velocities, N × rad/s.
    pub qd: JointVector<N>,
    /// Joint accelerations, N × rad/s².
    pub qdd: JointVector<N>,
}

impl<const N: usize> JointMotion<N> {
    /// All joints at zero, at rest.
    pub fn zero() -> Self {
        Self {
            q: JointVector::zeros(),
            qd: JointVector::zeros(),
            qdd: JointVector::zeros(),
        }
    }
}

/// What the sensors of the arm said at one instant. Velocity and acceleration are derived on the board.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointMeasurement<const N: usize> {
    /// Joint positions, N × rad.
    pub q: JointVector<N>,
    /// Joint torques (drive gain × motor current where there is no torque sensor), N × N·m.
    pub tau: JointVector<N>,
}

/// Input of one tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointSample<const N: usize> {
    /// The motion the arm shall have in the tick in which the answered torque takes effect.
    pub desired: JointMotion<N>,
    /// What the arm did; `None` when no fresh measurement came with the sample.
    pub measured: Option<JointMeasurement<N>>,
}
