//! Board in line between a host and its drives: passes every frame and adds a torque to the motion commands of its drives.
//!
//! Only the torque field of a motion command changes, and only while a torque is set that is younger than the time-out.
//! Otherwise, and for every other frame, the bytes that leave are the bytes that came. The torque field is that of MIT,
//! CyberGear, RobStride, ODrive and moteus, there where the host sends one. Commands of CiA 402 pass unchanged.

use super::frame::carried;
use super::{DriveProfile, Frame, JointCommand, Protocol, Request, cybergear, mit, moteus, odrive};
use heapless::Deque;

/// Torque added to the commands that pass, one per joint.
#[derive(Clone, Debug)]
pub struct InLine<const N: usize> {
    profiles: [Option<DriveProfile>; N],
    timeout: u32,
    /// Torques to add, N·m at the joint; `None` passes all frames unchanged.
    torques: Option<[f32; N]>,
    set_at: u32,
    /// Rounding errors of the added torques, in steps of their fields.
    carry: [f32; N],
    altered: u32,
}

impl<const N: usize> InLine<N> {
    /// Passes all frames unchanged until a torque is set. A torque is added for at most `timeout`, in counts of the clock
    /// that gives `now` elsewhere: free running, 32 bits.
    pub const fn new(profiles: [Option<DriveProfile>; N], timeout: u32) -> Self {
        Self {
            profiles,
            timeout,
            torques: None,
            set_at: 0,
            carry: [0.0; N],
            altered: 0,
        }
    }

    /// Sets the torques to add, N·m at the joints. A value that is not finite passes all frames unchanged.
    pub fn set(&mut self, torques: &[f32; N], now: u32) {
        let finite = torques.iter().all(|torque| torque.is_finite());
        self.torques = finite.then_some(*torques);
        self.set_at = now;
    }

    /// Passes all frames unchanged until the next [`Self::set`].
    pub fn clear(&mut self) {
        self.torques = None;
        self.carry = [0.0; N];
    }

    /// Number of frames changed, modulo 2³².
    pub const fn altered(&self) -> u32 {
        self.altered
    }

    /// Frame from the host on its way to the drives: adds the torque where it is a motion command.
    ///
    /// Joint and command as the host sent it; `None` for any other frame.
    pub fn to_drives(&mut self, frame: &mut Frame, now: u32) -> Option<(usize, JointCommand)> {
        let (joint, profile, command) =
            self.profiles
                .iter()
                .enumerate()
                .find_map(|(joint, profile)| {
                    let profile = profile.as_ref()?;
                    match profile.accept(frame)? {
                        Request::Command(command) => Some((joint, profile, command)),
                        Request::Order(_) => None,
                    }
                })?;
        if now.wrapping_sub(self.set_at) > self.timeout {
            // Stays off when the clock comes round again.
            self.torques = None;
        }
        let torque = self.torques.and_then(|torques| torques.get(joint).copied());
        if let Some((torque, carry)) = torque.zip(self.carry.get_mut(joint)) {
            // The sum stays within the limit; what the host itself sends beyond it is not reduced.
            let (low, high) = (-profile.torque_limit, profile.torque_limit);
            let room = (
                (low - command.torque).min(0.0),
                (high - command.torque).max(0.0),
            );
            let added = torque.max(room.0).min(room.1);
            if added != 0.0 && add(profile, frame, added, carry) {
                self.altered = self.altered.wrapping_add(1);
            }
        }
        Some((joint, command))
    }
}

