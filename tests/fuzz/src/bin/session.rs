//! Fuzzes `session` with libFuzzer.
#![no_main]

libfuzzer_sys::fuzz_target!(init: fuzz::plant("session"), |input: &[u8]| fuzz::session(input));
