//! The reproducible studies.

pub mod campaign;
pub mod closed_loop;
pub mod demo;
pub mod excitation;
pub mod learning;
pub mod paper;
pub mod prior;
pub mod real_ur5;
pub mod replay_real;

/// Names of the studies, each with one line on what it shows.
pub const EXPERIMENTS: [(&str, &str); 7] = [
    (
        "demo",
        "from a wrong prior, learn on the board in closed loop, freeze, play an unseen path",
    ),
    (
        "excitation",
        "one optimised excitation for every seed, every limit recounted; shardable",
    ),
    (
        "learning",
        "learned against frozen, in closed loop, over everything that may go wrong",
    ),
    (
        "paper",
        "the paper's experiment step by step, then every method over noise, friction and outliers; shardable",
    ),
    (
        "real-ur5",
        "identify a real UR5 on some paths, validate on the others, every path held out in turn",
    ),
    (
        "replay-real",
        "the board learns a real UR5 from its logs, row by row, against batch least squares",
    ),
    (
        "soak",
        "ten million ticks of learning: finite, positive, where exact arithmetic is, the same bits on the board",
    ),
];
