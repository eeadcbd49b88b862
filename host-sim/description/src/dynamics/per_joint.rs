//! Values of an arm whose number of joints is known at run time.

use crate::robot::MAX_JOINTS;
use std::ops::{Deref, DerefMut};

/// One value for each joint, without the heap: a slice with room for the most joints an arm may have.
#[derive(Clone, Copy, Debug, Default)]
pub struct PerJoint<T> {
    values: [T; MAX_JOINTS],
    count: usize,
}

/// Position, velocity and acceleration of all joints: rad, rad/s, rad/s².
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Motion {
    /// Joint positions, rad.
    pub q: PerJoint<f64>,
    /// Joint velocities, rad/s.
    pub qd: PerJoint<f64>,
    /// Joint accelerations, rad/s².
    pub qdd: PerJoint<f64>,
}

impl Motion {
    /// So many joints at rest at zero.
    pub fn zeros(joints: usize) -> Self {
        let zero = PerJoint::repeat(joints, 0.0);
        let (q, qd, qdd) = (zero, zero, zero);
        Self { q, qd, qdd }
    }
}

impl<T: Copy + Default> PerJoint<T> {
    /// The values that `of` gives for `count` joints.
    ///
    /// Panics beyond the most joints an arm may have; a description with more is refused.
    pub fn from_fn(count: usize, of: impl FnMut(usize) -> T) -> Self {
        let mut out = Self {
            values: [T::default(); MAX_JOINTS],
            count,
        };
        out.values[..count]
            .iter_mut()
            .zip((0..count).map(of))
            .for_each(|(value, new)| *value = new);
        out
    }

    /// `value` for each of `count` joints.
    pub fn repeat(count: usize, value: T) -> Self {
        Self::from_fn(count, |_| value)
    }

    /// Values of `of`, one for each value.
    pub fn map<U: Copy + Default>(&self, mut of: impl FnMut(T) -> U) -> PerJoint<U> {
        PerJoint::from_fn(self.count, |joint| of(self.values[joint]))
    }
}

impl<T: Copy + Default> From<&[T]> for PerJoint<T> {
    fn from(values: &[T]) -> Self {
        Self::from_fn(values.len(), |joint| values[joint])
    }
}

impl<T: Copy + Default, const N: usize> From<[T; N]> for PerJoint<T> {
    fn from(values: [T; N]) -> Self {
        values.as_slice().into()
    }
}

impl<T> Deref for PerJoint<T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        &self.values[..self.count]
    }
}

impl<T> DerefMut for PerJoint<T> {
    fn deref_mut(&mut self) -> &mut [T] {
        &mut self.values[..self.count]
    }
}

impl<T: PartialEq> PartialEq for PerJoint<T> {
    fn eq(&self, other: &Self) -> bool {
        **self == **other
    }
}
