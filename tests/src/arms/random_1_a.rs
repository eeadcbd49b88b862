//! Constants of `random_1_a`, written by `host-sim generate` from its description. Change that, not this.

use foretorque::arm::{Arm, BaseTerm, JointLimits, LinkColumns, Placement};

/// Number of joints.
pub const JOINTS: usize = 1;
/// Number of base parameters: inertial ones, then rotor inertias.
pub const PARAMETERS: usize = 3;

/// The arm `random_1_a`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Random1A;

/// Feed-forward of this arm.
pub type FeedForward = foretorque::feedforward::FeedForward<Random1A, JOINTS, PARAMETERS>;
/// Learner of this arm.
pub type Learner = foretorque::learning::Learner<Random1A, JOINTS, PARAMETERS>;
/// Learner configuration of this arm.
pub type LearnerConfig = foretorque::learning::LearnerConfig<JOINTS, PARAMETERS>;
/// Parameter set of this arm.
pub type ParameterSet = foretorque::learning::ParameterSet<JOINTS, PARAMETERS>;
/// Exchange between feed-forward and learner of this arm.
pub type Exchange = foretorque::learning::Exchange<JOINTS, PARAMETERS>;

#[rustfmt::skip]
impl Arm<JOINTS, PARAMETERS> for Random1A {
    const NAME: &'static str = "random_1_a";
    const GRAVITY: [f32; 3] = [0.0, 0.0, -9.81];
    const PLACEMENTS: [Placement; JOINTS] = [
        Placement { rot_parent_child: [[0.49778593, 0.6793788, 0.539123], [-0.41244248, 0.7322545, -0.54193586], [-0.762955, 0.04741082, 0.64471066]], origin: [0.174776, -0.104863, -0.032524] },
    ];
    const COLUMNS: [LinkColumns; JOINTS] = [
        LinkColumns { inertial: [false, true, true, false, false, false, true, false, false, false], rotor: false },
    ];
    const BASE_MAP: &'static [BaseTerm] = &[
        BaseTerm::new(0, 1, 1.0),
        BaseTerm::new(1, 2, 1.0),
        BaseTerm::new(2, 6, 1.0),
        BaseTerm::new(2, 10, 1.0),
    ];
    const LIMITS: [JointLimits; JOINTS] = [
        JointLimits { position: (f32::from_bits(0xc048f5c3 /* -3.14 */), f32::from_bits(0x4048f5c3 /* 3.14 */)), velocity: 3.15, torque: 12.0 },
    ];
    const NOMINAL: [f32; PARAMETERS] = [
        -0.3149165,
        0.25601614,
        0.8492755,
    ];
    const LINKS: [[f32; 10]; JOINTS] = [
        [2.2518, -0.3149165, 0.25601614, 0.23896326, 0.06949655, 0.08190159, 0.078875534, 0.034977645, 0.030227741, -0.03122313],
    ];
    const ROTORS: [f32; JOINTS] = [0.7704];
}
