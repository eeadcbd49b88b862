//! Boards: whatever runs the firmware's session at the other end of a byte link.
//!
//! In this process ([`Native`]), in the emulator or on a serial port: a [`Transport`] carries the bytes, one [`Client`]
//! is the protocol over any of them.

mod child;
mod client;
pub mod log;
pub mod qemu;
pub mod serial;

pub use client::{BoardShares, Client, TickReply};
pub use foretorque_description::described::Described;

use foretorque::arm::{Arm, ArmModel};
use foretorque::learning::{ConfigError, Learner, LearnerConfig};
use foretorque_link::bank::BankError;
use foretorque_link::session::{
    BoardDescription, Housekeeping, LocalSensor, Mailboxes, NoClock, NoLocalSensor, Session,
};
use foretorque_link::wire::{FrameBuffer, NackReason, PROTOCOL_VERSION, ResetReason};
use std::cell::RefCell;
use std::collections::VecDeque;
use std::io;
use std::rc::Rc;
use std::time::Duration;

/// A link that carries bytes to a board and back.
pub trait Transport {
    /// Where the board is, for messages: `native`, `qemu`, `serial:/dev/ttyUSB0`.
    fn name(&self) -> String;

    /// Sends all of `bytes`.
    ///
    /// Errors: the link is gone; the error of a board that died has the reason.
    fn send(&mut self, bytes: &[u8]) -> io::Result<()>;

    /// The host keeps the board's time at the other end: a sample a period, whatever the board is doing. Elsewhere the next
    /// sample comes when the one before is answered, and the answer waits for the learning step.
    fn keeps_time(&self) -> bool {
        false
    }

    /// Waits at most `timeout` for bytes and puts them into `buffer`. 0 = nothing came.
    ///
    /// Errors: the link is gone; the error of a board that died has the reason.
    fn receive(&mut self, buffer: &mut [u8], timeout: Duration) -> io::Result<usize>;
}

impl<T: Transport> Transport for Rc<RefCell<T>> {
    fn name(&self) -> String {
        self.borrow().name()
    }

    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.borrow_mut().send(bytes)
    }

    fn keeps_time(&self) -> bool {
        self.borrow().keeps_time()
    }

    fn receive(&mut self, buffer: &mut [u8], timeout: Duration) -> io::Result<usize> {
        self.borrow_mut().receive(buffer, timeout)
    }
}

/// Why a conversation with a board failed.
#[derive(Debug, thiserror::Error)]
pub enum BoardError {
    /// The link is gone, or the board behind it.
    #[error("link to board {0} is gone: {1}")]
    Closed(String, io::Error),
    /// No answer in time.
    #[error("board {0} does not answer")]
    Timeout(String),
    /// The board has another version of the protocol.
    #[error("the board speaks protocol version {0}, this program version {PROTOCOL_VERSION}")]
    WrongProtocol(u8),
    /// The board drives another robot: the identity that it reports, and the robot wanted.
    #[error(
        "the board drives {0}, not {1}: `cargo firmware` builds that of the UR5, `cargo xtask arm` that of others"
    )]
    WrongRobot(String, String),
    /// The board started over in the middle of the conversation.
    #[error("the board has started over ({0:?})")]
    Restarted(ResetReason),
    /// The desired motion is beyond the range of a sample: joint from 1 on, value, unit, range.
    #[error(
        "the desired motion of joint {0} reaches {1:.1} {2}, a sample carries up to {3:.0} {2}: lower the limits of the arm, or slow the path down"
    )]
    BeyondSample(usize, f32, &'static str, f32),
    /// The board refused.
    #[error("the board refused: {0}")]
    Refused(NackReason),
    /// The answer is not one to the question.
    #[error("the board gave an answer to another question")]
    UnexpectedAnswer,
    /// The bank belongs to another arm than the board's: arm of the bank, arm of the board.
    #[error("the bank is for {0}, the board drives {1}")]
    WrongBank(String, String),
    /// The board has a write key, and this program was given none.
    #[error("the board has a write key: an upload needs --key-file")]
    NoKey,
    /// The bank cannot be sent, or what was read is none.
    #[error("{0}")]
    Bank(BankError),
}

