//! Write key: authentication of uploads, and of orders that change model, learnt state or store.
//!
//! A board with a key accepts an upload only with a signature over its bytes and over a challenge, which is valid for one
//! upload: a recorded upload cannot be replayed. An order needs a permission, signed alike and valid for this one order. A
//! board without a key accepts everything.
//!
//! The signature is SipHash-2-4 with 128 bits (Aumasson and Bernstein 2012), in 3 kB of flash. HMAC-SHA-256 takes 10 kB,
//! and BLAKE2s in its small form has an index that can panic.

use crate::wire::MAC_BYTES;
use core::hash::Hasher as _;
use siphasher::sip128::{Hasher128 as _, SipHasher24};

/// Bytes of a key.
pub const KEY_BYTES: usize = 16;

/// First bytes of signed data, so that no signature serves another purpose.
const UPLOAD: &[u8] = b"foretorque upload 1";
const ORDER: &[u8] = b"foretorque order 1";
const CHALLENGE: &[u8] = b"foretorque challenge 1";

/// Symmetric key of host and board.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct WriteKey([u8; KEY_BYTES]);

impl WriteKey {
    /// The key in a slot of memory; `None` for a blank slot: all ones, as erased flash, or all zeros.
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

    /// The signature of a bank or excitation: over challenge, arm, length and bytes. Their first bytes differ, so neither
    /// signature serves the other.
    pub fn sign_upload(
        &self,
        nonce: &[u8; MAC_BYTES],
        arm_hash: u32,
        upload: &[u8],
    ) -> [u8; MAC_BYTES] {
        self.sign(UPLOAD, nonce, arm_hash, upload)
    }

    #[inline(never)]
    fn sign(
        &self,
        purpose: &[u8],
        nonce: &[u8; MAC_BYTES],
        arm_hash: u32,
        content: &[u8],
    ) -> [u8; MAC_BYTES] {
        let mut code = self.code();
        code.write(purpose);
        code.write(nonce);
        code.write(&arm_hash.to_le_bytes());
        code.write(&(content.len() as u32).to_le_bytes());
        code.write(content);
        code.finish128().as_bytes()
    }

    /// The signature that permits one order: over challenge, arm, tag of the message and its first byte.
    pub fn sign_order(
        &self,
        nonce: &[u8; MAC_BYTES],
        arm_hash: u32,
        order: [u8; 2],
    ) -> [u8; MAC_BYTES] {
        self.sign(ORDER, nonce, arm_hash, &order)
    }

    /// Verifies the permission of an order, in constant time.
    pub fn permits(
        &self,
        signature: &[u8; MAC_BYTES],
        nonce: &[u8; MAC_BYTES],
        arm_hash: u32,
        order: [u8; 2],
    ) -> bool {
        same(signature, &self.sign_order(nonce, arm_hash, order))
    }

    /// Verifies the signature of an upload, in constant time.
    pub fn verifies(
        &self,
        signature: &[u8; MAC_BYTES],
        nonce: &[u8; MAC_BYTES],
        arm_hash: u32,
        upload: &[u8],
    ) -> bool {
        same(signature, &self.sign_upload(nonce, arm_hash, upload))
    }

    /// Challenge number `count` of a board, unpredictable without the key.
    ///
    /// * `seed` differs from start to start of the board, and may be public
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

/// Compares in constant time.
fn same(given: &[u8; MAC_BYTES], right: &[u8; MAC_BYTES]) -> bool {
    let pairs = given.iter().zip(right);
    pairs.fold(0, |different, (given, right)| different | (given ^ right)) == 0
}

/// Hides the key from logs.
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

    /// The first reference vector (vectors_sip128 of the authors), and one of a Python program that reproduces it, over
    /// b"foretorque upload 1" + bytes(range(16)) + bytes([4,3,2,1,4,0,0,0]) + b"bank".
    #[test]
    fn signatures_are_those_of_another_implementation() {
        let hex = |bytes: [u8; MAC_BYTES]| format!("{:032x}", u128::from_be_bytes(bytes));
        let counted = WriteKey(core::array::from_fn(|place| place as u8));
        let of_nothing = counted.code().finish128().as_bytes();
        assert_eq!(hex(of_nothing), "a3817f04ba25a8e66df67214c7550293");
        let nonce = core::array::from_fn(|place| place as u8);
        let signature = key().sign_upload(&nonce, 0x0102_0304, b"bank");
        assert_eq!(hex(signature), "409ff72807ab61683987b50fc01f0bdd");
    }

    proptest! {
        #[test]
        fn any_change_invalidates_the_signature(
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
            let foreign = WriteKey::from_slot([0x5B; KEY_BYTES]).unwrap();
            prop_assert!(!foreign.verifies(&signature, &nonce, arm, &bank));
        }
    }
}
