//! Constants of `oblique`, written by `host-sim generate` from its description. Change that, not this.

use foretorque::arm::{Arm, BaseTerm, JointLimits, LinkColumns, Placement};

/// Number of joints.
pub const JOINTS: usize = 4;
/// Number of base parameters: inertial ones, then rotor inertias.
pub const PARAMETERS: usize = 27;

/// The arm `oblique`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Oblique;

/// Feed-forward of this arm.
pub type FeedForward = foretorque::feedforward::FeedForward<Oblique, JOINTS, PARAMETERS>;
/// Learner of this arm.
pub type Learner = foretorque::learning::Learner<Oblique, JOINTS, PARAMETERS>;
/// Learner configuration of this arm.
pub type LearnerConfig = foretorque::learning::LearnerConfig<JOINTS, PARAMETERS>;
/// Parameter set of this arm.
pub type ParameterSet = foretorque::learning::ParameterSet<JOINTS, PARAMETERS>;
/// Exchange between feed-forward and learner of this arm.
pub type Exchange = foretorque::learning::Exchange<JOINTS, PARAMETERS>;

#[rustfmt::skip]
impl Arm<JOINTS, PARAMETERS> for Oblique {
    const NAME: &'static str = "oblique";
    const GRAVITY: [f32; 3] = [0.0, 0.0, -9.81];
    const PLACEMENTS: [Placement; JOINTS] = [
        Placement { rot_parent_child: [[0.8216602, -0.4341058, -0.3693597], [0.30989602, -0.2036324, 0.92870784], [-0.47837108, -0.8775454, -0.03278897]], origin: [0.094395556, -0.3107035, 0.9269655] },
        Placement { rot_parent_child: [[0.61815745, 0.15231556, 0.77115583], [-0.21748388, -0.9096081, 0.35399687], [0.7553688, -0.3865398, -0.5291549]], origin: [-0.17666666, -0.20333333, -0.17333333] },
        Placement { rot_parent_child: [[-0.21835066, -0.8633169, 0.4549802], [-0.036957014, -0.45858032, -0.88788414], [0.9751703, -0.2106848, 0.0682257]], origin: [0.5007473, -0.038659558, -0.008658039] },
        Placement { rot_parent_child: [[0.38941833, 0.46499404, 0.7950685], [-0.52007014, -0.6014308, 0.6064718], [0.76018447, -0.6496626, 0.007621349]], origin: [0.02, 0.01, 0.3] },
    ];
    const COLUMNS: [LinkColumns; JOINTS] = [
        LinkColumns { inertial: [false, true, true, false, false, false, true, false, false, false], rotor: false },
        LinkColumns { inertial: [false, true, true, false, true, false, true, true, true, true], rotor: true },
        LinkColumns { inertial: [false, true, true, false, true, false, true, true, true, true], rotor: true },
        LinkColumns { inertial: [false, true, true, false, true, false, true, true, true, true], rotor: true },
    ];
    const BASE_MAP: &'static [BaseTerm] = &[
        BaseTerm::new(0, 1, 1.0),
        BaseTerm::new(0, 10, -0.17666666),
        BaseTerm::new(0, 13, 0.77115583),
        BaseTerm::new(0, 20, -0.18334337),
        BaseTerm::new(0, 23, 0.052612647),
        BaseTerm::new(0, 30, -0.16755956),
        BaseTerm::new(0, 33, 0.00040097933),
        BaseTerm::new(1, 2, 1.0),
        BaseTerm::new(1, 10, -0.20333333),
        BaseTerm::new(1, 13, 0.35399687),
        BaseTerm::new(1, 20, -0.20639825),
        BaseTerm::new(1, 23, 0.024151685),
        BaseTerm::new(1, 30, -0.19915275),
        BaseTerm::new(1, 33, 0.00018406843),
        BaseTerm::new(2, 6, 1.0),
        BaseTerm::new(2, 10, 0.07255556),
        BaseTerm::new(2, 13, -0.41643378),
        BaseTerm::new(2, 15, 0.7199951),
        BaseTerm::new(2, 20, 0.25675225),
        BaseTerm::new(2, 23, 0.29881102),
        BaseTerm::new(2, 25, 0.1523954),
        BaseTerm::new(2, 30, 0.36017212),
        BaseTerm::new(2, 33, 0.007820809),
        BaseTerm::new(2, 35, 0.096343145),
        BaseTerm::new(2, 40, 1.0),
        BaseTerm::new(3, 11, 1.0),
        BaseTerm::new(3, 20, 0.5007473),
        BaseTerm::new(3, 23, 0.4549802),
        BaseTerm::new(3, 30, 0.63724136),
        BaseTerm::new(3, 33, 0.0034675628),
        BaseTerm::new(4, 12, 1.0),
        BaseTerm::new(4, 20, -0.038659558),
        BaseTerm::new(4, 23, -0.88788414),
        BaseTerm::new(4, 30, -0.3050248),
        BaseTerm::new(4, 33, -0.006766875),
        BaseTerm::new(5, 14, 1.0),
        BaseTerm::new(5, 15, -1.0),
        BaseTerm::new(5, 20, -0.2492533),
        BaseTerm::new(5, 23, -0.3870098),
        BaseTerm::new(5, 25, 0.5813313),
        BaseTerm::new(5, 30, -0.3128039),
        BaseTerm::new(5, 33, 0.01819671),
        BaseTerm::new(5, 35, 0.367513),
        BaseTerm::new(6, 16, 1.0),
        BaseTerm::new(6, 20, 0.25224242),
        BaseTerm::new(6, 23, 0.52431065),
        BaseTerm::new(6, 25, 0.99534523),
        BaseTerm::new(6, 30, 0.49951482),
        BaseTerm::new(6, 33, 0.04020218),
        BaseTerm::new(6, 35, 0.6292493),
        BaseTerm::new(7, 17, 1.0),
        BaseTerm::new(7, 20, 0.019358668),
        BaseTerm::new(7, 23, 0.46219495),
        BaseTerm::new(7, 25, 0.4039697),
        BaseTerm::new(7, 30, 0.19453602),
        BaseTerm::new(7, 33, 0.018217169),
        BaseTerm::new(7, 35, 0.2553864),
        BaseTerm::new(8, 18, 1.0),
        BaseTerm::new(8, 20, 0.00433549),
        BaseTerm::new(8, 23, -0.030224599),
        BaseTerm::new(8, 25, -0.031041343),
        BaseTerm::new(8, 30, -0.007538027),
        BaseTerm::new(8, 33, -0.001359498),
        BaseTerm::new(8, 35, -0.019624086),
        BaseTerm::new(9, 19, 1.0),
        BaseTerm::new(9, 20, -0.00033471597),
        BaseTerm::new(9, 23, -0.005049761),
        BaseTerm::new(9, 25, 0.060576517),
        BaseTerm::new(9, 30, 0.003626473),
        BaseTerm::new(9, 33, 0.002165018),
        BaseTerm::new(9, 35, 0.038295988),
        BaseTerm::new(10, 21, 1.0),
        BaseTerm::new(10, 30, 0.02),
        BaseTerm::new(10, 33, 0.7950685),
        BaseTerm::new(11, 22, 1.0),
        BaseTerm::new(11, 30, 0.01),
        BaseTerm::new(11, 33, 0.6064718),
        BaseTerm::new(12, 24, 1.0),
        BaseTerm::new(12, 25, -1.0),
        BaseTerm::new(12, 30, -0.0003),
        BaseTerm::new(12, 33, -0.019673303),
        BaseTerm::new(12, 35, -0.26432586),
        BaseTerm::new(13, 26, 1.0),
        BaseTerm::new(13, 30, 0.0005),
        BaseTerm::new(13, 33, 0.043932173),
        BaseTerm::new(13, 35, 0.9999419),
        BaseTerm::new(14, 27, 1.0),
        BaseTerm::new(14, 30, -0.0002),
        BaseTerm::new(14, 33, -0.020080121),
        BaseTerm::new(14, 35, -0.48218662),
        BaseTerm::new(15, 28, 1.0),
        BaseTerm::new(15, 30, -0.006),
        BaseTerm::new(15, 33, -0.23867297),
        BaseTerm::new(15, 35, -0.0060594943),
        BaseTerm::new(16, 29, 1.0),
        BaseTerm::new(16, 30, -0.003),
        BaseTerm::new(16, 33, -0.18201774),
        BaseTerm::new(16, 35, -0.004622133),
        BaseTerm::new(17, 31, 1.0),
        BaseTerm::new(18, 32, 1.0),
        BaseTerm::new(19, 34, 1.0),
        BaseTerm::new(19, 35, -1.0),
        BaseTerm::new(20, 36, 1.0),
        BaseTerm::new(21, 37, 1.0),
        BaseTerm::new(22, 38, 1.0),
        BaseTerm::new(23, 39, 1.0),
        BaseTerm::new(24, 41, 1.0),
        BaseTerm::new(25, 42, 1.0),
        BaseTerm::new(26, 43, 1.0),
    ];
    const LIMITS: [JointLimits; JOINTS] = [
        JointLimits { position: (-3.0, 3.0), velocity: 2.0, torque: 300.0 },
        JointLimits { position: (-2.0, 2.0), velocity: 2.0, torque: 250.0 },
        JointLimits { position: (-core::f32::consts::TAU, core::f32::consts::TAU), velocity: 3.0, torque: 60.0 },
        JointLimits { position: (-1.5, 1.5), velocity: 3.0, torque: 30.0 },
    ];
    const NOMINAL: [f32; PARAMETERS] = [
        -1.1792985,
        -1.946121,
        1.5444598,
        2.6266165,
        -0.7210951,
        -1.1108919,
        1.5150566,
        0.36382678,
        -0.0027676756,
        0.015853466,
        -0.02513096,
        0.018509395,
        -0.0013795248,
        0.007029599,
        -0.0011752925,
        0.00025924787,
        -0.004725642,
        0.03064078,
        0.087247156,
        0.007536367,
        0.012072551,
        -0.003262914,
        0.0005229325,
        0.0014727013,
        0.0,
        0.0,
        0.0,
    ];
    const LINKS: [[f32; 10]; JOINTS] = [
        [6.3, -0.030658873, -0.5998666, -0.74032265, 0.22890612, 0.14206475, 0.12307878, 0.001113738, 0.00090254913, -0.085894644],
        [4.0, 1.0221332, -0.124033324, 0.03094012, 0.053380214, 0.36399794, 0.39332005, -0.005686041, 0.006967969, 0.010445795],
        [1.7, -0.034, 0.017, 0.255, 0.058151726, 0.05875337, 0.0042949, 0.000117776624, 0.0029350952, -0.004260718],
        [1.0, 0.03064078, 0.087247156, -0.014, 0.010386282, 0.002849915, 0.012072551, -0.003262914, 0.0005229325, 0.0014727013],
    ];
    const ROTORS: [f32; JOINTS] = [0.0, 0.0, 0.0, 0.0];
}
