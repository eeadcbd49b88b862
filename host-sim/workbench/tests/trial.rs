//! Boards in this process and in the emulator, what the emulator saw of them, and requests to them as raw bytes.

use elf::ElfBytes;
use elf::endian::LittleEndian;
use elf::segment::ProgramHeader;
use elf::symbol::Symbol;
use foretorque::arm::ur5::{JOINTS, PARAMETERS, Ur5};
use foretorque::dynamics::FrictionColumn;
use foretorque::feedforward::{ParameterSet, evaluate};
use foretorque::joint::{JointMeasurement, JointMotion, JointSample, JointVector};
use foretorque_f405::image::{self, Seal};
use foretorque_link::bank::NETWORK_SEED;
use foretorque_link::safety::{ARM_SAMPLES, SafetyReason};
use foretorque_link::wire::{
    BankSource, Configuration, Decoder, FrameBuffer, HostMessage, NackReason, Pacing, ReplyMode,
    SampleFrame,
};
use foretorque_workbench::board::qemu::{Emulator, QemuOptions};
use foretorque_workbench::board::{BoardError, Client, Native, TickReply, Transport};
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Longest time to a hello or an answer of the emulator on a busy machine.
pub(crate) const TIMEOUT: Duration = Duration::from_secs(5);

/// The client of a UR5's board.
pub(crate) fn connected(board: impl Transport + 'static) -> Client<JOINTS> {
    let client = Client::connect::<Ur5, PARAMETERS>(Box::new(board), TIMEOUT);
    client.unwrap_or_else(|error| panic!("{error}"))
}

pub(crate) fn native() -> Native<Ur5, JOINTS, PARAMETERS> {
    Native::new().expect("the UR5's limits are usable")
}

/// Sets period and pacing of a board.
pub(crate) fn paced(client: &mut Client<JOINTS>, period_us: u32, pacing: Pacing) {
    let configured = client.configure(Configuration {
        period_us,
        pacing,
        ..Configuration::default()
    });
    configured.expect("it has a timer");
}

/// Starts the emulator. A firmware that is not built fails the test with the command that builds it.
pub(crate) fn started(options: &QemuOptions) -> Emulator {
    Emulator::start(options).unwrap_or_else(|error| panic!("{error}"))
}

/// The arm stretched out, at rest.
pub(crate) fn still() -> JointSample<JOINTS> {
    let (q, tau) = (JointVector::zeros(), JointVector::zeros());
    JointSample {
        desired: JointMotion::zero(),
        measured: Some(JointMeasurement { q, tau }),
    }
}

/// A file in the directory of the tests.
pub(crate) fn scratch(name: &str) -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).join(name)
}

/// A firmware in the emulator, and the trace of its pins.
pub(crate) struct Trial {
    pub(crate) client: Client<JOINTS>,
    pub(crate) options: QemuOptions,
    trace: PathBuf,
}

impl Trial {
    pub(crate) fn start(name: &str, mut options: QemuOptions) -> Self {
        let trace = scratch(&format!("{name}.trace"));
        options.trace = Some(trace.clone());
        let mut client = connected(started(&options));
        client.timeout = TIMEOUT;
        Self {
            client,
            options,
            trace,
        }
    }

    pub(crate) fn trace(&self) -> String {
        fs::read_to_string(&self.trace).expect("the emulator writes a trace")
    }

    pub(crate) fn sample(&mut self, sample: &JointSample<JOINTS>) -> TickReply<JOINTS> {
        self.client.sample(sample).expect("a torque")
    }

    /// Arms the board and lets its torque rise.
    pub(crate) fn arm(&mut self) {
        self.client.arm(&still()).expect("it can be armed");
        for _ in 0..40 {
            self.sample(&still());
        }
    }

    /// Arms a board that its own timer paces.
    pub(crate) fn arm_paced_by_timer(&mut self) {
        // The time-out is some two hundred ticks then. Whenever the board is idle the emulator leaps to its next tick: a host
        // that gets its turn late has been silent for a while.
        paced(&mut self.client, 250, Pacing::SysTick);
        for _ in 0..5 {
            self.sample(&still());
        }
        let armed = (0..100).any(|_| self.client.arm(&still()).is_ok());
        assert!(armed, "it can be armed");
        self.sample(&still());
    }

    /// Sends no sample until the trace has `ended`; the time of the emulator moves on with traffic on its link, in leaps.
    pub(crate) fn silence_until(&mut self, ended: impl Fn(&str) -> bool) {
        let silence = (0..10_000).find(|_| {
            self.client.statistics().expect("counters");
            ended(&self.trace())
        });
        assert!(silence.is_some(), "the torque ends");
    }

