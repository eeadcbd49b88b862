//! The rows: one function each, and its inputs and outputs, which change from call to call.

use core::f32::consts::TAU;
use core::hint::black_box;

use foretorque::arm::Arm as _;
use foretorque::arm::panda::{self, Panda};
use foretorque::dynamics::{
    BaseParameters, FrictionColumn, FrictionParameters, friction, regressor, regressor_row, rnea,
};
use foretorque::feedforward::{FeedForward, FeedForwardConfig, evaluate};
use foretorque::joint::{JointMeasurement, JointMotion, JointSample, JointVector};
use foretorque::learning::{Exchange, LearnerConfig, LearningSample, ParameterSet, network_inputs};
use foretorque::limits::Flags;
use foretorque::math::{self, SinCos};
use foretorque::network::{BpNetwork, StepParameters};
use foretorque_f405::arm::{Arm, JOINTS, Learner, PARAMETERS};
use foretorque_test_arms::ur5_calibrated::{self, Ur5Calibrated};
use nalgebra::SVector;

use crate::bus::Bus;
use crate::commands::Link;

/// One measured function, kept apart by its address being taken: nothing about its inputs is known when it is compiled.
pub(crate) struct Row {
    pub(crate) name: &'static str,
    pub(crate) run: fn(&mut Stage),
}

macro_rules! rows {
    ($table:ident: $($name:ident($stage:pat) $body:expr;)*) => {
        $(
            #[inline(never)]
            pub(crate) fn $name($stage: &mut Stage) {
                $body
            }
        )*
        pub(crate) static $table: &[Row] = &[$(Row { name: stringify!($name), run: $name }),*];
    };
}

// The results of a regressor and of a tick are looked at where they are: a copy would be no part of the work.
// The networks are reached by a pointer to each, as by any caller that does not keep them in a struct of everything.
// The host subtracts the first row: what a call costs whose function returns at once.
rows! {
    ARM_ROWS:
    empty(_) ();
    sin_cos(s) s.sin_cos = math::sin_cos(s.angle);
    rnea_ur5(s) s.tau = rnea::<Arm, JOINTS, PARAMETERS>(&s.set.rigid, &s.motion);
    rnea_calibrated(s) s.calibrated_tau =
        rnea::<Ur5Calibrated, { ur5_calibrated::JOINTS }, { ur5_calibrated::PARAMETERS }>(
            &s.calibrated, &s.calibrated_motion,
        );
    rnea_7dof(s) s.panda_tau =
        rnea::<Panda, { panda::JOINTS }, { panda::PARAMETERS }>(&s.panda, &s.panda_motion);
    regressor_row_ur5(s) { black_box(&regressor_row::<Arm, JOINTS, PARAMETERS>(s.joint, &s.motion)); };
    regressor_ur5(s) { black_box(&regressor::<Arm, JOINTS, PARAMETERS>(&s.motion)); };
    friction_ur5(s) s.tau = friction::<Arm, JOINTS, PARAMETERS>(&s.set.friction, &s.motion.q, &s.motion.qd);
    bp_18_32_6_forward(s) s.output = black_box(&mut s.paper).forward(&s.input);
    bp_18_32_6_update(s) s.output = black_box(&mut s.paper).update(&s.input, &s.target, &s.step);
    block_network(s) s.block_network();
    feedforward_step(s) { black_box(&s.feedforward.step(&s.sample)); };
    learning_step(s) s.learner.learn(&s.learning_sample, &mut s.exchange);
}

rows! {
    LINK_ROWS:
    command(s) s.link.iter_mut().for_each(|link| link.run());
    configure(s) { black_box("another function than that of a command"); s.link.iter_mut().for_each(|link| link.run()) };
    bus_tick(s) s.bus.iter_mut().for_each(|bus| bus.tick());
    in_line(s) s.bus.iter_mut().for_each(|bus| bus.pass());
}

/// Period of the tick, s.
const PERIOD: f32 = 1e-3;
/// Ticks before the first measured call: the motion filter of the learner, 62 ticks long, is full by then.
const WARM_UP: u32 = 78;
/// Torques of the arm over those of its description.
const HEAVIER: f32 = 1.1;
/// Bound of the noise on the measured torque, in units of the torque limit.
const NOISE: f32 = 0.01;

/// Number of links and of buses of a UR5 beside the arm: the learner of a larger arm leaves no room for them.
pub(crate) const LINKS: usize = if JOINTS <= 6 { 1 } else { 0 };

