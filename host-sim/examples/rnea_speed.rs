//! Time of the firmware's RNEA on this machine: `cargo run --release -p host-sim --example rnea_speed`.
//!
//! Nanoseconds a call over 1000 random states of the UR5, the best of 200 rounds, f32, one thread.

use foretorque::arm::Arm;
use foretorque::arm::ur5::{JOINTS, PARAMETERS, Ur5};
use foretorque::dynamics::{BaseParameters, regressor, rnea};
use foretorque::joint::{JointMotion, JointVector};
use rand::{Rng, SeedableRng};
use std::hint::black_box;
use std::time::Instant;

const STATES: usize = 1000;
const ROUNDS: usize = 200;

fn main() {
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(1);
    let mut within =
        |bound: f32| JointVector::<JOINTS>::from_fn(|_, _| random.random_range(-bound..bound));
    let states: Vec<_> = (0..STATES)
        .map(|_| JointMotion {
            q: within(6.0),
            qd: within(3.0),
            qdd: within(10.0),
        })
        .collect();
    let beta = BaseParameters::from(Ur5::NOMINAL);
    let best = |call: &dyn Fn(&JointMotion<JOINTS>)| {
        let round = || {
            let start = Instant::now();
            states.iter().for_each(call);
            start.elapsed().as_secs_f64() * 1e9 / STATES as f64
        };
        (0..ROUNDS).map(|_| round()).fold(f64::INFINITY, f64::min)
    };
    let torque = best(&|motion| {
        black_box(rnea::<Ur5, JOINTS, PARAMETERS>(
            black_box(&beta),
            black_box(motion),
        ));
    });
    let rows = best(&|motion| {
        black_box(&regressor::<Ur5, JOINTS, PARAMETERS>(black_box(motion)));
    });
    println!("rnea_ur5 {torque:.0} ns, regressor_ur5 {rows:.0} ns");
}
