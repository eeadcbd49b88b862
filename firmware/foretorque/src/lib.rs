//! Torque feed-forward for robot joints that learns on the microcontroller.
//!
//! Every tick the torque of the desired motion is computed as a sum of shares, each bounded and each visible:
//!
//! ```text
//! tau = rigid(beta) + friction(phi) + network(w)
//! ```
//!
//! and in the slack of the tick the three parameter sets follow what the arm shows. The method is that of Y. Zhong,
//! *Identification of Robot Dynamic Parameters Based on BP Neural Network*; "eq." in these pages counts its equations.
//!
//! # Storeys, from the ground up
//! | room | what it knows |
//! |---|---|
//! | [`math`] | f32 kernels: sine and cosine, tanh, exp |
//! | [`joint`], [`arm`] | what is known of the joints; an arm as constants |
//! | [`dynamics`] | rigid-body torque, regressor rows, friction: nothing of learning |
//! | [`network`] | the back-propagation network and its gradient: nothing of robots |
//! | [`learning`] | incremental updates of the parameters, published whole |
//! | [`feedforward`], [`limits`] | the tick: shares, checks, limits, flags |
//!
//! Doors open downwards only. What touches the world outside the tick is in the crate `foretorque-link`. Nothing allocates, nothing blocks, and no input makes the tick panic or answer a torque
//! that is not finite.
//!
//! # Conventions
//! | what | convention |
//! |---|---|
//! | units | SI without a suffix inside; unit suffixes at every edge |
//! | frames | Craig 2005: z of frame i along joint axis i, a constant placement in frame i−1, then Rz(q_i) |
//! | parameters | m, m·x, m·y, m·z, Ixx, Iyy, Izz, Ixy, Ixz, Iyz about the link frame's origin, tensor entries (eq. 14) |
//! | base set | first independent columns from left to right, rotor inertias after the links |
//! | sign | torque is positive when it accelerates +q: what the drive must supply, link side |
//! | gravity | along −z of the base unless the arm says otherwise |
//!
//! The worked example is [`feedforward::FeedForward`].
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
