//! Training of BP networks on the host, in f64; the results are the board's own f32 networks.

mod network;
mod physical;
mod residual;

pub use network::{BlackBox, TrainingNetwork};
pub use physical::{Descent, LinearLayer, PhysicalConfig, Trained};
pub use residual::{SpeedPoint, train_residual};
