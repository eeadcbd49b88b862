//! A board that is master of its drives, or in line before them.

use super::tests::{Drives, ODRIVE, RANGES, config, config_of};
use super::*;
use crate::drives::{
    Carry, Cia402, ControlMode, DriveState, Frame, Frames, JointCommand, JointReply, Protocol,
};
use crate::excitation::ExcitationCommand;
use crate::safety::SafetyState;
use crate::session::tests as session;
use crate::wire::{BoardMessage, Configuration, HostMessage, NackReason, SampleFrame};
use foretorque::arm::ur5::Ur5;
use foretorque::joint::{JointMotion, JointVector};

/// A board that is master of its drives, and its host.
struct Board {
    board: session::Board<BoardDrives<Ur5, 6, 40>>,
    drives: Drives,
    /// Frames of the last period.
    sent: usize,
    /// In line: torques added to the frames that pass, N·m.
    added: Option<JointVector<6>>,
}

impl Board {
    fn new() -> Self {
        Self::of(Role::Master, config())
    }

    fn of(role: Role, config: BusConfig<6>) -> Self {
        let wiring = Wiring {
            arm_hash: <Ur5 as Arm<6, 40>>::hash(),
            role,
            wires: Wires::Can,
            bit_s: 1_000_000,
            shortest_period_us: 0,
            joints: config.joints.map(Some).into_iter().collect(),
        };
        let mut board = session::Board::measuring(BoardDrives::new(&wiring));
        board.session.limit_torques(board.sensor.torque_limits());
        Self {
            board,
            drives: Drives::of(config),
            sent: 0,
            added: None,
        }
    }

    fn powered(&self) -> bool {
        self.board.sensor.powered(&self.board.session)
    }

    /// A command and a reply of every drive at position zero and `celsius`, as they pass a board in line.
    fn pass(&mut self, celsius: f32) {
        for joint in self.drives.config.joints {
            let (mut frames, mut carry) = (Frames::new(), Carry::default());
            let command = JointCommand::default();
            joint.drive.command(&command, &mut carry, &mut frames);
            self.board.sensor.receive(0, &frames[0]);
            frames.clear();
            let reply = JointReply {
                position: Some(0.0),
                torque: Some(0.0),
                temperature: Some(celsius),
                state: Some(DriveState::Enabled),
                ..JointReply::default()
            };
            joint.drive.reply(&reply, &mut frames);
            self.board.sensor.receive(1, &frames[0]);
        }
    }

    /// Periods of a board in line, whose drives get the position zero and report it; with samples of the link or without.
    fn line(&mut self, periods: u32, orders: &[HostMessage<6>], samples: bool) {
        for _ in 0..periods {
            self.pass(30.0);
            if samples {
                self.rest(1, orders);
            } else {
                self.period(orders, |_, _| true);
            }
        }
    }

    /// A period with these messages of the host; `change` may alter an answer of a drive.
    fn period(
        &mut self,
        messages: &[HostMessage<6>],
        change: impl Fn(usize, &mut JointReply) -> bool,
    ) {
        let mut sent = Vec::new();
        let added = &mut self.added;
        // As the tick's task of the firmware does it.
        let mut follow = |board: &mut session::Board<BoardDrives<Ur5, 6, 40>>| {
            let (session, drives) = (&mut board.session, &mut board.sensor);
            if drives.ticked() {
                let send = |bus, frame: &Frame| sent.push((bus, *frame));
                *added = drives.follow(session, false, send);
            } else if !session.torque_enabled() {
                drives.end(session);
            }
        };
        self.board.timer();
        follow(&mut self.board);
        for message in messages {
            self.board.send(message);
            follow(&mut self.board);
        }
        self.sent = sent.len();
        for (bus, frame) in self.drives.answers(&sent, change) {
            self.board.sensor.receive(bus, &frame);
        }
    }

    /// So many periods at rest, with `orders` after the sample of the last one.
    fn rest(&mut self, periods: u32, orders: &[HostMessage<6>]) {
        self.rest_with(periods, orders, |_, _| true);
    }

