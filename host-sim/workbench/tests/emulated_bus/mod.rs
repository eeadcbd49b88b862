//! The board on a drive bus, in the emulator and as its twin in this process: master of six simulated drives, in line
//! between a host and drives, and between moteus' own client and one moteus.

mod in_line;

use crate::bus_loop::{network, path, profile, tracks_better};
use crate::trial;
use foretorque::arm::ur5::{JOINTS, PARAMETERS, Ur5};
use foretorque::joint::{JointSample, JointVector};
use foretorque::learning::ParameterSet;
use foretorque_link::bank::ParameterBank;
use foretorque_link::bus::{BoardDrives, Role, Wires, Wiring};
use foretorque_link::drives::Frame;
use foretorque_link::drives::in_line::InLine;
use foretorque_link::drives::text::{Direction, read_line, write_line};
use foretorque_link::safety::SafetyState;
use foretorque_link::session::{BoardDescription, NoClock};
use foretorque_link::wire::Configuration;
use foretorque_workbench::board::qemu::{Emulator, Image, QemuOptions};
use foretorque_workbench::board::{Client, Native, Transport};
use foretorque_workbench::bus::{Network as _, Profile};
use foretorque_workbench::closed_loop::motion_f32;
use foretorque_workbench::plant::{Events, PlantConfig};
use std::cell::RefCell;
use std::io::{self, Read, Write};
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::rc::Rc;
use std::time::Duration;

const TIMEOUT: Duration = Duration::from_secs(10);
/// The longest command of a host is shorter than a sample.
const SAMPLE_BYTES: usize = 70;

/// Line by which a port takes a frame, with its sum.
const ACKNOWLEDGEMENT: &[u8] = b"OK *BD";

type Drives = BoardDrives<Ur5, JOINTS, PARAMETERS>;
/// Frames with the ports at which they arrive or leave.
type Ported = Vec<(u8, Frame)>;

/// A board whose ports the host sees.
trait FrameBoard {
    /// Its line to the host.
    fn line(&mut self) -> &mut dyn Transport;
    /// Bytes arrive on that line.
    fn take(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.line().send(bytes)
    }
    /// Frames arrive at the ports; returns when the board has taken them and what follows from them at once.
    fn deliver(&mut self, frames: &[(u8, Frame)]);
    fn left(&mut self) -> Ported;
}

/// A board before whose samples something happens on its ports.
struct Ticked<B, F> {
    board: B,
    before: F,
}

impl<B: FrameBoard, F: FnMut(&mut B) -> bool> Transport for Ticked<B, F> {
    fn name(&self) -> String {
        "board on a bus".to_owned()
    }

    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        if bytes.len() > SAMPLE_BYTES && !(self.before)(&mut self.board) {
            return Ok(());
        }
        self.board.take(bytes)
    }

    fn receive(&mut self, buffer: &mut [u8], timeout: Duration) -> io::Result<usize> {
        self.board.line().receive(buffer, timeout)
    }
}

/// The client of `board`; `before` is called before each sample, and says whether that reaches the board.
fn connected<B: FrameBoard + 'static>(
    board: B,
    before: impl FnMut(&mut B) -> bool + 'static,
) -> Client<JOINTS> {
    let mut client = trial::connected(Ticked { board, before });
    client.timeout = TIMEOUT;
    client
}

struct Twin {
    board: Native<Ur5, JOINTS, PARAMETERS, Drives>,
    in_line: Option<InLine<JOINTS>>,
    /// Clock of the frames, ms.
    now: u32,
    left: Ported,
}

/// Time for which a torque is added after the last tick, ms.
const EXPIRY: u32 = 20;

impl Twin {
    fn new(wiring: &Wiring<JOINTS>) -> Self {
        let profiles = std::array::from_fn(|j| wiring.joints[j].map(|joint| joint.drive));
        let in_line = wiring.role == Role::InLine;
        let drives = Drives::new(wiring);
        let limits = drives.torque_limits();
        let mut board =
            Native::described(BoardDescription::plain(NoClock), drives).expect("usable limits");
        board.session.limit_torques(limits);
        Self {
            board,
            in_line: in_line.then(|| InLine::new(profiles, EXPIRY)),
            now: 0,
            left: Vec::new(),
        }
    }
}

impl FrameBoard for Twin {
    fn line(&mut self) -> &mut dyn Transport {
        &mut self.board
    }

    fn take(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.board.send(bytes)?;
        let (session, drives) = (&mut self.board.session, &mut self.board.sensor);
        if !drives.ticked() {
            if !session.torque_enabled() {
                drives.end(session);
                self.in_line.iter_mut().for_each(InLine::clear);
            }
            return Ok(());
        }
        let left = &mut self.left;
        let torques = drives.follow(session, false, |bus, frame| left.push((bus, *frame)));
        match (&mut self.in_line, torques) {
            (Some(in_line), Some(torques)) => in_line.set(&torques.data.0[0], self.now),
            (Some(in_line), None) => in_line.clear(),
            (None, _) => {}
        }
        Ok(())
    }

