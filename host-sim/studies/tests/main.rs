//! Everything that can be broken. One test crate: the studies are linked once.

mod faults;
mod store;
