//! The board on a drive bus, in the emulator and as its twin in this process: master of six simulated drives, in line
//! between a host and drives, and between moteus' own client and one moteus.

use foretorque::arm::ur5::{JOINTS, PARAMETERS, Ur5};
use foretorque::joint::{JointSample, JointVector};
use foretorque::learning::ParameterSet;
use foretorque_link::bank::ParameterBank;
use foretorque_link::bus::{BoardDrives, BusJoint, Role, Wires, Wiring};
use foretorque_link::drives::in_line::InLine;
use foretorque_link::drives::text::{Direction, read_line, write_line};
use foretorque_link::drives::{
    Carry, DriveProfile, DriveState, Frame, Frames, JointCommand, JointReply, Moteus, Protocol,
    Request, Resolution,
};
use foretorque_link::safety::SafetyState;
use foretorque_link::wire::Configuration;
use foretorque_workbench::board::qemu::{Emulator, Image, QemuOptions};
use foretorque_workbench::board::{Client, Native, Transport};
use foretorque_workbench::bus::sim::{SimulatedNetwork, plant_config};
use foretorque_workbench::bus::{Network, Profile};
use foretorque_workbench::closed_loop::motion_f32;
use foretorque_workbench::dynamics::{Joints, State};
use foretorque_workbench::plant::{Plant, PlantConfig};
use foretorque_workbench::robot::{Perturbation, Robot};
use foretorque_workbench::trajectory::Trajectory;
use foretorque_workbench::trajectory::via::ViaPath;
use std::cell::RefCell;
use std::io::{self, Read, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::rc::Rc;
use std::time::Duration;

const PATIENCE: Duration = Duration::from_secs(10);
/// The longest command of a host is shorter than a sample.
const SAMPLE_BYTES: usize = 70;

type Drives = BoardDrives<Ur5, JOINTS, PARAMETERS>;
/// Frames with the ports at which they arrive or leave.
type Ported = Vec<(u8, Frame)>;

/// A board whose ports the host sees.
trait FrameBoard: Transport {
    /// Frames arrive at the ports; returns when the board has taken them and what follows from them at once.
    fn deliver(&mut self, frames: &[(u8, Frame)]);
    /// Frames that have left.
    fn left(&mut self) -> Ported;
}

/// The twin in this process.
struct Twin {
    board: Native<Ur5, JOINTS, PARAMETERS, Drives>,
    in_line: Option<InLine<JOINTS>>,
    left: Ported,
}

impl Twin {
    fn new(wiring: &Wiring<JOINTS>) -> Self {
        let profiles = std::array::from_fn(|j| wiring.joints[j].map(|joint| joint.drive));
        let in_line = wiring.role == Role::InLine;
        Self {
            board: Native::with_sensor(Drives::new(wiring)).expect("usable limits"),
            in_line: in_line.then(|| InLine::new(profiles, 1)),
            left: Vec::new(),
        }
    }
}

impl Transport for Twin {
    fn name(&self) -> String {
        self.board.name()
    }

    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.board.send(bytes)?;
        let (session, drives) = self.board.parts();
        if !drives.ticked() {
            let in_line = self.in_line.as_mut().filter(|_| !session.torque_enabled());
            in_line.into_iter().for_each(InLine::clear);
            return Ok(());
        }
        let left = &mut self.left;
        let torques = drives.follow(session, false, |bus, frame| left.push((bus, *frame)));
        match (&mut self.in_line, torques) {
            (Some(in_line), Some(torques)) => in_line.set(&torques.data.0[0], 0),
            (Some(in_line), None) => in_line.clear(),
            (None, _) => {}
        }
        Ok(())
    }

    fn receive(&mut self, buffer: &mut [u8], timeout: Duration) -> io::Result<usize> {
        self.board.receive(buffer, timeout)
    }
}

impl FrameBoard for Twin {
    fn deliver(&mut self, frames: &[(u8, Frame)]) {
        for &(port, mut frame) in frames {
            let (_, drives) = self.board.parts();
            drives.receive(port, &frame);
            if let Some(in_line) = &mut self.in_line {
                if port == 0 {
                    in_line.to_drives(&mut frame, 0);
                }
                self.left.push((1 - port, frame));
            }
        }
    }

    fn left(&mut self) -> Ported {
        std::mem::take(&mut self.left)
    }
}

/// The board in the emulator, with lines on its ports.
struct Emulated {
    board: Emulator,
    ports: [TextEnd; 2],
    /// Every frame leaves again.
    passes: bool,
    left: Ported,
}