    fn deliver(&mut self, frames: &[(u8, Frame)]) {
        for &(port, mut frame) in frames {
            self.board.sensor.receive(port, &frame);
            if let Some(in_line) = &mut self.in_line {
                if port == 0 {
                    in_line.to_drives(&mut frame, self.now);
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
        let lines = lines.split(|byte| *byte == b'\n').map(<[u8]>::to_vec);
        lines.filter(|line| !line.is_empty()).collect()
    }
}

/// A file with the drives of a board, `None` with zeros.
fn wiring_file(name: &str, wiring: Option<&Wiring<JOINTS>>) -> PathBuf {
    let mut buffer = [0; Wiring::<JOINTS>::BYTES];
    let bytes = match wiring {
        Some(wiring) => wiring.encode(&mut buffer).expect("it fits").to_vec(),
        None => buffer.to_vec(),
    };
    let file = trial::scratch(&format!("{name}.wiring"));
    std::fs::write(&file, bytes).expect("it can be written");
    file
}

impl Emulated {
    fn start(name: &str, wiring: Option<&Wiring<JOINTS>>) -> Self {
        let mut options = QemuOptions::new(Image::Joint);
        options.elf.set_file_name("joint-can");
        options.wiring = Some(wiring_file(name, wiring));
        let mut board = trial::started(&options);
        let ports = board.take_frame_ports().expect("it has a wiring");
        let ports = ports.map(|end| {
            let (stream, bytes) = (UnixStream::from(end), Vec::new());
            stream.set_read_timeout(Some(TIMEOUT)).expect("it can");
            TextEnd { stream, bytes }
        });
        Self {
            board,
            ports,
            passes: wiring.is_none_or(|wiring| wiring.role == Role::InLine),
            left: Vec::new(),
        }
    }

    /// Takes what a port has sent: frames; the number of acknowledgements.
    fn take_from(&mut self, port: usize, waits: bool) -> usize {
        let mut acknowledged = 0;
        for line in self.ports[port].lines(waits) {
            match read_line(&line) {
                Some(frame) => self.left.push((port as u8, frame)),
                None => acknowledged += usize::from(line == ACKNOWLEDGEMENT),
            }
        }
        acknowledged
    }
}

impl FrameBoard for Emulated {
    fn line(&mut self) -> &mut dyn Transport {
        &mut self.board
    }

    fn deliver(&mut self, frames: &[(u8, Frame)]) {
        // One after the other, so that the order over both ports is that of the twin.
        for (port, frame) in frames {
            let port = usize::from(*port);
            let line = write_line(frame, Direction::Receive);
            let stream = &mut self.ports[port].stream;
            stream.write_all(&line).expect("it listens");
            let mut acknowledged = 0;
            while acknowledged == 0 {
                acknowledged += self.take_from(port, true);
            }
            let before = self.left.len();
            while self.passes && self.left.len() == before {
                self.take_from(1 - port, true);
            }
        }
    }

    fn left(&mut self) -> Ported {
        for port in 0..2 {
            self.take_from(port, false);
        }
        std::mem::take(&mut self.left)
    }
}

fn wiring(profile: &Profile, role: Role) -> Wiring<JOINTS> {
    profile
        .wiring::<Ur5, JOINTS, PARAMETERS>(role, Wires::Can, None)
        .expect("it fits the arm")
}

/// Result of a ride: torques as the board replied, frames it sent, tracking error over the last 6 s.
struct BusRun {
    torques: Vec<JointVector<JOINTS>>,
    sent: Ported,
    rms_mrad: f64,
}

/// Arms a master, and has it follow a seeded path while it learns.
fn bus_run(
    board: impl FrameBoard + 'static,
    rate_hz: f64,
    duration_s: f64,
    forward: bool,
) -> BusRun {
    const JUDGED_S: f64 = 6.0;
    let profile = profile(rate_hz);
    let path = path(40.0);
    let network = network(&profile, &path, PlantConfig::default(), Events::default());
    let network = Rc::new(RefCell::new(network));
    let sent = Rc::<RefCell<Ported>>::default();
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
        let safety = reply.safety;
        assert_eq!(safety.state, SafetyState::Armed, "{t_s} s: {safety}");
        torques.push(reply.total);
        if t_s > duration_s - JUDGED_S {
            // The plant is where the command of the tick before has brought it.
            let error = network.borrow().plant.q() - path.at(t_s).q;
            squares += error.norm_squared();
            counted += JOINTS;
        }
    }
    let sent = sent.borrow().clone();
    BusRun {
        torques,
        sent,
        rms_mrad: (squares / f64::from(counted as u32)).sqrt() * 1e3,
    }
}

#[test]
fn six_drives_follow_a_board_three_times_better_with_its_torque() {
    for rate_hz in [500.0, 1000.0] {
        let wiring = wiring(&profile(rate_hz), Role::Master);
        tracks_better(&format!("{rate_hz} Hz"), 3.0, |forward| {
            bus_run(Twin::new(&wiring), rate_hz, 36.0, forward).rms_mrad
        });
    }
}

#[test]
fn the_emulated_master_sends_the_bits_of_its_twin() {
    // Of both rates, the one that leaves a tick less time.
    let rate_hz = 1000.0;
    let wiring = wiring(&profile(rate_hz), Role::Master);
    let expected = bus_run(Twin::new(&wiring), rate_hz, 0.4, true);
    let seen = bus_run(Emulated::start("master", Some(&wiring)), rate_hz, 0.4, true);
    assert!(seen.torques == expected.torques, "torques");
    // Each port keeps its order; between two ports of the emulator there is none.
    let by_port = |mut sent: Ported| {
        sent.sort_by_key(|(port, _)| *port);
        sent
    };
    let [seen_sent, expected_sent] = [seen.sent, expected.sent].map(by_port);
    let differs = seen_sent.iter().zip(&expected_sent).find(|(a, b)| a != b);
    assert_eq!((differs, seen_sent.len()), (None, expected_sent.len()));
    assert!(seen_sent.len() > JOINTS * seen.torques.len());
    let sizes = seen.torques.iter().map(|torque| torque.amax());
    let largest = sizes.fold(0.0, f32::max);
    assert!(largest > 10.0, "{largest} N·m");
}