    fn rest_with(
        &mut self,
        periods: u32,
        orders: &[HostMessage<6>],
        change: fn(usize, &mut JointReply) -> bool,
    ) {
        let still = still();
        for k in 1..=periods {
            let mut messages = vec![HostMessage::Sample(still.in_period(k as u8 % 32))];
            if k == periods {
                messages.extend_from_slice(orders);
            }
            self.period(&messages, change);
        }
    }

    fn state(&self) -> SafetyState {
        self.board.session.safety().state
    }

    fn flows(&self) -> bool {
        self.drives.torque.iter().any(|torque| torque.abs() > 0.05)
    }
}

#[test]
fn a_board_waits_for_drives_that_are_slow_to_switch_on() {
    const SLOW_MS: u32 = 300;
    let slow = |_, reply: &mut JointReply| {
        reply.state = Some(DriveState::Disabled);
        true
    };
    let mut board = Board::new();
    board.rest(50, &[]);
    board.rest_with(1, &[HostMessage::Arm], slow);
    for ms in 0..SLOW_MS {
        board.rest_with(1, &[], slow);
        assert_eq!(board.board.session.torque_output()[1], 0.0, "{ms} ms");
    }
    board.rest(50, &[]);
    assert_eq!(board.state(), SafetyState::Armed);
    assert!(board.flows());
}

#[test]
fn drives_of_a_silent_host_lose_their_torque_damp_and_are_off() {
    let mut board = Board::new();
    board.rest(50, &[HostMessage::Arm]);
    board.rest(100, &[]);
    for ms in 0..1200 {
        board.period(&[], |_, _| true);
        let (flows, torque) = (board.flows(), &board.drives.torque);
        assert!(flows || ms > 10, "{ms} ms");
        assert!(!flows || ms < 65, "{ms} ms: {torque:?}");
    }
    assert_eq!(board.drives.on(), [false; 6]);
}

/// Flash stalls the processor, and a restart leaves the drives alone: both wait until they are off, and so does the supply.
#[test]
fn no_save_no_restart_and_no_supply_cut_while_drives_are_on() {
    let mut board = Board::new();
    let damping = BoardMessage::Nack(NackReason::Unsafe(SafetyReason::StillRamping));
    let refused = |board: &mut Board| {
        let orders = [HostMessage::Save, HostMessage::Reboot];
        orders.map(|message| board.board.request(message) == damping)
    };
    assert_eq!(refused(&mut board), [false; 2]);
    assert!(!board.powered());
    // The drives have their order to switch on, and the torque ends in the same period.
    board.rest(50, &[HostMessage::Arm]);
    board.rest(1, &[]);
    assert!(board.powered());
    board.rest(1, &[HostMessage::Disarm]);
    assert_eq!(refused(&mut board), [true; 2]);
    board.rest(1200, &[HostMessage::Arm]);
    board.rest(100, &[HostMessage::Disarm]);
    board.rest(20, &[]);
    assert_eq!(board.state(), SafetyState::Disarmed);
    assert_eq!(refused(&mut board), [true; 2]);
    // The rest of the second in another period.
    let slow = Configuration {
        period_us: 20_000,
        ..Configuration::default()
    };
    board.period(&[HostMessage::Configure(slow)], |_, _| true);
    for ms in (20..900).step_by(20) {
        board.rest(1, &[]);
        assert!(board.powered(), "{ms} ms");
    }
    board.rest(10, &[]);
    assert_eq!(board.drives.on(), [false; 6]);
    assert!(!board.powered());
    assert_eq!(refused(&mut board), [false; 2]);
    // An emergency stop cuts the supply at once.
    let mut board = Board::new();
    board.rest(50, &[HostMessage::Arm]);
    board.rest(100, &[]);
    board.period(&[HostMessage::Stop], |_, _| true);
    assert!(!board.powered());
}

/// A sample at rest, without a measurement.
fn still() -> SampleFrame<6> {
    SampleFrame::new(&JointSample {
        desired: JointMotion::zero(),
        measured: None,
    })
}

