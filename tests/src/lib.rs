//! What must hold across the crates of foretorque.
