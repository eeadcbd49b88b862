//! Payloads and collisions.

use super::*;
use crate::arm::{LinkInertia, base_parameters};
use crate::learning::Reason;

/// A cube in the hand, 5 cm beyond the flange and aside.
fn cube(mass: f32) -> BaseParameters<P> {
    let side = (mass / 2600.0).cbrt();
    let mut links = [LinkInertia::NONE; N];
    links[N - 1] = LinkInertia {
        mass,
        com: nalgebra::Vector3::from(COM),
        inertia_com: nalgebra::Matrix3::identity() * (mass * side * side / 6.0),
    };
    base_parameters::<Ur5, N, P>(&links, &[0.0; N])
}

const COM: [f32; 3] = [0.02, -0.01, 0.1323];

/// A board that has learnt the arm for `seconds`.
fn settled(seconds: u32) -> (Board, Plant, u32) {
    let mut board = Board::new(wrong_prior(1), 0);
    let mut plant = Plant::new(STRIBECK);
    board.feedforward.set_learning(true);
    for tick in 0..1000 * seconds {
        board.tick(&plant.sample(tick));
    }
    (board, plant, 1000 * seconds)
}

/// RMS over the joints of what `torque` misses of what is needed, in units of the torque limit, and the largest joint's.
fn error(plant: &Plant, sample: &JointSample<N>, torque: &Torque<N>) -> (f64, f64) {
    let needed = loaded_torque(&plant.body, &sample.desired, plant.stribeck);
    let shares =
        |j: usize| (f64::from(torque.total[j]) - needed[j]) / f64::from(Ur5::LIMITS[j].torque);
    let square: f64 = (0..N).map(|j| shares(j).powi(2)).sum();
    (
        (square / N as f64).sqrt(),
        (0..N).map(|j| shares(j).abs()).fold(0.0, f64::max),
    )
}

fn log(board: &Board, seen: &mut u32, from: u32) {
    let decisions = board.learner.state().report.decisions;
    while *seen < decisions.count() {
        if let Some(d) = decisions.get(*seen) {
            println!(
                "  {:.3} s {:?} joint {:?} {:.3}",
                f64::from(d.tick as i32 - from as i32) * 1e-3,
                d.reason,
                d.joint,
                d.figure
            );
        }
        *seen += 1;
    }
}

#[test]
fn payloads() {
    let (mut board, mut plant, mut tick) = settled(14);
    let mut seen = 0;
    log(&board, &mut seen, 0);
    for (mass, times) in [(3.0, 20), (0.5, 4), (1.0, 4), (2.0, 4), (5.0, 4)] {
        let mut onsets = Vec::new();
        let mut releases = Vec::new();
        for round in 0..times {
            let start = tick;
            let load = cube(mass);
            plant.body += load;
            let (mut last_bad, mut worst_after) = (0, 0.0f64);
            let held = 4000 + 137 * round;
            for k in 0..held {
                let sample = plant.sample(tick);
                let torque = board.tick(&sample);
                let weight = rnea::<Ur5, N, P>(&load, &sample.desired);
                let carried = board.feedforward.state().payload_torque;
                let share = |j: usize, tau: f32| f64::from(tau / Ur5::LIMITS[j].torque).powi(2);
                let (mut missed, mut step) = (0.0, 0.0);
                for j in 0..N {
                    missed += share(j, weight[j] - carried[j]);
                    step += share(j, weight[j]);
                }
                let (rms, _) = error(&plant, &sample, &torque);
                if missed.sqrt() > 0.1 * step.sqrt() {
                    last_bad = k;
                }
                if k > 2500 {
                    worst_after = worst_after.max(rms);
                }
                if k == 1000 + last_bad.min(600) {
                    let p = board.learner.state().report.quality.payload;
                    println!(
                        "{mass} kg: {:.3} kg, com off by {:.1?} mm, sigma {:.3}",
                        p.mass,
                        core::array::from_fn::<f32, 3, _>(|i| (p.com[i] - COM[i]) * 1e3),
                        p.mass_sigma
                    );
                }
                tick += 1;
            }
            onsets.push(last_bad);
            log(&board, &mut seen, start);
            plant.body = Ur5::NOMINAL.into();
            let start = tick;
            let mut last_bad = 0;
            for k in 0..4000 + 91 * round {
                let sample = plant.sample(tick);
                let torque = board.tick(&sample);
                let (_, worst) = error(&plant, &sample, &torque);
                if worst > 0.02 {
                    last_bad = k;
                }
                tick += 1;
            }
            releases.push(last_bad);
            log(&board, &mut seen, start);
        }
        onsets.sort();
        println!("{mass} kg: onset {onsets:?} releases {releases:?}");
    }
}

#[test]
fn collisions() {
    let (mut board, mut plant, mut tick) = settled(14);
    let mut seen = 0;
    log(&board, &mut seen, 0);
    let mut dice = Dice(5);
    let (mut during, mut after, mut promoted) = (0, 0, 0);
    for round in 0..200 {
        let uniform = |dice: &mut Dice| 0.5 * (dice.roll() + 1.0);
        let touched = ((uniform(&mut dice) * 6.0) as usize).min(5);
        let size = 0.1 + 0.25 * uniform(&mut dice);
        let push: [f64; N] = core::array::from_fn(|j| {
            let share = dice.roll();
            let limit = f64::from(Ur5::LIMITS[j].torque);
            if j < touched {
                size * share * limit
            } else if j == touched {
                size * share.signum() * limit
            } else {
                0.0
            }
        });
        let length = (1000.0 * (0.1 + 2.4 * uniform(&mut dice))) as u32;
        let pause = 2500 + (1000.0 * uniform(&mut dice)) as u32;
        let start = tick;
        let (mut worst_during, mut worst_after) = (0.0f64, 0.0f64);
        for k in 0..length + pause {
            let rise = (f64::from(k.min(length.saturating_sub(k))) / 10.0).min(1.0);
            plant.push = push.map(|p| p * rise);
            let sample = plant.sample(tick);
            let torque = board.tick(&sample);
            let (_, worst) = error(&plant, &sample, &torque);
            if k < length {
                worst_during = worst_during.max(worst);
            }
            if k > length + 1000 {
                worst_after = worst_after.max(worst);
            }
            tick += 1;
        }
        during += u32::from(worst_during > 0.05);
        after += u32::from(worst_after > 0.05);
        let before = seen;
        let decisions = board.learner.state().report.decisions;
        let bad = (before..decisions.count())
            .filter_map(|i| decisions.get(i))
            .any(|d| d.reason == Reason::Promoted);
        promoted += u32::from(bad);
        if bad || worst_during > 0.05 || worst_after > 0.05 || round < 10 {
            println!(
                "round {round} push {push:.1?} {length} ms: during {worst_during:.3} after {worst_after:.3}"
            );
            log(&board, &mut seen, start);
        }
        seen = decisions.count();
    }
    println!("{during} during, {after} after, {promoted} promoted of 200");
}
