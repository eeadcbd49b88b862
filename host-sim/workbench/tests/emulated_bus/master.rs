//! The board as master of six simulated drives.

use super::{Emulated, FrameBoard, Ported, Twin, connected, network, path, profile, wiring};
use foretorque::arm::ur5::{JOINTS, PARAMETERS, Ur5};
use foretorque::joint::{JointSample, JointVector};
use foretorque::learning::ParameterSet;
use foretorque_link::bank::ParameterBank;
use foretorque_link::bus::Role;
use foretorque_link::safety::SafetyState;
use foretorque_link::wire::Configuration;
use foretorque_workbench::bus::Network as _;
use foretorque_workbench::closed_loop::motion_f32;
use foretorque_workbench::plant::{Events, PlantConfig};
use std::cell::RefCell;
use std::rc::Rc;

/// Result of a ride: torques as the board replied, frames it sent, tracking error over the last 6 s.
struct Ride {
    torques: Vec<JointVector<JOINTS>>,
    sent: Ported,
    rms_mrad: f64,
}

/// Arms a master, and has it follow a seeded path while it learns.
fn ride(board: impl FrameBoard + 'static, rate_hz: f64, duration_s: f64, forward: bool) -> Ride {
    const JUDGED_S: f64 = 6.0;
    let profile = profile(rate_hz);
    let path = path(40.0);
    let network = network(&profile, &path, PlantConfig::default(), Events::default());
    let (network, sent) = (
        Rc::new(RefCell::new(network)),
        Rc::<RefCell<Ported>>::default(),
    );
    let (drives, log) = (Rc::clone(&network), Rc::clone(&sent));
    // Each sample of the host begins with a period of the drives.
    let mut client = connected(board, move |board| {
        let mut drives = drives.borrow_mut();
        for (bus, frame) in board.left() {
            drives.send(bus, &frame).expect("it is simulated");
            log.borrow_mut().push((bus, frame));
        }
        drives.wait();
        let replies = std::iter::from_fn(|| drives.receive().expect("it is simulated"));
        board.deliver(&replies.collect::<Vec<_>>());
        true
    });
    let period_us = (1e6 / rate_hz) as u32;
    let configuration = Configuration {
        period_us,
        ..Configuration::default()
    };
    client.configure(configuration).expect("a period");
    if !forward {
        let mut set = ParameterSet::nominal::<Ur5>(1);
        set.rigid.fill(0.0);
        let bank = ParameterBank::from_set::<Ur5, JOINTS, PARAMETERS>(&set);
        client.upload_bank(&bank).expect("a bank");
    }
    let ticks = |time_s: f64| (time_s * rate_hz) as usize;
    let sample = |t_s: f64| JointSample {
        desired: motion_f32(&path.at(t_s)),
        measured: None,
    };
    // Every scale is asked for, one a drive in four periods.
    for _ in 0..ticks(0.1) {
        client.sample(&sample(0.0)).expect("a torque");
    }
    client.arm(&sample(0.0)).expect("every drive is there");
    for _ in 0..ticks(0.7) {
        client.sample(&sample(0.0)).expect("a torque");
    }
    assert_eq!(client.safety().state, SafetyState::Armed);
    client.learning(forward).expect("it learns");
    let (mut torques, mut squares, mut counted) = (Vec::new(), 0.0, 0);
    for tick in 0..ticks(duration_s) {
        let t_s = tick as f64 / rate_hz;
        let reply = client
            .sample(&sample(t_s + profile.lead_s()))
            .expect("a torque");
        assert_eq!(
            reply.safety.state,
            SafetyState::Armed,
            "{t_s} s: {}",
            reply.safety
        );
        torques.push(reply.total);
        if t_s > duration_s - JUDGED_S {
            // The plant is where the command of the tick before has brought it.
            let error = network.borrow().plant.q() - path.at(t_s).q;
            squares += error.norm_squared();
            counted += JOINTS;
        }
    }
    let sent = sent.borrow().clone();
    Ride {
        torques,
        sent,
        rms_mrad: (squares / f64::from(counted as u32)).sqrt() * 1e3,
    }
}

#[test]
fn six_drives_follow_a_board_three_times_better_with_its_torque() {
    for rate_hz in [500.0, 1000.0] {
        let wiring = wiring(&profile(rate_hz), Role::Master);
        let alone = ride(Twin::new(&wiring), rate_hz, 36.0, false).rms_mrad;
        let with = ride(Twin::new(&wiring), rate_hz, 36.0, true).rms_mrad;
        println!(
            "{rate_hz} Hz: {alone:.3} mrad alone, {with:.3} mrad with, ratio {:.2}",
            alone / with
        );
        assert!(
            alone > 3.0 * with,
            "{rate_hz} Hz: {alone} mrad alone, {with} mrad with"
        );
    }
}

#[test]
fn the_emulated_master_sends_the_bits_of_its_twin() {
    // Of both rates, the one that leaves a tick less time.
    let rate_hz = 1000.0;
    let wiring = wiring(&profile(rate_hz), Role::Master);
    let expected = ride(Twin::new(&wiring), rate_hz, 0.4, true);
    let seen = ride(Emulated::start("master", Some(&wiring)), rate_hz, 0.4, true);
    assert!(seen.torques == expected.torques, "torques");
    // Each port keeps its order; between two ports of the emulator there is none.
    let by_port = |mut sent: Ported| {
        sent.sort_by_key(|(port, _)| *port);
        sent
    };
    let frames = seen.sent.len();
    let [seen_sent, expected_sent] = [seen.sent, expected.sent].map(by_port);
    let differs = (seen_sent.iter().zip(&expected_sent)).position(|(a, b)| a != b);
    let first = differs.map(|place| (&seen_sent[place], &expected_sent[place]));
    assert!(
        seen_sent == expected_sent,
        "{frames} and {} frames, first difference {differs:?}: {first:?}",
        expected_sent.len()
    );
    assert!(frames > JOINTS * seen.torques.len());
    let largest = seen
        .torques
        .iter()
        .map(|torque| torque.amax())
        .fold(0.0, f32::max);
    assert!(largest > 10.0, "{largest} N·m");
}