/// Two samples in one period, and none in the next, as an adapter delivers them.
#[test]
fn samples_that_come_in_pairs_are_one_command_a_period() {
    let mut board = Board::new();
    board.rest(50, &[HostMessage::Arm]);
    board.rest(700, &[]);
    let still = still();
    for k in 0..250_u8 {
        let pair = [0, 1].map(|n| HostMessage::Sample(still.in_period((k % 16) * 2 + n)));
        for samples in [&pair[..], &[]] {
            board.period(samples, |_, _| true);
            assert!(board.sent <= 6, "{k}: {} frames", board.sent);
            assert_eq!(board.state(), SafetyState::Armed, "{k}");
        }
    }
}

#[test]
fn a_drive_that_was_away_is_asked_for_its_scales_again() {
    let mut board = Board::new();
    board.rest(50, &[]);
    board.drives.other_scale = Some((2, 28.0));
    board.rest_with(100, &[], |joint, _| joint != 2);
    board.rest(50, &[HostMessage::Arm]);
    board.rest(50, &[]);
    assert_eq!(board.board.session.latched_fault(), SafetyReason::Drive);
    assert_eq!(board.drives.on(), [false; 6]);
    board.drives.other_scale = None;
    board.rest(1, &[HostMessage::ClearFault, HostMessage::Arm]);
    board.rest(50, &[]);
    assert_eq!(board.drives.on(), [true; 6]);
}

#[test]
fn an_excitation_does_not_wait_for_the_next_arming() {
    let mut board = Board::new();
    board.rest(50, &[]);
    let start = HostMessage::Excitation(ExcitationCommand::Start);
    let disarmed = BoardMessage::Nack(NackReason::Unsafe(SafetyReason::Disarmed));
    assert_eq!(board.board.request(start), disarmed);
}

/// In line, the torque in the frames is that of the safety in every period, also where no sample comes.
#[test]
fn in_line_the_torque_ends_as_the_session_has_it() {
    // The torque is held for 10 ms, and falls by half of its limit in 5 ms.
    for (end, least) in [(&[][..], 11), (&[HostMessage::Disarm], 2)] {
        let mut board = Board::of(Role::InLine, config());
        board.line(30, &[], true);
        board.line(1, &[HostMessage::Arm], true);
        board.line(60, &[], true);
        assert!(board.added.unwrap()[1].abs() > 20.0, "{:?}", board.added);
        board.line(1, end, false);
        let mut steps = 0;
        while board.board.session.torque_enabled() {
            let torque = *board.board.session.torque_output();
            assert_eq!(board.added, Some(torque));
            board.line(1, &[], false);
            steps += 1;
        }
        assert!(steps >= least, "{steps}");
        assert_eq!(board.added, None);
    }
}

/// The first arming ends with a fault of a drive, or because no scale comes in time.
#[test]
fn a_board_that_is_armed_with_a_cleared_fault_waits_for_scales() {
    for mute in [false, true] {
        let mut board = Board::new();
        board.drives.mute = mute;
        if !mute {
            board.drives.states[2] = DriveState::Fault(13);
        }
        board.rest(50, &[HostMessage::Arm]);
        board.rest(600, &[]);
        assert_eq!(board.board.session.latched_fault(), SafetyReason::Drive);
        board.drives.mute = false;
        board.rest(1, &[HostMessage::ClearFault, HostMessage::Arm]);
        board.rest(500, &[]);
        assert_eq!(board.state(), SafetyState::Armed, "{mute}");
        assert_eq!(board.drives.on(), [true; 6]);
    }
}

#[test]
fn an_end_of_the_torque_between_two_ticks_starts_softly_again() {
    let mut board = Board::new();
    board.rest(50, &[HostMessage::Arm]);
    board.rest(700, &[]);
    let full = board.drives.kp[1];
    assert!((full - 300.0).abs() < 1.0, "{full}");
    let burst = [HostMessage::Stop, HostMessage::ClearFault, HostMessage::Arm];
    board.rest(1, &burst);
    board.rest(1, &[]);
    assert_eq!(board.drives.on(), [false; 6]);
    board.drives.kp = [0.0; 6];
    let mut before = 0.0;
    for ms in 0..2000 {
        board.rest(1, &[]);
        let now = board.drives.kp[1];
        assert!(now - before < 2.0, "{ms} ms: from {before} to {now}");
        before = now;
    }
    assert!((before - full).abs() < 1.0, "{before}");
}

