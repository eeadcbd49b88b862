//! Constants of `random_2_b`, written by `host-sim generate` from its description. Change that, not this.

use foretorque::arm::{Arm, BaseTerm, JointLimits, LinkColumns, Placement};

/// Number of joints.
pub const JOINTS: usize = 2;
/// Number of base parameters: inertial ones, then rotor inertias.
pub const PARAMETERS: usize = 11;

/// The arm `random_2_b`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Random2B;

/// Feed-forward of this arm.
pub type FeedForward = foretorque::feedforward::FeedForward<Random2B, JOINTS, PARAMETERS>;
/// Learner of this arm.
pub type Learner = foretorque::learning::Learner<Random2B, JOINTS, PARAMETERS>;
/// Learner configuration of this arm.
pub type LearnerConfig = foretorque::learning::LearnerConfig<JOINTS, PARAMETERS>;
/// Parameter set of this arm.
pub type ParameterSet = foretorque::learning::ParameterSet<JOINTS, PARAMETERS>;
/// Exchange between feed-forward and learner of this arm.
pub type Exchange = foretorque::learning::Exchange<JOINTS, PARAMETERS>;

#[rustfmt::skip]
impl Arm<JOINTS, PARAMETERS> for Random2B {
    const NAME: &'static str = "random_2_b";
    const GRAVITY: [f32; 3] = [0.0, 0.0, -9.81];
    const PLACEMENTS: [Placement; JOINTS] = [
        Placement { rot_parent_child: [[-0.0839506, -0.89233154, 0.44350508], [-0.48061025, -0.35362747, -0.80247205], [0.8729067, -0.2805211, -0.39917642]], origin: [0.291816, 0.240953, 0.340003] },
        Placement { rot_parent_child: [[0.8469726, 0.33933106, -0.40925774], [-0.51580876, 0.33806604, -0.7871802], [-0.12875855, 0.87781876, 0.4613626]], origin: [0.348335, 0.138302, 0.004124] },
    ];
    const COLUMNS: [LinkColumns; JOINTS] = [
        LinkColumns { inertial: [false, true, true, false, false, false, true, false, false, false], rotor: false },
        LinkColumns { inertial: [false, true, true, false, true, false, true, true, true, true], rotor: true },
    ];
    const BASE_MAP: &'static [BaseTerm] = &[
        BaseTerm::new(0, 1, 1.0),
        BaseTerm::new(0, 10, 0.348335),
        BaseTerm::new(0, 13, -0.40925774),
        BaseTerm::new(1, 2, 1.0),
        BaseTerm::new(1, 10, 0.138302),
        BaseTerm::new(1, 13, -0.7871802),
        BaseTerm::new(2, 6, 1.0),
        BaseTerm::new(2, 10, 0.14046471),
        BaseTerm::new(2, 13, -0.50285476),
        BaseTerm::new(2, 15, 0.78714454),
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
        JointLimits { position: (f32::from_bits(0xc048f5c3 /* -3.14 */), f32::from_bits(0x4048f5c3 /* 3.14 */)), velocity: 3.15, torque: 25.0 },
        JointLimits { position: (f32::from_bits(0xc048f5c3 /* -3.14 */), f32::from_bits(0x4048f5c3 /* 3.14 */)), velocity: 3.15, torque: 11.0 },
    ];
    const NOMINAL: [f32; PARAMETERS] = [
        1.4293101,
        -0.23922053,
        0.9970656,
        0.049879413,
        0.15570526,
        0.002594464,
        0.023439148,
        -0.0024997848,
        -0.0065845153,
        -0.025667842,
        0.8353,
    ];
    const LINKS: [[f32; 10]; JOINTS] = [
        [7.0927, 0.8768634, -0.2592098, 1.1977443, 0.24086057, 0.34706077, 0.16967134, 0.01415258, -0.1508459, 0.04237337],
        [1.9609, 0.049879413, 0.15570526, 0.31912276, 0.06615257, 0.06355811, 0.023439148, -0.0024997848, -0.0065845153, -0.025667842],
    ];
    const ROTORS: [f32; JOINTS] = [0.6624, 0.8353];
}
