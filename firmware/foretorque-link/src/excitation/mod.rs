//! Excitation played by the board, as a commissioning step: the finite Fourier series of eq. 17 in f32. The board checks an
//! upload against its certificate and aborts it at limits of its own.
//!
//! ```text
//! q(t)   = q0 + Σ_l a_l / (ω l) sin(ω l t) − b_l / (ω l) cos(ω l t)          ω = 2 π / period, l = 1 … 5
//! qd(t)  =      Σ_l a_l cos(ω l t) + b_l sin(ω l t)
//! qdd(t) =      Σ_l ω l (b_l cos(ω l t) − a_l sin(ω l t))
//! ```
//! The position line is eq. 17 as printed; velocity and acceleration are its derivatives, which the printed ones are not.
//!
//! ```text
//!            load            start, check passed      at q(0)          stop, end, or a limit
//!   Empty ────────► Loaded ─────────────────► Approaching ──► Playing ────────────────► Holding / Aborted
//!                     │ check failed                              (path speed ramped to zero)     │ start: from the beginning
//!                     └────────► Refused                                                          └ release: Loaded
//! ```
//! A host runs this code through a board in its own process, so both give the same bits.

mod check;
mod path;
mod path_speed;
mod player;
mod program;
mod series;
mod state;
mod supervision;

pub use player::Player;
pub use program::{AbortReason, ExcitationError, ExcitationProgram, MotionBounds, PlayLimits};
pub use series::{HARMONICS, JointSeries, PreparedSeries};
pub use state::{ExcitationCommand, ExcitationState};
