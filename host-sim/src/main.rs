//! Command line of foretorque.

fn main() {}
