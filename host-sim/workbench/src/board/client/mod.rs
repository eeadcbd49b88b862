mod commands;

use super::{BoardError, Transport};
use foretorque::arm::Arm;
use foretorque::feedforward::{Shares, Torque};
use foretorque::joint::{JointMotion, JointVector};
use foretorque::limits::Flags;
use foretorque_link::excitation::ExcitationState;
use foretorque_link::safety::SafetyStatus;
use foretorque_link::telemetry::Statistics;
use foretorque_link::wire::{
    BoardHello, BoardMessage, Configuration, DecodeError, Decoder, FrameBuffer, HostMessage,
    SampleFrame, TelemetryFrame,
};
use foretorque_link::write_key::WriteKey;
use std::time::{Duration, Instant};

/// Largest number of times that an idempotent request is sent.
const ATTEMPTS: usize = 3;
/// How long one hello is waited for while a board may still be booting.
const HELLO_TIMEOUT: Duration = Duration::from_millis(300);

/// Shares of the torque of one tick, N·m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BoardShares<const N: usize> {
    /// Those of one joint: rigid body, friction, network.
    Joint(usize, [f32; 3]),
    /// All of them.
    All(Shares<N>),
}

impl<const N: usize> BoardShares<N> {
    /// Rigid body, friction and network of a joint, as far as known.
    pub fn of(&self, joint: usize) -> Option<[f32; 3]> {
        match self {
            Self::Joint(own, shares) => (*own == joint).then_some(*shares),
            Self::All(all) => Some([all.rigid, all.friction, all.network].map(|all| all[joint])),
        }
    }
}

/// Torque of one tick, as the board answered it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TickReply<const N: usize> {
    /// Counter of the tick.
    pub tick: u32,
    /// Flags of the tick.
    pub flags: Flags,
    /// Whether torque leaves the board, and why not.
    pub safety: SafetyStatus,
    /// The torque, N × N·m, bit for bit; zero unless the board is armed.
    pub total: JointVector<N>,
    /// Shares of the torque.
    pub shares: BoardShares<N>,
    /// Where the excitation stands and what it asks of the arm, if the board plays one.
    pub excited: Option<(ExcitationState, JointMotion<N>)>,
}

/// Client of the protocol, for a board of `N` joints over any [`Transport`].
pub struct Client<const N: usize> {
    transport: Box<dyn Transport>,
    decoder: Decoder,
    request: FrameBuffer,
    sequence: u16,
    /// Bytes received and not yet decoded.
    bytes: Vec<u8>,
    next: usize,
    /// Longest time for an answer.
    pub timeout: Duration,
    /// Number of the period of the next sample.
    period: u8,
    /// The torque of a sample is answered only when its learning step is done, so that what the board learns does not depend on
    /// when the next sample comes. So it is from the start, unless the transport [keeps time](Transport::keeps_time).
    pub waits_for_learning: bool,
    hello: BoardHello,
    /// Safety state of the last reply.
    safety: SafetyStatus,
    /// The desired motion of the last sample, without a measurement.
    presented: Option<SampleFrame<N>>,
    /// Telemetry that the board sent unasked.
    telemetry: Vec<TelemetryFrame>,
    /// Key that signs uploads, where the board asks for it.
    pub key: Option<WriteKey>,
    /// Gains by which measured torques are sent as motor currents, N × N·m/A: those of the board's bank.
    pub gains: Option<JointVector<N>>,
}

