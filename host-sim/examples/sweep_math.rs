//! Checks `sin_cos` against f64 at every f32 with |x| ≤ 2π (2.2e9 values), on all cores:
//! `cargo run --release -p host-sim --example sweep_math`.
//!
//! Too long for each test run, which takes every 331st value.

use foretorque::math::sin_cos;

/// The bound that `sin_cos` states for this range.
const BOUND: f64 = 1.2e-7;

fn main() -> Result<(), String> {
    let workers = std::thread::available_parallelism().map_or(1, usize::from);
    let last = std::f32::consts::TAU.to_bits();
    let worst = std::thread::scope(|scope| {
        let handles: Vec<_> = (0..workers)
            .map(|worker| scope.spawn(move || worst_of((worker as u32..=last).step_by(workers))))
            .collect();
        handles
            .into_iter()
            .filter_map(|handle| handle.join().ok())
            .fold((0.0, 0.0), |a: (f64, f32), b| if b.0 > a.0 { b } else { a })
    });
    let (error, x) = worst;
    println!(
        "{} values, largest error {error:.4e} at x = {x:?}",
        2 * (u64::from(last) + 1)
    );
    if error <= BOUND {
        Ok(())
    } else {
        Err(format!("the bound is {BOUND:e}"))
    }
}

/// Largest absolute error of sine or cosine over the bit patterns and their negatives, and where.
fn worst_of(patterns: impl Iterator<Item = u32>) -> (f64, f32) {
    let mut worst = (0.0, 0.0);
    for bits in patterns {
        for x in [f32::from_bits(bits), -f32::from_bits(bits)] {
            let pair = sin_cos(x);
            let (sin, cos) = f64::from(x).sin_cos();
            let error = (f64::from(pair.sin) - sin)
                .abs()
                .max((f64::from(pair.cos) - cos).abs());
            if error > worst.0 {
                worst = (error, x);
            }
        }
    }
    worst
}
