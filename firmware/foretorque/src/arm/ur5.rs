//! Constants of `ur5`, written by `host-sim generate` from its description. Change that, not this.
#![allow(
    clippy::approx_constant,
    dead_code,
    reason = "numbers of a description; a program needs some of these names only"
)]

use foretorque::arm::{Arm, BaseTerm, JointLimits, LinkColumns, Placement};

/// Number of joints.
pub const JOINTS: usize = 6;
/// Number of base parameters: inertial ones, then rotor inertias.
pub const PARAMETERS: usize = 40;

/// The arm `ur5`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ur5;

/// Feed-forward of this arm.
pub type FeedForward = foretorque::feedforward::FeedForward<Ur5, JOINTS, PARAMETERS>;
/// Learner of this arm.
pub type Learner = foretorque::learning::Learner<Ur5, JOINTS, PARAMETERS>;
/// Learner configuration of this arm.
pub type LearnerConfig = foretorque::learning::LearnerConfig<JOINTS, PARAMETERS>;
/// Parameter set of this arm.
pub type ParameterSet = foretorque::learning::ParameterSet<JOINTS, PARAMETERS>;
/// Exchange between feed-forward and learner of this arm.
pub type Exchange = foretorque::learning::Exchange<JOINTS, PARAMETERS>;