    pub(crate) fn refusal(&mut self) -> SafetyReason {
        match self.client.arm(&still()) {
            Err(BoardError::Refused(NackReason::Unsafe(reason))) => reason,
            other => panic!("{other:?}"),
        }
    }
}

/// A copy of the firmware `elf`, called `name`, in which the one function whose symbol contains each `part` is `code`.
pub(crate) fn patched(elf: &Path, name: &str, patches: &[(&str, Vec<u16>)]) -> PathBuf {
    let mut bytes = fs::read(elf).expect("the firmware is built: `cargo firmware`");
    for (part, code) in patches {
        let code: Vec<u8> = code.iter().flat_map(|half| half.to_le_bytes()).collect();
        let (place, size) = function(&bytes, part);
        let need = code.len();
        assert!(need <= size, "{part} has {size} bytes, {need} are needed");
        bytes[place..place + need].copy_from_slice(&code);
    }
    let file = scratch(name);
    fs::write(&file, bytes).expect("it can be written");
    file
}

/// A copy of the firmware `elf`, called `name`, with its checksum as `cargo xtask flash` writes it, and one bit of its last
/// byte flipped afterwards if `damaged`.
pub(crate) fn sealed(elf: &Path, name: &str, damaged: bool) -> PathBuf {
    let mut bytes = fs::read(elf).expect("the firmware is built: `cargo firmware`");
    let file = ElfBytes::<LittleEndian>::minimal_parse(&bytes).expect("it is an ELF");
    let seal = symbol(&file, |name, _| name == image::SYMBOL).st_value;
    let parts = file.segments().expect("it is linked").iter();
    let parts = parts.filter(|part| part.p_type == elf::abi::PT_LOAD && part.p_filesz > 0);
    let mut parts: Vec<_> = parts.collect();
    parts.sort_by_key(|part| part.p_paddr);
    let base = parts[0].p_paddr;
    let mut program = Vec::new();
    for part in &parts {
        // Between two segments the emulator has zeros, where flash is erased.
        program.resize((part.p_paddr - base) as usize, 0);
        program.extend_from_slice(file.segment_data(part).expect("it is in the file"));
    }
    let place = (seal - base) as usize;
    let Seal { length, crc } = Seal::of(&program, place).expect("it lies in the program");
    let holds = |at: u64| {
        move |part: &&ProgramHeader| (part.p_vaddr..part.p_vaddr + part.p_filesz).contains(&at)
    };
    let part = parts.iter().find(holds(seal)).expect("it is in the flash");
    let offset = (part.p_offset + (seal - part.p_vaddr)) as usize;
    let last = &parts[parts.len() - 1];
    let end = (last.p_offset + last.p_filesz - 1) as usize;
    let words = [length, crc].map(u32::to_le_bytes);
    bytes[offset..offset + image::BYTES].copy_from_slice(words.as_flattened());
    bytes[end] ^= u8::from(damaged);
    let file = scratch(name);
    fs::write(&file, bytes).expect("it can be written");
    file
}

/// The one symbol that `is` so by its name and type.
fn symbol(file: &ElfBytes<'_, LittleEndian>, is: impl Fn(&str, u8) -> bool) -> Symbol {
    let (symbols, names) = file.symbol_table().unwrap().expect("it has symbols");
    let found = symbols.iter().filter(|symbol| {
        let name = names.get(symbol.st_name as usize);
        name.is_ok_and(|name| is(name, symbol.st_symtype()))
    });
    let found: Vec<_> = found.collect();
    assert_eq!(found.len(), 1, "{found:?}");
    found[0].clone()
}

/// Offset of the function in the file, and its bytes.
fn function(bytes: &[u8], part: &str) -> (usize, usize) {
    let elf = ElfBytes::<LittleEndian>::minimal_parse(bytes).expect("it is an ELF");
    let is = |name: &str, kind| kind == elf::abi::STT_FUNC && name.contains(part);
    let symbol = symbol(&elf, is);
    let sections = elf.section_headers().expect("it has sections");
    let section = sections.get(usize::from(symbol.st_shndx));
    let section = section.expect("of the function");
    // Bit 0 of the address of a function marks Thumb code.
    let place = section.sh_offset + ((symbol.st_value & !1) - section.sh_addr);
    (place as usize, symbol.st_size as usize)
}