/// Adds a torque, N·m at the joint, to a motion command. `false`: the frame is unchanged.
fn add(profile: &DriveProfile, frame: &mut Frame, torque: f32, carry: &mut f32) -> bool {
    let torque = torque / (profile.sign * profile.gear);
    let before = *frame;
    let steps = |size: f32, carry: &mut f32| carried(torque / size, carry, -0xffff, 0xffff);
    match &profile.protocol {
        Protocol::MiniCheetah(ranges) | Protocol::Damiao(ranges) => {
            mit::add_torque(frame, steps(2.0 * ranges.torque / 4095.0, carry));
        }
        Protocol::CyberGear(ranges) | Protocol::RobStride(ranges) => {
            cybergear::add_torque(frame, steps(2.0 * ranges.torque / 65535.0, carry));
        }
        Protocol::Odrive(scales) => {
            odrive::add_torque(frame, torque, steps(1.0 / scales.torque_scale, carry));
        }
        Protocol::Moteus(_) => moteus::add_torque(frame, torque, carry),
        Protocol::Cia402(_) => {}
    }
    *frame != before
}

/// Controller of one bus.
pub trait Port {
    /// Oldest received frame.
    fn receive(&mut self) -> Option<Frame>;
    /// Gives a frame to the controller. `false`: it has no room now.
    fn send(&mut self, frame: &Frame) -> bool;
}

/// Both ports of a board. In line, port 0 is that of the host and port 1 that of the drives.
///
/// A frame leaves once it has arrived as a whole: that delays it by its own time on the bus, and by one [`Self::pass`].
#[derive(Debug)]
pub struct Bridge<P, const N: usize> {
    ports: [P; 2],
    queues: [Deque<Frame, QUEUE>; 2],
    /// Torques to add in line; `None` where the board is the master and no frame passes.
    in_line: Option<InLine<N>>,
    lost: u32,
}

/// Frames that wait for a busy bus, each way: 1.7 ms of MIT frames.
const QUEUE: usize = 16;

impl<P: Port, const N: usize> Bridge<P, N> {
    /// A bridge between two started ports.
    pub const fn new(ports: [P; 2], in_line: Option<InLine<N>>) -> Self {
        Self {
            ports,
            queues: [const { Deque::new() }; 2],
            in_line,
            lost: 0,
        }
    }

    /// Queues a frame of the board itself.
    pub fn send(&mut self, port: u8, frame: Frame) {
        if let Some(queue) = self.queues.get_mut(usize::from(port)) {
            self.lost = self.lost.wrapping_add(append(queue, frame));
        }
    }

    /// Sets the torques to add, N × N·m, or passes all frames unchanged.
    pub fn add(&mut self, torques: Option<&[f32; N]>, now: u32) {
        match (&mut self.in_line, torques) {
            (Some(in_line), Some(torques)) => in_line.set(torques, now),
            (Some(in_line), None) => in_line.clear(),
            (None, _) => {}
        }
    }

    /// Takes and passes what has arrived; calls `seen` with port and frame as it arrived. Called when a frame has arrived
    /// or a mailbox is empty again.
    ///
    /// * `now` count of the clock of [`InLine`]
    ///
    /// Cost: at most 16 frames each way.
    pub fn pass(&mut self, now: u32, mut seen: impl FnMut(u8, &Frame)) {
        let [host, drives] = &mut self.ports;
        let [to_host, to_drives] = &mut self.queues;
        let ways = [(host, to_drives), (drives, to_host)];
        for (way, (port, queue)) in ways.into_iter().enumerate() {
            for _ in 0..QUEUE {
                let Some(mut frame) = port.receive() else {
                    break;
                };
                seen(way as u8, &frame);
                if let Some(in_line) = &mut self.in_line {
                    if way == 0 {
                        in_line.to_drives(&mut frame, now);
                    }
                    self.lost = self.lost.wrapping_add(append(queue, frame));
                }
            }
        }
        for (queue, port) in self.queues.iter_mut().zip(&mut self.ports) {
            for _ in 0..QUEUE {
                let sent = queue.front().is_some_and(|frame| port.send(frame));
                if !sent {
                    break;
                }
                queue.pop_front();
            }
        }
    }

    /// Number of frames dropped because a bus stood still, modulo 2³².
    pub const fn lost(&self) -> u32 {
        self.lost
    }

    /// The ports.
    pub const fn ports(&mut self) -> &mut [P; 2] {
        &mut self.ports
    }
}

