use super::controller::Controller;
use super::scenario::SCENARIOS;
use super::world::{N, P, PERIOD_S, World};
use crate::experiment::closed_loop::{Answer, ClosedLoop};
use foretorque::arm::ur5::Ur5;
use foretorque::feedforward::evaluate;
use foretorque::joint::JointVector;
use foretorque::learning::{Conditioned, DELAY, MeasurementWindow, Stacked, torque_row};
use std::convert::Infallible;
use std::io::Write;

fn put(file: &mut impl Write, values: impl Iterator<Item = f32>) {
    for value in values {
        file.write_all(&value.to_le_bytes()).unwrap();
    }
}

#[test]
fn dump() {
    let seconds: f64 = std::env::var("LAB_S").map_or(12.0, |s| s.parse().unwrap());
    let hz: f64 = std::env::var("LAB_HZ").map_or(6.0, |s| s.parse().unwrap());
    for seed in 1..=6u64 {
        let world = World::new(seed).unwrap();
        let scenario = SCENARIOS.iter().find(|s| s.name == "convergence").unwrap();
        let path = scenario.trajectory(&world, false);
        let mut plant = world.plant(scenario.plant, 1.0, scenario.noise_stream()).unwrap();
        let pd = world.pd(hz);
        let dir = format!("/tmp/lab/{seed}");
        std::fs::create_dir_all(&dir).unwrap();
        let create = |name: &str| std::io::BufWriter::new(std::fs::File::create(format!("{dir}/{name}")).unwrap());
        let config = Controller::config();
        put(&mut create("sigma"), Stacked::sigma(&config).iter().copied());
        put(&mut create("start"), Stacked::of(&world.wrong).iter().copied());
        let truth = crate::experiment::prior::bank_of::<Ur5, N, P>(&world.truth).set::<Ur5, N, P>().unwrap();
        put(&mut create("truth"), Stacked::of(&truth).iter().copied());
        put(&mut create("standard"), world.described.standard_parameters().iter().map(|x| *x as f32));
        {
            // unseen
            let mut file = create("unseen");
            let needed = world.needed(&plant);
            for ((state, motion), needed) in world.unseen_path().iter().zip(&needed) {
                let seen = Conditioned { motion: *motion, tau: JointVector::zeros() };
                for j in 0..N {
                    let row = torque_row::<Ur5, N, P>(j, &seen);
                    put(&mut file, [needed[j] as f32, state.qd[j] as f32].into_iter().chain(row.iter().copied()));
                }
            }
        }
        let mut run = ClosedLoop::new(&mut plant, &pd, &path, PERIOD_S, None).unwrap();
        let mut window = MeasurementWindow::<N>::new();
        let mut torques: Vec<JointVector<N>> = Vec::new();
        let mut file = create("rows");
        for tick in 0..(seconds / PERIOD_S) as usize {
            let Ok(record) = run.tick_with::<Infallible>(&mut plant, |sample| {
                let measured = sample.unwrap().measured.unwrap();
                window.push(Some(&measured));
                torques.push(measured.tau);
                Ok(sample.map(|sample| Answer {
                    total: evaluate::<Ur5, N, P>(&world.wrong, &sample.desired).total,
                    shares: None,
                    flags: 0,
                }))
            });
            let _ = record;
            if let Some(seen) = window.conditioned(1.0 / PERIOD_S as f32) {
                let raw = torques[torques.len() - 1 - DELAY];
                for j in 0..N {
                    let row = torque_row::<Ur5, N, P>(j, &seen);
                    put(&mut file, [tick as f32, j as f32, seen.motion.qd[j], raw[j], seen.tau[j]].into_iter().chain(row.iter().copied()));
                }
            }
        }
    }
}
