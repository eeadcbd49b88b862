/// The counter that costs are told in. A type and not a pointer to a function, so that what a tick calls can be read off
/// the linked firmware.
pub trait Clock {
    /// The free-running count: all 32 bits count, and it wraps.
    fn now(&self) -> u32;
}

/// A board without a counter: every cost is 0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct NoClock;

impl Clock for NoClock {
    fn now(&self) -> u32 {
        0
    }
}
