/// What the guard is doing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum Phase {
    /// The active set follows the estimate.
    #[default]
    Healthy = 0,
    /// Something changed: the active set is frozen while candidates are weighed in the shadow.
    PayloadTest = 1,
    /// The change is no payload: friction is learnt anew in the shadow.
    Relearning = 2,
    /// An emergency stop: nothing is learnt.
    Stopped = 3,
}

/// What the arm carries, as far as it is known.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PayloadEstimate {
    /// Mass, kg; 0 without a payload.
    pub mass: f32,
    /// Centre of mass, measured from and expressed in the frame of the last link, m.
    pub com: [f32; 3],
    /// Standard deviation of the mass, kg, with the measurement variance inflated as the guard does.
    pub mass_sigma: f32,
}

/// How well the model in force explains the torques that are measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ModelQuality<const N: usize> {
    /// RMS of what the active set leaves unexplained while the joint moves, over the last seconds, in units of the
    /// joint's torque limit.
    pub residual_rms: [f32; N],
    /// RMS of the rigid-body, friction and network share over the last seconds, root mean square over the joints, in
    /// units of the torque limit.
    pub share_rms: [f32; 3],
    /// Mean over the linear parameters of `1 − P_ii`: the part of the prior's variance that measurements have removed. It
    /// stays below 1 where no motion shows a column: cogging of a drive that has none, the load of an upright axis.
    pub information: f32,
    /// 0 … 1: how far the residuals are those of measurement noise; 1 until the arm has moved.
    pub trust: f32,
    /// The trust figure has fallen below what the guard accepts.
    pub low_trust: bool,
    /// What the guard is doing.
    pub phase: Phase,
    /// The payload in the torque.
    pub payload: PayloadEstimate,
}

impl<const N: usize> ModelQuality<N> {
    /// Nothing is known yet, and nothing speaks against the model.
    pub const fn new() -> Self {
        Self {
            residual_rms: [0.0; N],
            share_rms: [0.0; 3],
            information: 0.0,
            trust: 1.0,
            low_trust: false,
            phase: Phase::Healthy,
            payload: PayloadEstimate {
                mass: 0.0,
                com: [0.0; 3],
                mass_sigma: 0.0,
            },
        }
    }
}

impl<const N: usize> Default for ModelQuality<N> {
    fn default() -> Self {
        Self::new()
    }
}
