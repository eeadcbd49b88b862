//! The loop of an arm whose joints are drives on one or two CAN buses.
//!
//! ```text
//! period k    tick: replies of k−1 ─► sample ─► safety, feed-forward ─► commands of all joints, torque included
//!             afterwards: the learner takes its sample; replies to the commands of k arrive
//! ```
//! Sans-IO: the owner passes in frames as they arrive, calls [`BusController::tick`] once a period, and sends what it
//! passes out. The torque of a tick belongs to the desired motion of that tick and leaves at once; the measurement is that
//! of the commands one period before. `docs/bus.md` lists the latencies.
//!
//! A drive that is silent, reports a fault, resets, or reports another scale than its profile ends the torque: it ramps to
//! zero within 10 ms, the drives damp the arm for [`DAMPING_S`], then they are switched off.

mod board;
mod config;
mod controller;
mod drives;
mod fault;
mod joint;
mod line;

pub use board::{BoardDrives, Role, Wires, Wiring};
pub use config::{BusConfig, BusConfigError, BusJoint};
pub use controller::{BusController, BusTick};
pub use drives::{BusDrives, BusPhase};
pub use fault::{BusFault, FaultCause};
pub use joint::JointCounters;

/// Time without a reply of a drive after which the torque ends, s.
pub const SILENCE_S: f32 = 0.02;
/// Time in which stiffness and damping rise to those of the profile, s.
pub const SOFT_START_S: f32 = 0.5;
/// Time for which the drives damp the arm after the torque has ended, s.
pub const DAMPING_S: f32 = 1.0;
/// Time that the drives have to report that they are enabled, s.
pub const ENABLE_S: f32 = 0.5;
/// Distance between desired and measured position that ends the torque, rad.
pub const FOLLOWING_RAD: f32 = 0.3;
/// Change of the desired position during which a reply that repeats itself counts as stuck, rad.
pub const STUCK_RAD: f32 = 0.05;

#[cfg(test)]
mod tests;
