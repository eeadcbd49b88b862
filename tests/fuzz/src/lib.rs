//! Targets of the fuzzer: each takes any bytes, and panics if a promise of the firmware is broken.
//!
//! A checksum stops a fuzzer at once. After an even first byte, therefore, the input is sealed as a correct sender
//! would have done it, and the reader behind the checksum gets the bytes that the fuzzer wanted it to get.

mod drives;
mod seeds;

pub use drives::drives;
pub use seeds::{plant, seeds};

use crc::{CRC_32_ISO_HDLC, Crc};
use foretorque::arm::Arm;
use foretorque::arm::panda::Panda;
use foretorque::arm::ur5::Ur5;
use foretorque::limits::Flags;
use foretorque_flash::SimulatedFlash;
use foretorque_link::bank::ParameterBank;
use foretorque_link::safety::SafetyLimits;
use foretorque_link::safety::promises::Promises;
use foretorque_link::session::{
    BoardDescription, Housekeeping, Mailboxes, NoClock, NoLocalSensor, Session,
};
use foretorque_link::store::{SLOT_BYTES, Store};
use foretorque_link::wire::{
    BoardMessage, Capabilities, Configuration, DecodeError, Decoder, FrameBuffer, HostMessage,
    MAX_FRAME, PROTOCOL_VERSION, encode,
};
use serde::{Serialize, de::DeserializeOwned};

const CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// The target of this name.
pub fn target(name: &str) -> Option<fn(&[u8])> {
    Some(match name {
        "decoder" => decoder,
        "bank" => bank,
        "session" => session,
        "store" => store,
        "drives" => drives,
        _ => return None,
    })
}

/// One sealed frame: version, sequence, `message`, checksum, COBS, delimiter.
fn sealed(sequence: u16, message: &[u8]) -> Vec<u8> {
    let mut content = vec![PROTOCOL_VERSION];
    content.extend(sequence.to_le_bytes());
    content.extend(message);
    content.extend(CRC.checksum(&content).to_le_bytes());
    let mut frame = vec![0; cobs::max_encoding_length(content.len()) + 1];
    let length = cobs::encode(&content, &mut frame);
    frame.truncate(length + 1);
    frame
}

/// Whether the first byte asks for a seal, and the bytes behind it.
fn sealing(input: &[u8]) -> (bool, &[u8]) {
    let parts = input.split_first();
    parts.map_or((false, input), |(first, rest)| (first % 2 == 0, rest))
}

/// The bytes as a line would carry them: as they are, or every run up to a delimiter as a sealed frame.
fn line(input: &[u8]) -> Vec<u8> {
    let (seal, mut rest) = sealing(input);
    if !seal {
        return rest.to_vec();
    }
    // The length in front of each message: a delimiter would be a byte that no message can hold.
    let (mut bytes, mut sequence) = (Vec::new(), 0u16);
    while let Some((&length, behind)) = rest.split_first() {
        let (message, behind) = behind.split_at(behind.len().min(length.into()));
        sequence = sequence.wrapping_add(1);
        bytes.extend(sealed(sequence, message));
        rest = behind;
    }
    bytes
}

/// The frame decoder: never more frames than delimiters, every message that is read is written and read again as the same,
/// and whatever came before, the frame after the next delimiter is decoded.
pub fn decoder(input: &[u8]) {
    let bytes = line(input);
    let mut decoder = Decoder::new();
    let (mut frames, mut delimiters) = (0usize, 0usize);
    for &byte in &bytes {
        delimiters += usize::from(byte == 0);
        if let Some(outcome) = decoder.push(byte) {
            frames += 1;
            let Ok(frame) = outcome else { continue };
            again::<HostMessage<6>>(frame.message());
            again::<HostMessage<7>>(frame.message());
            again::<BoardMessage<6>>(frame.message());
        }
    }
    assert!(frames <= delimiters, "a frame without an end");
    assert!(decoder.bytes_lost() as usize <= bytes.len());
    let _ = decoder.push(0);
    let good = sealed(7, &[0]);
    let mut push = |&byte: &u8| decoder.push(byte).map(|frame| frame.is_ok());
    let decoded: Vec<bool> = good.iter().filter_map(&mut push).collect();
    assert_eq!(decoded, [true], "out of step after a delimiter");
}

/// A message keeps its bytes when it is read, written and read again. NaN is compared by its bits.
fn again<M: Serialize + DeserializeOwned>(message: Result<M, DecodeError>) {
    let Ok(message) = message else { return };
    let (mut first, mut second) = ([0; MAX_FRAME], [0; MAX_FRAME]);
    let bytes = encode(1, &message, &mut first).expect("a message that came in a frame fits one");
    let mut decoder = Decoder::new();
    let mut read = None;
    for &byte in bytes {
        if let Some(frame) = decoder.push(byte) {
            read = Some(frame.and_then(|frame| frame.message::<M>()));
        }
    }
    let read = read.expect("a frame has an end");
    let read = read.expect("it was just written");
    let written = encode(1, &read, &mut second).expect("it fits as before");
    assert_eq!(bytes, written);
}

