use super::{BoardError, Transport};
use foretorque::arm::Arm;
use foretorque::edge::bank::ParameterBank;
use foretorque::edge::safety::{ARM_SAMPLES, SafetyReason, SafetyState, SafetyStatus};
use foretorque::edge::telemetry::Statistics;
use foretorque::edge::wire::{
    BankSource, BoardHello, BoardMessage, CHUNK, Capabilities, Chunk, Configuration, DecodeError,
    Decoder, FrameBuffer, HostMessage, MAC_BYTES, NackReason, SampleFlags, SampleFrame,
    TelemetryFrame,
};
use foretorque::edge::write_key::WriteKey;
use foretorque::excitation::{Cue, ExcitationProgram, Stage};
use foretorque::feedforward::{Shares, Torque};
use foretorque::joint::{JointMotion, JointSample, JointVector};
use foretorque::learning::Request;
use foretorque::limits::Flags;
use std::time::{Duration, Instant};

/// How often a question that may be asked twice without harm is asked.
const ATTEMPTS: usize = 3;
/// How long one hello is waited for while a board may still be booting.
const HELLO_TIMEOUT: Duration = Duration::from_millis(300);

/// How long the store may take: erasing a sector of 128 KiB takes up to 2 s (DS8626 table 48), and it has two.
const STORE_TIMEOUT: Duration = Duration::from_secs(10);
/// Samples that a board is given, at most, to become ready to be armed.
const ARM_ATTEMPTS: u32 = 30;
/// Samples that a board is given, at most, to bring its torque to zero: many times what its slew limit takes.
const DISARM_SAMPLES: u32 = 2000;

/// Shares of the torque of one tick, N·m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BoardShares<const N: usize> {
    /// Those of one joint: rigid body, friction, network.
    Joint(usize, [f32; 3]),
    /// All of them.
    All(Shares<N>),
}

/// Torque of one tick, as the board answered it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TickReply<const N: usize> {
    /// Counter of the tick.
    pub tick: u32,
    /// What happened.
    pub flags: Flags,
    /// Whether torque leaves the board, and why not.
    pub safety: SafetyStatus,
    /// The torque, N × N·m, bit for bit; zero unless the board is armed.
    pub total: JointVector<N>,
    /// What it is made of.
    pub shares: BoardShares<N>,
    /// Where the excitation stands and what it asks of the arm, if the board plays one.
    pub excited: Option<(Stage, JointMotion<N>)>,
}

/// What the host saw of the link.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LinkCount {
    /// Frames sent.
    pub sent: u64,
    /// Good frames received.
    pub received: u64,
    /// Damaged or foreign frames received.
    pub errors: u64,
    /// Good frames that answered no open question.
    pub stray: u64,
    /// Questions that found no answer in time.
    pub timeouts: u64,
}

/// Speaks the protocol with a board of `N` joints over any [`Transport`].
pub struct Client<const N: usize> {
    transport: Box<dyn Transport>,
    decoder: Decoder,
    request: FrameBuffer,
    sequence: u16,
    /// Bytes received and not yet decoded.
    bytes: Vec<u8>,
    next: usize,
    timeout: Duration,
    count: LinkCount,
    hello: BoardHello,
    /// The board as its last reply told it.
    safety: SafetyStatus,
    /// The desired motion that the board knows, without a measurement.
    presented: Option<SampleFrame<N>>,
    /// What it told unasked.
    telemetry: Vec<TelemetryFrame>,
    key: Option<WriteKey>,
}

impl<const N: usize> Client<N> {
    /// Greets the board and makes sure that it drives arm `A` and speaks this protocol.
    ///
    /// * `boot` how long the board may take to answer its first hello
    ///
    /// Errors: [`BoardError::Timeout`], [`BoardError::WrongProtocol`], [`BoardError::WrongRobot`],
    /// [`BoardError::Closed`].
    pub fn connect<A: Arm<N, P>, const P: usize>(
        transport: Box<dyn Transport>,
        boot: Duration,
    ) -> Result<Self, BoardError> {
        Self::connect_as(transport, A::NAME, A::HASH, boot)
    }