#[test]
fn a_held_position_does_not_follow_an_arm_that_sags() {
    let mut board = Board::of(Role::Master, config_of(ODRIVE));
    board.rest(50, &[HostMessage::Arm]);
    board.rest(100, &[]);
    assert_eq!(board.state(), SafetyState::Armed);
    board.rest(1, &[HostMessage::Disarm]);
    board.rest(20, &[]);
    board.rest(1, &[HostMessage::Arm]);
    let held = board.drives.position;
    for _ in 0..500 {
        board.rest(1, &[]);
        board.drives.q.iter_mut().for_each(|q| *q -= 1e-4);
        assert_eq!(board.state(), SafetyState::Armed);
        assert_eq!(board.drives.position, held);
    }
}

#[test]
fn a_state_from_before_the_order_switches_no_drive_on() {
    let mut board = Board::of(Role::Master, config_of(ODRIVE));
    board.drives.heartbeat = 50;
    board.rest(80, &[HostMessage::Arm]);
    for _ in 0..2 {
        board.rest(300, &[]);
        assert_eq!(board.state(), SafetyState::Armed);
        assert_eq!(board.drives.on(), [true; 6]);
        // It is armed again while the drives damp.
        board.rest(1, &[HostMessage::Disarm]);
        board.rest(20, &[]);
        board.rest(1, &[HostMessage::Arm]);
        board.rest(1000, &[]);
    }
    assert_eq!(board.board.session.latched_fault(), SafetyReason::None);
}

#[test]
fn nodes_that_boot_are_started_and_switched_on_step_by_step() {
    for mode in [ControlMode::Position, ControlMode::Velocity] {
        let cia402 = Cia402 {
            mode,
            counts_per_turn: 65_536.0,
            rated_torque: 12.0,
        };
        let mut board = Board::of(Role::Master, config_of(Protocol::Cia402(cia402)));
        board.drives.states = [DriveState::NotReady; 6];
        board.rest(50, &[HostMessage::Arm]);
        board.rest(50, &[]);
        assert_eq!(board.drives.on(), [true; 6]);
        assert_eq!(board.state(), SafetyState::Armed);
        // A node that boots again is off, which is a fault; after that it is started again.
        board.drives.started[3] = false;
        board.drives.states[3] = DriveState::NotReady;
        board.rest(1200, &[]);
        assert_eq!(board.board.session.latched_fault(), SafetyReason::Drive);
        board.rest(1, &[HostMessage::ClearFault, HostMessage::Arm]);
        board.rest(100, &[]);
        assert_eq!(board.drives.on(), [true; 6]);
    }
}

#[test]
fn a_temperature_that_no_longer_comes_makes_a_warm_motor() {
    let mut board = Board::of(Role::Master, config_of(ODRIVE));
    let slow = Configuration {
        period_us: 20_000,
        ..Configuration::default()
    };
    board.period(&[HostMessage::Configure(slow)], |_, _| true);
    let celsius = [40.0_f32.to_le_bytes(), 30.0_f32.to_le_bytes()].concat();
    let drives = &mut board.board.sensor;
    drives.receive(0, &Frame::standard(1 << 5 | 0x15, &celsius));
    board.rest(10, &[]);
    assert_eq!(board.board.statistics().hottest_c, 40);
    assert_ne!(board.board.session.safety().reason, SafetyReason::MotorWarm);
    board.rest(1050, &[]);
    assert_eq!(board.board.session.safety().reason, SafetyReason::MotorWarm);
}

#[test]
fn a_temperature_beyond_the_plausible_ones_is_hot_in_line_too() {
    for (celsius, armed) in [(40.0, true), (130.0, false)] {
        let mut board = Board::of(Role::InLine, config());
        for _ in 0..20 {
            board.pass(celsius);
            board.rest(1, &[HostMessage::Arm]);
        }
        let session = &board.board.session;
        let (flows, safety) = (session.torque_enabled(), session.safety());
        assert_eq!(flows, armed, "{celsius} °C: {safety}");
    }
}

