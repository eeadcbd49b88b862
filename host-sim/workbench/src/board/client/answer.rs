//! Answers of a board, judged.

use crate::board::BoardError;
use foretorque_link::safety::SafetyStatus;
use foretorque_link::wire::{BoardHello, BoardMessage, Capabilities, ChipStatus, Configuration};

pub(super) fn acknowledged<const N: usize>(answer: BoardMessage<N>) -> Result<(), BoardError> {
    match answer {
        BoardMessage::Ack => Ok(()),
        other => Err(refused(other)),
    }
}

pub(super) fn refused<const N: usize>(answer: BoardMessage<N>) -> BoardError {
    match answer {
        BoardMessage::Nack(reason) => BoardError::Refused(reason),
        _ => BoardError::UnexpectedAnswer,
    }
}

/// Stands where the board's hello will stand.
pub(super) fn nobody() -> BoardHello {
    use foretorque_link::wire::{CounterKind, Name, ResetReason};
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
        chip: ChipStatus::VIRTUAL,
    }
}
