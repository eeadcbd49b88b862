//! Everything that touches the world outside the tick: frames, parameter bank, telemetry, hardware adapters.

pub mod hal;
