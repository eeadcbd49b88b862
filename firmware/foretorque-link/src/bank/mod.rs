//! Parameter bank: one versioned, checksummed format for file, wire and store.
//!
//! `"FTPB"`, format version, postcard of [`ParameterBank`], CRC-32. A bank lists its columns by identity. Friction columns
//! that it lacks are zero.

mod column;
mod error;
mod format;
mod parameters;
mod typed;

pub use column::{ColumnId, ColumnKind, NoColumnKind, columns};
pub use error::BankError;
pub use parameters::Parameters;
pub(crate) use parameters::config as feed_forward_config;
pub use typed::NETWORK_SEED;
pub(crate) use typed::name;

use crate::wire::Name;
use foretorque::arm::most_parameters;
use foretorque::dynamics::FRICTION_COLUMNS;
use heapless::Vec;
use serde::{Deserialize, Serialize};

pub use foretorque::dynamics::MAX_JOINTS;
/// Most linear columns: base parameters and friction of eight joints. A larger number does not change the format.
pub const MAX_COLUMNS: usize = most_parameters(MAX_JOINTS) + MAX_JOINTS * FRICTION_COLUMNS;
/// Most network weights.
pub const MAX_WEIGHTS: usize = 256;

/// One linear parameter.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Column {
    /// Quantity and joint.
    pub id: ColumnId,
    /// Value, in the unit of its kind.
    pub value: f32,
    /// Standard deviation, in the same unit.
    pub deviation: f32,
}

/// Activation of the hidden layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ActivationKind {
    /// Rectifier, eq. 19.
    Relu,
    /// Sigmoid, eq. 18.
    Sigmoid,
    /// Hyperbolic tangent.
    Tanh,
}

/// Shape of the network of one joint.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct NetworkShape {
    /// Activation of the hidden layer.
    pub activation: ActivationKind,
    /// Inputs.
    pub inputs: u8,
    /// Hidden units.
    pub hidden: u8,
    /// Outputs.
    pub outputs: u8,
    /// Number of such networks, side by side.
    pub blocks: u8,
}

impl NetworkShape {
    /// No network.
    pub(crate) const NONE: Self = Self {
        activation: ActivationKind::Relu,
        inputs: 0,
        hidden: 0,
        outputs: 0,
        blocks: 0,
    };
}

/// Limits of one joint, inside those of the arm.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct JointBounds {
    /// Largest torque, N·m.
    pub torque_nm: f32,
    /// Largest rate of the torque, N·m/s.
    pub slew_nm_s: f32,
    /// Largest share of the network, as a part of the arm's torque limit.
    pub network_share: f32,
}

/// All parameters of one arm.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ParameterBank {
    /// Identity of the arm.
    #[serde(with = "postcard::fixint::le")]
    pub arm_hash: u32,
    /// Name of the arm.
    pub arm: Name,
    /// Linear parameters: rigid body, then friction.
    pub columns: Vec<Column, MAX_COLUMNS>,
    /// Drive gain of every joint, N·m/A; 0 is unknown.
    pub drive_gains_nm_a: Vec<f32, MAX_JOINTS>,
    /// Shape of the networks.
    pub network: NetworkShape,
    /// Weights, network by network: hidden weights (all that leave one input together), hidden thresholds, output
    /// weights (all that leave one hidden unit together), output thresholds.
    pub weights: Vec<f32, MAX_WEIGHTS>,
    /// Limits of every joint.
    pub limits: Vec<JointBounds, MAX_JOINTS>,
}

impl ParameterBank {
    /// The column with this identity.
    pub fn column(&self, id: ColumnId) -> Option<&Column> {
        self.columns.iter().find(|column| column.id == id)
    }
}

#[cfg(test)]
mod tests;