#[rustfmt::skip]
impl Arm<JOINTS, PARAMETERS> for Ur5 {
    const NAME: &'static str = "ur5";
    const GRAVITY: [f32; 3] = [0.0, 0.0, -9.81];
    const PLACEMENTS: [Placement; JOINTS] = [
        Placement { rot_parent_child: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], origin: [0.0, 0.0, 0.089159] },
        Placement { rot_parent_child: [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]], origin: [0.0, 0.0, 0.0] },
        Placement { rot_parent_child: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], origin: [-0.425, 0.0, 0.0] },
        Placement { rot_parent_child: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], origin: [-0.39225, 0.0, 0.10915] },
        Placement { rot_parent_child: [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]], origin: [0.0, -0.09465, 0.0] },
        Placement { rot_parent_child: [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]], origin: [0.0, 0.0823, 0.0] },
    ];
    const COLUMNS: [LinkColumns; JOINTS] = [
        LinkColumns { inertial: [false, false, false, false, false, false, true, false, false, false], rotor: false },
        LinkColumns { inertial: [false, true, true, false, true, false, true, true, true, true], rotor: false },
        LinkColumns { inertial: [false, true, true, false, true, false, true, true, true, true], rotor: true },
        LinkColumns { inertial: [false, true, true, false, true, false, true, true, true, true], rotor: true },
        LinkColumns { inertial: [false, true, true, false, true, false, true, true, true, true], rotor: true },
        LinkColumns { inertial: [false, true, true, false, true, false, true, true, true, true], rotor: true },
    ];
    const BASE_MAP: &'static [BaseTerm] = &[
        BaseTerm::new(0, 6, 1.0), BaseTerm::new(0, 15, 1.0), BaseTerm::new(0, 20, 0.180625), BaseTerm::new(0, 25, 1.0),
        BaseTerm::new(0, 30, 0.34639877), BaseTerm::new(0, 33, 0.2183), BaseTerm::new(0, 35, 1.0),
        BaseTerm::new(0, 40, 0.34639877), BaseTerm::new(0, 50, 0.34639877), BaseTerm::new(0, 60, 1.0),
        BaseTerm::new(1, 11, 1.0), BaseTerm::new(1, 20, -0.425), BaseTerm::new(1, 30, -0.425),
        BaseTerm::new(1, 40, -0.425), BaseTerm::new(1, 50, -0.425), BaseTerm::new(2, 12, 1.0),
        BaseTerm::new(3, 14, 1.0), BaseTerm::new(3, 15, -1.0), BaseTerm::new(3, 20, -0.180625),
        BaseTerm::new(3, 30, -0.180625), BaseTerm::new(3, 40, -0.180625), BaseTerm::new(3, 50, -0.180625),
        BaseTerm::new(4, 16, 1.0), BaseTerm::new(4, 20, 0.180625), BaseTerm::new(4, 30, 0.180625),
        BaseTerm::new(4, 40, 0.180625), BaseTerm::new(4, 50, 0.180625), BaseTerm::new(4, 61, 1.0),
        BaseTerm::new(5, 17, 1.0), BaseTerm::new(6, 18, 1.0), BaseTerm::new(6, 23, 0.425),
        BaseTerm::new(6, 30, 0.04638875), BaseTerm::new(6, 33, 0.425), BaseTerm::new(6, 40, 0.04638875),
        BaseTerm::new(6, 50, 0.04638875), BaseTerm::new(7, 19, 1.0), BaseTerm::new(8, 21, 1.0),
        BaseTerm::new(8, 30, -0.39225), BaseTerm::new(8, 40, -0.39225), BaseTerm::new(8, 50, -0.39225),
        BaseTerm::new(9, 22, 1.0), BaseTerm::new(10, 24, 1.0), BaseTerm::new(10, 25, -1.0),
        BaseTerm::new(10, 30, -0.15386006), BaseTerm::new(10, 40, -0.15386006), BaseTerm::new(10, 50, -0.15386006),
        BaseTerm::new(11, 26, 1.0), BaseTerm::new(11, 30, 0.15386006), BaseTerm::new(11, 40, 0.15386006),
        BaseTerm::new(11, 50, 0.15386006), BaseTerm::new(12, 27, 1.0), BaseTerm::new(13, 28, 1.0),
        BaseTerm::new(13, 30, 0.042814087), BaseTerm::new(13, 33, 0.39225), BaseTerm::new(13, 40, 0.042814087),
        BaseTerm::new(13, 50, 0.042814087), BaseTerm::new(14, 29, 1.0), BaseTerm::new(15, 31, 1.0),
        BaseTerm::new(16, 32, 1.0), BaseTerm::new(16, 40, -0.09465), BaseTerm::new(16, 43, -1.0),
        BaseTerm::new(16, 50, -0.09465), BaseTerm::new(17, 34, 1.0), BaseTerm::new(17, 35, -1.0),
        BaseTerm::new(17, 40, 0.008958623), BaseTerm::new(17, 43, 0.1893), BaseTerm::new(17, 45, 1.0),
        BaseTerm::new(17, 50, 0.008958623), BaseTerm::new(18, 36, 1.0), BaseTerm::new(18, 40, 0.008958623),
        BaseTerm::new(18, 43, 0.1893), BaseTerm::new(18, 45, 1.0), BaseTerm::new(18, 50, 0.008958623),
        BaseTerm::new(19, 37, 1.0), BaseTerm::new(20, 38, 1.0), BaseTerm::new(21, 39, 1.0), BaseTerm::new(22, 41, 1.0),
        BaseTerm::new(23, 42, 1.0), BaseTerm::new(23, 50, 0.0823), BaseTerm::new(23, 53, 1.0),
        BaseTerm::new(24, 44, 1.0), BaseTerm::new(24, 45, -1.0), BaseTerm::new(24, 50, 0.00677329),
        BaseTerm::new(24, 53, 0.1646), BaseTerm::new(24, 55, 1.0), BaseTerm::new(25, 46, 1.0),
        BaseTerm::new(25, 50, 0.00677329), BaseTerm::new(25, 53, 0.1646), BaseTerm::new(25, 55, 1.0),
        BaseTerm::new(26, 47, 1.0), BaseTerm::new(27, 48, 1.0), BaseTerm::new(28, 49, 1.0), BaseTerm::new(29, 51, 1.0),
        BaseTerm::new(30, 52, 1.0), BaseTerm::new(31, 54, 1.0), BaseTerm::new(31, 55, -1.0), BaseTerm::new(32, 56, 1.0),
        BaseTerm::new(33, 57, 1.0), BaseTerm::new(34, 58, 1.0), BaseTerm::new(35, 59, 1.0), BaseTerm::new(36, 62, 1.0),
        BaseTerm::new(37, 63, 1.0), BaseTerm::new(38, 64, 1.0), BaseTerm::new(39, 65, 1.0),
    ];
    const LIMITS: [JointLimits; JOINTS] = [
        JointLimits { position: (-6.2831855, 6.2831855), velocity: 3.1415927, torque: 150.0 },
        JointLimits { position: (-6.2831855, 6.2831855), velocity: 3.1415927, torque: 150.0 },
        JointLimits { position: (-6.2831855, 6.2831855), velocity: 3.1415927, torque: 150.0 },
        JointLimits { position: (-6.2831855, 6.2831855), velocity: 3.1415927, torque: 28.0 },
        JointLimits { position: (-6.2831855, 6.2831855), velocity: 3.1415927, torque: 28.0 },
        JointLimits { position: (-6.2831855, 6.2831855), velocity: 3.1415927, torque: 28.0 },
    ];
    const COGGING_CYCLES: [f32; JOINTS] = [202.0, 202.0, 202.0, 202.0, 202.0, 202.0];
    const ENCODER_STEP: f32 = 4.79369e-5;
    const NOMINAL: [f32; PARAMETERS] = [
        3.3960273, -3.866395, 0.0, -1.6057215, 2.6195214, 0.0, 0.34868085, 0.0, -1.6495373, 0.0, -0.625331, 0.627331,
        0.0, 0.13138233, 0.0, 0.0, -0.15088734, 0.013717941, 0.014617941, 0.0, 0.0, -3.5853227e-5, 0.0, 0.035164855,
        0.0019625754, 0.0028625752, 0.0, 0.0, 3.5853227e-5, 0.0, 0.0, 0.0, 0.0001, 0.0, 0.0, 0.0, 0.9, 0.22, 0.22, 0.22,
    ];
    const LINKS: [[f32; 10]; JOINTS] = [
        [3.7, 0.0, -0.007141, -0.094757, 0.009140509, 0.009126727, 0.006413782, 0.0, 0.0, -0.000182881],
        [8.393, -1.7835125, 0.0, 0.9514305, 0.12275416, 0.8432506, 0.7342964, 0.0, 0.20217897, 0.0],
        [2.275, -0.619528, 0.0, 0.0602875, 0.0040976186, 0.22540748, 0.22330986, 0.0, 0.019817492, 0.0],
        [1.219, 0.0, -0.01991846, -0.0021942, 0.0015294172, 0.00090394955, 0.0015254676, 0.0, 0.0, -3.5853227e-5],
        [1.219, 0.0, 0.01991846, -0.0021942, 0.0015294172, 0.00090394955, 0.0015254676, 0.0, 0.0, 3.5853227e-5],
        [0.1879, 0.0, 0.0, -0.0002177761, 0.0001002524, 0.0001002524, 0.0001, 0.0, 0.0, 0.0],
    ];
    const ROTORS: [f32; JOINTS] = [1.0, 1.0, 0.9, 0.22, 0.22, 0.22];
}
