//! Ticks a second that each board answers in lock-step, learning off and on: `cargo run --release --example link_speed`.

use foretorque::arm::ur5::{JOINTS, PARAMETERS, Ur5};
use foretorque::joint::{JointMeasurement, JointMotion, JointSample, JointVector};
use foretorque_workbench::board::qemu::{Emulator, Image, QemuOptions};
use foretorque_workbench::board::{Client, Native, Transport};
use std::time::{Duration, Instant};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    report(Box::new(Native::<Ur5, JOINTS, PARAMETERS>::new()?), 100_000)?;
    for (image, ticks) in [(Image::Bulk, 50_000), (Image::Joint, 2_000)] {
        let pinned = QemuOptions::new(image);
        let free = QemuOptions {
            core: None,
            ..pinned.clone()
        };
        println!("one core:");
        report(Box::new(Emulator::start(&pinned)?), ticks)?;
        println!("any core:");
        report(Box::new(Emulator::start(&free)?), ticks)?;
    }
    Ok(())
}

fn report(link: Box<dyn Transport>, ticks: u32) -> Result<(), Box<dyn std::error::Error>> {
    let name = link.name();
    let mut client = Client::<JOINTS>::connect::<Ur5, PARAMETERS>(link, Duration::from_secs(5))?;
    for learning in [false, true] {
        let pace = pace(&mut client, ticks, learning)?;
        println!("{name}: {pace:.0} ticks/s, learning: {learning}");
    }
    let statistics = client.statistics()?;
    println!(
        "  tick {:?}, learning {:?}, byte {:?}, late sets {}",
        statistics.tick_cost, statistics.learn_cost, statistics.receive_cost, statistics.late_sets
    );
    Ok(())
}

/// Ticks a second over `ticks` ticks.
fn pace(
    client: &mut Client<JOINTS>,
    ticks: u32,
    learning: bool,
) -> Result<f64, Box<dyn std::error::Error>> {
    client.learning(learning)?;
    let start = Instant::now();
    for k in 0..ticks {
        let angle = k as f32 * 2e-3;
        let desired = JointMotion {
            q: JointVector::repeat(angle.sin()),
            qd: JointVector::repeat(2.0 * angle.cos()),
            qdd: JointVector::repeat(-4.0 * angle.sin()),
        };
        let measured = JointMeasurement {
            q: desired.q,
            tau: JointVector::repeat(angle.cos()),
        };
        client.sample(&JointSample {
            desired,
            measured: Some(measured),
        })?;
    }
    Ok(f64::from(ticks) / start.elapsed().as_secs_f64())
}
