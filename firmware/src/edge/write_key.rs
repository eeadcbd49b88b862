//! The write key: who may change the parameters of a board.
//!
//! A board with a key takes an upload only with HMAC-SHA-256 (RFC 2104, FIPS 180-4; cut to 16 bytes) over what is uploaded
//! and over a challenge of its own, which is good for one upload: what was overheard on the bus cannot be sent again. A
//! board without a key takes every upload.

use crate::edge::wire::MAC_BYTES;
use hmac::{Hmac, KeyInit, Mac};
use sha2::Sha256;

/// Bytes of a key.
pub const KEY_BYTES: usize = 32;

/// What is signed is told apart by its first bytes, so that no signature can be passed off as another.
const UPLOAD: &[u8] = b"foretorque upload 1";
const CHALLENGE: &[u8] = b"foretorque challenge 1";

/// A secret that host and board share.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct WriteKey([u8; KEY_BYTES]);

impl WriteKey {
    /// The key in a slot of memory; `None` for a slot that nobody has written: all ones, as erased flash is, or all zeros.
    ///
    /// ```
    /// use foretorque::edge::write_key::WriteKey;
    /// assert!(WriteKey::from_slot([0xFF; 32]).is_none());
    /// let key = WriteKey::from_slot([7; 32]).ok_or("erased")?;
    /// let signature = key.sign_upload(&[1; 16], 0xC0FFEE, b"bank");
    /// assert!(key.verifies(&signature, &[1; 16], 0xC0FFEE, b"bank"));
    /// assert!(!key.verifies(&signature, &[2; 16], 0xC0FFEE, b"bank"), "another challenge");
    /// # Ok::<(), &str>(())
    /// ```
    pub fn from_slot(slot: [u8; KEY_BYTES]) -> Option<Self> {
        let blank = slot == [0xFF; KEY_BYTES] || slot == [0; KEY_BYTES];
        (!blank).then_some(Self(slot))
    }

    /// The signature of an upload: over challenge, arm, length and bytes.
    pub fn sign_upload(
        &self,
        nonce: &[u8; MAC_BYTES],
        arm_hash: u32,
        bank: &[u8],
    ) -> [u8; MAC_BYTES] {
        let code = self.upload(nonce, arm_hash, bank).finalize();
        front(&code.into_bytes())
    }

    /// The signature is that of the upload. Takes the same time whatever is wrong with it.
    pub fn verifies(
        &self,
        signature: &[u8; MAC_BYTES],
        nonce: &[u8; MAC_BYTES],
        arm_hash: u32,
        bank: &[u8],
    ) -> bool {
        let code = self.upload(nonce, arm_hash, bank);
        code.verify_truncated_left(signature).is_ok()
    }

    /// Challenge number `count` of a board, which nobody without the key can foretell.
    ///
    /// * `seed` differs from start to start of the board, and need not be secret
    pub fn challenge(&self, seed: &[u8; MAC_BYTES], count: u32) -> [u8; MAC_BYTES] {
        let mut code = self.code();
        code.update(CHALLENGE);
        code.update(seed);
        code.update(&count.to_le_bytes());
        front(&code.finalize().into_bytes())
    }

    fn upload(&self, nonce: &[u8; MAC_BYTES], arm_hash: u32, bank: &[u8]) -> Hmac<Sha256> {
        let mut code = self.code();
        code.update(UPLOAD);
        code.update(nonce);
        code.update(&arm_hash.to_le_bytes());
        code.update(&(bank.len() as u32).to_le_bytes());
        code.update(bank);
        code
    }

    fn code(&self) -> Hmac<Sha256> {
        // The key is shorter than a block, which this type of constructor takes: RFC 2104 pads it with zeros.
        let mut block = [0; 64];
        for (slot, byte) in block.iter_mut().zip(self.0) {
            *slot = byte;
        }
        Hmac::new(&block.into())
    }
}

/// The key is not for logs.
impl core::fmt::Debug for WriteKey {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("WriteKey(…)")
    }
}

fn front(code: &[u8]) -> [u8; MAC_BYTES] {
    let mut front = [0; MAC_BYTES];
    for (slot, byte) in front.iter_mut().zip(code) {
        *slot = *byte;
    }
    front
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn key() -> WriteKey {
        WriteKey::from_slot([0x5A; KEY_BYTES]).unwrap()
    }

    /// By Python 3: hmac.new(bytes([0x5a]*32), b"foretorque upload 1" + bytes(range(16)) + bytes([4,3,2,1]) +
    /// bytes([4,0,0,0]) + b"bank", "sha256").hexdigest()[:32]
    #[test]
    fn signatures_are_those_of_another_implementation() {
        let nonce = core::array::from_fn(|place| place as u8);
        let signature = key().sign_upload(&nonce, 0x0102_0304, b"bank");
        let hex: std::string::String = signature
            .iter()
            .map(|byte| std::format!("{byte:02x}"))
            .collect();
        assert_eq!(hex, "d6221f6216a0f087ed5ff09e10564334");
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
