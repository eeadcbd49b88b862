use super::*;
use crate::drives::{
    Carry, Cia402, ControlMode, DriveProfile, DriveState, Frame, Frames, JointCommand, JointReply,
    Odrive, Order, Protocol, Ranges, Request, Scale,
};
use crate::safety::SafetyState;
use crate::session::{LearnerMailbox, tests as session};
use crate::wire::{Configuration, HostMessage, SampleFrame};
use foretorque::arm::ur5::Ur5;
use foretorque::joint::JointMotion;

type Controller = BusController<Ur5, 6, 40>;

pub(super) const RANGES: Ranges = Ranges {
    position: 12.5,
    velocity: 30.0,
    torque: 200.0,
    kp: 5000.0,
    kd: 500.0,
};

pub(super) fn config() -> BusConfig<6> {
    let joint = |id| BusJoint {
        drive: DriveProfile {
            protocol: Protocol::Damiao(RANGES),
            id,
            host_id: 0x40,
            sign: if id % 2 == 0 { -1.0 } else { 1.0 },
            zero: 0.1,
            gear: 1.0,
            torque_limit: 28.0,
        },
        bus: u8::from(id > 3),
        kp: 300.0,
        kd: 20.0,
    };
    BusConfig {
        period_s: 2e-3,
        joints: [1, 2, 3, 4, 5, 6].map(joint),
    }
}

pub(super) fn controller(config: BusConfig<6>) -> Result<Controller, Contradiction> {
    Controller::new(config, &Parameters::nominal::<Ur5>())
}

/// The drives of [`config`] with another protocol.
fn config_of(protocol: Protocol) -> BusConfig<6> {
    let mut config = config();
    config
        .joints
        .iter_mut()
        .for_each(|joint| joint.drive.protocol = protocol);
    config
}

/// Position, velocity and torque in the frames; the gains and the temperatures are not.
const ODRIVE: Protocol = Protocol::Odrive(Odrive {
    mode: ControlMode::Position,
    velocity_scale: 1000.0,
    torque_scale: 1000.0,
    torque_scale_endpoint: 0,
    polled: true,
});

/// Drives that stand where they are set, with a switch for each.
struct Drives {
    config: BusConfig<6>,
    states: [DriveState; 6],
    /// CANopen: nodes that were started.
    started: [bool; 6],
    /// The drives answer no question for a scale.
    mute: bool,
    /// ODrive: periods between two heartbeats, and periods so far.
    heartbeat: u32,
    periods: u32,
    /// Positions, velocities and stiffness of the last commands.
    position: [f32; 6],
    velocity: [f32; 6],
    kp: [f32; 6],
    q: [f32; 6],
    torque: [f32; 6],
    order: Vec<u16>,
}

impl Drives {
    fn new() -> Self {
        Self::of(config())
    }

    fn of(config: BusConfig<6>) -> Self {
        Self {
            config,
            states: [DriveState::Disabled; 6],
            started: [false; 6],
            mute: false,
            heartbeat: 1,
            periods: 0,
            position: [0.0; 6],
            velocity: [0.0; 6],
            kp: [0.0; 6],
            q: [0.0; 6],
            torque: [0.0; 6],
            order: Vec::new(),
        }
    }

    fn on(&self) -> [bool; 6] {
        self.states.map(|state| state == DriveState::Enabled)
    }

    /// One period: what the controller sends, and what the drives answer to it; `change` may alter an answer.
    fn period(
        &mut self,
        controller: &mut Controller,
        desired: Option<&JointMotion<6>>,
        change: impl Fn(usize, &mut JointReply) -> bool,
    ) -> BusTick<6> {
        let mut sent = Vec::new();
        let mut mailbox = LearnerMailbox::default();
        let tick = controller.tick(desired, &mut mailbox, |bus, frame| sent.push((bus, *frame)));
        for (bus, frame) in self.answers(&sent, change) {
            controller.receive(bus, &frame);
        }
        tick
    }

