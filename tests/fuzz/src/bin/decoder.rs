//! Fuzzes `decoder` with libFuzzer.
#![no_main]

libfuzzer_sys::fuzz_target!(init: fuzz::plant("decoder"), |input: &[u8]| fuzz::decoder(input));
