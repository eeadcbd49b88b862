//! Set-up, demo and test of foretorque in one command each.

fn main() {}
