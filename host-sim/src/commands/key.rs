//! The write key of a board, from a file.

use super::{Failure, unusable};
use foretorque_link::write_key::{KEY_BYTES, WriteKey};
use std::fs;
use std::path::Path;

/// The key in `path`: 32 hexadecimal digits in one line.
///
/// Errors: the file's, or that it holds no key.
pub(super) fn read(path: &Path) -> Result<WriteKey, Failure> {
    let text =
        fs::read_to_string(path).map_err(|error| foretorque_workbench::files::at(path, error))?;
    let key = parsed(text.trim()).and_then(WriteKey::from_slot);
    key.ok_or_else(|| {
        unusable(format!(
            "{}: not a write key: 32 hexadecimal digits, not all 0 or f",
            path.display()
        ))
    })
}

fn parsed(text: &str) -> Option<[u8; KEY_BYTES]> {
    let mut key = [0; KEY_BYTES];
    let digits = text.as_bytes();
    if digits.len() != 2 * KEY_BYTES || !digits.iter().all(u8::is_ascii_hexdigit) {
        return None;
    }
    for (byte, pair) in key.iter_mut().zip(digits.chunks(2)) {
        *byte = u8::from_str_radix(std::str::from_utf8(pair).ok()?, 16).ok()?;
    }
    Some(key)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_is_32_hexadecimal_digits() {
        assert_eq!(parsed(&"0a".repeat(16)), Some([10; 16]));
        for wrong in [
            "",
            "0a",
            &"0g".repeat(16),
            &"+a".repeat(16),
            &"0a".repeat(17),
        ] {
            assert_eq!(parsed(wrong), None, "{wrong}");
        }
    }
}