#[test]
fn a_stop_of_a_board_switches_every_drive_off_with_its_next_frame() {
    for (protocol, heartbeat) in [(ODRIVE, 1), (ODRIVE, 50), (Protocol::Damiao(RANGES), 1)] {
        let mut board = Board::of(Role::Master, config_of(protocol));
        board.drives.heartbeat = heartbeat;
        board.rest(100, &[HostMessage::Arm]);
        board.rest(300, &[]);
        // While the drives follow, and while they damp.
        for order in [HostMessage::Statistics, HostMessage::Disarm] {
            board.rest(1, &[order]);
            assert_eq!(board.drives.on(), [true; 6], "{protocol:?}");
            board.rest(1, &[HostMessage::Stop]);
            board.rest(1, &[]);
            assert_eq!(board.drives.on(), [false; 6], "{protocol:?}");
            board.rest(100, &[HostMessage::ClearFault, HostMessage::Arm]);
            board.rest(300, &[]);
            assert_eq!(board.state(), SafetyState::Armed);
            // Armed again before the next tick, while the drives follow or are being switched on.
            for _ in 0..2 {
                let burst = [HostMessage::Stop, HostMessage::ClearFault, HostMessage::Arm];
                board.rest(1, &burst);
                board.rest(1, &[]);
                assert_eq!(board.drives.on(), [false; 6], "{protocol:?}");
                board.rest(2, &[]);
            }
            board.rest(300, &[]);
            assert_eq!(board.state(), SafetyState::Armed);
        }
    }
}

/// The arm's own gravity needs more.
#[test]
fn a_board_keeps_the_torque_limits_of_its_drives_and_their_derating() {
    let mut config = config();
    config.joints[1].drive.torque_limit = 7.0;
    let mut board = Board::of(Role::Master, config);
    // That of the tick, too, from which the bounds of learning follow.
    let limit = |board: &Board| board.board.session.feed_forward().config().limits[1].torque;
    assert_eq!(limit(&board), 7.0);
    board.rest(50, &[HostMessage::Arm]);
    board.rest(200, &[]);
    let step = RANGES.torque / 2047.0;
    for (celsius, most) in [(30.0, 7.0), (90.0, 3.5)] {
        for _ in 0..100 {
            board.period(&[HostMessage::Sample(still())], |_, reply| {
                reply.temperature = Some(celsius);
                true
            });
        }
        let torque = board.board.session.torque_output()[1].abs();
        assert!((torque - most).abs() < 1e-3, "{celsius} °C: {torque}");
        let sent = board.drives.torque[1].abs();
        assert!((sent - torque).abs() <= step, "{celsius} °C: {sent}");
    }
    board.rest(1, &[HostMessage::Disarm]);
    board.rest(50, &[]);
    board.rest(1, &[HostMessage::Configure(Configuration::default())]);
    assert_eq!(limit(&board), 7.0);
}

#[test]
fn a_desired_velocity_beyond_the_arms_reaches_no_drive() {
    let mut board = Board::new();
    board.rest(50, &[HostMessage::Arm]);
    board.rest(100, &[]);
    let mut desired = JointMotion::<6>::zero();
    desired.qd.fill(-25.0);
    let sample = SampleFrame::new(&JointSample {
        desired,
        measured: None,
    });
    // It runs with the next period of the timer.
    board.period(&[HostMessage::Sample(sample)], |_, _| true);
    board.period(&[], |_, _| true);
    let limits = <Ur5 as Arm<6, 40>>::limits().map(|limits| limits.velocity);
    for (sent, limit) in board.drives.velocity.iter().zip(limits) {
        assert!((sent + limit).abs() < 0.02, "{sent} of {limit}");
    }
}

#[test]
fn an_arm_that_sags_while_its_drives_switch_on_is_held_where_it_is() {
    /// Drives from `FIRST` on are off.
    fn off<const FIRST: usize>(joint: usize, reply: &mut JointReply) -> bool {
        if joint >= FIRST {
            reply.state = Some(DriveState::Disabled);
        }
        true
    }
    let mut board = Board::of(Role::Master, config_of(ODRIVE));
    board.rest(50, &[HostMessage::Arm]);
    for _ in 0..100 {
        board.rest_with(1, &[], off::<1>);
        board.drives.q.iter_mut().for_each(|q| *q -= 1e-4);
    }
    board.rest_with(3, &[], off::<5>);
    let held = board.drives.position[1];
    assert!((held - board.drives.q[1]).abs() < 2e-4, "{held}");
}
