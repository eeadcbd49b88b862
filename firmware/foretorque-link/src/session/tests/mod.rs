//! A board under test, and the messages that it receives; tests of its link and telemetry.

mod arming;
mod keys;
mod store;
mod ticks;
mod time;

use super::*;
use crate::bank::{NETWORK_SEED, ParameterBank};
use crate::safety::{ARM_SAMPLES, SafetyLimits, SafetyState};
use crate::telemetry::Statistics;
use crate::wire::size::{self, LinkCapacity};
use crate::wire::*;
use foretorque::arm::ur5::Ur5;
use foretorque::joint::{JointMeasurement, JointMotion, JointSample, JointVector};
use foretorque::learning::{Learner, LearnerConfig, ParameterSet};
use foretorque::limits::Flags;
use store::Flash;

pub(crate) const N: usize = 6;
const P: usize = 40;
pub(crate) const ACK: BoardMessage<N> = BoardMessage::Ack;

pub(crate) const fn nack(reason: NackReason) -> BoardMessage<N> {
    BoardMessage::Nack(reason)
}

const fn no_torque(reason: SafetyReason) -> BoardMessage<N> {
    nack(NackReason::Unsafe(reason))
}

type Mac = [u8; MAC_BYTES];
pub(crate) type Replies = Vec<(u16, BoardMessage<N>)>;

/// A session with its mailboxes, learner and sensor.
pub(crate) struct Board<S = NoLocalSensor> {
    pub(crate) session: Box<Session<Ur5, N, P>>,
    pub(crate) sensor: S,
    mailboxes: Box<Mailboxes<N, P>>,
    housekeeping: Box<Housekeeping<Ur5, N, P, Flash>>,
    learner: Box<Learner<Ur5, N, P>>,
    sequence: u16,
}

impl Board {
    fn new() -> Self {
        Self::measuring(NoLocalSensor)
    }

    /// A plain board, but for `change`.
    fn with(change: impl FnOnce(&mut BoardDescription)) -> Self {
        let mut description = BoardDescription::plain(NoClock);
        change(&mut description);
        Self::described(description, NoLocalSensor)
    }

    fn armed() -> Self {
        let mut board = Self::new();
        board.arm();
        (0..20).for_each(|_| _ = board.sample(0));
        assert_ne!(board.sample(0).total, [0.0; N]);
        board
    }
}

impl<S: LocalSensor<N>> Board<S> {
    pub(crate) fn measuring(sensor: S) -> Self {
        let mut description = BoardDescription::plain(NoClock);
        description.capabilities = Capabilities::LEARNING | Capabilities::TIMER;
        Self::described(description, sensor)
    }

    fn described(description: BoardDescription, sensor: S) -> Self {
        let session = Session::new(description).unwrap();
        let set = session.feed_forward().state().active;
        Self {
            session: Box::new(session),
            sensor,
            mailboxes: Box::default(),
            housekeeping: Box::new(Housekeeping::new(None)),
            learner: Box::new(Learner::new(LearnerConfig::for_arm::<Ur5>(1e-3), set).unwrap()),
            sequence: 0,
        }
    }

    fn receive(&mut self, bytes: &[u8]) -> Replies {
        self.output(|session, mailboxes, out, sensor| {
            session.receive(bytes, mailboxes, out, sensor);
        })
    }

    pub(crate) fn timer(&mut self) -> Replies {
        self.output(|session, mailboxes, out, sensor| {
            session.timer_tick(mailboxes, out, sensor);
        })
    }

    fn output(
        &mut self,
        act: impl FnOnce(&mut Session<Ur5, N, P>, &mut Mailboxes<N, P>, &mut FrameBuffer, &mut S),
    ) -> Replies {
        let (mut out, mailboxes) = (FrameBuffer::new(), &mut self.mailboxes);
        act(&mut self.session, mailboxes, &mut out, &mut self.sensor);
        if self.housekeeping.work(&mut self.mailboxes.parameters) {
            self.session.poll_parameters(&mut self.mailboxes, &mut out);
        }
        decoded(out.as_bytes())
    }