/// The board in this process: the firmware's own session and learner behind the very same frames.
///
/// The learner takes its learning sample right after each reply, as it does on the board that simulates in bulk.
pub struct Native<A: Arm<N, P>, const N: usize, const P: usize, S: LocalSensor<N> = NoLocalSensor> {
    arm: &'static ArmModel<N, P>,
    /// The session inside.
    pub session: Session<A, N, P>,
    mailboxes: Mailboxes<N, P>,
    housekeeping: Housekeeping<A, N, P>,
    /// The learner inside.
    pub learner: Learner<A, N, P>,
    out: FrameBuffer,
    waiting: VecDeque<u8>,
    /// The sensor of its own.
    pub sensor: S,
}

impl<A: Arm<N, P>, const N: usize, const P: usize> Native<A, N, P> {
    /// A board that has just booted and sent its hello.
    ///
    /// Errors: the first limit of the arm that cannot work.
    pub fn new() -> Result<Self, ConfigError> {
        Self::described(BoardDescription::plain(NoClock), NoLocalSensor)
    }
}

impl<A: Arm<N, P>, const N: usize, const P: usize, S: LocalSensor<N>> Native<A, N, P, S> {
    /// Lets one period of the timer pass that the description of the board may have, as on silicon beside the samples, whichever
    /// of the two paces the board.
    pub fn timer(&mut self) {
        self.select_arm();
        self.session
            .timer_tick(&mut self.mailboxes, &mut self.out, &mut self.sensor);
        self.flush();
        self.mailboxes.learner.work(&mut self.learner, &NoClock);
    }

    /// A board that has just booted as `board` describes and sent its hello, with a sensor of its own.
    ///
    /// Errors: the first limit of the arm that cannot work.
    pub fn described(board: BoardDescription, sensor: S) -> Result<Self, ConfigError> {
        let session = Session::new(board)?;
        let period_s = session.configuration().period_us as f32 * 1e-6;
        let set = session.feed_forward().state().active;
        let mut native = Self {
            arm: A::model(),
            session,
            mailboxes: Mailboxes::default(),
            housekeeping: Housekeeping::new(None),
            learner: Learner::new(LearnerConfig::for_arm::<A>(period_s), set)?,
            out: FrameBuffer::new(),
            waiting: VecDeque::new(),
            sensor,
        };
        native.session.send_hello(&mut native.out);
        native.flush();
        Ok(native)
    }

    /// Makes the arm of this board the described arm of this thread.
    fn select_arm(&self) {
        if A::COMPILED.is_none() {
            Described::select(self.arm);
        }
    }

    fn flush(&mut self) {
        self.waiting.extend(self.out.as_bytes());
        self.out.clear();
    }
}

impl<A: Arm<N, P>, const N: usize, const P: usize, S: LocalSensor<N>> Transport
    for Native<A, N, P, S>
{
    fn name(&self) -> String {
        "native".into()
    }

    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.select_arm();
        for frame in bytes.split_inclusive(|&byte| byte == 0) {
            self.session
                .receive(frame, &mut self.mailboxes, &mut self.out, &mut self.sensor);
            if self.housekeeping.work(&mut self.mailboxes.parameters) {
                self.session
                    .poll_parameters(&mut self.mailboxes, &mut self.out);
            }
            self.flush();
            self.mailboxes.learner.work(&mut self.learner, &NoClock);
        }
        Ok(())
    }

    fn receive(&mut self, buffer: &mut [u8], _timeout: Duration) -> io::Result<usize> {
        let count = buffer.len().min(self.waiting.len());
        for (slot, byte) in buffer.iter_mut().zip(self.waiting.drain(..count)) {
            *slot = byte;
        }
        Ok(count)
    }
}
