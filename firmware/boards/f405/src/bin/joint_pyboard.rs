//! The flashable firmware on a pyboard v1.1: everything but the board's own file is that of `joint`.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
foretorque_f405::image!(foretorque_f405::pyboard::Pyboard);

foretorque_f405::on_the_host!();