/// The host's end of a port.
struct TextEnd {
    stream: UnixStream,
    bytes: Vec<u8>,
}

impl TextEnd {
    /// Whole lines that have come; waits for some where `waits`.
    fn lines(&mut self, waits: bool) -> Vec<Vec<u8>> {
        let mut buffer = [0; 4096];
        self.stream.set_nonblocking(!waits).expect("it can");
        match self.stream.read(&mut buffer) {
            Ok(count) => self.bytes.extend_from_slice(&buffer[..count]),
            Err(error) if !waits && error.kind() == io::ErrorKind::WouldBlock => {}
            Err(error) => panic!("the board is silent: {error}"),
        }
        self.stream.set_nonblocking(false).expect("it can");
        let whole = self.bytes.iter().rposition(|byte| *byte == b'\n');
        let rest = self.bytes.split_off(whole.map_or(0, |end| end + 1));
        let lines = std::mem::replace(&mut self.bytes, rest);
        let lines = lines
            .split(|byte| *byte == b'\n')
            .filter(|line| !line.is_empty());
        lines.map(<[u8]>::to_vec).collect()
    }
}

/// A file with the drives of a board, `None` with zeros.
fn wiring_file(name: &str, wiring: Option<&Wiring<JOINTS>>) -> PathBuf {
    let mut buffer = [0; Wiring::<JOINTS>::BYTES];
    let bytes = match wiring {
        Some(wiring) => wiring.encode(&mut buffer).expect("it fits").to_vec(),
        None => buffer.to_vec(),
    };
    let file = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("{name}.wiring"));
    std::fs::write(&file, bytes).expect("it can be written");
    file
}

impl Emulated {
    fn start(name: &str, wiring: Option<&Wiring<JOINTS>>) -> Self {
        let mut options = QemuOptions::new(Image::Joint);
        options.elf.set_file_name("joint-can");
        options.wiring = Some(wiring_file(name, wiring));
        let mut board = Emulator::start(&options).unwrap_or_else(|error| panic!("{error}"));
        let ports = board.take_frame_ports().expect("it has a wiring");
        let ports = ports.map(|end| {
            let stream = UnixStream::from(end);
            stream.set_read_timeout(Some(PATIENCE)).expect("it can");
            TextEnd {
                stream,
                bytes: Vec::new(),
            }
        });
        Self {
            board,
            ports,
            passes: wiring.is_none_or(|wiring| wiring.role == Role::InLine),
            left: Vec::new(),
        }
    }

    /// Takes what a port has sent: frames; the number of acknowledgements.
    fn take(&mut self, port: usize, waits: bool) -> usize {
        let mut acknowledged = 0;
        for line in self.ports[port].lines(waits) {
            match read_line(&line) {
                Some(frame) => self.left.push((port as u8, frame)),
                None => acknowledged += usize::from(line == b"OK"),
            }
        }
        acknowledged
    }
}

impl Transport for Emulated {
    fn name(&self) -> String {
        self.board.name()
    }

    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.board.send(bytes)
    }

    fn receive(&mut self, buffer: &mut [u8], timeout: Duration) -> io::Result<usize> {
        self.board.receive(buffer, timeout)
    }
}

impl FrameBoard for Emulated {
    fn deliver(&mut self, frames: &[(u8, Frame)]) {
        // One after the other, so that the order over both ports is that of the twin.
        for (port, frame) in frames {
            let port = usize::from(*port);
            let line = write_line(frame, Direction::Receive);
            self.ports[port]
                .stream
                .write_all(&line)
                .expect("it listens");
            let mut acknowledged = 0;
            while acknowledged == 0 {
                acknowledged += self.take(port, true);
            }
            let before = self.left.len();
            while self.passes && self.left.len() == before {
                self.take(1 - port, true);
            }
        }
    }

    fn left(&mut self) -> Ported {
        for port in 0..2 {
            self.take(port, false);
        }
        std::mem::take(&mut self.left)
    }
}

/// A master and its simulated drives: each sample of the host begins with a period of theirs.
struct OnBus<B> {
    board: B,
    network: Rc<RefCell<SimulatedNetwork<JOINTS>>>,
    sent: Rc<RefCell<Ported>>,
}