    /// Answers of the drives to these frames; `change` may alter an answer.
    fn answers(
        &mut self,
        sent: &[(u8, Frame)],
        change: impl Fn(usize, &mut JointReply) -> bool,
    ) -> Vec<(u8, Frame)> {
        let mut answers = Vec::new();
        self.order.clear();
        self.periods += 1;
        for &(bus, frame) in sent {
            for j in 0..6 {
                let joint = self.config.joints[j];
                if joint.bus != bus {
                    continue;
                }
                let canopen = matches!(joint.drive.protocol, Protocol::Cia402(_));
                self.started[j] |= frame == Frame::standard(0, &[1, joint.drive.id as u8]);
                // Before its start a node takes no process data.
                if canopen && !self.started[j] && frame.id < 0x600 {
                    continue;
                }
                let Some(request) = joint.drive.accept(&frame) else {
                    continue;
                };
                self.order.push(joint.drive.id);
                let mut frames = Frames::new();
                let state = &mut self.states[j];
                match request {
                    Request::Order(Order::ReadScale(_)) if self.mute => {}
                    Request::Order(Order::ReadScale(scale)) => {
                        let value = [12.5, 30.0, if canopen { 12.0 } else { 200.0 }];
                        let value = value[scale as usize];
                        joint.drive.reply_scale(scale, value, &mut frames);
                    }
                    Request::Order(Order::ClearFault) => *state = DriveState::Disabled,
                    // A fault keeps a drive off until it is cleared.
                    _ if matches!(state, DriveState::Fault(_)) => {}
                    Request::Order(Order::Disable) => *state = DriveState::Disabled,
                    Request::Order(Order::Enable) if !canopen => *state = DriveState::Enabled,
                    Request::Order(Order::Enable) if *state == DriveState::Disabled => {
                        *state = DriveState::SwitchedOn;
                    }
                    Request::Command(_) if *state == DriveState::SwitchedOn => {
                        *state = DriveState::Enabled;
                    }
                    Request::Command(command) if *state == DriveState::Enabled => {
                        self.torque[j] = command.torque;
                        (self.position[j], self.kp[j]) = (command.position, command.kp);
                        self.velocity[j] = command.velocity;
                        if command.kp > 0.0 {
                            self.q[j] = command.position;
                        }
                    }
                    _ => {}
                }
                let mut reply = JointReply {
                    position: Some(self.q[j]),
                    velocity: Some(0.0),
                    torque: Some(0.0),
                    temperature: Some(30.0),
                    state: Some(*state),
                };
                if frames.is_empty() && change(j, &mut reply) {
                    joint.drive.reply(&reply, &mut frames);
                }
                if joint.drive.protocol == ODRIVE && !self.periods.is_multiple_of(self.heartbeat) {
                    // The heartbeat is the last one.
                    frames.pop();
                }
                answers.extend(frames.iter().map(|frame| (bus, *frame)));
            }
        }
        answers
    }

    /// So many periods at rest; the last one.
    fn rest(&mut self, controller: &mut Controller, periods: u32) -> BusTick<6> {
        let rest = JointMotion::zero();
        let ticks = (0..periods).map(|_| self.period(controller, Some(&rest), |_, _| true));
        ticks.last().unwrap()
    }

    /// Runs until the drives follow.
    fn started(&mut self) -> Controller {
        let mut controller = controller(config()).unwrap();
        for _ in 0..40 {
            self.rest(&mut controller, 1);
            let _ = controller.arm();
        }
        let running = matches!(controller.drives().phase(), BusPhase::Running(_));
        assert!(running, "{:?}", controller.drives().fault());
        controller
    }
}

#[test]
fn arms_after_the_scales_and_sends_torque_and_ramped_gains() {
    let mut drives = Drives::new();
    let mut controller = controller(config()).unwrap();
    let refusal = controller.arm().unwrap_err();
    assert_eq!(refusal.cause, FaultCause::Silent);
    drives.rest(&mut controller, 3);
    let refusal = controller.arm().unwrap_err();
    let unknown = matches!(refusal.cause, FaultCause::ScaleUnknown(_));
    assert!(unknown, "{refusal}");
    let mut controller = drives.started();
    let tick = drives.rest(&mut controller, 100);
    assert_eq!(tick.status.state, SafetyState::Armed);
    assert!(tick.measured.is_some());
    let total = tick.torque.total;
    assert!(total[1] <= -27.9, "the limit of the profile: {total}");
    for (j, (sent, wanted)) in drives.torque.iter().zip(&total).enumerate() {
        assert!((sent - wanted).abs() <= 0.05, "joint {j}");
    }
    assert_eq!(drives.order, [1, 4, 2, 5, 3, 6], "the buses take turns");
    controller.disarm();
    for _ in 0..600 {
        drives.period(&mut controller, None, |_, _| true);
    }
    let phase = controller.drives().phase();
    assert_eq!((phase, drives.on()), (BusPhase::Off, [false; 6]));
    assert!(controller.drives().fault().is_none());
}

