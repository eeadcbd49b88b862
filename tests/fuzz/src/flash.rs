use crate::{CRC, sealing};
use foretorque_flash::SimulatedFlash;
use foretorque_link::store::SLOT_BYTES;

const SECTOR: usize = SLOT_BYTES as usize;

/// Flash of two sectors with one slot each, that begins with the fuzzer's bytes.
///
/// The first half of `content` is at the front of the first sector, the rest at that of the second. An even first byte seals
/// what follows it in each: the checksum of the header is put right.
pub(crate) fn flash(content: &[u8]) -> SimulatedFlash<SECTOR> {
    let mut bytes = [[0xFF; SECTOR]; 2];
    let (seal, content) = sealing(content);
    let halves = content.split_at(content.len() / 2);
    for (sector, half) in bytes.iter_mut().zip([halves.0, halves.1]) {
        for (to, from) in sector.iter_mut().zip(half) {
            *to = *from;
        }
        if let (true, Some((header, body))) = (seal, sector.split_at_mut_checked(32)) {
            let length = u32::from_le_bytes([header[16], header[17], header[18], header[19]]);
            let body = body.get(..length as usize).unwrap_or_default();
            header[20..24].copy_from_slice(&CRC.checksum(body).to_le_bytes());
            let check = CRC.checksum(&header[..28]);
            header[28..].copy_from_slice(&check.to_le_bytes());
        }
    }
    SimulatedFlash::holding(bytes)
}
