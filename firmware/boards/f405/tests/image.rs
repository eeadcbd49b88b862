//! The check of the program in flash.

use foretorque_f405::image::{BYTES, Seal};
use foretorque_link::wire::ImageStatus::{Damaged, Sound, Unsealed};

/// Place of the seal in the program.
const PLACE: usize = 300;

fn write(flash: &mut [u8], seal: Seal) {
    flash[PLACE..PLACE + 4].copy_from_slice(&seal.length.to_le_bytes());
    flash[PLACE + 4..PLACE + BYTES].copy_from_slice(&seal.crc.to_le_bytes());
}

/// The seal as the program reads it from the flash.
fn read(flash: &[u8]) -> Seal {
    let word = |at: usize| u32::from_le_bytes(flash[at..at + 4].try_into().unwrap());
    Seal {
        length: word(PLACE),
        crc: word(PLACE + 4),
    }
}

#[test]
fn m7_every_flipped_bit_of_a_sealed_program_is_found() {
    let mut flash: Vec<u8> = (0..4096_u32).map(|k| ((k * 7) >> 2) as u8).collect();
    let program = 1000;
    write(&mut flash, Seal::default());
    assert_eq!(read(&flash).check(&flash, PLACE), Unsealed);
    let seal = Seal::of(&flash[..program], PLACE).unwrap();
    write(&mut flash, seal);
    assert_eq!(read(&flash).check(&flash, PLACE), Sound);
    for bit in 0..8 * flash.len() {
        flash[bit / 8] ^= 1 << (bit % 8);
        let wanted = if bit / 8 < program { Damaged } else { Sound };
        assert_eq!(read(&flash).check(&flash, PLACE), wanted, "bit {bit}");
        flash[bit / 8] ^= 1 << (bit % 8);
    }
    assert_eq!(Seal::of(&flash[..PLACE + BYTES - 1], PLACE), None);
}