#[test]
fn no_drive_is_switched_on_where_torque_may_not_flow() {
    let mut drives = Drives::new();
    let mut controller = drives.started();
    controller.disarm();
    drives.rest(&mut controller, 20);
    let refusal = controller.arm().expect_err("the drives damp");
    assert_eq!(refusal, SafetyReason::StillRamping.into());
    let mut mailbox = LearnerMailbox::default();
    controller.stop(&mut mailbox);
    let request = mailbox.exchange.request.map(|(_, request)| request);
    assert_eq!(request, Some(foretorque::learning::Request::Stop));
    drives.rest(&mut controller, 20);
    let refusal = controller.arm().expect_err("the stop stands");
    assert_eq!(refusal, SafetyReason::Stopped.into());
    drives.rest(&mut controller, 20);
    assert_eq!(drives.on(), [false; 6]);
    controller.clear().unwrap();
    drives.rest(&mut controller, 20);
    controller.arm().unwrap();
    let mut far = JointMotion::zero();
    far.q[1] = 0.25;
    for _ in 0..400 {
        drives.period(&mut controller, Some(&far), |_, _| true);
    }
    let fault = controller.drives().fault().expect("too far away");
    assert_eq!(fault, SafetyReason::TooFar.into());
    assert_eq!(drives.on(), [false; 6]);
}

