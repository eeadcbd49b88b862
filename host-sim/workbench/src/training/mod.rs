//! Training of BP networks on the host, in f64; the results are the board's own f32 networks.

mod black_box;
mod network;
mod physical;
mod residual;

pub use black_box::BlackBox;
pub use network::TrainingNetwork;
pub use physical::{Descent, LinearLayer, PhysicalConfig, Trained};
pub use residual::{ResidualConfig, SpeedPoint, train_residual};
