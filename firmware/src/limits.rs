//! Saturation, slew and flags of the torque that leaves the tick.