    /// [`connect`](Self::connect) with name and identity of the arm as values.
    pub fn connect_as(
        transport: Box<dyn Transport>,
        arm: &str,
        arm_hash: u32,
        boot: Duration,
    ) -> Result<Self, BoardError> {
        let mut client = Self {
            transport,
            decoder: Decoder::new(),
            request: FrameBuffer::new(),
            sequence: 0,
            bytes: Vec::new(),
            next: 0,
            timeout: Duration::from_secs(2),
            count: LinkCount::default(),
            hello: nobody(),
            safety: SafetyStatus::default(),
            presented: None,
            telemetry: Vec::new(),
            key: None,
        };
        client.hello = client.greet(boot)?;
        client.safety = client.hello.safety;
        let found = &client.hello;
        if found.arm_hash != arm_hash || usize::from(found.joints) != N {
            return Err(BoardError::WrongRobot {
                wanted: format!("{arm} ({arm_hash:08x})"),
                found: format!(
                    "{} ({:08x}, {} joints)",
                    found.arm, found.arm_hash, found.joints
                ),
            });
        }
        Ok(client)
    }

    /// Signs uploads from now on, where the board asks for it.
    pub fn set_write_key(&mut self, key: WriteKey) {
        self.key = Some(key);
    }

    /// How long an answer is waited for.
    pub fn set_timeout(&mut self, timeout: Duration) {
        self.timeout = timeout;
    }

    /// Who the board said it is.
    pub fn hello(&self) -> &BoardHello {
        &self.hello
    }

    /// What the host saw of the link so far.
    pub fn link_count(&self) -> LinkCount {
        self.count
    }

    /// Runs one tick with `sample` and returns its torque.
    ///
    /// Errors: as below; after [`BoardError::Timeout`] the sample counts as lost and the next one may follow.
    pub fn sample(&mut self, sample: &JointSample<N>) -> Result<TickReply<N>, BoardError> {
        self.sample_frame(&SampleFrame::new(sample))
    }

    /// [`sample`](Self::sample) for a frame made elsewhere: with currents, or temperatures.
    pub fn sample_frame(&mut self, frame: &SampleFrame<N>) -> Result<TickReply<N>, BoardError> {
        let sequence = self.post(&HostMessage::Sample(*frame))?;
        let reply = self.wait_for(sequence, self.timeout)?;
        let reply = match reply {
            BoardMessage::Torque(reply) => Ok(TickReply {
                tick: reply.tick,
                flags: Flags(reply.flags),
                safety: reply.safety,
                total: reply.total.into(),
                shares: BoardShares::Joint(reply.tick as usize % N, reply.shares),
                excited: None,
            }),
            BoardMessage::Excited(reply) => Ok(TickReply {
                tick: reply.torque.tick,
                flags: Flags(reply.torque.flags),
                safety: reply.torque.safety,
                total: reply.torque.total.into(),
                shares: BoardShares::Joint(reply.torque.tick as usize % N, reply.torque.shares),
                excited: Some((reply.stage, reply.desired())),
            }),
            BoardMessage::FullTorque(reply) => {
                let torque = Torque::from(&reply);
                Ok(TickReply {
                    tick: torque.tick,
                    flags: torque.flags,
                    safety: reply.safety,
                    total: torque.total,
                    shares: BoardShares::All(torque.shares),
                    excited: None,
                })
            }
            other => Err(refused(other)),
        }?;
        self.safety = reply.safety;
        self.presented = Some(SampleFrame {
            flags: SampleFlags::default(),
            ..*frame
        });
        Ok(reply)
    }

    /// Whether torque leaves the board, and why not, as it last said.
    pub fn safety(&self) -> SafetyStatus {
        self.safety
    }

    /// Shows the board `sample` until it has heard enough, then arms it: its torque counts from the next sample on.
    ///
    /// Errors: as for every command; [`BoardError::Refused`] with the reason why the board must not be armed.
    pub fn arm(&mut self, sample: &JointSample<N>) -> Result<(), BoardError> {
        let mut shown = 0;
        loop {
            self.sample(sample)?;
            shown += 1;
            if shown < ARM_SAMPLES {
                continue;
            }
            match self.command(&HostMessage::Arm) {
                Err(BoardError::Refused(NackReason::Unsafe(SafetyReason::NoSample)))
                    if shown < ARM_ATTEMPTS => {}
                done => return done,
            }
        }
    }

    /// Disarms the board and goes on with the last desired motion until its torque is zero.
    ///
    /// Errors: as for every command; a board whose torque does not end is one of [`BoardError::UnexpectedAnswer`].
    pub fn disarm(&mut self) -> Result<(), BoardError> {
        self.command(&HostMessage::Disarm)?;
        let Some(frame) = self.presented else {
            return Ok(());
        };
        for _ in 0..DISARM_SAMPLES {
            if !torque_flows(self.safety.state) {
                return Ok(());
            }
            self.sample_frame(&frame)?;
        }
        Err(BoardError::UnexpectedAnswer)
    }

