//! Fuzzes the target that the program is named after with libFuzzer.
#![no_main]

const NAME: &str = env!("CARGO_BIN_NAME");

libfuzzer_sys::fuzz_target!(init: fuzz::plant(NAME), |input: &[u8]| fuzz::target(NAME).unwrap()(input));