/// Of as many periods these have no sample: gaps of one, two and three.
const EVERY: u32 = 97;
const LOST: [u32; 6] = [50, 60, 61, 70, 71, 72];

/// A motion of all joints fast enough to learn from, with a torque that no model explains well.
pub(crate) fn sample(k: u32) -> JointSample<JOINTS> {
    let t = k as f32 * 1e-3;
    let rate = |joint: usize| 2.0 + 0.3 * joint as f32;
    let phase = |joint: usize| t * rate(joint) + joint as f32;
    let desired = JointMotion {
        q: JointVector::from_fn(|j, _| phase(j).sin()),
        qd: JointVector::from_fn(|j, _| rate(j) * phase(j).cos()),
        qdd: JointVector::from_fn(|j, _| -rate(j) * rate(j) * phase(j).sin()),
    };
    let tau = JointVector::from_fn(|j, _| 4.0 * phase(j).cos() + 2.0 * (3.0 * phase(j)).sin());
    let measured = Some(JointMeasurement { q: desired.q, tau });
    JointSample { desired, measured }
}

/// The motion with the torques of an arm a tenth heavier than its description and with friction.
pub(crate) fn credible(k: u32) -> JointSample<JOINTS> {
    let mut truth = ParameterSet::nominal::<Ur5>(NETWORK_SEED);
    truth.rigid *= 1.1;
    for friction in &mut truth.friction {
        friction[FrictionColumn::Viscous] = 2.0;
        friction[FrictionColumn::Coulomb] = 1.0;
    }
    let desired = sample(k).desired;
    let tau = evaluate::<Ur5, JOINTS, PARAMETERS>(&truth, &desired).total;
    let measured = Some(JointMeasurement { q: desired.q, tau });
    JointSample { desired, measured }
}

/// One conversation, question by question, as raw bytes.
pub(crate) struct Dialogue<T> {
    link: T,
    frames: FrameBuffer,
    pub(crate) sequence: u16,
}

impl<T: Transport> Dialogue<T> {
    /// After the board's own hello, which depends on the board and is not compared.
    pub(crate) fn begin(link: T) -> Self {
        let mut dialogue = Self {
            link,
            frames: FrameBuffer::new(),
            sequence: 0,
        };
        dialogue.send(&HostMessage::Reset);
        // The line may hold a greeting; the acknowledgement of the reset is the first answer with our number.
        while dialogue.receive().0 != dialogue.sequence {}
        dialogue
    }

    pub(crate) fn send(&mut self, message: &HostMessage<JOINTS>) {
        self.sequence += 1;
        self.frames.clear();
        self.frames.push(self.sequence, message).unwrap();
        self.link.send(self.frames.as_bytes()).unwrap();
    }

    /// One frame, byte for byte, and the number it carries.
    pub(crate) fn receive(&mut self) -> (u16, Vec<u8>) {
        let mut frame = Vec::new();
        let mut decoder = Decoder::new();
        let mut byte = [0];
        loop {
            let count = self.link.receive(&mut byte, TIMEOUT).unwrap();
            assert_eq!(count, 1, "the board answers in time");
            frame.push(byte[0]);
            if let Some(received) = decoder.push(byte[0]) {
                return (received.expect("no bit is lost").sequence, frame);
            }
        }
    }

    pub(crate) fn ask(&mut self, message: &HostMessage<JOINTS>) -> Vec<u8> {
        self.send(message);
        self.receive().1
    }

    /// `ticks` periods while learning, a few of them without a sample, then the whole state that matters: every answer in one
    /// string of bytes.
    pub(crate) fn learn(&mut self, ticks: u32) -> Vec<u8> {
        let configuration = Configuration {
            reply: ReplyMode::Full,
            ..Configuration::default()
        };
        let mut message = self.ask(&HostMessage::Configure(configuration));
        // The learner is done before the next sample comes, however busy this machine is.
        let answered_late = |k| SampleFrame::new(&sample(k)).answered_after_learning();
        for _ in 0..ARM_SAMPLES {
            message.extend(self.ask(&HostMessage::Sample(answered_late(0))));
        }
        message.extend(self.ask(&HostMessage::Arm));
        message.extend(self.ask(&HostMessage::Learning { on: true }));
        for k in 0..ticks {
            if !LOST.contains(&(k % EVERY)) {
                message.extend(self.ask(&HostMessage::Sample(answered_late(k).in_period(k as u8))));
            }
        }
        message.extend(self.ask(&HostMessage::BankRead {
            source: BankSource::Live,
            offset: 0,
        }));
        message
    }
}
