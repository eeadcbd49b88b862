//! Fuzzes `store` with libFuzzer.
#![no_main]

libfuzzer_sys::fuzz_target!(init: fuzz::plant("store"), |input: &[u8]| fuzz::store(input));
