//! Torque feed-forward for robot joints that learns on the microcontroller.
//!
//! Every tick the torque of the desired motion is computed as a sum of shares, each bounded and each visible:
//!
//! ```text
//! tau = rigid(beta) + friction(phi) + network(w)
//! ```
//!
//! The rest of the period is for learning: a recursive estimator updates the base parameters and the friction. Of the
//! networks, incremental back-propagation updates the hidden layer, and a Kalman filter the output layer. The method is that
//! of Y. Zhong, *Identification of Robot Dynamic Parameters Based on BP Neural Network*; "eq." on these pages counts its
//! equations.
//!
//! The crate is for control engineers with a serial arm of one to eight revolute joints, and drives that accept a torque
//! beside their own position loop. It needs the desired motion one period ahead, and the position and torque of every
//! joint in every period.
//!
//! # Example
//! ```
//! use foretorque::arm::ur5::{Exchange, FeedForward, Learner, LearnerConfig, ParameterSet, Ur5};
//! use foretorque::feedforward::FeedForwardConfig;
//! use foretorque::joint::{JointMeasurement, JointMotion, JointSample, JointVector};
//!
//! const PERIOD_S: f32 = 1e-3;
//! let set = ParameterSet::nominal::<Ur5>(1);
//! let mut feedforward = FeedForward::new(FeedForwardConfig::for_arm::<Ur5, _>(PERIOD_S), set)?;
//! let mut learner = Learner::new(LearnerConfig::for_arm::<Ur5>(PERIOD_S), set)?;
//! let mut exchange = Exchange::new();
//! feedforward.set_learning(true);
//!
//! for _tick in 0..1000 {
//!     // From the drives: position, rad, and torque on the link side, N·m.
//!     let (q, tau) = (JointVector::zeros(), JointVector::zeros());
//!     let measured = Some(JointMeasurement { q, tau });
//!     let desired = JointMotion::zero();
//!     feedforward.adopt(&mut exchange);
//!     let torque = feedforward.step(&JointSample { desired, measured });
//!     // `torque.total` goes to the drives now; learning uses the rest of the period.
//!     learner.learn(&feedforward.learning_sample(measured), &mut exchange);
//!     assert!(torque.total.iter().all(|tau| tau.is_finite()));
//! }
//! # Ok::<(), foretorque::learning::ConfigError>(())
//! ```
//! The folder `examples/` holds complete programs: `tick`, `payload` (learning on the host), `own_arm` and `rtic`. A board
//! has no room for a learner on its stack: there a static [`Learner::EMPTY`](learning::Learner::EMPTY) is restarted in place.
//!
//! # Modules
//! A module uses those above it. Two uses point down: [`arm`] has the vector of base parameters and the largest number of
//! joints from [`dynamics`], and the module of an arm has type aliases of [`learning`] and [`feedforward`].
//!
//! | module | content |
//! |---|---|
//! | [`math`], [`limits`] | f32 kernels: sine and cosine, tanh, exp; limits and flags of a torque |
//! | [`joint`], [`arm`] | joint vectors and samples; an arm as constants |
//! | [`dynamics`] | rigid-body torque (recursive Newton–Euler), regressor rows, friction |
//! | [`network`] | the back-propagation network and its gradient |
//! | [`learning`] | recursive estimation, supervision, payload, training of the networks |
//! | [`feedforward`] | the tick: shares, checks, limits, flags |
//!
//! Wire format, parameter banks, storage and the safety state machine are in the crate `foretorque-link`.
//!
//! # Guarantees
//! * `no_std`, no allocation, no `unsafe`; memory is of fixed size.
//! * A tick takes fixed time. No input makes it panic, and every torque is finite and within the arm's limits.
//! * The learnt part of a torque is bounded, visible on its own ([`FeedForward::learnt_torque`](feedforward::FeedForward::learnt_torque)), and removable in one call.
//! * Host and emulated Cortex-M4F compute the same bits. Nothing ran on silicon.
//!
//! # Features
//! * `defmt`: errors, flags and requests implement `defmt::Format`. Off by default.
//!
//! # Conventions
//! | quantity | convention |
//! |---|---|
//! | units | SI without a suffix inside; unit suffixes at every interface |
//! | frames | Craig 2005: z of frame i along joint axis i, a constant placement in frame i−1, then Rz(q_i) |
//! | parameters | m, m·x, m·y, m·z, Ixx, Iyy, Izz, Ixy, Ixz, Iyz about the link frame's origin, tensor entries (eq. 14) |
//! | base set | first independent columns from left to right, rotor inertias after the links |
//! | sign | torque is positive when it accelerates +q: the torque that the drive must supply, link side |
//! | gravity | along −z of the base unless the arm's constants give another direction |
#![cfg_attr(not(test), no_std)]
#![forbid(unsafe_code)]

// A generated arm names this crate as one of a user does.
extern crate self as foretorque;

pub mod arm;
pub mod dynamics;
pub mod feedforward;
pub mod joint;
pub mod learning;
pub mod limits;
pub mod math;
pub mod network;

/// The README's code compiles and runs.
#[cfg(doctest)]
#[doc = include_str!("../../../README.md")]
struct Readme;

/// Seeded numbers of tests, uniform in ±1.
#[cfg(test)]
pub(crate) struct Random(pub(crate) u64);

#[cfg(test)]
impl Random {
    pub(crate) fn uniform(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }

    /// Sum of twelve: variance 1 is four times a third.
    pub(crate) fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() * 0.5
    }
}

/// Motion of tests at the time `t`, s: a sine of `[amplitude, angular frequency, phase]` a joint, rad, rad/s, rad.
#[cfg(test)]
pub(crate) fn sines<const N: usize>(
    t: f64,
    wave: impl Fn(usize) -> [f64; 3],
) -> joint::JointMotion<N> {
    let mut motion = joint::JointMotion::zero();
    for j in 0..N {
        let [amplitude, omega, phase] = wave(j);
        let (sin, cos) = (omega * t + phase).sin_cos();
        motion.q[j] = (amplitude * sin) as f32;
        motion.qd[j] = (amplitude * omega * cos) as f32;
        motion.qdd[j] = (-amplitude * omega * omega * sin) as f32;
    }
    motion
}
