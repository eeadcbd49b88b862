//! Motion and measurement of the joints at one instant.

use nalgebra::{ArrayStorage, SVector};

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

/// A vector of zeros where constants are made.
pub(crate) const fn zero_vector<const R: usize>() -> SVector<f32, R> {
    SVector::from_array_storage(ArrayStorage([[0.0; R]; 1]))
}

impl<const N: usize> JointMotion<N> {
    /// All joints at zero, at rest.
    pub const fn zero() -> Self {
        Self {
            q: zero_vector(),
            qd: zero_vector(),
            qdd: zero_vector(),
        }
    }
}

/// Sensor values of the arm at one instant. Velocity and acceleration are derived on the board.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointMeasurement<const N: usize> {
    /// Joint positions, N × rad.
    pub q: JointVector<N>,
    /// Joint torques (drive gain × motor current where there is no torque sensor), N × N·m.
    pub tau: JointVector<N>,
}

impl<const N: usize> JointMeasurement<N> {
    /// All joints at zero, without torque.
    pub const fn zero() -> Self {
        Self {
            q: zero_vector(),
            tau: zero_vector(),
        }
    }
}

/// Input of one tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointSample<const N: usize> {
    /// The motion the arm shall have in the tick in which the answered torque takes effect.
    pub desired: JointMotion<N>,
    /// Measurement of the arm; `None` when no fresh one came with the sample.
    pub measured: Option<JointMeasurement<N>>,
}
