//! Everything that touches the world outside the tick: frames, parameter bank, telemetry, hardware adapters, and the drive of a joint.

pub mod bank;
pub mod drive;
pub mod hal;
pub mod safety;
pub mod session;
pub mod store;
pub mod telemetry;
pub mod wire;
pub mod write_key;
