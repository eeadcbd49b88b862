//! Goals of the measured quantities, and the best published figures of others.
//!
//! The figures of others were measured as ours are: instructions executed in the emulator, cycles estimated at zero wait
//! states. gcc fuses multiplications with additions; our code never does.

/// One quantity of the budget beside others.
struct Anchor {
    /// Name in the budget.
    quantity: &'static str,
    /// Goal of this project.
    reach: Option<u32>,
    /// The best peer.
    peer: Option<Peer>,
}

/// A figure of others.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Peer {
    pub(crate) value: u32,
    pub(crate) who: &'static str,
}

const NEWLIB: &str = "newlib sinf + cosf";
const PINOCCHIO: &str = "Pinocchio + CasADi, 60 run-time parameters, gcc -Ofast";
const ROWS: &str = "Pinocchio + CasADi, all rows of 60 columns";
const BEST: &str = "the best known";
const CMSIS: &str = "CMSIS-DSP mat_vec_mult";
const PLAIN_C: &str = "plain C, -O3 -ffast-math -funroll-loops";

const ANCHORS: &[Anchor] = &[
    against("sin_cos, instructions", 40, 152, NEWLIB),
    against("sin_cos, est. cycles", 0, 272, NEWLIB),
    against("rnea_ur5, instructions", 1000, 1790, PINOCCHIO),
    against("rnea_ur5, est. cycles", 1700, 2908, PINOCCHIO),
    against("rnea_calibrated, instructions", 1700, 1890, BEST),
    against("regressor_row_ur5, instructions", 500, 2834, ROWS),
    against("regressor_ur5, instructions", 1800, 2834, ROWS),
    against("regressor_ur5, est. cycles", 0, 4216, ROWS),
    against("bp_18_32_6_forward, instructions", 2600, 3049, CMSIS),
    against("bp_18_32_6_forward, est. cycles", 4766, 4766, PLAIN_C),
    against("bp_18_32_6_update, instructions", 6500, 7926, PLAIN_C),
    against("bp_18_32_6_update, est. cycles", 11635, 11635, PLAIN_C),
    alone("feedforward_step, est. cycles", 12_000),
    alone("learning_step, est. cycles", 60_000),
    // Three quarters of 1 ms at 168 MHz, and all of it.
    alone("tick and learning step of 7 joints, est. cycles", 126_000),
    alone("tick and learning step of 8 joints, est. cycles", 168_000),
    alone("flash, bytes", 128 << 10),
    alone("flash of joint-drive, bytes", 128 << 10),
    alone("static RAM, bytes", 64 << 10),
    alone("stack of the tick, bytes", 8 << 10),
];

/// A goal, none if 0, and a peer.
const fn against(quantity: &'static str, reach: u32, value: u32, who: &'static str) -> Anchor {
    Anchor {
        quantity,
        reach: if reach == 0 { None } else { Some(reach) },
        peer: Some(Peer { value, who }),
    }
}

const fn alone(quantity: &'static str, reach: u32) -> Anchor {
    Anchor {
        quantity,
        reach: Some(reach),
        peer: None,
    }
}

/// Goal of `quantity`, if one was set.
pub(crate) fn reach(quantity: &str) -> Option<u32> {
    find(quantity)?.reach
}

/// The best peer of `quantity`, if one is known.
pub(crate) fn peer(quantity: &str) -> Option<Peer> {
    find(quantity)?.peer
}

fn find(quantity: &str) -> Option<&'static Anchor> {
    ANCHORS.iter().find(|anchor| anchor.quantity == quantity)
}
