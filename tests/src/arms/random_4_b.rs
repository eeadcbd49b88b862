//! Constants of `random_4_b`, written by `host-sim generate` from its description. Change that, not this.

use foretorque::arm::{Arm, BaseTerm, JointLimits, LinkColumns, Placement};

/// Number of joints.
pub const JOINTS: usize = 4;
/// Number of base parameters: inertial ones, then rotor inertias.
pub const PARAMETERS: usize = 27;

/// The arm `random_4_b`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Random4B;

/// Feed-forward of this arm.
pub type FeedForward = foretorque::feedforward::FeedForward<Random4B, JOINTS, PARAMETERS>;
/// Learner of this arm.
pub type Learner = foretorque::learning::Learner<Random4B, JOINTS, PARAMETERS>;
/// Learner configuration of this arm.
pub type LearnerConfig = foretorque::learning::LearnerConfig<JOINTS, PARAMETERS>;
/// Parameter set of this arm.
pub type ParameterSet = foretorque::learning::ParameterSet<JOINTS, PARAMETERS>;
/// Exchange between feed-forward and learner of this arm.
pub type Exchange = foretorque::learning::Exchange<JOINTS, PARAMETERS>;

#[rustfmt::skip]
impl Arm<JOINTS, PARAMETERS> for Random4B {
    const NAME: &'static str = "random_4_b";
    const GRAVITY: [f32; 3] = [0.0, 0.0, -9.81];
    const PLACEMENTS: [Placement; JOINTS] = [
        Placement { rot_parent_child: [[0.8984719, -0.3937908, 0.19410577], [-0.43827635, -0.778591, 0.44912127], [-0.025730813, -0.48859483, -0.8721313]], origin: [0.336633, -0.270098, -0.191421] },
        Placement { rot_parent_child: [[-0.137632, 0.6584409, -0.73994124], [-0.39963302, -0.7204601, -0.56677216], [-0.9062841, 0.21769895, 0.36229306]], origin: [-0.058795, -0.089176, 0.006851] },
        Placement { rot_parent_child: [[0.55955833, 0.36574396, 0.7437243], [-0.42499036, 0.8970228, -0.12138073], [-0.71153194, -0.24815604, 0.65737426]], origin: [-0.135362, 0.022486, -0.327069] },
        Placement { rot_parent_child: [[-0.64280474, 0.7289574, 0.23542123], [0.33806118, 0.5457308, -0.76674145], [-0.6873985, -0.41327828, -0.59723055]], origin: [-0.1006, 0.153013, 0.051084] },
    ];
    const COLUMNS: [LinkColumns; JOINTS] = [
        LinkColumns { inertial: [false, true, true, false, false, false, true, false, false, false], rotor: false },
        LinkColumns { inertial: [false, true, true, false, true, false, true, true, true, true], rotor: true },
        LinkColumns { inertial: [false, true, true, false, true, false, true, true, true, true], rotor: true },
        LinkColumns { inertial: [false, true, true, false, true, false, true, true, true, true], rotor: true },
    ];
    const BASE_MAP: &'static [BaseTerm] = &[
        BaseTerm::new(0, 1, 1.0),
        BaseTerm::new(0, 10, -0.058795),
        BaseTerm::new(0, 13, -0.73994124),
        BaseTerm::new(0, 20, 0.18321684),
        BaseTerm::new(0, 23, -0.4864183),
        BaseTerm::new(0, 30, 0.15836865),
        BaseTerm::new(0, 33, 0.2905039),
        BaseTerm::new(1, 2, 1.0),
        BaseTerm::new(1, 10, -0.089176),
        BaseTerm::new(1, 13, -0.56677216),
        BaseTerm::new(1, 20, 0.09619761),
        BaseTerm::new(1, 23, -0.37258142),
        BaseTerm::new(1, 30, 0.07716466),
        BaseTerm::new(1, 33, 0.22251703),
        BaseTerm::new(2, 6, 1.0),
        BaseTerm::new(2, 10, 0.011409211),
        BaseTerm::new(2, 13, 0.18809465),
        BaseTerm::new(2, 15, 0.8687437),
        BaseTerm::new(2, 20, 0.05874027),
        BaseTerm::new(2, 23, -0.4248393),
        BaseTerm::new(2, 25, 0.8559443),
        BaseTerm::new(2, 30, 0.047933895),
        BaseTerm::new(2, 33, 0.16095583),
        BaseTerm::new(2, 35, 0.35274106),
        BaseTerm::new(2, 40, 1.0),
        BaseTerm::new(3, 11, 1.0),
        BaseTerm::new(3, 20, -0.135362),
        BaseTerm::new(3, 23, 0.7437243),
        BaseTerm::new(3, 30, -0.09736959),
        BaseTerm::new(3, 33, -0.4441749),
        BaseTerm::new(4, 12, 1.0),
        BaseTerm::new(4, 20, 0.022486),
        BaseTerm::new(4, 23, -0.12138073),
        BaseTerm::new(4, 30, 0.016285386),
        BaseTerm::new(4, 33, 0.07249229),
        BaseTerm::new(5, 14, 1.0),
        BaseTerm::new(5, 15, -1.0),
        BaseTerm::new(5, 20, -0.017817251),
        BaseTerm::new(5, 23, 0.19588529),
        BaseTerm::new(5, 25, -0.53839254),
        BaseTerm::new(5, 30, -0.014664349),
        BaseTerm::new(5, 33, -0.058635216),
        BaseTerm::new(5, 35, -0.22187561),
        BaseTerm::new(6, 16, 1.0),
        BaseTerm::new(6, 20, 0.01882849),
        BaseTerm::new(6, 23, -0.20680274),
        BaseTerm::new(6, 25, 0.5678591),
        BaseTerm::new(6, 30, 0.015492989),
        BaseTerm::new(6, 33, 0.06196174),
        BaseTerm::new(6, 35, 0.234019),
        BaseTerm::new(7, 17, 1.0),
        BaseTerm::new(7, 20, 0.0030437498),
        BaseTerm::new(7, 23, -0.033153724),
        BaseTerm::new(7, 25, 0.0902738),
        BaseTerm::new(7, 30, 0.0024993047),
        BaseTerm::new(7, 33, 0.0100161275),
        BaseTerm::new(7, 35, 0.03720251),
        BaseTerm::new(8, 18, 1.0),
        BaseTerm::new(8, 20, -0.044272713),
        BaseTerm::new(8, 23, 0.33223265),
        BaseTerm::new(8, 25, -0.4889052),
        BaseTerm::new(8, 30, -0.033524673),
        BaseTerm::new(8, 33, -0.1454297),
        BaseTerm::new(8, 35, -0.2014815),
        BaseTerm::new(9, 19, 1.0),
        BaseTerm::new(9, 20, 0.0073544737),
        BaseTerm::new(9, 23, -0.054481592),
        BaseTerm::new(9, 25, 0.07979257),
        BaseTerm::new(9, 30, 0.0055870903),
        BaseTerm::new(9, 33, 0.023889787),
        BaseTerm::new(9, 35, 0.03288312),
        BaseTerm::new(10, 21, 1.0),
        BaseTerm::new(10, 30, -0.1006),
        BaseTerm::new(10, 33, 0.23542123),
        BaseTerm::new(11, 22, 1.0),
        BaseTerm::new(11, 30, 0.153013),
        BaseTerm::new(11, 33, -0.76674145),
        BaseTerm::new(12, 24, 1.0),
        BaseTerm::new(12, 25, -1.0),
        BaseTerm::new(12, 30, 0.013292618),
        BaseTerm::new(12, 33, -0.18727608),
        BaseTerm::new(12, 35, 0.53246933),
        BaseTerm::new(13, 26, 1.0),
        BaseTerm::new(13, 30, 0.03353334),
        BaseTerm::new(13, 33, -0.28200957),
        BaseTerm::new(13, 35, 0.6433156),
        BaseTerm::new(14, 27, 1.0),
        BaseTerm::new(14, 30, 0.015393108),
        BaseTerm::new(14, 33, -0.1131567),
        BaseTerm::new(14, 35, 0.18050721),
        BaseTerm::new(15, 28, 1.0),
        BaseTerm::new(15, 30, 0.0051390505),
        BaseTerm::new(15, 33, -0.07210766),
        BaseTerm::new(15, 35, 0.14060076),
        BaseTerm::new(16, 29, 1.0),
        BaseTerm::new(16, 30, -0.007816516),
        BaseTerm::new(16, 33, 0.13055226),
        BaseTerm::new(16, 35, -0.45792145),
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
        JointLimits { position: (f32::from_bits(0xc048f5c3 /* -3.14 */), f32::from_bits(0x4048f5c3 /* 3.14 */)), velocity: 3.15, torque: 41.0 },
        JointLimits { position: (f32::from_bits(0xc048f5c3 /* -3.14 */), f32::from_bits(0x4048f5c3 /* 3.14 */)), velocity: 3.15, torque: 44.0 },
        JointLimits { position: (f32::from_bits(0xc048f5c3 /* -3.14 */), f32::from_bits(0x4048f5c3 /* 3.14 */)), velocity: 3.15, torque: 29.0 },
        JointLimits { position: (f32::from_bits(0xc048f5c3 /* -3.14 */), f32::from_bits(0x4048f5c3 /* 3.14 */)), velocity: 3.15, torque: 7.0 },
    ];
    const NOMINAL: [f32; PARAMETERS] = [
        1.7245471,
        1.1233044,
        1.5534034,
        -1.7108545,
        0.13787885,
        -0.4259481,
        0.45627525,
        0.048852403,
        -0.62384385,
        0.102076314,
        -1.2390163,
        0.26697588,
        -0.07399103,
        0.30855083,
        0.023183832,
        -0.05230786,
        -0.06252903,
        0.026475647,
        0.22529738,
        0.025805537,
        0.031690687,
        -0.000984836,
        0.0016262284,
        0.017571418,
        0.6946,
        0.8274,
        0.3235,
    ];
    const LINKS: [[f32; 10]; JOINTS] = [
        [4.4307, 0.20900054, 0.4465614, 0.81577164, 0.23494287, 0.19868304, 0.060501516, -0.020791637, -0.03906191, -0.08202214],
        [2.6098, -0.35681447, -0.08640265, 0.010757595, 0.012700715, 0.068407275, 0.06540966, -0.013789986, -0.006615101, 0.00018583171],
        [6.0764, -0.9683959, -0.21600387, -0.52029175, 0.100502804, 0.24690767, 0.171463, -0.034875736, -0.079102136, -0.013827851],
        [2.2814, 0.026475647, 0.22529738, -0.17462976, 0.043429233, 0.017623695, 0.031690687, -0.000984836, 0.0016262284, 0.017571418],
    ];
    const ROTORS: [f32; JOINTS] = [0.5249, 0.6946, 0.8274, 0.3235];
}
