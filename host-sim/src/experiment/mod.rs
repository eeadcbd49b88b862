//! The reproducible studies.

pub mod closed_loop;
pub mod demo;
pub mod prior;

/// Names of the studies, each with one line on what it shows.
pub const EXPERIMENTS: [(&str, &str); 1] = [(
    "demo",
    "from a wrong prior, learn on the board in closed loop, freeze, play an unseen path",
)];
