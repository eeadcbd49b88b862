//! Constants of `random_2_a`, written by `host-sim generate` from its description. Change that, not this.

use foretorque::arm::{Arm, BaseTerm, JointLimits, LinkColumns, Placement};

/// Number of joints.
pub const JOINTS: usize = 2;
/// Number of base parameters: inertial ones, then rotor inertias.
pub const PARAMETERS: usize = 11;

/// The arm `random_2_a`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Random2A;

/// Feed-forward of this arm.
pub type FeedForward = foretorque::feedforward::FeedForward<Random2A, JOINTS, PARAMETERS>;
/// Learner of this arm.
pub type Learner = foretorque::learning::Learner<Random2A, JOINTS, PARAMETERS>;
/// Learner configuration of this arm.
pub type LearnerConfig = foretorque::learning::LearnerConfig<JOINTS, PARAMETERS>;
/// Parameter set of this arm.
pub type ParameterSet = foretorque::learning::ParameterSet<JOINTS, PARAMETERS>;
/// Exchange between feed-forward and learner of this arm.
pub type Exchange = foretorque::learning::Exchange<JOINTS, PARAMETERS>;

#[rustfmt::skip]
impl Arm<JOINTS, PARAMETERS> for Random2A {
    const NAME: &'static str = "random_2_a";
    const GRAVITY: [f32; 3] = [0.0, 0.0, -9.81];
    const PLACEMENTS: [Placement; JOINTS] = [
        Placement { rot_parent_child: [[-0.49220338, 0.86095047, 0.12845275], [0.45847058, 0.38183838, -0.8024987], [-0.73995984, -0.3361008, -0.5826626]], origin: [-0.25922, -0.069923, -0.230828] },
        Placement { rot_parent_child: [[-0.39295256, -0.18604513, 0.9005418], [-0.3616492, 0.9316694, 0.03466977], [-0.8454574, -0.31205663, -0.43338495]], origin: [-0.136284, 0.149987, 0.322668] },
    ];
    const COLUMNS: [LinkColumns; JOINTS] = [
        LinkColumns { inertial: [false, true, true, false, false, false, true, false, false, false], rotor: false },
        LinkColumns { inertial: [false, true, true, false, true, false, true, true, true, true], rotor: true },
    ];
    const BASE_MAP: &'static [BaseTerm] = &[
        BaseTerm::new(0, 1, 1.0),
        BaseTerm::new(0, 10, -0.136284),
        BaseTerm::new(0, 13, 0.9005418),
        BaseTerm::new(1, 2, 1.0),
        BaseTerm::new(1, 10, 0.149987),
        BaseTerm::new(1, 13, 0.03466977),
        BaseTerm::new(2, 6, 1.0),
        BaseTerm::new(2, 10, 0.04106943),
        BaseTerm::new(2, 13, -0.23505884),
        BaseTerm::new(2, 15, 0.8121775),
        BaseTerm::new(2, 20, 1.0),
        BaseTerm::new(3, 11, 1.0),
        BaseTerm::new(4, 12, 1.0),
        BaseTerm::new(5, 14, 1.0),
        BaseTerm::new(5, 15, -1.0),
        BaseTerm::new(6, 16, 1.0),
        BaseTerm::new(7, 17, 1.0),
        BaseTerm::new(8, 18, 1.0),
        BaseTerm::new(9, 19, 1.0),
        BaseTerm::new(10, 21, 1.0),
    ];
    const LIMITS: [JointLimits; JOINTS] = [
        JointLimits { position: (f32::from_bits(0xc048f5c3 /* -3.14 */), f32::from_bits(0x4048f5c3 /* 3.14 */)), velocity: 3.15, torque: 16.0 },
        JointLimits { position: (f32::from_bits(0xc048f5c3 /* -3.14 */), f32::from_bits(0x4048f5c3 /* 3.14 */)), velocity: 3.15, torque: 10.0 },
    ];
    const NOMINAL: [f32; PARAMETERS] = [
        -0.76929915,
        0.11411807,
        0.8000513,
        -0.17147368,
        0.1795042,
        0.016537908,
        0.04361327,
        0.012354775,
        -0.021377759,
        0.0149763655,
        0.6756,
    ];
    const LINKS: [[f32; 10]; JOINTS] = [
        [1.9324, -0.15709253, -0.2483791, 0.34302998, 0.106576264, 0.0831712, 0.05236305, -0.01832824, 0.02512342, 0.049523287],
        [2.487, -0.17147368, 0.1795042, -0.30344883, 0.07086131, 0.0543234, 0.04361327, 0.012354775, -0.021377759, 0.0149763655],
    ];
    const ROTORS: [f32; JOINTS] = [0.5301, 0.6756];
}
