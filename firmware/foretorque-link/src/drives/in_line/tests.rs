//! Frames that pass a board in line: foreign ones unchanged and in order, commands with the torque added.

use super::super::tests::{PROTOCOLS, profile};
use super::super::{Carry, Frames, JointReply, Order};
use super::*;
use proptest::prelude::RngExt as _;
use proptest::test_runner::{RngAlgorithm, TestRng};

const TIMEOUT_US: u32 = 5000;

fn random() -> TestRng {
    TestRng::deterministic_rng(RngAlgorithm::XorShift)
}

/// Damiao, CyberGear and ODrive, each with an identifier of its own.
fn arm() -> [DriveProfile; 3] {
    let mut arm = [PROTOCOLS[1].0, PROTOCOLS[2].0, PROTOCOLS[7].0].map(profile);
    for (profile, id) in arm.iter_mut().zip([1, 2, 3]) {
        profile.id = id;
    }
    arm
}

/// The frame of a motion command.
fn sent(profile: &DriveProfile, command: &JointCommand) -> Frame {
    let mut frames = Frames::new();
    profile.command(command, &mut Carry::default(), &mut frames);
    frames[0]
}

fn torque_of(profile: &DriveProfile, frame: &Frame) -> f32 {
    match profile.accept(frame) {
        Some(Request::Command(command)) => command.torque,
        other => panic!("{frame:?}: {other:?}"),
    }
}

/// A frame of the mix, and the joint whose motion command it is.
fn mixed(arm: &[DriveProfile; 3], random: &mut TestRng) -> (Frame, Option<usize>) {
    let joint = random.random_range(0..3);
    let (profile, mut frames) = (&arm[joint], Frames::new());
    match random.random_range(0..4) {
        0 => {
            let command = JointCommand {
                position: random.random(),
                torque: random.random_range(-6.0..6.0),
                kp: random.random_range(0.0..50.0),
                ..JointCommand::default()
            };
            return (sent(profile, &command), Some(joint));
        }
        1 => {
            use Order::{ClearFault, Disable, Enable, SetZero};
            let orders = [Enable, Disable, ClearFault, SetZero];
            profile.order(orders[random.random_range(0..4)], &mut frames);
        }
        2 => profile.reply(&JointReply::default(), &mut frames),
        _ => {
            let data: [u8; 8] = random.random();
            let bytes = &data[..random.random_range(0..=8)];
            let frame = Frame::new(random.random(), random.random(), bytes);
            let own = arm
                .iter()
                .position(|profile| matches!(profile.accept(&frame), Some(Request::Command(_))));
            return (frame, own);
        }
    }
    (frames[0], None)
}

#[test]
fn a_million_mixed_frames_pass_with_the_torque_added_to_commands_alone() {
    let (arm, mut random) = (arm(), random());
    let mut board = InLine::new(arm.map(Some), TIMEOUT_US);
    let (mut foreign, mut changed) = (0, 0);
    let added = [1.5, -0.75, 0.25];
    for number in 0..1_000_000_u32 {
        let now_us = number.wrapping_mul(100);
        if number.is_multiple_of(10) {
            board.set(&added, now_us);
        }
        let (sent, joint) = mixed(&arm, &mut random);
        let mut passed = sent;
        let seen = board.to_drives(&mut passed, now_us);
        assert_eq!(seen.map(|(joint, _)| joint), joint, "{sent:?}");
        let Some(joint) = joint else {
            assert_eq!(passed, sent);
            foreign += 1;
            continue;
        };
        let before = torque_of(&arm[joint], &sent);
        let want = (before + added[joint]).clamp(-9.0, 9.0);
        let got = torque_of(&arm[joint], &passed);
        let near = (got - want).abs() < 0.01 || before.abs() > 8.9;
        assert!(near, "{sent:?} {passed:?}: {got} for {want}");
        changed += 1;
    }
    let many = foreign > 600_000 && changed > 100_000;
    assert!(many, "{foreign} {changed}");
}

