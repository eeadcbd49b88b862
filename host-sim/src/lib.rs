//! Simulator and workbench of foretorque.