impl<B: FrameBoard> Transport for OnBus<B> {
    fn name(&self) -> String {
        self.board.name()
    }

    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        if bytes.len() > SAMPLE_BYTES {
            let mut network = self.network.borrow_mut();
            for (bus, frame) in self.board.left() {
                network.send(bus, &frame).expect("it is simulated");
                self.sent.borrow_mut().push((bus, frame));
            }
            network.wait();
            let replies = std::iter::from_fn(|| network.receive().expect("it is simulated"));
            self.board.deliver(&replies.collect::<Vec<_>>());
        }
        self.board.send(bytes)
    }

    fn receive(&mut self, buffer: &mut [u8], timeout: Duration) -> io::Result<usize> {
        self.board.receive(buffer, timeout)
    }
}

fn profile(rate_hz: f64) -> Profile {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../profiles/sim-ur5.toml");
    let mut profile = Profile::load(&file).expect("it is a profile");
    profile.rate_hz = rate_hz;
    profile
}

fn wiring(profile: &Profile, role: Role) -> Wiring<JOINTS> {
    profile
        .wiring::<Ur5, JOINTS, PARAMETERS>(role, Wires::Can)
        .expect("it fits the arm")
}

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
    let robot = Robot::load("ur5").expect("built in");
    let path: Trajectory<JOINTS> = Trajectory::Via(ViaPath::random(&robot, 1, 40.0, 2.0));
    let truth = robot.perturbed(1, &Perturbation::PLANT);
    let plant = plant_config(PlantConfig::default());
    let mut plant = Plant::<JOINTS>::new(&truth, plant, 1).expect("six joints");
    plant.place(&path.at(0.0).q);
    let config = profile
        .config::<Ur5, JOINTS, PARAMETERS>()
        .expect("it fits the arm");
    let noise = Joints::from_fn(|j, _| if j < 3 { 1.5 } else { 0.28 });
    let network = SimulatedNetwork::new(plant, &config, profile.bus[0], &noise, 1);
    let (network, sent) = (Rc::new(RefCell::new(network)), Rc::default());
    let on_bus = OnBus {
        board,
        network: Rc::clone(&network),
        sent: Rc::clone(&sent),
    };
    let mut client = Client::connect::<Ur5, PARAMETERS>(Box::new(on_bus), PATIENCE)
        .unwrap_or_else(|error| panic!("{error}"));
    client.set_timeout(PATIENCE);
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
    for rate_hz in [500.0, 1000.0] {
        let wiring = wiring(&profile(rate_hz), Role::Master);
        let expected = ride(Twin::new(&wiring), rate_hz, 0.8, true);
        let name = format!("master-{rate_hz}");
        let seen = ride(Emulated::start(&name, Some(&wiring)), rate_hz, 0.8, true);
        assert!(seen.torques == expected.torques, "{rate_hz} Hz: torques");
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
            "{rate_hz} Hz: {frames} and {} frames, first difference {differs:?}: {first:?}",
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
}

/// Frames of one period on a line: commands of a host, replies, and frames of no drive.
fn traffic(wiring: &Wiring<JOINTS>, period: u32) -> Ported {
    let mut ported = Vec::new();
    let mut frames = Frames::new();
    let q = |joint: usize| 0.1 * (0.02 * f64::from(period) + joint as f64).sin() as f32;
    for (index, joint) in wiring.joints.iter().flatten().enumerate() {
        let command = JointCommand {
            position: q(index),
            kp: joint.kp,
            kd: joint.kd,
            ..JointCommand::default()
        };
        frames.clear();
        let _ = joint
            .drive
            .command(&command, &mut Carry::default(), &mut frames);
        ported.extend(frames.iter().map(|frame| (0, *frame)));
        let foreign = [period as u8, index as u8, 0xff, 0xff];
        ported.push((0, Frame::standard(0x300 + index as u32, &foreign)));
        ported.push((1, Frame::extended(0x1234_5600 + period, &foreign)));
        frames.clear();
        let reply = JointReply {
            position: Some(q(index)),
            torque: Some(0.3 * q(index)),
            state: Some(DriveState::Enabled),
            ..JointReply::default()
        };
        joint.drive.reply(&reply, &mut frames);
        ported.extend(frames.iter().map(|frame| (1, *frame)));
    }
    ported
}

/// A board in line: each sample of the host begins with a period of traffic.
struct OnLine<B> {
    board: B,
    wiring: Wiring<JOINTS>,
    rounds: Rc<RefCell<Rounds>>,
}

/// Frames that came in each period, and those that left for it.
type Rounds = Vec<(Ported, Ported)>;