    /// Emergency stop: torque off at once; a fault is latched.
    pub fn stop(&mut self) -> Result<(), BoardError> {
        self.command(&HostMessage::Stop)
    }

    /// Has the board forget a latched fault.
    pub fn clear_fault(&mut self) -> Result<(), BoardError> {
        self.command(&HostMessage::ClearFault)
    }

    /// Asks the board's learner; what comes of it is among its decisions.
    pub fn request(&mut self, request: Request) -> Result<(), BoardError> {
        self.command(&HostMessage::Request {
            code: request as u8,
        })
    }

    /// Has the board stream `fields`, a sum of [`Field`](foretorque::edge::wire::Field) bits, of every `every`-th tick.
    pub fn stream(&mut self, fields: u16, every: u16) -> Result<(), BoardError> {
        self.command(&HostMessage::Telemetry { fields, every })
    }

    /// The telemetry that came since this was last asked, in the order it came.
    pub fn take_telemetry(&mut self) -> Vec<TelemetryFrame> {
        std::mem::take(&mut self.telemetry)
    }

    /// Starts the board's processor anew. Says nothing of whether it came back: greet it again.
    pub fn reboot(&mut self) -> Result<(), BoardError> {
        self.post(&HostMessage::Reboot)?;
        Ok(())
    }

    /// Disarms the board if its torque flows.
    fn bring_to_rest(&mut self) -> Result<(), BoardError> {
        if torque_flows(self.safety.state) {
            self.disarm()?;
        }
        Ok(())
    }

    /// Shares of the board's active set for `motion`; changes nothing on the board.
    pub fn evaluate(&mut self, motion: &JointMotion<N>) -> Result<Torque<N>, BoardError> {
        match self.ask(&HostMessage::Evaluate(motion.into()))? {
            BoardMessage::Evaluated(frame) => Ok(Torque::from(&frame)),
            other => Err(refused(other)),
        }
    }

    /// Sets period, pacing and reply mode; the board is disarmed, and its tick starts over at 0.
    pub fn configure(&mut self, configuration: Configuration) -> Result<(), BoardError> {
        self.bring_to_rest()?;
        self.command(&HostMessage::Configure(configuration))?;
        self.hello.configuration = configuration;
        Ok(())
    }

    /// Switches learning on or off.
    pub fn learning(&mut self, on: bool) -> Result<(), BoardError> {
        self.command(&HostMessage::Learning { on })
    }

    /// The board's counters.
    pub fn statistics(&mut self) -> Result<Statistics, BoardError> {
        match self.ask(&HostMessage::Statistics)? {
            BoardMessage::Statistics(statistics) => Ok(statistics),
            other => Err(refused(other)),
        }
    }

    /// Disarms the board and brings it back to the state after boot; a latched fault stays.
    pub fn reset(&mut self) -> Result<(), BoardError> {
        self.bring_to_rest()?;
        self.command(&HostMessage::Reset)?;
        self.hello.configuration = Configuration::default();
        Ok(())
    }

    /// Disarms the board, sends `bank` and has the board take it over, whole or not at all. Learning must be off.
    pub fn upload_bank(&mut self, bank: &ParameterBank) -> Result<(), BoardError> {
        self.bring_to_rest()?;
        let mut room = [0; ParameterBank::MAX_BYTES];
        let bytes = bank.encode(&mut room).map_err(BoardError::Bank)?;
        let mac = self.signature(bytes)?;
        self.upload(bytes)?;
        // Not asked twice: the first commit ends the upload, so a second would be refused although the first was good.
        let sequence = self.post(&HostMessage::BankCommit {
            length: bytes.len() as u16,
            crc: crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(bytes),
            mac,
        })?;
        acknowledged(self.wait_for(sequence, self.timeout)?)
    }

    /// The signature of an upload, where the board has a write key.
    fn signature(&mut self, upload: &[u8]) -> Result<Option<[u8; MAC_BYTES]>, BoardError> {
        if !self.hello.capabilities.contains(Capabilities::WRITE_KEY) {
            return Ok(None);
        }
        let key = self.key.ok_or(BoardError::NoKey)?;
        match self.ask(&HostMessage::Challenge)? {
            BoardMessage::Challenge { nonce } => {
                Ok(Some(key.sign_upload(&nonce, self.hello.arm_hash, upload)))
            }
            other => Err(refused(other)),
        }
    }

