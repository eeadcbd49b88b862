//! Constants of `random_1_b`, written by `host-sim generate` from its description. Change that, not this.

use foretorque::arm::{Arm, BaseTerm, JointLimits, LinkColumns, Placement};

/// Number of joints.
pub const JOINTS: usize = 1;
/// Number of base parameters: inertial ones, then rotor inertias.
pub const PARAMETERS: usize = 3;

/// The arm `random_1_b`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Random1B;

/// Feed-forward of this arm.
pub type FeedForward = foretorque::feedforward::FeedForward<Random1B, JOINTS, PARAMETERS>;
/// Learner of this arm.
pub type Learner = foretorque::learning::Learner<Random1B, JOINTS, PARAMETERS>;
/// Learner configuration of this arm.
pub type LearnerConfig = foretorque::learning::LearnerConfig<JOINTS, PARAMETERS>;
/// Parameter set of this arm.
pub type ParameterSet = foretorque::learning::ParameterSet<JOINTS, PARAMETERS>;
/// Exchange between feed-forward and learner of this arm.
pub type Exchange = foretorque::learning::Exchange<JOINTS, PARAMETERS>;

#[rustfmt::skip]
impl Arm<JOINTS, PARAMETERS> for Random1B {
    const NAME: &'static str = "random_1_b";
    const GRAVITY: [f32; 3] = [0.0, 0.0, -9.81];
    const PLACEMENTS: [Placement; JOINTS] = [
        Placement { rot_parent_child: [[0.27655193, 0.5927863, 0.7563884], [0.62604016, 0.48602706, -0.6097962], [-0.7291041, 0.64216983, -0.2366963]], origin: [-0.207723, -0.302269, -0.103565] },
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
        JointLimits { position: (f32::from_bits(0xc048f5c3 /* -3.14 */), f32::from_bits(0x4048f5c3 /* 3.14 */)), velocity: 3.15, torque: 10.0 },
    ];
    const NOMINAL: [f32; PARAMETERS] = [
        0.18594612,
        -0.3213262,
        0.5614799,
    ];
    const LINKS: [[f32; 10]; JOINTS] = [
        [4.4646, 0.18594612, -0.3213262, -0.647867, 0.13988633, 0.13094586, 0.044779938, 0.013525304, 0.016577024, -0.042913906],
    ];
    const ROTORS: [f32; JOINTS] = [0.5167];
}