#[test]
fn a_stop_switches_every_drive_off_with_its_next_frame() {
    for periods in 1..6 {
        let mut drives = Drives::new();
        let mut controller = drives.started();
        drives.rest(&mut controller, periods);
        controller.stop(&mut LearnerMailbox::default());
        drives.rest(&mut controller, 1);
        assert_eq!(drives.on(), [false; 6], "{periods}");
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
            let still = HostMessage::Sample(SampleFrame::new(&JointSample {
                desired: JointMotion::zero(),
                measured: None,
            }));
            board.period(&[still], |_, reply| {
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
    board.period(&[HostMessage::Sample(sample)], |_, _| true);
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

#[test]
fn a_fault_that_is_cleared_is_cleared_in_the_drive_too() {
    let mut drives = Drives::new();
    let mut controller = drives.started();
    drives.states[2] = DriveState::Fault(13);
    drives.rest(&mut controller, 600);
    let fault = controller.drives().fault().expect("of the third drive");
    assert_eq!(fault.joint, Some(2));
    controller.clear().unwrap();
    drives.rest(&mut controller, 20);
    assert_eq!(drives.states, [DriveState::Disabled; 6]);
    controller.arm().unwrap();
    drives.rest(&mut controller, 100);
    assert!(controller.drives().fault().is_none());
    assert_eq!(drives.on(), [true; 6]);
}

/// A board that is master of its drives, and its host.
struct Board {
    board: session::Board<BoardDrives<Ur5, 6, 40>>,
    drives: Drives,
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
        }
    }

    /// A period with these messages of the host; `change` may alter an answer of a drive.
    fn period(
        &mut self,
        messages: &[HostMessage<6>],
        change: impl Fn(usize, &mut JointReply) -> bool,
    ) {
        let mut sent = Vec::new();
        // As the tick's task of the firmware does it.
        let mut follow = |board: &mut session::Board<BoardDrives<Ur5, 6, 40>>| {
            let (session, drives) = (&mut board.session, &mut board.sensor);
            if drives.ticked() {
                drives.follow(session, false, |bus, frame| sent.push((bus, *frame)));
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
        let still = SampleFrame::new(&JointSample {
            desired: JointMotion::zero(),
            measured: None,
        });
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
            for joint in config().joints {
                let (mut frames, mut carry) = (Frames::new(), Carry::default());
                let command = JointCommand::default();
                joint.drive.command(&command, &mut carry, &mut frames);
                board.board.sensor.receive(0, &frames[0]);
                frames.clear();
                let reply = JointReply {
                    temperature: Some(celsius),
                    state: Some(DriveState::Enabled),
                    ..JointReply::default()
                };
                joint.drive.reply(&reply, &mut frames);
                board.board.sensor.receive(1, &frames[0]);
            }
            board.rest(1, &[HostMessage::Arm]);
        }
        let session = &board.board.session;
        let (flows, safety) = (session.torque_enabled(), session.safety());
        assert_eq!(flows, armed, "{celsius} °C: {safety}");
    }
}

#[test]
fn faults_of_the_replies_end_the_torque_with_their_joint() {
    type Change = fn(&mut JointReply) -> bool;
    fn set<T>(field: &mut T, value: T) -> bool {
        *field = value;
        true
    }
    let cases: [(&str, usize, Change); 5] = [
        ("joint 3: the drive does not answer", 2, |_| false),
        ("joint 3: the drive reports fault 0x9", 2, |reply| {
            set(&mut reply.state, Some(DriveState::Fault(9)))
        }),
        ("joint 3: the drive has switched itself off", 2, |reply| {
            set(&mut reply.state, Some(DriveState::Disabled))
        }),
        ("joint 3: desired position", 2, |reply| {
            set(&mut reply.position, Some(0.5))
        }),
        ("joint 5: the drive reports fault 0xd", 4, |reply| {
            set(&mut reply.state, Some(DriveState::Fault(0xd)))
        }),
    ];
    for (named, joint, change) in cases {
        let change = |j: usize, reply: &mut JointReply| j != joint || change(reply);
        let mut drives = Drives::new();
        let mut controller = drives.started();
        let rest = JointMotion::zero();
        for _ in 0..25 {
            drives.period(&mut controller, Some(&rest), change);
        }
        let fault = controller.drives().fault().expect(named).to_string();
        assert!(fault.starts_with(named), "{fault}");
        assert!(!controller.status().state.eq(&SafetyState::Armed));
        let off = drives.torque.iter().all(|torque| torque.abs() < 0.05);
        assert!(off, "{named}");
        for _ in 0..600 {
            drives.period(&mut controller, Some(&rest), change);
        }
        assert_eq!(controller.drives().phase(), BusPhase::Off, "{named}");
        let refusal = controller.arm().unwrap_err().to_string();
        assert_eq!(refusal, fault, "a fault stands");
        controller.clear().unwrap();
        assert!(controller.drives().fault().is_none());
    }
}

#[test]
fn a_scale_that_differs_and_a_bus_that_is_off_end_the_torque() {
    let mut drives = Drives::new();
    let mut controller = drives.started();
    let mut frames = Frames::new();
    let joint = config().joints[1];
    joint.drive.reply_scale(Scale::Torque, 20.0, &mut frames);
    controller.receive(0, &frames[0]);
    drives.rest(&mut controller, 1);
    let fault = controller.drives().fault().unwrap().to_string();
    let differs = "joint 2: scale of torque is 200 in the profile, 20 in the drive";
    assert_eq!(fault, differs);
    let mut controller = drives.started();
    controller.bus_off();
    assert_eq!(controller.status().state, SafetyState::RampDown);
    let fault = controller.drives().fault().unwrap().to_string();
    assert_eq!(fault, "the bus is off");
}

#[test]
fn foreign_frames_and_any_bits_change_no_torque() {
    let mut drives = Drives::new();
    let mut controller = drives.started();
    let strays = controller.drives().strays();
    for id in 0..0x800 {
        if id != 0x40 {
            controller.receive(0, &Frame::standard(id, &[0xa5; 8]));
        }
        controller.receive(7, &Frame::extended(id, &[0x5a; 64]));
    }
    assert_eq!(controller.drives().strays() - strays, 0xfff);
    let mut motion = JointMotion::<6>::zero();
    motion.q.fill(f32::NAN);
    let mut mailbox = LearnerMailbox::default();
    for _ in 0..100 {
        let tick = controller.tick(Some(&motion), &mut mailbox, |_, frame| {
            let sent = config()
                .joints
                .iter()
                .find_map(|joint| joint.drive.accept(frame));
            if let Some(Request::Command(command)) = sent {
                assert!(command.torque.abs() < 28.1 && command.position.is_finite());
            }
        });
        assert!(tick.torque.total.iter().all(|torque| torque.is_finite()));
    }
    assert_ne!(controller.status().state, SafetyState::Armed);
}
