//! Every committed input of the fuzzer, the seeds, and inputs near them: the promises hold, the same way in every run.

use flate2::read::GzDecoder;
use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use std::io::Read as _;

/// Committed inputs, each with the name of its target.
fn committed() -> Vec<(String, Vec<u8>)> {
    let packed = GzDecoder::new(&include_bytes!("../corpus.tar.gz")[..]);
    let mut archive = tar::Archive::new(packed);
    let entries = archive.entries().expect("the archive is whole");
    let files = entries.filter_map(|entry| {
        let mut entry = entry.expect("the archive is whole");
        let path = entry.path().expect("names are text").into_owned();
        let target = path.iter().nth(1)?.to_str()?.to_owned();
        let mut input = Vec::new();
        entry.read_to_end(&mut input).expect("the archive is whole");
        entry
            .header()
            .entry_type()
            .is_file()
            .then_some((target, input))
    });
    files.collect()
}

/// Numbers that a check may forget.
const NUMBERS: [f32; 6] = [f32::NAN, f32::INFINITY, f32::MAX, -1.0, 0.0, 1e-40];

/// Up to eight changes of `input`: a byte, a bit, a number, a piece left out, or a piece repeated.
fn mutate(input: &mut Vec<u8>, random: &mut ChaCha8Rng) {
    for _ in 0..random.random_range(1..=8) {
        if input.is_empty() {
            input.push(0);
        }
        let place = random.random_range(0..input.len());
        let end = input.len().min(place + random.random_range(1..=16));
        match random.random_range(0..5) {
            0 => input[place] = random.random(),
            1 => input[place] ^= 1 << random.random_range(0..8),
            2 => drop(input.drain(place..end)),
            3 => {
                let number = NUMBERS[random.random_range(0..NUMBERS.len())].to_le_bytes();
                let room = input[place..].iter_mut();
                room.zip(number).for_each(|(byte, new)| *byte = new);
            }
            _ => input.extend_from_within(place..end),
        }
    }
}

/// Passes every input and `executions` changed ones to a target, which panics where a promise is broken.
fn run(name: &str, executions: usize) {
    let target = fuzz::target(name).expect("a target of this name");
    let mut inputs = fuzz::seeds(name);
    let committed = committed().into_iter().filter(|(target, _)| target == name);
    inputs.extend(committed.map(|(_, input)| input));
    inputs.iter().for_each(|input| target(input));
    let mut random = ChaCha8Rng::seed_from_u64(1);
    for input in inputs.iter().cycle().take(executions) {
        let mut changed = input.clone();
        mutate(&mut changed, &mut random);
        let broken = std::panic::catch_unwind(|| target(&changed)).is_err();
        assert!(!broken, "{name} breaks a promise after {changed:02x?}");
    }
}

#[test]
fn every_committed_input_has_a_target() {
    let committed = committed();
    assert!(committed.len() > 400, "the committed archive has 468");
    for (target, _) in committed {
        assert!(fuzz::target(&target).is_some(), "{target}");
    }
}

#[test]
fn the_decoder_stays_in_step_whatever_bytes_come() {
    run("decoder", 450_000);
}

#[test]
fn a_bank_that_is_read_is_usable_and_is_written_the_same() {
    run("bank", 400_000);
}

#[test]
fn a_session_keeps_its_promises_whatever_frames_and_periods_come() {
    run("session", 20_000);
}

#[test]
fn a_store_loads_whole_parameters_or_none() {
    run("store", 30_000);
}

#[test]
fn drives_refuse_what_is_no_reply() {
    run("drives", 100_000);
}
