//! Fuzzes `drives` with libFuzzer.
#![no_main]

libfuzzer_sys::fuzz_target!(init: fuzz::plant("drives"), |input: &[u8]| fuzz::drives(input));
