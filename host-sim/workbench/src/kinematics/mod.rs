//! Forward kinematics, Jacobian and inverse kinematics of the tool.
//!
//! The tool flange is the tip of the description: the frame `flange` of a TOML file where it gives one, else the far end
//! of the last link (its DH frame); of a URDF the tip link. All poses are expressed in the base frame. Twists are six
//! numbers: velocity of the flange's origin, m/s, then angular velocity, rad/s, both along the axes of the base.
//!
//! `chain` (any arm: forward, Jacobian) → `ur` (closed form) or damped least squares → [`Inverse`].

mod chain;
mod error;
mod inverse;
mod ur;

pub use chain::{Chain, Twist, rotation_vector};
pub use error::InverseError;
pub use inverse::Inverse;