#[test]
fn without_a_young_torque_nothing_changes() {
    let (arm, mut random) = (arm(), random());
    let mut cases = [(); 5].map(|()| InLine::new(arm.map(Some), TIMEOUT_US));
    let ([_, cleared, late, rubbish, zero], now) = (&mut cases, 1_000_000);
    cleared.set(&[1.0; 3], now);
    cleared.clear();
    late.set(&[1.0; 3], now - TIMEOUT_US - 1);
    rubbish.set(&[1.0, f32::NAN, 0.0], now);
    zero.set(&[0.0; 3], now);
    for _ in 0..50_000 {
        let (sent, _) = mixed(&arm, &mut random);
        for board in &mut cases {
            let mut passed = sent;
            let _ = board.to_drives(&mut passed, now);
            assert_eq!(passed, sent);
        }
    }
    // A torque that has expired stays off when the clock of 32 bits comes round.
    let [_, _, mut late, ..] = cases;
    let sent = sent(&arm[0], &JointCommand::default());
    let mut passed = sent;
    let _ = late.to_drives(&mut passed, now - TIMEOUT_US);
    assert_eq!(passed, sent);
}

#[test]
fn added_torque_has_no_bias_and_makes_no_order() {
    let (arm, mut random) = (arm(), random());
    let mut board = InLine::new(arm.map(Some), TIMEOUT_US);
    board.set(&[0.0011; 3], 0);
    for (joint, profile) in arm.iter().enumerate() {
        let sent = sent(profile, &JointCommand::default());
        let (before, mut sum) = (torque_of(profile, &sent), 0.0);
        for _ in 0..4096 {
            let mut passed = sent;
            let _ = board.to_drives(&mut passed, 0);
            sum += f64::from(torque_of(profile, &passed) - before);
        }
        let mean = sum / 4096.0;
        assert!((mean - 0.0011).abs() < 1e-5, "joint {joint}: {mean}");
    }
    // Motion commands at full scale next to the bytes of an order.
    for torque in [9.0, -9.0] {
        board.set(&[torque; 3], 0);
        for _ in 0..10_000 {
            let data = random.random::<[u8; 8]>().map(|byte| byte | 0xfe);
            let sent = Frame::standard(1, &data);
            let mut passed = sent;
            let was_command = board.to_drives(&mut passed, 0).is_some();
            let is_command = matches!(arm[0].accept(&passed), Some(Request::Command(_)));
            assert_eq!(was_command, is_command, "{sent:?} {passed:?}");
        }
    }
}

/// Port with three mailboxes, and a bus that stands still now and then.
#[derive(Default)]
struct Wire {
    arrived: std::collections::VecDeque<Frame>,
    mailboxes: Vec<Frame>,
    left: Vec<Frame>,
}

impl Port for Wire {
    fn receive(&mut self) -> Option<Frame> {
        self.arrived.pop_front()
    }

    fn send(&mut self, frame: &Frame, _: u32) -> bool {
        let room = self.mailboxes.len() < 3;
        self.mailboxes.extend(room.then_some(*frame));
        room
    }

    fn expire(&mut self, _: u32, _: u32) -> u32 {
        0
    }
}