    /// The frame of a message under the next number.
    fn numbered(&mut self, message: &HostMessage<N>) -> Vec<u8> {
        self.sequence = self.sequence.checked_add(1).unwrap_or(1);
        frame(self.sequence, message)
    }

    pub(crate) fn send(&mut self, message: &HostMessage<N>) -> Replies {
        let frame = self.numbered(message);
        self.receive(&frame)
    }

    /// The one reply to a message.
    pub(crate) fn request(&mut self, message: HostMessage<N>) -> BoardMessage<N> {
        let replies = self.send(&message);
        let [(sequence, reply)] = replies.as_slice() else {
            panic!("{} replies", replies.len());
        };
        assert_eq!(*sequence, self.sequence);
        reply.clone()
    }

    #[track_caller]
    fn acknowledged(&mut self, message: HostMessage<N>) {
        assert_eq!(self.request(message), ACK);
    }

    fn hello(&mut self) -> BoardHello {
        match self.request(HostMessage::Hello) {
            BoardMessage::Hello(hello) => hello,
            other => panic!("{other:?}"),
        }
    }

    fn sample(&mut self, k: u32) -> TorqueFrame<N> {
        torque(&self.request(sample_message(k)))
    }

    fn samples_to_arm(&mut self) {
        for _ in 0..ARM_SAMPLES {
            assert_eq!(self.sample(0).total, [0.0; N]);
        }
    }

    /// Samples until the board can be armed, then arms it.
    fn arm(&mut self) {
        self.samples_to_arm();
        self.acknowledged(HostMessage::Arm);
    }

    /// One period of a board with a timer: at most one sample, then the timer, whichever of the two paces the board.
    fn period(&mut self, sample: Option<JointSample<N>>) -> Option<TorqueFrame<N>> {
        let mut replies = sample.map_or(Vec::new(), |sample| {
            self.send(&HostMessage::Sample(SampleFrame::new(&sample)))
        });
        replies.extend(self.timer());
        assert!(replies.len() <= 1);
        replies.first().map(|(_, reply)| torque(reply))
    }

    pub(crate) fn pace(&mut self, pacing: Pacing) {
        self.acknowledged(configure(|wanted| wanted.pacing = pacing));
    }

    fn learn(&mut self) {
        self.mailboxes.learner.work(&mut self.learner, &NoClock);
    }

    pub(crate) fn statistics(&self) -> Statistics {
        self.session.statistics(&self.mailboxes.learner)
    }

    fn read_from(&mut self, source: BankSource) -> Vec<u8> {
        let read = |offset: usize| HostMessage::BankRead {
            source,
            offset: offset as u16,
        };
        let mut bank = Vec::new();
        let mut reply = self.request(read(0));
        loop {
            let BoardMessage::BankChunk { bytes, length, .. } = reply else {
                panic!("{reply:?}");
            };
            bank.extend(bytes);
            if bank.len() == usize::from(length) {
                return bank;
            }
            reply = self.request(read(bank.len()));
        }
    }

    fn read(&mut self) -> Vec<u8> {
        self.read_from(BankSource::Live)
    }

    fn write(&mut self, bank: &[u8]) {
        for place in 0..bank.len().div_ceil(CHUNK) {
            self.acknowledged(write(bank, place));
        }
    }

    fn commit(&mut self, bank: &[u8], mac: Option<Mac>) -> BoardMessage<N> {
        let (length, crc) = (bank.len() as u16, CRC.checksum(bank));
        self.request(HostMessage::BankCommit { length, crc, mac })
    }

    fn upload(&mut self, bank: &[u8], mac: Option<Mac>) -> BoardMessage<N> {
        self.write(bank);
        self.commit(bank, mac)
    }

    fn upload_excitation(&mut self, program: &[u8], mac: Option<Mac>) -> BoardMessage<N> {
        self.write(program);
        let (length, crc) = (program.len() as u16, CRC.checksum(program));
        self.request(HostMessage::ExcitationLoad { length, crc, mac })
    }
}

/// The default configuration, but for `change`.
fn configure(change: impl FnOnce(&mut Configuration)) -> HostMessage<N> {
    let mut wanted = Configuration::default();
    change(&mut wanted);
    HostMessage::Configure(wanted)
}