impl<B: FrameBoard> Transport for OnLine<B> {
    fn name(&self) -> String {
        self.board.name()
    }

    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        if bytes.len() > SAMPLE_BYTES {
            let mut rounds = self.rounds.borrow_mut();
            let came = traffic(&self.wiring, rounds.len() as u32);
            self.board.deliver(&came);
            rounds.push((came, self.board.left()));
        }
        self.board.send(bytes)
    }

    fn receive(&mut self, buffer: &mut [u8], timeout: Duration) -> io::Result<usize> {
        self.board.receive(buffer, timeout)
    }
}

fn of_port(frames: &Ported, port: u8) -> Vec<Frame> {
    let of = frames.iter().filter(|(at, _)| *at == port);
    of.map(|(_, frame)| *frame).collect()
}

/// Arms a board in line and stops it again; the frames that have left. Only torques of commands differ, by the board's.
fn pass(board: impl FrameBoard + 'static, wiring: &Wiring<JOINTS>) -> Rounds {
    let rounds = Rc::new(RefCell::new(Rounds::new()));
    let on_line = OnLine {
        board,
        wiring: wiring.clone(),
        rounds: Rc::clone(&rounds),
    };
    let mut client = Client::<JOINTS>::connect::<Ur5, PARAMETERS>(Box::new(on_line), PATIENCE)
        .unwrap_or_else(|error| panic!("{error}"));
    client.set_timeout(PATIENCE);
    // The motion that passes takes the place of this one.
    let idle = idle();
    let mut torques = std::collections::BTreeMap::new();
    for period in 0..60 {
        let reply = client.sample(&idle).expect("a torque");
        if reply.safety.state == SafetyState::Armed {
            torques.insert(rounds.borrow().len(), reply.total);
        }
        match period {
            20 => client.arm(&idle).expect("it can be armed"),
            45 => {
                torques.remove(&rounds.borrow().len());
                client.stop().expect("it obeys");
            }
            _ => {}
        }
    }
    assert!(torques.len() > 20 && torques.values().any(|torque| torque.amax() > 10.0));
    let drives: Vec<DriveProfile> = wiring.joints.iter().flatten().map(|j| j.drive).collect();
    let rounds = rounds.borrow().clone();
    let mut changed = 0;
    for (period, (came, left)) in rounds.iter().enumerate() {
        for port in 0..2 {
            let (came, left) = (of_port(came, port), of_port(left, 1 - port));
            assert_eq!(came.len(), left.len(), "period {period}");
            for (came, left) in came.into_iter().zip(left) {
                let joint = drives.iter().position(|drive| {
                    port == 0 && matches!(drive.accept(&came), Some(Request::Command(_)))
                });
                let Some((joint, torque)) = joint.zip(torques.get(&period)) else {
                    assert_eq!(came, left, "period {period}");
                    continue;
                };
                let Some(Request::Command(command)) = drives[joint].accept(&left) else {
                    panic!("{left:?}");
                };
                let error = (command.torque - torque[joint]).abs();
                let step = drives[joint].torque_resolution();
                assert!(
                    error <= 2.0 * step,
                    "period {period}, joint {joint}: {command:?}, {torque}"
                );
                changed += u32::from(came != left);
            }
        }
    }
    assert!(changed > 60, "{changed} commands changed");
    rounds
}

fn idle() -> JointSample<JOINTS> {
    JointSample {
        desired: motion_f32(&State::rest(Joints::zeros())),
        measured: None,
    }
}

#[test]
fn a_board_in_line_adds_its_torque_to_commands_alone() {
    let mut profile = profile(500.0);
    // One bus carries all.
    profile.joint.iter_mut().for_each(|joint| joint.bus = 0);
    let wiring = wiring(&profile, Role::InLine);
    let twin = pass(Twin::new(&wiring), &wiring);
    let emulated = pass(Emulated::start("in-line", Some(&wiring)), &wiring);
    for (period, ((_, one), (_, other))) in twin.iter().zip(&emulated).enumerate() {
        for port in 0..2 {
            assert!(
                of_port(one, port) == of_port(other, port),
                "period {period}"
            );
        }
    }
}

#[test]
fn a_board_without_a_wiring_passes_every_frame_and_refuses_to_arm() {
    let wiring = wiring(&profile(500.0), Role::InLine);
    let mut board = Emulated::start("no-wiring", None);
    for period in 0..5 {
        let sent = traffic(&wiring, period);
        board.deliver(&sent);
        let left = board.left();
        for port in 0..2 {
            assert_eq!(
                of_port(&sent, port),
                of_port(&left, 1 - port),
                "period {period}"
            );
        }
    }
    let mut client = Client::<JOINTS>::connect::<Ur5, PARAMETERS>(Box::new(board), PATIENCE)
        .unwrap_or_else(|error| panic!("{error}"));
    let refused = client.arm(&idle()).expect_err("there are no drives");
    assert!(refused.to_string().contains("drive fault"), "{refused}");
}

