//! bulk
#![cfg_attr(target_os = "none", no_std, no_main)]
#[cfg(target_os = "none")]
use {panic_never as _, stm32f4xx_hal as _};
#[cfg(target_os = "none")]
#[cortex_m_rt::entry]
fn main() -> ! {
    loop {}
}

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("bulk is firmware: build it with --target thumbv7em-none-eabihf --profile firmware");
    std::process::exit(2);
}
