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

pub use client::{BoardShares, Client, LinkCount, TickReply};
pub use native::Native;

use foretorque_link::bank::BankError;
use foretorque_link::wire::{NackReason, PROTOCOL_VERSION, ResetReason};
use std::fmt;
use std::io;
use std::time::Duration;

/// A link that carries bytes to a board and back.
pub trait Transport {
    /// Where the board is, for messages: `native`, `qemu`, `serial:/dev/ttyUSB0`.
    fn name(&self) -> String;

    /// Sends all of `bytes`.
    ///
    /// Errors: the link is gone; a board that died says so in the error's text.
    fn send(&mut self, bytes: &[u8]) -> io::Result<()>;

    /// The host keeps the board's time at the other end: a sample a period, whatever the board is doing. Elsewhere the next
    /// sample comes when the one before is answered, and the answer waits until its lesson is learnt.
    fn keeps_time(&self) -> bool {
        false
    }

    /// Waits at most `timeout` for bytes and puts what there is into `room`. 0 = nothing came.
    ///
    /// Errors: the link is gone; a board that died says so in the error's text.
    fn receive(&mut self, room: &mut [u8], timeout: Duration) -> io::Result<usize>;
}

/// Why a conversation with a board failed.
#[derive(Debug)]
pub enum BoardError {
    /// The link is gone, or the board behind it.
    Closed(String, io::Error),
    /// No answer in time.
    Timeout(String),
    /// The board speaks another version of the protocol.
    WrongProtocol(u8),
    /// The board drives another robot.
    WrongRobot {
        /// The robot wanted.
        wanted: String,
        /// What the board says it is.
        found: String,
    },
    /// The board started over in the middle of the conversation.
    Restarted(ResetReason),
    /// The board refused.
    Refused(NackReason),
    /// The answer is not one to the question.
    UnexpectedAnswer,
    /// The board has a write key, and this program was given none.
    NoKey,
    /// The bank cannot be sent, or what was read is none.
    Bank(BankError),
}

impl fmt::Display for BoardError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Closed(board, error) => write!(f, "link to board {board} is gone: {error}"),
            Self::Timeout(board) => write!(f, "board {board} does not answer"),
            Self::WrongProtocol(version) => write!(
                f,
                "the board speaks protocol version {version}, this program version {PROTOCOL_VERSION}"
            ),
            Self::WrongRobot { wanted, found } => {
                write!(
                    f,
                    "the board drives {found}, not {wanted}: is its firmware that of `cargo firmware`?"
                )
            }
            Self::Restarted(reason) => write!(f, "the board has started over ({reason:?})"),
            Self::Refused(reason) => write!(f, "the board refused: {reason}"),
            Self::UnexpectedAnswer => f.write_str("the board gave an answer to another question"),
            Self::NoKey => f.write_str("the board has a write key: an upload needs --key-file"),
            Self::Bank(error) => write!(f, "{error}"),
        }
    }
}

impl std::error::Error for BoardError {}
