//! The back-propagation (BP) network and its gradient. Knows nothing of robots.

mod activation;
mod bp;
mod descent;
mod gradient;

pub use activation::{Activation, Relu, Sigmoid, Tanh};
pub use bp::BpNetwork;
pub use gradient::StepParameters;
