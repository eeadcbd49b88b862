//! Types of a board that follow from its arm.

use foretorque_link::session::{Housekeeping, Session};

use crate::counter::Counter;
use crate::store_flash::StoreFlash;

/// Session of a board.
pub type BoardSession<A, const N: usize, const P: usize> = Session<A, N, P, Counter>;
/// Its housekeeping, with the store.
pub type BoardHousekeeping<A, const N: usize, const P: usize> = Housekeeping<A, N, P, StoreFlash>;