/// Network of the paper.
pub(crate) type Paper = BpNetwork<18, 32, 6>;

/// Parts that the stages take over from one another.
pub(crate) type Parts = (
    &'static mut Learner,
    [&'static mut Link; LINKS],
    [&'static mut Bus; LINKS],
    &'static mut Paper,
);

/// Everything a row reads or writes. A row takes what it needs; the rest costs it nothing.
///
/// In this order, small kernels first, so that an access is one instruction as it would be through an argument.
#[repr(C)]
pub(crate) struct Stage {
    pub(crate) angle: f32,
    pub(crate) sin_cos: SinCos,
    pub(crate) joint: usize,
    pub(crate) motion: JointMotion<JOINTS>,
    pub(crate) tau: JointVector<JOINTS>,
    pub(crate) input: SVector<f32, 18>,
    pub(crate) target: SVector<f32, 6>,
    pub(crate) output: SVector<f32, 6>,
    pub(crate) step: StepParameters,
    pub(crate) set: ParameterSet<JOINTS, PARAMETERS>,
    pub(crate) calibrated: BaseParameters<{ ur5_calibrated::PARAMETERS }>,
    pub(crate) calibrated_motion: JointMotion<{ ur5_calibrated::JOINTS }>,
    pub(crate) calibrated_tau: JointVector<{ ur5_calibrated::JOINTS }>,
    pub(crate) panda: BaseParameters<{ panda::PARAMETERS }>,
    pub(crate) panda_motion: JointMotion<{ panda::JOINTS }>,
    pub(crate) panda_tau: JointVector<{ panda::JOINTS }>,
    pub(crate) sample: JointSample<JOINTS>,
    pub(crate) feedforward: FeedForward<Arm, JOINTS, PARAMETERS>,
    pub(crate) learning_sample: LearningSample<JOINTS>,
    pub(crate) exchange: Exchange<JOINTS, PARAMETERS>,
    // Not in the stage but beside it: a stage is built on the stack, and these are most of the memory.
    pub(crate) learner: &'static mut Learner,
    pub(crate) link: [&'static mut Link; LINKS],
    pub(crate) bus: [&'static mut Bus; LINKS],
    pub(crate) paper: &'static mut Paper,
    random: Random,
}

impl Stage {
    /// The residual networks of all joints, their inputs included.
    #[inline(always)]
    fn block_network(&mut self) {
        let joints = self.set.network.iter().zip(self.motion.qd.iter());
        for (tau, (network, &qd)) in self.tau.iter_mut().zip(joints) {
            let [[output]] = network.forward(&network_inputs(qd)).data.0;
            *tau = output;
        }
    }

    /// A learner of zeros for the stages, one after the other: each restarts it.
    pub(crate) const LEARNER: Learner = {
        // SAFETY: zeros are a value of every field. The compiler checks the value of a constant.
        unsafe { core::mem::MaybeUninit::zeroed().assume_init() }
    };

    /// The stage before the warm-up; `None` if a configuration does not validate. Inlined and used in place, because the stack
    /// has no room for a second stage.
    #[inline(always)]
    pub(crate) fn new((learner, link, bus, paper): Parts) -> Option<Self> {
        *paper = Paper::random(1);
        let mut set = ParameterSet::nominal::<Arm>(1);
        for (friction, limits) in set.friction.iter_mut().zip(&Arm::LIMITS) {
            *friction = FrictionParameters::NONE
                .with(FrictionColumn::Viscous, 0.05 * limits.torque)
                .with(FrictionColumn::Coulomb, 0.05 * limits.torque)
                .with(FrictionColumn::Stribeck, 0.01 * limits.torque)
                .with(FrictionColumn::ShearThinning, 0.01 * limits.torque)
                .with(FrictionColumn::Load, 0.05)
                .with(FrictionColumn::Offset, 0.001 * limits.torque)
                .with(FrictionColumn::CoggingSine, 0.003 * limits.torque)
                .with(FrictionColumn::CoggingCosine, 0.001 * limits.torque);
        }
        learner
            .restart(LearnerConfig::for_arm::<Arm>(PERIOD), &set)
            .ok()?;
        Some(Self {
            random: Random(0x9E37_79B9),
            set,
            motion: JointMotion::zero(),
            angle: 0.0,
            joint: 0,
            sin_cos: SinCos { sin: 0.0, cos: 1.0 },
            tau: JointVector::zeros(),
            calibrated: BaseParameters::from(Ur5Calibrated::NOMINAL),
            calibrated_motion: JointMotion::zero(),
            calibrated_tau: JointVector::zeros(),
            panda: BaseParameters::from(Panda::NOMINAL),
            panda_motion: JointMotion::zero(),
            panda_tau: JointVector::zeros(),
            input: SVector::zeros(),
            target: SVector::zeros(),
            output: SVector::zeros(),
            step: StepParameters {
                learning_rate: 0.01,
                error_clip: 0.5,
            },
            feedforward: FeedForward::new(FeedForwardConfig::for_arm::<Arm, _>(PERIOD), set)
                .ok()?,
            sample: JointSample {
                desired: JointMotion::zero(),
                measured: None,
            },
            learner,
            link,
            bus,
            paper,
            learning_sample: LearningSample {
                tick: 0,
                generation: 0,
                requests: 0,
                measured: None,
                enabled: true,
                flags: Flags::NONE,
            },
            exchange: Exchange::new(),
        })
    }

    /// Switches learning on and fills the learner's window.
    pub(crate) fn warm_up(&mut self) {
        self.feedforward.set_learning(true);
        for _ in 0..WARM_UP {
            self.vary();
            // With learning off a learning step only fills the window of measurements.
            self.learning_sample.enabled = false;
            self.learner
                .learn(&self.learning_sample, &mut self.exchange);
        }
    }

    /// Next inputs: a random state of the arm for the kernels, the next tick of a smooth motion for what has a memory.
    pub(crate) fn vary(&mut self) {
        let random = &mut self.random;
        for (joint, limits) in Arm::LIMITS.iter().enumerate() {
            self.motion.q[joint] = random.within(TAU);
            self.motion.qd[joint] = random.within(limits.velocity);
            self.motion.qdd[joint] = random.within(10.0);
        }
        let (motion, copy) = (&self.motion, &mut self.calibrated_motion);
        for joint in 0..JOINTS.min(ur5_calibrated::JOINTS) {
            copy.q[joint] = motion.q[joint];
            copy.qd[joint] = motion.qd[joint];
            copy.qdd[joint] = motion.qdd[joint];
        }
        let random = &mut self.random;
        for (joint, limits) in Panda::LIMITS.iter().enumerate() {
            self.panda_motion.q[joint] = random.within(TAU);
            self.panda_motion.qd[joint] = random.within(limits.velocity);
            self.panda_motion.qdd[joint] = random.within(10.0);
        }
        self.angle = random.within(TAU);
        self.joint = (self.joint + 1) % JOINTS;
        self.input.apply(|x| *x = random.within(1.0));
        self.target.apply(|x| *x = random.within(1.0));

        let tick = self.learning_sample.tick.wrapping_add(1);
        let wave = wave(tick);
        let mut tau = HEAVIER * evaluate::<Arm, JOINTS, PARAMETERS>(&self.set, &wave).total;
        for (tau, limits) in tau.iter_mut().zip(&Arm::LIMITS) {
            *tau += limits.torque * random.within(NOISE);
        }
        let measured = Some(JointMeasurement { q: wave.q, tau });
        self.sample = JointSample {
            desired: wave,
            measured,
        };
        self.learning_sample = LearningSample {
            tick,
            generation: 0,
            requests: 0,
            measured,
            enabled: true,
            flags: Flags::NONE,
        };
    }
}

/// One sine a joint, each with a frequency of its own, none ever at rest for long.
fn wave(tick: u32) -> JointMotion<JOINTS> {
    let time = tick as f32 * PERIOD;
    let mut motion = JointMotion::zero();
    for joint in 0..JOINTS {
        let omega = 1.5 + 0.2 * joint as f32;
        let SinCos { sin, cos } = math::sin_cos(omega * time + joint as f32);
        motion.q[joint] = sin;
        motion.qd[joint] = omega * cos;
        motion.qdd[joint] = -omega * omega * sin;
    }
    motion
}

/// Xorshift with a 32-bit state [Marsaglia 2003].
struct Random(u32);

impl Random {
    /// A number within ±`bound`.
    fn within(&mut self, bound: f32) -> f32 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 17;
        self.0 ^= self.0 << 5;
        // The upper 24 bits are exact in f32.
        let unit = (self.0 >> 8) as f32 * (1.0 / 16_777_216.0);
        bound * (2.0 * unit - 1.0)
    }
}