/// The bank loader: what it reads it writes and reads again as the same, and what it lets through is usable by the tick.
pub fn bank(input: &[u8]) {
    let (seal, rest) = sealing(input);
    let mut bytes = rest.to_vec();
    if seal {
        bytes = [b"FTPB", &[ParameterBank::FORMAT_VERSION][..], rest].concat();
        bytes.extend(CRC.checksum(&bytes).to_le_bytes());
    }
    let Ok(bank) = ParameterBank::decode(&bytes) else {
        return;
    };
    let mut buffer = [0; ParameterBank::MAX_BYTES];
    let written = bank.encode(&mut buffer);
    let written = written.expect("a bank that was read fits the largest one");
    let read = ParameterBank::decode(written).expect("it was just written");
    let mut second = [0; ParameterBank::MAX_BYTES];
    let again = read.encode(&mut second).expect("it fits as before");
    assert_eq!(written, again);
    check_set::<Ur5, 6, 40>(&bank);
    check_set::<Panda, 7, 48>(&bank);
}

fn check_set<A: Arm<N, P>, const N: usize, const P: usize>(bank: &ParameterBank) {
    if let Ok(set) = bank.set::<A, N, P>() {
        assert!(set.is_finite(), "a set that the loader let through");
    }
    if let Ok(gains) = bank.drive_gains::<N>() {
        assert!(gains.iter().all(|gain| gain.is_finite() && *gain >= 0.0));
    }
    if let Ok(config) = bank.feed_forward_config::<A, N, P>(1e-3) {
        assert!(config.validate().is_ok());
    }
}

/// Part of a session's input.
enum Event {
    /// Bytes of the line.
    Bytes(Vec<u8>),
    /// Periods of the board's timer.
    Periods(u8),
}

/// The input as frames and periods of the timer: after an even first byte every length below 240 seals a message, and the
/// others are periods; otherwise a period follows every 64 bytes.
fn events(input: &[u8]) -> Vec<Event> {
    let (seal, mut rest) = sealing(input);
    if !seal {
        let pieces = rest.chunks(64).map(<[u8]>::to_vec);
        return pieces
            .flat_map(|piece| [Event::Bytes(piece), Event::Periods(1)])
            .collect();
    }
    let (mut events, mut sequence) = (Vec::new(), 0u16);
    while let Some((&length, behind)) = rest.split_first() {
        rest = behind;
        if let Some(periods) = length.checked_sub(PERIODS) {
            // 1, 2, 3, 5, 9 and so on, past every time-out.
            events.push(Event::Periods(1 + periods * periods / 2));
            continue;
        }
        let (message, behind) = rest.split_at(rest.len().min(length.into()));
        sequence = sequence.wrapping_add(1);
        events.push(Event::Bytes(sealed(sequence, message)));
        rest = behind;
    }
    events
}

/// First length that stands for periods of the timer.
const PERIODS: u8 = 240;

/// A session, its timer, and the observer of both.
struct Observed {
    session: Session<Ur5, 6, 40>,
    mailboxes: Mailboxes<6, 40>,
    housekeeping: Box<Housekeeping<Ur5, 6, 40>>,
    out: FrameBuffer,
    promises: Promises<6>,
    configuration: Configuration,
    /// Decoders of the frames to the board and of its replies.
    sent: Decoder,
    listener: Decoder,
    /// Number of the last `Arm`.
    arming: Option<u16>,
}

impl Observed {
    fn new() -> Self {
        let mut board = BoardDescription::plain(NoClock);
        board.capabilities = board.capabilities | Capabilities::TIMER | Capabilities::REBOOT;
        let session = Session::new(board).expect("the UR5's limits are usable");
        Self {
            promises: promises(&session),
            session,
            mailboxes: Mailboxes::default(),
            housekeeping: Box::new(Housekeeping::new(None)),
            out: FrameBuffer::new(),
            configuration: Configuration::default(),
            sent: Decoder::new(),
            listener: Decoder::new(),
            arming: None,
        }
    }

    /// Bytes up to a delimiter: before it a board acts on none.
    fn frame(&mut self, bytes: &[u8]) {
        let (mailboxes, out) = (&mut self.mailboxes, &mut self.out);
        self.session
            .receive(bytes, mailboxes, out, &mut NoLocalSensor);
        if self.housekeeping.work(&mut mailboxes.parameters) {
            self.session.poll_parameters(mailboxes, out);
        }
        let mut message = None;
        for &byte in bytes {
            if let Some(Ok(frame)) = self.sent.push(byte) {
                let read = frame.message().ok();
                message = read.map(|message| (frame.sequence, message));
            }
        }
        match message {
            Some((sequence, HostMessage::<6>::Arm)) => self.arming = Some(sequence),
            Some((_, HostMessage::Stop)) => self.promises.stop(),
            // The timer starts anew.
            Some((_, HostMessage::Configure(_) | HostMessage::Reset)) => {
                self.check();
                return self.timer();
            }
            _ => {}
        }
        self.check();
    }

