//! Board side of foretorque: frames, parameter bank, session, safety, store, excitation, telemetry, hardware adapters.
//!
//! | module | contents |
//! |---|---|
//! | [`wire`] | frames and messages of the link |
//! | [`bank`], [`store`] | parameter bank, and its storage in flash |
//! | [`safety`] | state machine of the torque enable, limits |
//! | [`excitation`] | Fourier series of eq. 17, checked and played by the board |
//! | [`session`], [`telemetry`] | one connection to a host: protocol, controller, counters |
//! | [`drives`] | codecs of CAN drives with a torque feed-forward, and their profiles |
//! | [`bus`] | loop of an arm whose joints are such drives |
//! | [`hal`], [`drive`] | adapters of motor stage and encoder; the drive of one joint |
//! | [`write_key`] | authentication of uploads |
//!
//! Nothing allocates, nothing blocks, and no input makes a session panic.
#![cfg_attr(not(test), no_std)]
#![forbid(unsafe_code)]

#[macro_use]
mod texts;

pub mod bank;
pub mod bus;
mod division;
pub mod drive;
pub mod drives;
pub mod excitation;
pub mod hal;
pub mod safety;
pub mod session;
pub mod store;
pub mod telemetry;
pub mod wire;
pub mod write_key;

/// Copies as many entries as both have; `copy_from_slice` can panic.
#[inline(always)]
fn copy<T: Copy>(to: &mut [T], from: &[T]) {
    to.iter_mut().zip(from).for_each(|(to, from)| *to = *from);
}