/// Talks to one moteus by its own client, through the board.
const MOTEUS_CLIENT: &str = r#"
import asyncio, sys, moteus
async def main():
    transport = moteus.Fdcanusb(sys.argv[1])
    drive = moteus.Controller(id=1, transport=transport)
    for _ in range(20):
        reply = await asyncio.wait_for(
            drive.set_position(position=0.5, velocity=0.0, feedforward_torque=0.25, query=True), 10)
        values = reply.values
        print(values[moteus.Register.MODE], values[moteus.Register.POSITION], values[moteus.Register.TORQUE], flush=True)
asyncio.run(main())
"#;

#[test]
fn the_client_of_moteus_drives_its_motor_through_the_board() {
    let python = std::env::var("FORETORQUE_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let there = Command::new(&python)
        .args(["-c", "import moteus"])
        .stderr(Stdio::null())
        .status();
    if !there.is_ok_and(|status| status.success()) {
        println!("skipped: {python} has no package moteus; FORETORQUE_PYTHON names one that has");
        return;
    }
    let drive = DriveProfile {
        protocol: Protocol::Moteus(Moteus {
            kp: 4.0,
            kd: 0.05,
            watchdog_s: 0.1,
            resolution: Resolution::F32,
        }),
        id: 1,
        host_id: 0,
        sign: 1.0,
        zero: 0.0,
        gear: 1.0,
        torque_limit: 5.0,
    };
    let mut wiring = wiring(&profile(500.0), Role::InLine);
    wiring.wires = Wires::Uart;
    for (joint, slot) in wiring.joints.iter_mut().enumerate() {
        let only = slot.map(|slot| BusJoint {
            drive,
            bus: 0,
            ..slot
        });
        *slot = only.filter(|_| joint == 0);
    }
    let mut board = Emulated::start("moteus", Some(&wiring));
    let [host, motor] = &mut board.ports;
    let (mut near, far) = serialport::TTYPort::pair().expect("the system has pseudo-terminals");
    let path = serialport::SerialPort::name(&far).expect("it has a name");
    serialport::SerialPort::set_timeout(&mut near, Duration::from_millis(1)).expect("it can");
    let mut client = Command::new(&python)
        .args(["-c", MOTEUS_CLIENT, &path])
        .stdout(Stdio::piped())
        .spawn()
        .expect("it starts");
    let deadline = std::time::Instant::now() + Duration::from_secs(60);
    let (mut taken, mut buffer) = (0, [0; 512]);
    host.stream.set_nonblocking(true).expect("it can");
    while client.try_wait().expect("it is ours").is_none() {
        assert!(
            std::time::Instant::now() < deadline,
            "{taken} commands came"
        );
        if let Ok(count) = near.read(&mut buffer) {
            host.stream.set_nonblocking(false).expect("it can");
            host.stream.write_all(&buffer[..count]).expect("it listens");
            host.stream.set_nonblocking(true).expect("it can");
        }
        for line in motor.lines(false) {
            let frame = read_line(&line).expect("a frame");
            let Some(request) = drive.accept(&frame) else {
                panic!("{frame:?}");
            };
            let mut replies = Frames::new();
            let mut reply = JointReply {
                state: Some(DriveState::Enabled),
                ..JointReply::default()
            };
            if let Request::Command(command) = request {
                taken += 1;
                reply.position = Some(command.position);
                reply.torque = Some(command.torque);
            }
            drive.reply(&reply, &mut replies);
            for reply in &replies {
                let line = write_line(reply, Direction::Receive);
                motor.stream.write_all(&line).expect("it listens");
            }
        }
        if let Ok(count) = host.stream.read(&mut buffer) {
            near.write_all(&buffer[..count]).expect("it listens");
        }
    }
    let mut text = String::new();
    let mut output = client.stdout.take().expect("it is piped");
    output.read_to_string(&mut text).expect("it is text");
    let rows: Vec<Vec<f64>> = text
        .lines()
        .map(|line| {
            line.split(' ')
                .map(|word| word.parse().expect(line))
                .collect()
        })
        .collect();
    assert_eq!((rows.len(), taken), (20, 20), "{text}");
    for row in rows {
        assert_eq!((row[0], row[1]), (10.0, 0.5));
        assert!(
            (row[2] - 0.25).abs() < 1e-6,
            "not armed: the torque of the client alone"
        );
    }
    drop(far);
}
