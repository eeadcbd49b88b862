//! The kernels of the tick, called over seeded inputs: what `cargo xtask bench` counts and traces in the emulator.
//!
//! One line `name count` leaves over semihosting for every call of every row. The count is that of TIM2, which under
//! `-icount shift=0` advances by one for each executed instruction. The semihosting command line is the number of
//! calls of each row, then the number of ticks of the long run, of which one line `name least sum most` leaves.
//!
//! Rows of the UR5 are those of another arm where `FORETORQUE_ARM` names one to the build.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod bus;
#[cfg(target_os = "none")]
mod commands;
#[cfg(target_os = "none")]
mod run;
#[cfg(target_os = "none")]
mod stage;

foretorque_f405::on_the_host!();
