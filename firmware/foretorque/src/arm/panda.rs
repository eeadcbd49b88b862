//! Constants of `panda`, written by `host-sim generate` from its description. Change that, not this.
#![allow(
    clippy::approx_constant,
    dead_code,
    reason = "numbers of a description; a program needs some of these names only"
)]

use foretorque::arm::{Arm, BaseTerm, JointLimits, LinkColumns, Placement};

/// Number of joints.
pub const JOINTS: usize = 7;
/// Number of base parameters: inertial ones, then rotor inertias.
pub const PARAMETERS: usize = 48;

/// The arm `panda`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Panda;

/// Feed-forward of this arm.
pub type FeedForward = foretorque::feedforward::FeedForward<Panda, JOINTS, PARAMETERS>;
/// Learner of this arm.
pub type Learner = foretorque::learning::Learner<Panda, JOINTS, PARAMETERS>;
/// Learner configuration of this arm.
pub type LearnerConfig = foretorque::learning::LearnerConfig<JOINTS, PARAMETERS>;
/// Parameter set of this arm.
pub type ParameterSet = foretorque::learning::ParameterSet<JOINTS, PARAMETERS>;
/// Exchange between feed-forward and learner of this arm.
pub type Exchange = foretorque::learning::Exchange<JOINTS, PARAMETERS>;

