use super::StoreError;
use serde::{Deserialize, Serialize};

/// State of the store.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum StoreHealth {
    /// The board has none, or it has not been used yet.
    #[default]
    Unused,
    /// The last order succeeded.
    Sound,
    /// It holds no set.
    Empty,
    /// Its content does not fit this firmware, or the store.
    Refused,
    /// The flash is worn out, write-protected or absent: the board runs from RAM and loses its set at power-off. Stays
    /// until a save succeeds.
    Failing,
}

impl StoreHealth {
    /// The state after one more access: a flash that failed to store is not sound because it can be read.
    ///
    /// * `wrote` the access was a save
    pub(crate) fn after<T>(self, wrote: bool, outcome: &Result<T, StoreError>) -> Self {
        match (self, outcome) {
            (Self::Failing, _) if !wrote => Self::Failing,
            (_, Ok(_)) => Self::Sound,
            (_, Err(StoreError::Empty)) => Self::Empty,
            (_, Err(StoreError::NotKept | StoreError::Flash)) => Self::Failing,
            (_, Err(_)) => Self::Refused,
        }
    }
}
