use crate::safety::SafetyReason;
use foretorque::joint::JointSample;

/// What a board measures of its own joint, in the place of what the sample says.
pub trait LocalSensor {
    /// Puts the measurement into the sample. Called once in every tick, with the sample if one came.
    ///
    /// * `at_rest` no torque flows
    ///
    /// Returns [`SafetyReason::None`], or why the joint is not measured: then nothing of this sample counts as measured,
    /// and the sample is an implausible one, with this reason.
    fn measure<const N: usize>(
        &mut self,
        sample: Option<&mut JointSample<N>>,
        at_rest: bool,
    ) -> SafetyReason;
}

/// A board without a sensor of its own: the host measures every joint.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct NoLocalSensor;

impl LocalSensor for NoLocalSensor {
    #[inline(always)]
    fn measure<const N: usize>(&mut self, _: Option<&mut JointSample<N>>, _: bool) -> SafetyReason {
        SafetyReason::None
    }
}