#[rustfmt::skip]
impl Arm<JOINTS, PARAMETERS> for Panda {
    const NAME: &'static str = "panda";
    const GRAVITY: [f32; 3] = [0.0, 0.0, -9.81];
    const PLACEMENTS: [Placement; JOINTS] = [
        Placement { rot_parent_child: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], origin: [0.0, 0.0, 0.333] },
        Placement { rot_parent_child: [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]], origin: [0.0, 0.0, 0.0] },
        Placement { rot_parent_child: [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]], origin: [0.0, -0.316, 0.0] },
        Placement { rot_parent_child: [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]], origin: [0.0825, 0.0, 0.0] },
        Placement { rot_parent_child: [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]], origin: [-0.0825, 0.384, 0.0] },
        Placement { rot_parent_child: [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]], origin: [0.0, 0.0, 0.0] },
        Placement { rot_parent_child: [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]], origin: [0.088, 0.0, 0.0] },
    ];
    const COLUMNS: [LinkColumns; JOINTS] = [
        LinkColumns { inertial: [false, false, false, false, false, false, true, false, false, false], rotor: false },
        LinkColumns { inertial: [false, true, true, false, true, false, true, true, true, true], rotor: false },
        LinkColumns { inertial: [false, true, true, false, true, false, true, true, true, true], rotor: true },
        LinkColumns { inertial: [false, true, true, false, true, false, true, true, true, true], rotor: true },
        LinkColumns { inertial: [false, true, true, false, true, false, true, true, true, true], rotor: true },
        LinkColumns { inertial: [false, true, true, false, true, false, true, true, true, true], rotor: true },
        LinkColumns { inertial: [false, true, true, false, true, false, true, true, true, true], rotor: true },
    ];
    const BASE_MAP: &'static [BaseTerm] = &[
        BaseTerm::new(0, 6, 1.0), BaseTerm::new(0, 15, 1.0), BaseTerm::new(0, 70, 1.0), BaseTerm::new(1, 11, 1.0),
        BaseTerm::new(2, 12, 1.0), BaseTerm::new(2, 20, -0.316), BaseTerm::new(2, 23, -1.0),
        BaseTerm::new(2, 30, -0.316), BaseTerm::new(2, 40, -0.316), BaseTerm::new(2, 50, -0.316),
        BaseTerm::new(2, 60, -0.316), BaseTerm::new(3, 14, 1.0), BaseTerm::new(3, 15, -1.0),
        BaseTerm::new(3, 20, 0.099856), BaseTerm::new(3, 23, 0.632), BaseTerm::new(3, 25, 1.0),
        BaseTerm::new(3, 30, 0.10666225), BaseTerm::new(3, 40, 0.10666225), BaseTerm::new(3, 50, 0.10666225),
        BaseTerm::new(3, 60, 0.10666225), BaseTerm::new(4, 16, 1.0), BaseTerm::new(4, 20, 0.099856),
        BaseTerm::new(4, 23, 0.632), BaseTerm::new(4, 25, 1.0), BaseTerm::new(4, 30, 0.10666225),
        BaseTerm::new(4, 40, 0.10666225), BaseTerm::new(4, 50, 0.10666225), BaseTerm::new(4, 60, 0.10666225),
        BaseTerm::new(4, 71, 1.0), BaseTerm::new(5, 17, 1.0), BaseTerm::new(6, 18, 1.0), BaseTerm::new(7, 19, 1.0),
        BaseTerm::new(8, 21, 1.0), BaseTerm::new(8, 30, 0.0825), BaseTerm::new(8, 40, 0.0825),
        BaseTerm::new(8, 50, 0.0825), BaseTerm::new(8, 60, 0.0825), BaseTerm::new(9, 22, 1.0),
        BaseTerm::new(9, 33, -1.0), BaseTerm::new(10, 24, 1.0), BaseTerm::new(10, 25, -1.0),
        BaseTerm::new(10, 30, -0.00680625), BaseTerm::new(10, 35, 1.0), BaseTerm::new(11, 26, 1.0),
        BaseTerm::new(11, 30, 0.00680625), BaseTerm::new(11, 35, 1.0), BaseTerm::new(11, 40, 0.0136125),
        BaseTerm::new(11, 50, 0.0136125), BaseTerm::new(11, 60, 0.0136125), BaseTerm::new(12, 27, 1.0),
        BaseTerm::new(12, 33, 0.0825), BaseTerm::new(13, 28, 1.0), BaseTerm::new(14, 29, 1.0),
        BaseTerm::new(15, 31, 1.0), BaseTerm::new(15, 40, -0.0825), BaseTerm::new(15, 50, -0.0825),
        BaseTerm::new(15, 60, -0.0825), BaseTerm::new(16, 32, 1.0), BaseTerm::new(16, 40, 0.384),
        BaseTerm::new(16, 43, 1.0), BaseTerm::new(16, 50, 0.384), BaseTerm::new(16, 60, 0.384),
        BaseTerm::new(17, 34, 1.0), BaseTerm::new(17, 35, -1.0), BaseTerm::new(17, 40, 0.14064975),
        BaseTerm::new(17, 43, 0.768), BaseTerm::new(17, 45, 1.0), BaseTerm::new(17, 50, 0.14064975),
        BaseTerm::new(17, 60, 0.14064975), BaseTerm::new(18, 36, 1.0), BaseTerm::new(18, 40, 0.15426224),
        BaseTerm::new(18, 43, 0.768), BaseTerm::new(18, 45, 1.0), BaseTerm::new(18, 50, 0.15426224),
        BaseTerm::new(18, 60, 0.15426224), BaseTerm::new(19, 37, 1.0), BaseTerm::new(19, 40, 0.03168),
        BaseTerm::new(19, 43, 0.0825), BaseTerm::new(19, 50, 0.03168), BaseTerm::new(19, 60, 0.03168),
        BaseTerm::new(20, 38, 1.0), BaseTerm::new(21, 39, 1.0), BaseTerm::new(22, 41, 1.0), BaseTerm::new(23, 42, 1.0),
        BaseTerm::new(23, 53, -1.0), BaseTerm::new(24, 44, 1.0), BaseTerm::new(24, 45, -1.0),
        BaseTerm::new(24, 55, 1.0), BaseTerm::new(24, 60, 0.007744), BaseTerm::new(25, 46, 1.0),
        BaseTerm::new(25, 55, 1.0), BaseTerm::new(25, 60, 0.007744), BaseTerm::new(26, 47, 1.0),
        BaseTerm::new(27, 48, 1.0), BaseTerm::new(28, 49, 1.0), BaseTerm::new(29, 51, 1.0),
        BaseTerm::new(29, 60, 0.088), BaseTerm::new(30, 52, 1.0), BaseTerm::new(30, 63, -1.0),
        BaseTerm::new(31, 54, 1.0), BaseTerm::new(31, 55, -1.0), BaseTerm::new(31, 60, -0.007744),
        BaseTerm::new(31, 65, 1.0), BaseTerm::new(32, 56, 1.0), BaseTerm::new(32, 60, 0.007744),
        BaseTerm::new(32, 65, 1.0), BaseTerm::new(33, 57, 1.0), BaseTerm::new(33, 63, 0.088),
        BaseTerm::new(34, 58, 1.0), BaseTerm::new(35, 59, 1.0), BaseTerm::new(36, 61, 1.0), BaseTerm::new(37, 62, 1.0),
        BaseTerm::new(38, 64, 1.0), BaseTerm::new(38, 65, -1.0), BaseTerm::new(39, 66, 1.0), BaseTerm::new(40, 67, 1.0),
        BaseTerm::new(41, 68, 1.0), BaseTerm::new(42, 69, 1.0), BaseTerm::new(43, 72, 1.0), BaseTerm::new(44, 73, 1.0),
        BaseTerm::new(45, 74, 1.0), BaseTerm::new(46, 75, 1.0), BaseTerm::new(47, 76, 1.0),
    ];
    const LIMITS: [JointLimits; JOINTS] = [
        JointLimits { position: (-2.8973, 2.8973), velocity: 2.175, torque: 87.0 },
        JointLimits { position: (-1.7628, 1.7628), velocity: 2.175, torque: 87.0 },
        JointLimits { position: (-2.8973, 2.8973), velocity: 2.175, torque: 87.0 },
        JointLimits { position: (-3.0718, -0.0698), velocity: 2.175, torque: 87.0 },
        JointLimits { position: (-2.8973, 2.8973), velocity: 2.61, torque: 12.0 },
        JointLimits { position: (-0.0175, 3.7525), velocity: 2.61, torque: 12.0 },
        JointLimits { position: (-2.8973, 2.8973), velocity: 2.61, torque: 12.0 },
    ];
    const ENCODER_STEP: f32 = 4.79369e-5;
    const NOMINAL: [f32; PARAMETERS] = [
        0.03733745, -0.0020319945, -3.10434, 0.9896233, 1.035779, -0.003983359, 0.010261102, 0.0007689361, 0.68415797,
        0.028227095, 0.011595864, 0.124455206, -0.000121912424, -0.0054876483, -0.004377257, -0.49008027, 1.7206836,
        0.5408293, 0.6325241, 0.13876407, 0.003905355, -0.0016444876, -0.014653733, 0.06787063, 0.024230847, 0.02713316,
        -0.0015152445, -0.0046002455, 0.002164052, 0.16496755, -0.0688327, -0.00088412355, 0.030389506, 0.0055110343,
        -0.00010375892, 9.35691e-5, 0.0077354847, -0.0031274396, 0.0024209437, 0.004909652, -0.0003951087,
        -0.0016724827, -0.0005483591, 0.0, 0.0, 0.0, 0.0, 0.0,
    ];
    const LINKS: [[f32; 10]; JOINTS] = [
        [4.970684, 0.019261401, 0.010343993, -0.23670398, 0.7146634, 0.7179565, 0.0092131635, -0.00017908297, 0.007689228, 0.019661581],
        [0.646926, -0.0020319945, -0.018579714, 0.0022610063, 0.008503512, 0.028124284, 0.026534991, -0.003983359, 0.010261102, 0.0007689361],
        [3.228604, 0.088844724, 0.12672916, -0.21470863, 0.056494925, 0.052878384, 0.018249203, -0.008248333, -0.0054876483, -0.004377257],
        [3.587895, -0.19076838, 0.3746444, 0.09850207, 0.06767727, 0.03239943, 0.07758615, 0.027715843, 0.003905355, -0.0016444876],
        [1.225946, -0.014653733, 0.050343473, -0.047121685, 0.03942757, 0.03146037, 0.0108695105, -0.0015152445, -0.0046002455, 0.002164052],
        [1.666555, 0.10024162, -0.023526756, -0.01752716, 0.0024804603, 0.010567766, 0.011794561, 0.0015241109, -0.00010375892, 9.35691e-5],
        [0.735522, 0.0077354847, -0.0031274396, 0.04530595, 0.015320009, 0.012899064, 0.004909652, -0.0003951087, -0.0016724827, -0.0005483591],
    ];
    const ROTORS: [f32; JOINTS] = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
}