/// Appends a frame; drops the oldest one, which is late, where the queue is full. Number of frames dropped.
fn append(queue: &mut Deque<Frame, QUEUE>, frame: Frame) -> u32 {
    let dropped = queue.is_full() && queue.pop_front().is_some();
    let room = queue.push_back(frame);
    debug_assert!(room.is_ok(), "a place was made");
    dropped.into()
}

#[cfg(test)]
mod tests {
    //! Frames that pass a board in line: foreign ones unchanged and in order, commands with the torque added.

    use super::super::tests::{PROTOCOLS, profile};
    use super::super::{Carry, Frames, JointReply, Order, Resolution};
    use super::*;

    const TIMEOUT_US: u32 = 5000;

    /// Xorshift64*.
    struct Random(u64);

    impl Random {
        fn next(&mut self) -> u64 {
            self.0 ^= self.0 >> 12;
            self.0 ^= self.0 << 25;
            self.0 ^= self.0 >> 27;
            self.0.wrapping_mul(0x2545_F491_4F6C_DD1D)
        }

        fn share(&mut self) -> f32 {
            (self.next() >> 40) as f32 / (1 << 24) as f32
        }
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
        let _ = profile.command(command, &mut Carry::default(), &mut frames);
        frames[0]
    }

    fn torque_of(profile: &DriveProfile, frame: &Frame) -> f32 {
        match profile.accept(frame) {
            Some(Request::Command(command)) => command.torque,
            other => panic!("{frame:?}: {other:?}"),
        }
    }

    /// A frame of the mix, and the joint whose motion command it is.
    fn mixed(arm: &[DriveProfile; 3], random: &mut Random) -> (Frame, Option<usize>) {
        let joint = (random.next() % 3) as usize;
        let (profile, mut frames) = (&arm[joint], Frames::new());
        match random.next() % 4 {
            0 => {
                let command = JointCommand {
                    position: random.share(),
                    torque: 12.0 * random.share() - 6.0,
                    kp: 50.0 * random.share(),
                    ..JointCommand::default()
                };
                return (sent(profile, &command), Some(joint));
            }
            1 => {
                use Order::{ClearFault, Disable, Enable, SetZero};
                let order = [Enable, Disable, ClearFault, SetZero][(random.next() % 4) as usize];
                profile.order(order, &mut frames);
            }
            2 => profile.reply(&JointReply::default(), &mut frames),
            _ => {
                let data = random.next().to_le_bytes();
                let bytes = &data[..(random.next() % 9) as usize];
                let id = random.next() as u32;
                let frame = Frame::new(id, random.next().is_multiple_of(2), bytes);
                let own = arm.iter().position(|profile| {
                    matches!(profile.accept(&frame), Some(Request::Command(_)))
                });
                return (frame, own);
            }
        }
        (frames[0], None)
    }

    #[test]
    fn a_million_mixed_frames_pass_in_order() {
        let (arm, mut random) = (arm(), Random(7));
        let mut board = InLine::new(arm.map(Some), TIMEOUT_US);
        // As on the board: one queue each way, drained a few frames at a time.
        let mut queue = heapless::Deque::<Frame, 16>::new();
        let (mut expected, mut foreign, mut changed) = (std::collections::VecDeque::new(), 0, 0);
        let added = [1.5, -0.75, 0.25];
        for number in 0..1_000_000_u32 {
            let now_us = number.wrapping_mul(100);
            if number.is_multiple_of(10) {
                board.set(&added, now_us);
            }
            let (sent, joint) = mixed(&arm, &mut random);
            let mut passed = sent;
            if random.next().is_multiple_of(2) {
                let seen = board.to_drives(&mut passed, now_us);
                assert_eq!(seen.map(|(joint, _)| joint), joint, "{sent:?}");
                match joint {
                    Some(joint) => {
                        let profile = &arm[joint];
                        let want = (torque_of(profile, &sent) + added[joint]).clamp(-9.0, 9.0);
                        let got = torque_of(profile, &passed);
                        let near =
                            (got - want).abs() < 0.01 || torque_of(profile, &sent).abs() > 8.9;
                        assert!(near, "{sent:?} {passed:?}: {got} for {want}");
                        changed += 1;
                    }
                    None => {
                        assert_eq!(passed, sent);
                        foreign += 1;
                    }
                }
            } else {
                foreign += 1;
            }
            queue.push_back(passed).unwrap();
            expected.push_back(passed);
            while !queue.is_empty() && (queue.is_full() || !random.next().is_multiple_of(3)) {
                assert_eq!(queue.pop_front(), expected.pop_front());
            }
        }
        let many = foreign > 600_000 && changed > 100_000;
        assert!(many, "{foreign} {changed}");
    }

