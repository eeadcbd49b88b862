use super::*;
use crate::drives::{
    ControlMode, DriveProfile, DriveState, Frame, Frames, JointReply, Odrive, Order, Protocol,
    Ranges, Request, Scale,
};
use crate::safety::SafetyState;
use crate::session::LearnerMailbox;
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
pub(super) fn config_of(protocol: Protocol) -> BusConfig<6> {
    let mut config = config();
    config
        .joints
        .iter_mut()
        .for_each(|joint| joint.drive.protocol = protocol);
    config
}

/// Position, velocity and torque in the frames; the gains and the temperatures are not.
pub(super) const ODRIVE: Protocol = Protocol::Odrive(Odrive {
    mode: ControlMode::Position,
    velocity_scale: 1000.0,
    torque_scale: 1000.0,
    torque_scale_endpoint: 0,
    polled: true,
});

/// Drives that stand where they are set, with a switch for each.
pub(super) struct Drives {
    pub(super) config: BusConfig<6>,
    pub(super) states: [DriveState; 6],
    /// CANopen: nodes that were started.
    pub(super) started: [bool; 6],
    /// The drives answer no question for a scale.
    pub(super) mute: bool,
    /// A drive whose scale of torque is not that of the profile.
    pub(super) other_scale: Option<(usize, f32)>,
    /// ODrive: periods between two heartbeats, and periods so far.
    pub(super) heartbeat: u32,
    periods: u32,
    /// Positions, velocities and stiffness of the last commands.
    pub(super) position: [f32; 6],
    pub(super) velocity: [f32; 6],
    pub(super) kp: [f32; 6],
    pub(super) q: [f32; 6],
    pub(super) torque: [f32; 6],
    order: Vec<u16>,
}

impl Drives {
    fn new() -> Self {
        Self::of(config())
    }

    pub(super) fn of(config: BusConfig<6>) -> Self {
        Self {
            config,
            states: [DriveState::Disabled; 6],
            started: [false; 6],
            mute: false,
            other_scale: None,
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

    pub(super) fn on(&self) -> [bool; 6] {
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
    pub(super) fn answers(
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
                        let other = self.other_scale.filter(|&(joint, _)| joint == j);
                        let value = match (scale, other) {
                            (Scale::Torque, Some((_, other))) => other,
                            _ => value[scale as usize],
                        };
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
                if frames.is_empty() && joint.drive.answers(&frame) && change(j, &mut reply) {
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