#[test]
fn a_bridge_passes_both_ways_in_order_and_outlives_a_dead_bus() {
    let (arm, mut random) = (arm(), random());
    let line = InLine::new(arm.map(Some), TIMEOUT_US);
    let ports = [Wire::default(), Wire::default()];
    let mut bridge = Bridge::new(ports, Some(line), u32::MAX);
    let (mut sent, mut seen) = ([vec![], vec![]], [0, 0]);
    let mut rounds = |bridge: &mut Bridge<Wire, 3>, count: u32, alive: bool| {
        for round in 0..count {
            let (frame, _) = mixed(&arm, &mut random);
            let way = random.random_range(0..2);
            bridge.ports()[way].arrived.push_back(frame);
            sent[way].push(frame);
            bridge.pass(round.wrapping_mul(100), |port, _| {
                seen[usize::from(port)] += 1;
            });
            let [host, drives] = bridge.ports();
            host.left.append(&mut host.mailboxes);
            if alive {
                drives.left.append(&mut drives.mailboxes);
            }
        }
    };
    rounds(&mut bridge, 50_000, true);
    // The bus of the drives is off: the host's side goes on, the newest frames wait.
    rounds(&mut bridge, 1000, false);
    let dropped = bridge.lost() as usize;
    rounds(&mut bridge, 50_000, true);
    assert_eq!(seen, sent.each_ref().map(Vec::len));
    assert!((400..600).contains(&dropped) && bridge.lost() as usize - dropped < 16);
    let lost = bridge.lost() as usize;
    let ([host, drives], [down, up]) = (bridge.ports(), sent);
    assert_eq!(host.left, up);
    // What left is what arrived, in order, without those that were dropped.
    let mut arrived = down.iter();
    let mut left = drives.left.iter();
    assert!(left.all(|frame| arrived.any(|sent| sent == frame)));
    assert_eq!(drives.left.len() + lost, down.len());
}

#[test]
fn a_master_sends_its_own_frames_and_passes_none() {
    let ports = [Wire::default(), Wire::default()];
    let mut bridge = Bridge::<Wire, 3>::new(ports, None, TIMEOUT_US);
    let frame = |id| Frame::standard(id, &[0; 8]);
    bridge.ports()[0].arrived.push_back(frame(1));
    for id in 2..6 {
        bridge.send(1, frame(id), 0);
    }
    let mut seen = vec![];
    bridge.pass(0, |port, frame| seen.push((port, *frame)));
    assert_eq!(seen, [(0, frame(1))]);
    let [host, drives] = bridge.ports();
    assert!(host.mailboxes.is_empty());
    assert_eq!(drives.mailboxes, [2, 3, 4].map(frame));
    drives.mailboxes.clear();
    // The fourth has waited for too long.
    bridge.send(1, frame(7), TIMEOUT_US);
    bridge.pass(TIMEOUT_US + 1, |_, _| {});
    assert_eq!(bridge.ports()[1].mailboxes, [frame(7)]);
    assert_eq!(bridge.lost(), 1);
}

#[test]
fn torque_is_added_to_every_form_of_a_moteus_command_that_has_the_field() {
    // Those of moteus.
    for (protocol, _) in &PROTOCOLS[4..7] {
        let drive = profile(*protocol);
        let mut board = InLine::new([Some(drive)], TIMEOUT_US);
        board.set(&[1.5], 0);
        let command = JointCommand {
            position: 0.5,
            torque: 0.25,
            ..JointCommand::default()
        };
        let sent = sent(&drive, &command);
        let mut frame = sent;
        assert!(board.to_drives(&mut frame, 0).is_some());
        let Some(Request::Command(passed)) = drive.accept(&frame) else {
            panic!("{frame:?}");
        };
        let near = (passed.torque - 1.75).abs() < 0.03 && (passed.position - 0.5).abs() < 1e-3;
        assert!(near, "{protocol:?} {passed:?}");
        assert_eq!(frame.bytes().len(), sent.bytes().len());
    }
    // Mode 10 and a position, without the field of the torque.
    let drive = profile(PROTOCOLS[4].0);
    let id = 0x8000 | u32::from(drive.host_id) << 8 | u32::from(drive.id);
    let sent = Frame::extended(id, &[1, 0, 10, 5, 0x20, 0x10, 0x27]).into_fd(0x50);
    let mut board = InLine::new([Some(drive)], TIMEOUT_US);
    board.set(&[1.5], 0);
    let mut passed = sent;
    assert!(board.to_drives(&mut passed, 0).is_some());
    assert_eq!(passed, sent);
}
