//! Constants of `random_4_a`, written by `host-sim generate` from its description. Change that, not this.

use foretorque::arm::{Arm, BaseTerm, JointLimits, LinkColumns, Placement};

/// Number of joints.
pub const JOINTS: usize = 4;
/// Number of base parameters: inertial ones, then rotor inertias.
pub const PARAMETERS: usize = 27;

/// The arm `random_4_a`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Random4A;

/// Feed-forward of this arm.
pub type FeedForward = foretorque::feedforward::FeedForward<Random4A, JOINTS, PARAMETERS>;
/// Learner of this arm.
pub type Learner = foretorque::learning::Learner<Random4A, JOINTS, PARAMETERS>;
/// Learner configuration of this arm.
pub type LearnerConfig = foretorque::learning::LearnerConfig<JOINTS, PARAMETERS>;
/// Parameter set of this arm.
pub type ParameterSet = foretorque::learning::ParameterSet<JOINTS, PARAMETERS>;
/// Exchange between feed-forward and learner of this arm.
pub type Exchange = foretorque::learning::Exchange<JOINTS, PARAMETERS>;

#[rustfmt::skip]
impl Arm<JOINTS, PARAMETERS> for Random4A {
    const NAME: &'static str = "random_4_a";
    const GRAVITY: [f32; 3] = [0.0, 0.0, -9.81];
    const PLACEMENTS: [Placement; JOINTS] = [
        Placement { rot_parent_child: [[0.5234153, -0.843291, 0.122052155], [0.10952023, 0.20863496, 0.97184193], [-0.84500986, -0.4953098, 0.20156015]], origin: [0.044767, 0.04895, 0.065827] },
        Placement { rot_parent_child: [[-0.562156, -0.42588636, 0.70894384], [0.81742233, -0.41641438, 0.3980198], [0.12570323, 0.8032558, 0.5822189]], origin: [-0.205187, 0.337409, 0.230502] },
        Placement { rot_parent_child: [[0.0087614, -0.84241563, -0.538757], [-0.024019882, 0.53844494, -0.8423183], [0.99967307, 0.020320768, -0.015517192]], origin: [0.235226, 0.163253, 0.156929] },
        Placement { rot_parent_child: [[-0.9917764, 0.12448559, -0.029713564], [0.087690875, 0.83008116, 0.55070466], [0.09321946, 0.5435703, -0.8341712]], origin: [-0.147164, 0.055413, 0.04202] },
    ];
    const COLUMNS: [LinkColumns; JOINTS] = [
        LinkColumns { inertial: [false, true, true, false, false, false, true, false, false, false], rotor: false },
        LinkColumns { inertial: [false, true, true, false, true, false, true, true, true, true], rotor: true },
        LinkColumns { inertial: [false, true, true, false, true, false, true, true, true, true], rotor: true },
        LinkColumns { inertial: [false, true, true, false, true, false, true, true, true, true], rotor: true },
    ];
    const BASE_MAP: &'static [BaseTerm] = &[
        BaseTerm::new(0, 1, 1.0),
        BaseTerm::new(0, 10, -0.205187),
        BaseTerm::new(0, 13, 0.70894384),
        BaseTerm::new(0, 20, -0.09393315),
        BaseTerm::new(0, 23, -0.011000818),
        BaseTerm::new(0, 30, -0.0943954),
        BaseTerm::new(0, 33, 0.009176565),
        BaseTerm::new(1, 2, 1.0),
        BaseTerm::new(1, 10, 0.337409),
        BaseTerm::new(1, 13, 0.3980198),
        BaseTerm::new(1, 20, 0.39986986),
        BaseTerm::new(1, 23, -0.0061761495),
        BaseTerm::new(1, 30, 0.3996103),
        BaseTerm::new(1, 33, 0.0051519657),
        BaseTerm::new(2, 6, 1.0),
        BaseTerm::new(2, 10, 0.15594654),
        BaseTerm::new(2, 13, -0.022341216),
        BaseTerm::new(2, 15, 0.6610212),
        BaseTerm::new(2, 20, 0.20529447),
        BaseTerm::new(2, 23, -0.17041461),
        BaseTerm::new(2, 25, 0.1920266),
        BaseTerm::new(2, 30, 0.20263147),
        BaseTerm::new(2, 33, 0.13037254),
        BaseTerm::new(2, 35, 0.13378963),
        BaseTerm::new(2, 40, 1.0),
        BaseTerm::new(3, 11, 1.0),
        BaseTerm::new(3, 20, 0.235226),
        BaseTerm::new(3, 23, -0.538757),
        BaseTerm::new(3, 30, 0.21258743),
        BaseTerm::new(3, 33, 0.4494156),
        BaseTerm::new(4, 12, 1.0),
        BaseTerm::new(4, 20, 0.163253),
        BaseTerm::new(4, 23, -0.8423183),
        BaseTerm::new(4, 30, 0.12785879),
        BaseTerm::new(4, 33, 0.7026376),
        BaseTerm::new(5, 14, 1.0),
        BaseTerm::new(5, 15, -1.0),
        BaseTerm::new(5, 20, -0.028679729),
        BaseTerm::new(5, 23, -0.02156264),
        BaseTerm::new(5, 25, 0.41924092),
        BaseTerm::new(5, 30, -0.019765943),
        BaseTerm::new(5, 33, -0.00773694),
        BaseTerm::new(5, 35, 0.29209536),
        BaseTerm::new(6, 16, 1.0),
        BaseTerm::new(6, 20, 0.081982814),
        BaseTerm::new(6, 23, -0.5284813),
        BaseTerm::new(6, 25, 0.9997592),
        BaseTerm::new(6, 30, 0.08319331),
        BaseTerm::new(6, 33, 0.37950042),
        BaseTerm::new(6, 35, 0.6965566),
        BaseTerm::new(7, 17, 1.0),
        BaseTerm::new(7, 20, -0.03840135),
        BaseTerm::new(7, 23, 0.28608885),
        BaseTerm::new(7, 25, -0.4538049),
        BaseTerm::new(7, 30, -0.037009332),
        BaseTerm::new(7, 33, -0.21080242),
        BaseTerm::new(7, 35, -0.31617695),
        BaseTerm::new(8, 18, 1.0),
        BaseTerm::new(8, 20, -0.036913782),
        BaseTerm::new(8, 23, 0.08819665),
        BaseTerm::new(8, 25, -0.008359997),
        BaseTerm::new(8, 30, -0.03340357),
        BaseTerm::new(8, 33, -0.07305815),
        BaseTerm::new(8, 35, -0.0058246134),
        BaseTerm::new(9, 19, 1.0),
        BaseTerm::new(9, 20, -0.02561913),
        BaseTerm::new(9, 23, 0.13471739),
        BaseTerm::new(9, 25, -0.013070414),
        BaseTerm::new(9, 30, -0.020264452),
        BaseTerm::new(9, 33, -0.11157539),
        BaseTerm::new(9, 35, -0.009106477),
        BaseTerm::new(10, 21, 1.0),
        BaseTerm::new(10, 30, -0.147164),
        BaseTerm::new(10, 33, -0.029713564),
        BaseTerm::new(11, 22, 1.0),
        BaseTerm::new(11, 30, 0.055413),
        BaseTerm::new(11, 33, 0.55070466),
        BaseTerm::new(12, 24, 1.0),
        BaseTerm::new(12, 25, -1.0),
        BaseTerm::new(12, 30, -0.018586643),
        BaseTerm::new(12, 33, 0.05228686),
        BaseTerm::new(12, 35, 0.3023927),
        BaseTerm::new(13, 26, 1.0),
        BaseTerm::new(13, 30, 0.024727844),
        BaseTerm::new(13, 33, 0.06977793),
        BaseTerm::new(13, 35, 0.30415848),
        BaseTerm::new(14, 27, 1.0),
        BaseTerm::new(14, 30, 0.008154798),
        BaseTerm::new(14, 33, 0.08269042),
        BaseTerm::new(14, 35, 0.016363397),
        BaseTerm::new(15, 28, 1.0),
        BaseTerm::new(15, 30, 0.0061838315),
        BaseTerm::new(15, 33, -0.1215114),
        BaseTerm::new(15, 35, -0.024786199),
        BaseTerm::new(16, 29, 1.0),
        BaseTerm::new(16, 30, -0.0023284543),
        BaseTerm::new(16, 33, 0.023083318),
        BaseTerm::new(16, 35, 0.4593819),
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
        JointLimits { position: (f32::from_bits(0xc048f5c3 /* -3.14 */), f32::from_bits(0x4048f5c3 /* 3.14 */)), velocity: 3.15, torque: 108.0 },
        JointLimits { position: (f32::from_bits(0xc048f5c3 /* -3.14 */), f32::from_bits(0x4048f5c3 /* 3.14 */)), velocity: 3.15, torque: 44.0 },
        JointLimits { position: (f32::from_bits(0xc048f5c3 /* -3.14 */), f32::from_bits(0x4048f5c3 /* 3.14 */)), velocity: 3.15, torque: 28.0 },
        JointLimits { position: (f32::from_bits(0xc048f5c3 /* -3.14 */), f32::from_bits(0x4048f5c3 /* 3.14 */)), velocity: 3.15, torque: 18.0 },
    ];
    const NOMINAL: [f32; PARAMETERS] = [
        -1.3340772,
        3.2535257,
        2.4782197,
        1.9549421,
        0.61881644,
        -0.11753261,
        0.85536146,
        -0.23693164,
        -0.24017341,
        -0.16935022,
        -0.7103302,
        0.3855453,
        -0.030879032,
        0.18135734,
        0.06431823,
        -0.018681029,
        0.042859532,
        0.3811883,
        0.33612707,
        -0.013967475,
        0.074067,
        -0.030314125,
        -0.034245316,
        -0.029140314,
        0.2638,
        0.812,
        0.9139,
    ];
    const LINKS: [[f32; 10]; JOINTS] = [
        [1.7249, -0.2623987, -0.10760099, 0.12729073, 0.029140074, 0.061592583, 0.051055565, -0.018125553, 0.023062404, 0.012424862],
        [2.3558, 0.43966767, -0.4414298, 0.017833406, 0.10241062, 0.10042789, 0.16924809, 0.08295789, -0.0010470042, -0.0009365364],
        [1.8476, -0.02879115, -0.08231797, 0.116951235, 0.020976922, 0.012372819, 0.016676357, -0.006513121, 0.002765741, 0.0069689653],
        [4.5521, 0.3811883, 0.33612707, 0.39153066, 0.06755967, 0.08152714, 0.074067, -0.030314125, -0.034245316, -0.029140314],
    ];
    const ROTORS: [f32; JOINTS] = [0.6477, 0.2638, 0.812, 0.9139];
}