    fn timer(&mut self) {
        self.promises.period();
        self.session
            .timer_tick(&mut self.mailboxes, &mut self.out, &mut NoLocalSensor);
        self.check();
    }

    fn check(&mut self) {
        if self.session.configuration() != self.configuration {
            self.configuration = self.session.configuration();
            self.promises = promises(&self.session);
        }
        let mut used = false;
        for &byte in self.out.as_bytes() {
            let Some(frame) = self.listener.push(byte) else {
                continue;
            };
            let frame = frame.expect("a board sends good frames");
            let flags = match frame.message::<BoardMessage<6>>().expect("of its own kind") {
                BoardMessage::Torque(torque) => Some(torque.flags),
                BoardMessage::FullTorque(full) => Some(full.torque.flags),
                BoardMessage::Excited(excited) => Some(excited.torque.flags),
                BoardMessage::Ack if self.arming == Some(frame.sequence) => {
                    self.promises.permit();
                    self.arming = None;
                    None
                }
                _ => None,
            };
            used |= flags.is_some_and(|flags| !Flags(flags).contains(Flags::STALE_SAMPLE));
        }
        self.out.clear();
        let session = &self.session;
        let (torque, enabled) = (session.torque_output(), session.torque_enabled());
        let kept = self.promises.check(torque, enabled, session.safety(), used);
        assert_eq!(kept, Ok(()), "{}", session.safety());
    }
}

fn promises(session: &Session<Ur5, 6, 40>) -> Promises<6> {
    let configuration = session.configuration();
    let period_us = configuration.period_us;
    let close_us = 1000 * u32::from(configuration.brake_close_ms);
    let limits = SafetyLimits::for_arm::<Ur5, 40>(period_us).with_brake(close_us, period_us);
    Promises::new(limits, session.feed_forward().config())
}

/// The whole session with its timer: whatever arrives between whatever periods, the board keeps every promise about torque
/// and time.
pub fn session(input: &[u8]) {
    let mut board = Observed::new();
    board.timer();
    for event in events(input) {
        match event {
            Event::Bytes(bytes) => {
                let frames = bytes.split_inclusive(|&byte| byte == 0);
                frames.for_each(|frame| board.frame(frame));
            }
            Event::Periods(periods) => (0..periods).for_each(|_| board.timer()),
        }
    }
}

const SECTOR: usize = SLOT_BYTES as usize;

/// Flash of two sectors with one slot each, that begins with the fuzzer's bytes.
///
/// The first half of `content` is at the front of the first sector, the rest at that of the second. An even first byte seals
/// what follows it in each: the checksum of the header is put right.
fn flash(content: &[u8]) -> SimulatedFlash<SECTOR> {
    let mut bytes = [[0xFF; SECTOR]; 2];
    let (seal, content) = sealing(content);
    let halves = content.split_at(content.len() / 2);
    for (sector, half) in bytes.iter_mut().zip([halves.0, halves.1]) {
        for (to, from) in sector.iter_mut().zip(half) {
            *to = *from;
        }
        if let (true, Some((header, body))) = (seal, sector.split_at_mut_checked(32)) {
            let length = u32::from_le_bytes([header[16], header[17], header[18], header[19]]);
            let body = body.get(..length as usize).unwrap_or_default();
            header[20..24].copy_from_slice(&CRC.checksum(body).to_le_bytes());
            let check = CRC.checksum(&header[..28]);
            header[28..].copy_from_slice(&check.to_le_bytes());
        }
    }
    SimulatedFlash::holding(bytes)
}

/// The store over flash with any content: what is loaded is whole, and a save into it is either refused or kept.
pub fn store(input: &[u8]) {
    let mut store = Store::new(flash(input));
    let mut buffer = [0; ParameterBank::MAX_BYTES];
    let before = store.load(Ur5::HASH, &mut buffer).map(<[u8]>::to_vec);
    let mut session = Session::<Ur5, 6, 40>::new(BoardDescription::plain(NoClock))
        .expect("the UR5's limits are usable");
    let mut housekeeping = Box::new(Housekeeping::new(Some(store)));
    let loaded = session.boot_from(&mut housekeeping, &mut Mailboxes::default());
    let store = housekeeping.store_mut().expect("it has one");
    assert!(before.is_ok() || loaded.is_err());
    let bytes = input.get(..64).unwrap_or(input);
    let saved = store.save(Ur5::HASH, bytes);
    let expected = saved.map_or(before, |_| Ok(bytes.to_vec()));
    let after = store.load(Ur5::HASH, &mut buffer).map(<[u8]>::to_vec);
    assert_eq!(after, expected);
}