/// Chunk `place` of an upload.
fn write(bank: &[u8], place: usize) -> HostMessage<N> {
    let chunk = bank.chunks(CHUNK).nth(place).unwrap();
    HostMessage::BankWrite {
        offset: (place * CHUNK) as u16,
        bytes: chunk.iter().copied().collect(),
    }
}

fn frame(sequence: u16, message: &HostMessage<N>) -> Vec<u8> {
    encode(sequence, message, &mut [0; 300]).unwrap().to_vec()
}

fn decoded(bytes: &[u8]) -> Replies {
    let mut decoder = Decoder::new();
    let frames = bytes.iter().filter_map(|&byte| {
        let frame = decoder.push(byte)?.unwrap();
        Some((frame.sequence, frame.message().unwrap()))
    });
    frames.collect()
}

pub(crate) fn torque(reply: &BoardMessage<N>) -> TorqueFrame<N> {
    match reply {
        BoardMessage::Torque(torque) => *torque,
        other => panic!("{other:?}"),
    }
}

fn sample(k: u32) -> JointSample<N> {
    let t = k as f32 * 3e-3;
    let q = JointVector::from_fn(|j, _| (t + j as f32).sin());
    JointSample {
        desired: JointMotion {
            q,
            qd: JointVector::from_fn(|j, _| (t + j as f32).cos()),
            qdd: -q,
        },
        measured: Some(JointMeasurement {
            q,
            tau: JointVector::<N>::repeat(2.0),
        }),
    }
}

fn sample_message(k: u32) -> HostMessage<N> {
    HostMessage::Sample(SampleFrame::new(&sample(k)))
}

fn uploaded() -> Vec<u8> {
    let mut bank = ParameterBank::nominal::<Ur5, N, P>();
    bank.columns[0].value += 1.0;
    bank.drive_gains_nm_a.fill(10.0);
    let mut buffer = [0; ParameterBank::MAX_BYTES];
    bank.encode(&mut buffer).unwrap().to_vec()
}

#[test]
fn a_host_of_another_version_receives_the_hello() {
    let mut board = Board::new();
    let mut buffer = [0; 300];
    let foreign = encode_as(9, 77, &HostMessage::<N>::Hello, &mut buffer).unwrap();
    let replies = board.receive(foreign);
    assert!(matches!(replies.as_slice(), [(0, BoardMessage::Hello(_))]));
    assert_eq!(board.statistics().foreign_version, 1);
}

const ALL: u16 = (1 << Field::ALL.len()) - 1;

/// A serial line of 2 Mbaud.
const LINE: LinkCapacity = LinkCapacity::stream(200_000);

fn connected(link: LinkCapacity) -> Board {
    Board::with(|board| board.link = link)
}

/// Telemetry of `ticks` ticks, and the most bytes in one of them.
fn streamed(
    link: LinkCapacity,
    fields: u16,
    every: u16,
    ticks: u32,
) -> (Vec<TelemetryFrame>, usize) {
    let mut board = connected(link);
    board.acknowledged(HostMessage::Telemetry { fields, every });
    let (mut frames, mut most) = (Vec::new(), 0);
    for k in 0..ticks {
        let mut bytes = 0;
        for (sequence, message) in board.send(&sample_message(k)) {
            bytes += encode(sequence, &message, &mut [0; 300]).unwrap().len();
            if let BoardMessage::Telemetry(frame) = message {
                assert_eq!(sequence, 0, "unasked");
                frames.push(frame);
            }
        }
        most = most.max(bytes);
    }
    assert_eq!(board.statistics().records_lost, 0);
    (frames, most)
}

fn refused(link: LinkCapacity, fields: u16, every: u16) -> u16 {
    match connected(link).request(HostMessage::Telemetry { fields, every }) {
        BoardMessage::Nack(NackReason::Bandwidth { every }) => every,
        other => panic!("{other:?}"),
    }
}