    /// Sends `program` and has the board take it over, whole or not at all. Learning must be off; the board's check runs
    /// in the ticks that follow.
    pub fn load_excitation(&mut self, program: &ExcitationProgram<N>) -> Result<(), BoardError> {
        let mut room = [0; ParameterBank::MAX_BYTES];
        let bytes = program
            .encode(&mut room)
            .expect("an excitation of few joints is shorter than a bank");
        let mac = self.signature(bytes)?;
        self.upload(bytes)?;
        let sequence = self.post(&HostMessage::ExcitationLoad {
            length: bytes.len() as u16,
            crc: crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(bytes),
            mac,
        })?;
        acknowledged(self.wait_for(sequence, self.timeout)?)
    }

    /// Starts, stops or releases the excitation on the board, or asks for it; where it then stands.
    pub fn excitation(&mut self, cue: Cue) -> Result<Stage, BoardError> {
        match self.ask(&HostMessage::Excitation(cue))? {
            BoardMessage::Excitation(stage) => Ok(stage),
            other => Err(refused(other)),
        }
    }

    /// Has the board keep its parameters over power-off. The board is disarmed; learning must be off.
    pub fn save(&mut self) -> Result<(), BoardError> {
        self.at_the_store(&HostMessage::Save)
    }

    /// Has the board take over its stored parameters. The board is disarmed; learning must be off.
    pub fn restore(&mut self) -> Result<(), BoardError> {
        self.at_the_store(&HostMessage::Restore)
    }

    /// Not asked twice: what the store was asked for it does, however long it takes.
    fn at_the_store(&mut self, message: &HostMessage<N>) -> Result<(), BoardError> {
        self.bring_to_rest()?;
        let sequence = self.post(message)?;
        acknowledged(self.wait_for(sequence, STORE_TIMEOUT)?)
    }

    fn upload(&mut self, bytes: &[u8]) -> Result<(), BoardError> {
        for (place, chunk) in bytes.chunks(CHUNK).enumerate() {
            self.command(&HostMessage::BankWrite {
                offset: (place * CHUNK) as u16,
                bytes: chunk.iter().copied().collect(),
            })?;
        }
        Ok(())
    }

    /// The bank in force on the board, what it has learnt included.
    pub fn read_bank(&mut self) -> Result<ParameterBank, BoardError> {
        self.read_bank_of(BankSource::Live)
    }

    /// One of the banks on the board.
    pub fn read_bank_of(&mut self, source: BankSource) -> Result<ParameterBank, BoardError> {
        let mut bank = Vec::new();
        loop {
            let wanted = bank.len() as u16;
            let (length, piece) = self.read_chunk(source, wanted)?;
            bank.extend_from_slice(&piece);
            if bank.len() >= usize::from(length) || piece.is_empty() {
                return ParameterBank::decode(&bank).map_err(BoardError::Bank);
            }
        }
    }

    fn read_chunk(&mut self, source: BankSource, wanted: u16) -> Result<(u16, Chunk), BoardError> {
        let question = HostMessage::BankRead {
            source,
            offset: wanted,
        };
        match self.ask(&question)? {
            BoardMessage::BankChunk {
                offset,
                length,
                bytes,
            } if offset == wanted => Ok((length, bytes)),
            other => Err(refused(other)),
        }
    }

    fn greet(&mut self, boot: Duration) -> Result<BoardHello, BoardError> {
        let deadline = Instant::now() + boot;
        // Whatever a predecessor left half said on the line ends here.
        self.transmit(&[0])?;
        loop {
            let sequence = self.post(&HostMessage::Hello)?;
            match self.wait_for(sequence, HELLO_TIMEOUT) {
                Ok(BoardMessage::Hello(hello)) => return Ok(hello),
                Ok(_) => return Err(BoardError::UnexpectedAnswer),
                // The board has just booted, and may not have heard the question.
                Err(BoardError::Timeout(_) | BoardError::Restarted(_))
                    if Instant::now() < deadline => {}
                Err(error) => return Err(error),
            }
        }
    }

    fn command(&mut self, message: &HostMessage<N>) -> Result<(), BoardError> {
        acknowledged(self.ask(message)?)
    }