    #[test]
    fn without_a_young_torque_nothing_changes() {
        let (arm, mut random) = (arm(), Random(9));
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
        assert!(cases.iter().all(|board| board.altered() == 0));
        // A torque that has expired stays off when the clock of 32 bits comes round.
        let [_, _, mut late, ..] = cases;
        let sent = sent(&arm[0], &JointCommand::default());
        let mut passed = sent;
        let _ = late.to_drives(&mut passed, now - TIMEOUT_US);
        assert_eq!(passed, sent);
    }

    #[test]
    fn added_torque_has_no_bias_and_makes_no_order() {
        let (arm, mut random) = (arm(), Random(11));
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
                let data = random.next().to_le_bytes().map(|byte| byte | 0xfe);
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
        mailboxes: std::vec::Vec<Frame>,
        left: std::vec::Vec<Frame>,
    }

    impl Port for Wire {
        fn receive(&mut self) -> Option<Frame> {
            self.arrived.pop_front()
        }

        fn send(&mut self, frame: &Frame) -> bool {
            let room = self.mailboxes.len() < 3;
            self.mailboxes.extend(room.then_some(*frame));
            room
        }
    }

    #[test]
    fn a_bridge_passes_both_ways_in_order_and_outlives_a_dead_bus() {
        let (arm, mut random) = (arm(), Random(13));
        let line = InLine::new(arm.map(Some), TIMEOUT_US);
        let mut bridge = Bridge::new([Wire::default(), Wire::default()], Some(line));
        let (mut sent, mut seen) = ([std::vec![], std::vec![]], [0, 0]);
        let mut rounds = |bridge: &mut Bridge<Wire, 3>, count: u32, alive: bool| {
            for round in 0..count {
                let (frame, _) = mixed(&arm, &mut random);
                let way = (random.next() % 2) as usize;
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
        assert_eq!(seen, sent.each_ref().map(std::vec::Vec::len));
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
        let mut bridge = Bridge::<Wire, 3>::new([Wire::default(), Wire::default()], None);
        let frame = |id| Frame::standard(id, &[0; 8]);
        bridge.ports()[0].arrived.push_back(frame(1));
        for id in 2..6 {
            bridge.send(1, frame(id));
        }
        let mut seen = std::vec![];
        bridge.pass(0, |port, frame| seen.push((port, *frame)));
        assert_eq!(seen, [(0, frame(1))]);
        let [host, drives] = bridge.ports();
        assert!(host.mailboxes.is_empty());
        assert_eq!(drives.mailboxes, [2, 3, 4].map(frame));
    }

    #[test]
    fn torque_is_added_to_every_form_of_a_moteus_command_that_has_the_field() {
        for resolution in [Resolution::Int16, Resolution::Int32, Resolution::F32] {
            let mut drive = profile(PROTOCOLS[4].0);
            let Protocol::Moteus(scales) = &mut drive.protocol else {
                panic!("{drive:?}");
            };
            scales.resolution = resolution;
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
            assert!(near, "{resolution:?} {passed:?}");
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
        assert_eq!((passed, board.altered()), (sent, 0));
    }
}