impl<const N: usize> Client<N> {
    /// Connects to the board and makes sure that it drives arm `A` and has this version of the protocol.
    ///
    /// * `boot` how long the board may take to answer its first hello
    ///
    /// Errors: [`BoardError::Timeout`], [`BoardError::WrongProtocol`], [`BoardError::WrongRobot`],
    /// [`BoardError::Closed`].
    pub fn connect<A: Arm<N, P>, const P: usize>(
        transport: Box<dyn Transport>,
        boot: Duration,
    ) -> Result<Self, BoardError> {
        let mut client = Self {
            period: 0,
            waits_for_learning: !transport.keeps_time(),
            transport,
            decoder: Decoder::new(),
            request: FrameBuffer::new(),
            sequence: 0,
            bytes: Vec::new(),
            next: 0,
            timeout: Duration::from_secs(2),
            hello: BoardHello::default(),
            safety: SafetyStatus::default(),
            presented: None,
            telemetry: Vec::new(),
            key: None,
            gains: None,
        };
        client.hello = client.await_hello(boot)?;
        client.safety = client.hello.safety;
        let found = &client.hello;
        if found.arm_hash != A::hash() || usize::from(found.joints) != N {
            let (arm, hash, joints) = (&found.arm, found.arm_hash, found.joints);
            return Err(BoardError::WrongRobot(
                format!("{arm} ({hash:08x}, {joints} joints)"),
                format!("{} ({:08x})", A::name(), A::hash()),
            ));
        }
        Ok(client)
    }

    /// Lets a period go by without a sample: the number of the next one shows it.
    pub fn skip_period(&mut self) {
        self.period = self.period.wrapping_add(1);
    }

    /// Identity from the board's hello.
    pub fn hello(&self) -> &BoardHello {
        &self.hello
    }

    /// Has the board stream `fields`, a sum of [`Field`](foretorque_link::wire::Field) bits, of every `every`-th tick.
    pub fn stream(&mut self, fields: u16, every: u16) -> Result<(), BoardError> {
        self.command(&HostMessage::Telemetry { fields, every })
    }

    /// The telemetry that came since this was last asked, in the order it came.
    pub fn take_telemetry(&mut self) -> Vec<TelemetryFrame> {
        std::mem::take(&mut self.telemetry)
    }

    /// Starts the board's processor anew. It has to be greeted again.
    pub fn reboot(&mut self) -> Result<(), BoardError> {
        self.bring_to_rest()?;
        self.post(&HostMessage::Reboot)?;
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

    fn await_hello(&mut self, boot: Duration) -> Result<BoardHello, BoardError> {
        let deadline = Instant::now() + boot;
        // An unfinished frame of a predecessor ends here.
        self.transmit(&[0])?;
        loop {
            let sequence = self.post(&HostMessage::Hello)?;
            match self.wait_for(sequence, HELLO_TIMEOUT) {
                Ok(BoardMessage::Hello(hello)) => return Ok(hello),
                Ok(_) => return Err(BoardError::UnexpectedAnswer),
                // The board has just booted, and may not have received the question.
                Err(BoardError::Timeout(_) | BoardError::Restarted(_))
                    if Instant::now() < deadline => {}
                Err(error) => return Err(error),
            }
        }
    }

    fn command(&mut self, message: &HostMessage<N>) -> Result<(), BoardError> {
        self.unlock(message)?;
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
        // Number 0 is the board's own, for unasked messages.
        self.sequence = self.sequence.checked_add(1).unwrap_or(1);
        self.request.clear();
        self.request
            .push(self.sequence, message)
            .expect("every message of the protocol fits an empty frame buffer");
        let frame = self.request.as_bytes().to_vec();
        self.transmit(&frame)?;
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
                    Ok((from, answer)) if from == sequence => return Ok(answer),
                    Ok((0, BoardMessage::Hello(hello))) => {
                        self.safety = hello.safety;
                        return Err(BoardError::Restarted(hello.reset_reason));
                    }
                    Ok((0, BoardMessage::Telemetry(frame))) => self.telemetry.push(frame),
                    Err(DecodeError::ForeignVersion(version)) => {
                        return Err(BoardError::WrongProtocol(version));
                    }
                    // A damaged frame, or an answer to no open question.
                    _ => {}
                }
            }
            let left = deadline.saturating_duration_since(Instant::now());
            // A board that sends without pause must not keep the question open for ever.
            if left.is_zero() || !self.fill(left)? {
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