    /// Asks a question that may be asked twice without harm.
    fn ask(&mut self, message: &HostMessage<N>) -> Result<BoardMessage<N>, BoardError> {
        let mut attempt = 1;
        loop {
            let sequence = self.post(message)?;
            match self.wait_for(sequence, self.timeout) {
                Err(BoardError::Timeout(_)) if attempt < ATTEMPTS => attempt += 1,
                answer => return answer,
            }
        }
    }

    fn post(&mut self, message: &HostMessage<N>) -> Result<u16, BoardError> {
        // Number 0 is the board's own: what it says unasked.
        self.sequence = self.sequence.checked_add(1).unwrap_or(1);
        self.request.clear();
        self.request
            .push(self.sequence, message)
            .expect("every message of the protocol fits an empty frame buffer");
        let frame = self.request.as_bytes().to_vec();
        self.transmit(&frame)?;
        self.count.sent += 1;
        Ok(self.sequence)
    }

    fn transmit(&mut self, bytes: &[u8]) -> Result<(), BoardError> {
        let sent = self.transport.send(bytes);
        sent.map_err(|error| BoardError::Closed(self.transport.name(), error))
    }

    /// The answer to question `sequence`.
    fn wait_for(
        &mut self,
        sequence: u16,
        timeout: Duration,
    ) -> Result<BoardMessage<N>, BoardError> {
        let deadline = Instant::now() + timeout;
        loop {
            while let Some(&byte) = self.bytes.get(self.next) {
                self.next += 1;
                let received = match self.decoder.push(byte) {
                    None => continue,
                    Some(frame) => frame.and_then(|frame| {
                        Ok((frame.sequence, frame.message::<BoardMessage<N>>()?))
                    }),
                };
                match received {
                    Ok((from, answer)) => {
                        self.count.received += 1;
                        match answer {
                            answer if from == sequence => return Ok(answer),
                            BoardMessage::Hello(hello) if from == 0 => {
                                self.safety = hello.safety;
                                return Err(BoardError::Restarted(hello.reset_reason));
                            }
                            BoardMessage::Telemetry(frame) if from == 0 => {
                                self.telemetry.push(frame);
                            }
                            _ => self.count.stray += 1,
                        }
                    }
                    Err(DecodeError::ForeignVersion(version)) => {
                        return Err(BoardError::WrongProtocol(version));
                    }
                    Err(_) => self.count.errors += 1,
                }
            }
            let left = deadline.saturating_duration_since(Instant::now());
            // A board that talks without pause must not keep the question open for ever.
            if left.is_zero() || !self.fill(left)? {
                self.count.timeouts += 1;
                return Err(BoardError::Timeout(self.transport.name()));
            }
        }
    }

    /// Waits for bytes; `false` when none came in time.
    fn fill(&mut self, timeout: Duration) -> Result<bool, BoardError> {
        self.bytes.resize(FrameBuffer::CAPACITY, 0);
        self.next = 0;
        let received = self.transport.receive(&mut self.bytes, timeout);
        self.bytes.truncate(*received.as_ref().unwrap_or(&0));
        match received {
            Ok(count) => Ok(count > 0),
            Err(error) => Err(BoardError::Closed(self.transport.name(), error)),
        }
    }
}

/// In this state the motor stage has torque.
fn torque_flows(state: SafetyState) -> bool {
    matches!(state, SafetyState::Armed | SafetyState::RampDown)
}

fn acknowledged<const N: usize>(answer: BoardMessage<N>) -> Result<(), BoardError> {
    match answer {
        BoardMessage::Ack => Ok(()),
        other => Err(refused(other)),
    }
}

fn refused<const N: usize>(answer: BoardMessage<N>) -> BoardError {
    match answer {
        BoardMessage::Nack(reason) => BoardError::Refused(reason),
        _ => BoardError::UnexpectedAnswer,
    }
}

/// Stands where the board's hello will stand.
fn nobody() -> BoardHello {
    use foretorque::edge::wire::{CounterKind, Name, ResetReason};
    BoardHello {
        arm_hash: 0,
        arm: Name::new(),
        joints: 0,
        base_columns: 0,
        firmware: Name::new(),
        capabilities: Capabilities::default(),
        counter: CounterKind::None,
        counter_hz: 0,
        configuration: Configuration::default(),
        reset_reason: ResetReason::Unknown,
        safety: SafetyStatus::default(),
        boot_counts: 0,
    }
}
