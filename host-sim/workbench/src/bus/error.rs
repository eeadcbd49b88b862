use foretorque_link::bus::{BusConfigError, BusFault};
use foretorque_link::safety::SafetyReason;
use std::io;

/// Reason for which an arm on a bus cannot be driven.
#[derive(Debug, thiserror::Error)]
pub enum BusError {
    /// The profile cannot be read.
    #[error("{file}: {problem}")]
    Profile {
        /// File.
        file: String,
        /// Reason, with the field.
        problem: String,
    },
    /// The profile contradicts itself or the arm.
    #[error("{file}: {error}")]
    Contradiction {
        /// File.
        file: String,
        /// The two values.
        error: BusConfigError,
    },
    /// The bus cannot be opened.
    #[error("bus {name}: {error}")]
    Open {
        /// Name of the bus.
        name: String,
        /// Reason.
        error: io::Error,
    },
    /// The bus has gone.
    #[error("bus {name} has gone, torque off: {error}")]
    Gone {
        /// Name of the bus.
        name: String,
        /// Reason.
        error: io::Error,
    },
    /// Nothing answers.
    #[error("bus {0} is silent, torque off: no drive of the profile answers")]
    Quiet(String),
    /// Commissioning has found a mistake.
    #[error("joint {}: {mistake}", joint + 1)]
    Mistake {
        /// Joint, from 0.
        joint: usize,
        /// The mistake, with the value of the profile and the one found.
        mistake: String,
    },
    /// A drive or the bus has a fault.
    #[error("torque off: {0}")]
    Fault(BusFault),
    /// The torque has ended for another reason.
    #[error("torque off: {0}")]
    Stopped(SafetyReason),
}
