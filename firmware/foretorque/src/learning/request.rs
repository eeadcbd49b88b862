/// What the board's owner may ask of the learner. It is handed over at a tick and holds from the lesson of that tick on,
/// so that the answer does not depend on how fast the learner is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum Request {
    /// Keep the present parameters as the set to come back to.
    Snapshot = 1,
    /// Go back to the kept set, bit for bit.
    Rollback = 2,
    /// Make the active set the committed one: the bound on learnt change lies around it from then on.
    Commit = 3,
    /// The hand is empty: no payload from now on.
    ZeroPayload = 4,
    /// Emergency stop: what was learnt in the last moments is dropped, and nothing is learnt until learning has been
    /// switched off and on again.
    Stop = 5,
}

impl Request {
    /// The request with number `code`, as the wire has it.
    pub const fn from_code(code: u8) -> Option<Self> {
        Some(match code {
            1 => Self::Snapshot,
            2 => Self::Rollback,
            3 => Self::Commit,
            4 => Self::ZeroPayload,
            5 => Self::Stop,
            _ => return None,
        })
    }
}

/// The request before is still waiting for its lesson.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct RequestPending;

impl core::fmt::Display for RequestPending {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("the request before is still waiting for its lesson")
    }
}

impl core::error::Error for RequestPending {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_request_is_found_by_its_number_and_no_other_number_is_one() {
        let known = [
            Request::Snapshot,
            Request::Rollback,
            Request::Commit,
            Request::ZeroPayload,
            Request::Stop,
        ];
        for code in 0..=u8::MAX {
            let expected = known.into_iter().find(|&request| request as u8 == code);
            assert_eq!(Request::from_code(code), expected, "{code}");
        }
    }
}
