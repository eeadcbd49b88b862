//! The fault campaign: everything that can be broken is broken, and what the board makes of it is counted.
//!
//! A torque is *wrong* when it differs in one bit from that of a reference board that was fed only with the frames that the
//! board under test accepted. A set is *lost* when, after the fault, neither the newest set that was stored nor the one under
//! way can be loaded.

pub mod store;

use serde::Serialize;

/// What one kind of fault came to.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Campaign {
    /// What was broken, and where.
    pub name: String,
    /// Faults.
    pub injected: u64,
    /// Torques that were not those of the reference.
    pub wrong_torques: u64,
    /// Faults after which the last good set could not be loaded.
    pub lost_sets: u64,
    /// Faults after which the board did its work again.
    pub recovered: u64,
}

impl Campaign {
    /// Nothing broken yet.
    pub fn new(name: &str) -> Self {
        Self {
            name: name.into(),
            ..Self::default()
        }
    }

    /// Something was broken, no wrong torque left the board, no set was lost, and the board came back every time.
    pub fn is_survived(&self) -> bool {
        let Self {
            injected,
            wrong_torques,
            lost_sets,
            recovered,
            ..
        } = self;
        *injected > 0 && *wrong_torques == 0 && *lost_sets == 0 && recovered == injected
    }
}
