//! Boards: whatever runs the firmware's session at the other end of a byte link.
//!
//! In this process ([`Native`]), in the emulator or on a serial port: a [`Transport`] carries the bytes, one [`Client`]
//! speaks the protocol over any of them.

mod child;
mod client;
pub mod flash;
pub mod log;
mod native;
pub mod qemu;
pub mod serial;

pub use client::{BoardShares, Client, TickReply};
pub use foretorque_description::described::Described;
pub use native::Native;

use foretorque_link::bank::BankError;
use foretorque_link::wire::{NackReason, PROTOCOL_VERSION, ResetReason};
use std::cell::RefCell;
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
    /// The board speaks another version of the protocol.
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
