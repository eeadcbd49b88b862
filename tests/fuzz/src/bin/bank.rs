//! Fuzzes `bank` with libFuzzer.
#![no_main]

libfuzzer_sys::fuzz_target!(init: fuzz::plant("bank"), |input: &[u8]| fuzz::bank(input));
