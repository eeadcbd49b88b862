//! The write key: who may change the parameters of a board.
//!
//! A board with a key takes an upload only with a code over what is uploaded and over a challenge of its own, which is good
//! for one upload: what was overheard on the bus cannot be sent again. A board without a key takes every upload.
//!
//! The code is SipHash-2-4 with 128 bits (Aumasson and Bernstein 2012), a keyed function made to be one: 3 kB of flash.
//! HMAC-SHA-256 takes 10 kB, and BLAKE2s in its small form has an index that can panic.

use crate::wire::MAC_BYTES;
use core::hash::Hasher as _;
use siphasher::sip128::{Hasher128 as _, SipHasher24};

/// Bytes of a key.
pub const KEY_BYTES: usize = 16;

/// Domain of an upload: the first bytes of signed data differ, so that no signature can be passed off as another.
const UPLOAD: &[u8] = b"foretorque upload 1";
const CHALLENGE: &[u8] = b"foretorque challenge 1";

/// A secret that host and board share.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct WriteKey([u8; KEY_BYTES]);

impl WriteKey {
    /// The key in a slot of memory; `None` for a slot that nobody has written: all ones, as erased flash is, or all zeros.
    ///
    /// ```
    /// use foretorque_link::write_key::WriteKey;
    /// assert!(WriteKey::from_slot([0xFF; 16]).is_none());
    /// let key = WriteKey::from_slot([7; 16]).ok_or("erased")?;
    /// let signature = key.sign_upload(&[1; 16], 0xC0FFEE, b"bank");
    /// assert!(key.verifies(&signature, &[1; 16], 0xC0FFEE, b"bank"));
    /// assert!(!key.verifies(&signature, &[2; 16], 0xC0FFEE, b"bank"), "another challenge");
    /// # Ok::<(), &str>(())
    /// ```
    pub fn from_slot(slot: [u8; KEY_BYTES]) -> Option<Self> {
        let blank = slot == [0xFF; KEY_BYTES] || slot == [0; KEY_BYTES];
        (!blank).then_some(Self(slot))
    }

    /// The signature of an upload, bank or excitation: over challenge, arm, length and bytes. By their first bytes neither
    /// can be taken for the other.
    pub fn sign_upload(
        &self,
        nonce: &[u8; MAC_BYTES],
        arm_hash: u32,
        upload: &[u8],
    ) -> [u8; MAC_BYTES] {
        let mut code = self.code();
        code.write(UPLOAD);
        code.write(nonce);
        code.write(&arm_hash.to_le_bytes());
        code.write(&(upload.len() as u32).to_le_bytes());
        code.write(upload);
        code.finish128().as_bytes()
    }

    /// The signature is that of the upload. Takes the same time whatever is wrong with it.
    pub fn verifies(
        &self,
        signature: &[u8; MAC_BYTES],
        nonce: &[u8; MAC_BYTES],
        arm_hash: u32,
        upload: &[u8],
    ) -> bool {
        let right = self.sign_upload(nonce, arm_hash, upload);
        let pairs = signature.iter().zip(right);
        let different = pairs.fold(0, |different, (given, right)| different | (given ^ right));
        different == 0
    }

    /// Challenge number `count` of a board, which nobody without the key can foretell.
    ///
    /// * `seed` differs from start to start of the board, and need not be secret
    pub fn challenge(&self, seed: &[u8; MAC_BYTES], count: u32) -> [u8; MAC_BYTES] {
        let mut code = self.code();
        code.write(CHALLENGE);
        code.write(seed);
        code.write(&count.to_le_bytes());
        code.finish128().as_bytes()
    }

    fn code(&self) -> SipHasher24 {
        SipHasher24::new_with_key(&self.0)
    }
}

/// The key is not for logs.
impl core::fmt::Debug for WriteKey {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("WriteKey(…)")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn key() -> WriteKey {
        WriteKey::from_slot([0x5A; KEY_BYTES]).unwrap()
    }

    /// The first of the reference's vectors (vectors_sip128 of its authors), and one by a program of a few lines of
    /// Python that gives it, over b"foretorque upload 1" + bytes(range(16)) + bytes([4,3,2,1,4,0,0,0]) + b"bank".
    #[test]
    fn signatures_are_those_of_another_implementation() {
        let hex = |bytes: [u8; MAC_BYTES]| -> std::string::String {
            bytes
                .iter()
                .map(|byte| std::format!("{byte:02x}"))
                .collect()
        };
        let counted = WriteKey(core::array::from_fn(|place| place as u8));
        let of_nothing = counted.code().finish128().as_bytes();
        assert_eq!(hex(of_nothing), "a3817f04ba25a8e66df67214c7550293");
        let nonce = core::array::from_fn(|place| place as u8);
        let signature = key().sign_upload(&nonce, 0x0102_0304, b"bank");
        assert_eq!(hex(signature), "409ff72807ab61683987b50fc01f0bdd");
    }

    #[test]
    fn challenges_differ_from_count_to_count_and_from_start_to_start() {
        let mut seen = std::vec::Vec::new();
        for seed in 0..20 {
            for count in 0..20 {
                seen.push(key().challenge(&[seed; MAC_BYTES], count));
            }
        }
        seen.sort_unstable();
        seen.dedup();
        assert_eq!(seen.len(), 400);
    }

    proptest! {
        #[test]
        fn whatever_is_changed_the_signature_no_longer_fits(
            bank in prop::collection::vec(any::<u8>(), 1..200),
            nonce: [u8; MAC_BYTES],
            arm: u32,
            place: prop::sample::Index,
            bit in 0..8u32,
        ) {
            let signature = key().sign_upload(&nonce, arm, &bank);
            prop_assert!(key().verifies(&signature, &nonce, arm, &bank));
            let mut other = bank.clone();
            other[place.index(bank.len())] ^= 1 << bit;
            prop_assert!(!key().verifies(&signature, &nonce, arm, &other));
            prop_assert!(!key().verifies(&signature, &nonce, arm ^ 1, &bank));
            let mut forged = signature;
            forged[place.index(MAC_BYTES)] ^= 1 << bit;
            prop_assert!(!key().verifies(&forged, &nonce, arm, &bank));
            let stranger = WriteKey::from_slot([0x5B; KEY_BYTES]).unwrap();
            prop_assert!(!stranger.verifies(&signature, &nonce, arm, &bank));
        }
    }
}