#[test]
fn every_field_of_a_record_arrives_with_its_tick() {
    for link in [LINE, LinkCapacity::UNLIMITED] {
        let (frames, _) = streamed(link, ALL, 10, 200);
        for tick in (0..200).step_by(10) {
            let of_tick = frames.iter().filter(|frame| frame.tick == tick);
            let fields: Vec<Field> = of_tick
                .flat_map(|frame| frame.fields(N).map(|(field, _)| field))
                .collect();
            assert_eq!(fields, Field::ALL, "tick {tick}");
        }
        assert!(frames.iter().all(|frame| frame.tick.is_multiple_of(10)));
        let size = |frame: &TelemetryFrame| size::telemetry(frame.bytes.len());
        assert!(frames.iter().all(|frame| size(frame) <= MAX_FRAME));
    }
}

#[test]
fn telemetry_never_exceeds_what_the_link_has_left() {
    for every in [10, 50] {
        let (frames, most) = streamed(LINE, ALL, every, 100);
        assert!(!frames.is_empty());
        // 200 bytes a period, less the reserve.
        assert!(most <= 140, "{most}");
    }
    let (_, most) = streamed(LINE, Field::Total.bit(), 1, 100);
    assert_eq!(most, size::torque(N) + size::telemetry(4 * N));
}

#[test]
fn too_much_is_refused_with_the_smallest_interval() {
    let every = refused(LINE, ALL, 1);
    assert!((2..=10).contains(&every), "{every}");
    streamed(LINE, ALL, every, 10);
    assert_eq!(refused(LINE, ALL, every - 1), every);
    // Replies alone fill this line.
    let slow = LinkCapacity::stream(50_000);
    assert_eq!(refused(slow, Field::Total.bit(), 1000), 0);
}

#[test]
fn fields_equal_the_values_of_the_replies() {
    let fields = Field::State.bit() | Field::Total.bit() | Field::MeasuredPosition.bit();
    let mut board = Board::new();
    board.arm();
    board.acknowledged(HostMessage::Telemetry { fields, every: 1 });
    for k in 0..20 {
        let replies = board.send(&sample_message(k));
        let [(_, reply), (0, BoardMessage::Telemetry(telemetry))] = replies.as_slice() else {
            panic!("{replies:?}");
        };
        let torque = torque(reply);
        assert_eq!(telemetry.tick, torque.tick);
        let [low, high] = torque.flags.to_le_bytes();
        let safety = torque.safety;
        let measured = SampleFrame::new(&sample(k)).sample(&[0.0; N]).measured;
        let measured: [f32; N] = measured.unwrap().q.into();
        let expected = [
            &[low, high, safety.state as u8, safety.reason.code()][..],
            &torque.total.map(f32::to_le_bytes).concat(),
            &measured.map(f32::to_le_bytes).concat(),
        ];
        let parts: Vec<_> = telemetry.fields(N).map(|(_, bytes)| bytes).collect();
        assert_eq!(parts, expected);
    }
    let none = HostMessage::Telemetry {
        fields: 0,
        every: 0,
    };
    board.acknowledged(none.clone());
    assert_eq!(board.send(&sample_message(0)).len(), 1);
    // No fields always fit, and so do bits without a field.
    let mut slow = connected(LinkCapacity::stream(50_000));
    slow.acknowledged(none);
    let (fields, every) = (!ALL, 0);
    slow.acknowledged(HostMessage::Telemetry { fields, every });
}

/// A record without space is counted once, and so is a reply; the frames before them are whole.
#[test]
fn records_that_are_not_sent_whole_are_counted() {
    let mut board = Board::new();
    let every = 1;
    board.acknowledged(HostMessage::Telemetry { fields: ALL, every });
    let frame = board.numbered(&sample_message(0));
    let whole = board.output(|session, mailboxes, out, sensor| {
        while out.push(0, &ACK).is_ok() {}
        session.receive(&frame, mailboxes, out, sensor);
    });
    assert!(!whole.is_empty() && whole.iter().all(|frame| *frame == (0, ACK)));
    let statistics = board.statistics();
    assert_eq!((statistics.records_lost, statistics.replies_lost), (1, 1));
    let two = [1, 2].map(|k| board.numbered(&sample_message(k)));
    assert_eq!(board.receive(&two.concat()).len(), 6);
}
