//! The flashable firmware of a joint controller: one STM32F405, one serial link, one tick.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
foretorque_f405::image!(foretorque_f405::odrive_v3::OdriveV3);

foretorque_f405::on_the_host!();
