use super::config::LearnerConfig;
use super::parameters::ParameterSet;
use crate::dynamics::{FRICTION_COLUMNS, FrictionParameters};

/// One number for each linear parameter of an arm, friction first.
///
/// Two fields and not one array, because `P + N · FRICTION_COLUMNS` is no length that stable Rust can write.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinearParameters<const N: usize, const P: usize> {
    /// Friction, joint by joint, in the order of [`crate::dynamics::friction_row`].
    pub friction: [[f32; FRICTION_COLUMNS]; N],
    /// Base parameters of the rigid body.
    pub rigid: [f32; P],
}

impl<const N: usize, const P: usize> LinearParameters<N, P> {
    /// `value` everywhere.
    pub const fn filled(value: f32) -> Self {
        Self {
            friction: [[value; FRICTION_COLUMNS]; N],
            rigid: [value; P],
        }
    }

    /// The linear parameters of `set`.
    pub fn of(set: &ParameterSet<N, P>) -> Self {
        let [rigid] = set.rigid.data.0;
        Self {
            friction: set.friction.map(|joint| joint.0),
            rigid,
        }
    }

    /// The prior standard deviations of `config`.
    pub fn sigma(config: &LearnerConfig<N, P>) -> Self {
        Self {
            friction: config.friction_sigma.map(|joint| joint.0),
            rigid: config.rigid_sigma,
        }
    }

    /// Puts these parameters into `set`.
    pub fn write(&self, set: &mut ParameterSet<N, P>) {
        for (friction, &columns) in set.friction.iter_mut().zip(&self.friction) {
            *friction = FrictionParameters(columns);
        }
        set.rigid.data.0 = [self.rigid];
    }

    /// Friction and rigid body, each as one run of numbers: loops over these cost less than over [`iter`](Self::iter).
    pub(super) fn parts(&self) -> [&[f32]; 2] {
        [self.friction.as_flattened(), &self.rigid]
    }

    /// Friction and rigid body, each as one run of numbers.
    pub(super) fn parts_mut(&mut self) -> [&mut [f32]; 2] {
        [self.friction.as_flattened_mut(), &mut self.rigid]
    }

    /// Number by number, friction first.
    pub fn iter(&self) -> impl Iterator<Item = &f32> {
        self.friction.as_flattened().iter().chain(&self.rigid)
    }

    /// Number by number, friction first.
    pub fn iter_mut(&mut self) -> impl Iterator<Item = &mut f32> {
        let friction = self.friction.as_flattened_mut();
        friction.iter_mut().chain(&mut self.rigid)
    }
}
