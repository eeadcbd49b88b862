//! The set that the store kept, and the session.

use embedded_storage::nor_flash::NorFlash;

use super::{Clock, Desk, Session};
use crate::arm::Arm;
use crate::edge::bank::ParameterBank;
use crate::edge::store::{Store, StoreError, StoreState};
use crate::edge::wire::NackReason;

impl<A: Arm<N, P>, const N: usize, const P: usize, C: Clock> Session<A, N, P, C> {
    /// Begins with the newest set that the store kept for this arm; where there is none, the bank of the firmware stays.
    ///
    /// Cannot fail: what is wrong is what is returned, and the board runs. To be called at boot, before the first tick.
    #[inline(never)]
    pub fn boot_from<F: NorFlash>(
        &mut self,
        store: &mut Store<F>,
        desk: &mut Desk<N, P>,
    ) -> StoreState {
        let mut room = [0; ParameterBank::MAX_BYTES];
        let loaded = store.load(A::HASH, &mut room);
        match loaded.and_then(|bank| self.restore(bank, desk).map_err(refused)) {
            Ok(()) => StoreState::Loaded,
            Err(error) => StoreState::Failed(error),
        }
    }
}

/// A session that has just booted refuses a set for what is in it alone.
fn refused(reason: NackReason) -> StoreError {
    match reason {
        NackReason::Bank(error) => StoreError::Bank(error),
        _ => StoreError::Damaged,
    }
}
