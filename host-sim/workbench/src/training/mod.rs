//! Training of BP networks on the host, in f64: the board's own f32 networks are what comes out.

mod black_box;
mod network;
mod physical;
mod residual;

pub use black_box::BlackBox;
pub use network::TrainingNetwork;
pub use physical::{Descent, LinearLayer, PhysicalConfig, Trained};
pub use residual::{ResidualConfig, SpeedPoint, train_residual};
