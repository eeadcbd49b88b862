//! The back-propagation (BP) network and its gradient. Knows nothing of robots.

use nalgebra::{SMatrix, SVector};

/// A network with one hidden layer: `I` inputs, `H` hidden units, `O` linear outputs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BpNetwork<const I: usize, const H: usize, const O: usize> {
    /// Weights of the hidden layer, one row a unit.
    pub hidden_weights: SMatrix<f32, H, I>,
    /// Thresholds of the hidden layer.
    pub hidden_bias: SVector<f32, H>,
    /// Weights of the output layer, one row an output.
    pub output_weights: SMatrix<f32, O, H>,
    /// Thresholds of the output layer.
    pub output_bias: SVector<f32, O>,
}
