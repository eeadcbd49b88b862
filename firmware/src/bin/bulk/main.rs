//! The tick of the flashable firmware around two pipes of the emulator: the same code, many more ticks a second.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod semihost;

#[cfg(target_os = "none")]
mod run {
    use panic_never as _;
    use stm32f4xx_hal as _;

    use crate::semihost::{Streams, exit};

    #[cortex_m_rt::entry]
    fn main() -> ! {
        let Some(streams) = Streams::open() else { exit(false) };
        let mut well = streams.write(b"hello\0");
        let mut buffer = [0u8; 512];
        while well && let Some(bytes) = streams.read(&mut buffer) {
            well = streams.write(bytes);
        }
        exit(well)
    }
}

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("bulk is firmware: build it with --target thumbv7em-none-eabihf --profile firmware");
    std::process::exit(2);
}
