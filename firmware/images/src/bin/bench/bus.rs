//! Six MIT drives on a bus: the loop of a master, and a command that passes in line from port to port.

use core::mem::MaybeUninit;

use foretorque::arm::ur5::{JOINTS, PARAMETERS, Ur5};
use foretorque::joint::JointMotion;
use foretorque_link::bank::Parameters;
use foretorque_link::bus::{BusConfig, BusController, BusJoint, BusPhase};
use foretorque_link::drives::in_line::{Bridge, InLine, Port};
use foretorque_link::drives::{
    Carry, DriveProfile, Frame, Frames, JointCommand, JointReply, Protocol, Ranges,
};
use foretorque_link::session::LearnerMailbox;

/// Largest number of periods until a loop runs whose drives all reply.
const START: usize = 40;

/// A loop whose drives stand still, and a board in line of the same drives.
pub(crate) struct Bus {
    controller: BusController<Ur5, JOINTS, PARAMETERS>,
    mailbox: LearnerMailbox<JOINTS, PARAMETERS>,
    replies: [Frame; JOINTS],
    bridge: Bridge<Mailbox, JOINTS>,
    command: Frame,
}

/// A port with room for one frame each way.
#[derive(Default)]
struct Mailbox {
    arrived: Option<Frame>,
    left: Option<Frame>,
}

impl Port for Mailbox {
    #[inline(always)]
    fn receive(&mut self) -> Option<Frame> {
        self.arrived.take()
    }

    #[inline(always)]
    fn send(&mut self, frame: &Frame, _: u32) -> bool {
        self.left = Some(*frame);
        true
    }

    #[inline(always)]
    fn expire(&mut self, _: u32, _: u32) -> u32 {
        0
    }
}

impl Bus {
    /// Initialises in place; `None` if the configuration contradicts the arm, or the loop does not start.
    #[inline(never)]
    pub(crate) fn init(place: &'static mut MaybeUninit<Self>) -> Option<&'static mut Self> {
        let joints = [1, 2, 3, 4, 5, 6].map(joint);
        let config = BusConfig {
            period_s: 1e-3,
            joints,
        };
        let mut frames = Frames::new();
        let replies = joints.map(|joint| {
            frames.clear();
            joint.drive.reply(&JointReply::default(), &mut frames);
            frames[0]
        });
        // The last joint is found after all others.
        let (command, mut carry) = (JointCommand::default(), Carry::default());
        frames.clear();
        joint(6).drive.command(&command, &mut carry, &mut frames);
        let mut in_line = InLine::new(joints.map(|joint| Some(joint.drive)), u32::MAX);
        in_line.set(&[1.0; JOINTS], 0);
        let bus = place.write(Self {
            controller: BusController::new(config, &Parameters::nominal::<Ur5>()).ok()?,
            mailbox: LearnerMailbox::default(),
            replies,
            bridge: Bridge::new(
                [Mailbox::default(), Mailbox::default()],
                Some(in_line),
                u32::MAX,
            ),
            command: frames[0],
        });
        for _ in 0..START {
            bus.tick();
            let _ = bus.controller.arm();
        }
        matches!(bus.controller.drives().phase(), BusPhase::Running(_)).then_some(bus)
    }

    /// One period: six replies in, six commands out.
    #[inline(always)]
    pub(crate) fn tick(&mut self) {
        for reply in &self.replies {
            self.controller.receive(0, reply);
        }
        let still = JointMotion::zero();
        let tick = self
            .controller
            .tick(Some(&still), &mut self.mailbox, |_, frame| {
                core::hint::black_box(frame);
            });
        core::hint::black_box(&tick);
    }

    /// One command that passes in line: taken, looked up, changed, queued and sent.
    #[inline(always)]
    pub(crate) fn pass(&mut self) {
        let [host, _] = self.bridge.ports();
        host.arrived = Some(self.command);
        self.bridge.pass(0, |_, frame| {
            core::hint::black_box(frame);
        });
        core::hint::black_box(self.bridge.ports());
    }
}

fn joint(id: u16) -> BusJoint {
    let ranges = Ranges {
        position: 12.5,
        velocity: 30.0,
        torque: 200.0,
        kp: 5000.0,
        kd: 500.0,
    };
    BusJoint {
        drive: DriveProfile {
            protocol: Protocol::MiniCheetah(ranges),
            id,
            host_id: 0,
            sign: 1.0,
            zero: 0.0,
            gear: 1.0,
            torque_limit: 28.0,
        },
        bus: 0,
        kp: 100.0,
        kd: 5.0,
    }
}
