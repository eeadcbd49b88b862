//! The flashable firmware on a board that drives its joint: motor stage, fault input and encoder are its own, the rest is
//! that of `joint`.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
foretorque_f405::image!(foretorque_f405::pyboard_drive::PyboardDrive);

foretorque_f405::on_the_host!();
