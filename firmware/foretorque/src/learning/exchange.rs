use super::decision::DecisionLog;
use super::parameters::ParameterSet;
use super::quality::ModelQuality;
use super::request::{Request, RequestPending};
use crate::dynamics::BaseParameters;
use crate::joint::JointMeasurement;
use crate::limits::Flags;

/// What one tick hands to the learner.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LearningSample<const N: usize> {
    /// Counter of the tick.
    pub tick: u32,
    /// Number of the load before the tick: a lesson teaches only the learner of the set that was loaded then.
    pub generation: u32,
    /// Requests made before the tick.
    pub requests: u32,
    /// What the arm did, `None` when nothing fresh was measured.
    pub measured: Option<JointMeasurement<N>>,
    /// Learning is switched on.
    pub enabled: bool,
    /// What happened in the tick.
    pub flags: Flags,
}

/// Speed and acceleration up to which the model has been learnt.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionRange<const N: usize> {
    /// Largest speed of each joint, rad/s.
    pub velocity: [f32; N],
    /// Largest acceleration of each joint, rad/s².
    pub acceleration: [f32; N],
}

impl<const N: usize> MotionRange<N> {
    /// Nothing has been learnt.
    pub const NONE: Self = Self {
        velocity: [0.0; N],
        acceleration: [0.0; N],
    };
}

/// What the guard tells about itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LearnerReport<const N: usize> {
    /// How well the model explains what is measured.
    pub quality: ModelQuality<N>,
    /// What was decided.
    pub decisions: DecisionLog,
}

impl<const N: usize> LearnerReport<N> {
    /// Nothing to tell.
    pub const fn new() -> Self {
        Self {
            quality: ModelQuality::new(),
            decisions: DecisionLog::new(),
        }
    }
}

impl<const N: usize> Default for LearnerReport<N> {
    fn default() -> Self {
        Self::new()
    }
}

/// What the learner lays on the desk when a round closes; the tick takes all of it or nothing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Publication<const N: usize, const P: usize> {
    /// The tick at whose end the round closed.
    pub closed: u32,
    /// Number of the load that the set was learnt from; it is taken only while no other one has been loaded.
    pub generation: u32,
    /// The set that shall be active.
    pub set: ParameterSet<N, P>,
    /// What the payload adds to the base parameters.
    pub payload: BaseParameters<P>,
    /// The motion for which the set has been learnt.
    pub range: MotionRange<N>,
    /// The set becomes the committed one as well.
    pub commit: bool,
    /// What the guard tells.
    pub report: LearnerReport<N>,
}

/// The desk between tick and learner: the only state both touch, each for the time of one copy.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exchange<const N: usize, const P: usize> {
    /// What the learner has finished, on its way to the tick.
    pub published: Option<Publication<N, P>>,
    /// A set that replaces the learner's own, with the number of its load.
    pub reload: Option<(u32, ParameterSet<N, P>)>,
    /// What the learner is asked to do, with the number of the request.
    pub request: Option<(u32, Request)>,
}

impl<const N: usize, const P: usize> Exchange<N, P> {
    /// An empty desk.
    pub const fn new() -> Self {
        Self {
            published: None,
            reload: None,
            request: None,
        }
    }

    /// Asks the learner for `request`, from the first lesson on before which `number` requests were made.
    ///
    /// Errors: the request before has not been taken yet; it stays.
    pub fn post_request(&mut self, number: u32, request: Request) -> Result<(), RequestPending> {
        if self.request.is_some() {
            return Err(RequestPending);
        }
        self.request = Some((number, request));
        Ok(())
    }
}

impl<const N: usize, const P: usize> Default for Exchange<N, P> {
    fn default() -> Self {
        Self::new()
    }
}
