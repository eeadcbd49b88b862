//! Replays a target's seeds, its inputs and mutations of them, without coverage and without libFuzzer.
//!
//! For machines without a C++ compiler, and to reproduce a finding: `plain TARGET RUNS [--seed N] [FILE or DIR …]`.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::{env, fs, io};

fn main() -> ExitCode {
    let words: Vec<String> = env::args().skip(1).collect();
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    let done = match words.as_slice() {
        [target, runs, "--seed", seed, inputs @ ..] => run(target, runs, seed, inputs),
        [target, runs, inputs @ ..] => run(target, runs, "0", inputs),
        _ => Err(io::Error::other(
            "usage: plain TARGET RUNS [--seed N] [FILE or DIR ...]",
        )),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

/// Every input as it is, then `runs` mutations of them, the same ones for a seed every time.
fn run(target: &str, runs: &str, seed: &str, inputs: &[&str]) -> io::Result<()> {
    let check = fuzz::target(target)
        .ok_or_else(|| io::Error::other(format!("there is no target `{target}`")))?;
    let number = |text: &str| {
        let parsed = text.parse::<u64>();
        parsed.map_err(|_| io::Error::other(format!("`{text}` is no number")))
    };
    let (runs, seed) = (number(runs)?, number(seed)?);
    let mut corpus = fuzz::seeds(target);
    for input in inputs {
        for file in files(Path::new(input))? {
            corpus.push(fs::read(file)?);
        }
    }
    corpus.iter().for_each(|input| check(input));
    // Odd times odd: no seed gives a state of zero.
    let mut random = Random(
        seed.wrapping_mul(2)
            .wrapping_add(1)
            .wrapping_mul(0x9E37_79B9_7F4A_7C15),
    );
    for _ in 0..runs {
        let mut input = corpus[random.below(corpus.len())].clone();
        for _ in 0..=random.below(4) {
            let other = &corpus[random.below(corpus.len())];
            mutate(&mut input, other, &mut random);
        }
        check(&input);
    }
    println!(
        "{target}: {} inputs and {runs} mutations of them",
        corpus.len()
    );
    Ok(())
}

fn files(path: &Path) -> io::Result<Vec<PathBuf>> {
    if path.is_file() {
        return Ok(vec![path.into()]);
    }
    let mut files: Vec<PathBuf> = fs::read_dir(path)?
        .map(|file| Ok(file?.path()))
        .collect::<io::Result<_>>()?;
    files.sort();
    Ok(files)
}

/// Changes a bit, a byte, the end, the order, or a piece.
fn mutate(input: &mut Vec<u8>, other: &[u8], random: &mut Random) {
    let place = random.below(input.len() + 1);
    match (random.below(8), input.get_mut(place)) {
        (0, Some(byte)) => *byte ^= 1 << random.below(8),
        (1, Some(byte)) => *byte = random.below(256) as u8,
        (2, _) => input.truncate(place),
        (3, Some(_)) => input.rotate_left(place),
        (4, _) => input.insert(place, random.below(256) as u8),
        // Pieces of another input in place of one of this, or before it.
        (kind, _) => {
            let (own, others) = (fuzz::pieces(input), fuzz::pieces(other));
            let first = random.below(own.len());
            let last = (first + usize::from(kind > 5)).min(own.len() - 1);
            let from = random.below(others.len());
            let to = from + random.below((others.len() - from).min(8));
            input.splice(
                own[first]..own[last],
                other[others[from]..others[to]].iter().copied(),
            );
        }
    }
}

/// Xorshift64*: the mutations need no better chance than that.
struct Random(u64);

impl Random {
    fn below(&mut self, bound: usize) -> usize {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 33) as usize % bound.max(1)
    }
}
