//! Board side of foretorque: frames, parameter bank, session, safety, store, excitation, telemetry, hardware adapters.
//!
//! | module | contents |
//! |---|---|
//! | [`wire`] | frames and messages of the link |
//! | [`bank`], [`store`] | parameter bank, and its storage in flash |
//! | [`safety`] | state machine of the torque enable, limits |
//! | [`excitation`] | Fourier series of eq. 17, checked and played by the board |
//! | [`session`], [`telemetry`] | one connection to a host: protocol, controller, counters |
//! | [`drives`] | codecs of CAN drives with a torque feed-forward, and their profiles |
//! | [`bus`] | loop of an arm whose joints are such drives |
//! | [`hal`], [`drive`] | adapters of motor stage and encoder; the drive of one joint |
//! | [`write_key`] | authentication of uploads |
//!
//! Nothing allocates, nothing but the [`store`] blocks, and no input makes a session panic.
#![cfg_attr(not(test), no_std)]
#![forbid(unsafe_code)]

#[macro_use]
mod texts;

pub mod bank;
pub mod bus;
pub mod drive;
pub mod drives;
pub mod excitation;
pub mod hal;
pub mod safety;
pub mod session;
pub mod store;
pub mod telemetry;
pub mod wire;
pub mod write_key;

use core::hint::black_box;

/// Copies as many entries as both have; `copy_from_slice` can panic.
#[inline(always)]
fn copy<T: Copy>(to: &mut [T], from: &[T]) {
    to.iter_mut().zip(from).for_each(|(to, from)| *to = *from);
}

/// The whole part of `numerator / divisor`; `u32::MAX` where it is larger than that, or `divisor` is zero.
///
/// The compiler's routine for 64 by 64 bits takes 0.9 kB of flash.
/// Cost: one division of the core below 2³², else 32 rounds of long division, one for each bit.
#[inline(never)]
pub(crate) const fn div_u64_by_u32(numerator: u64, divisor: u32) -> u32 {
    let (mut rest, mut low) = ((numerator >> 32) as u32, numerator as u32);
    if rest >= divisor {
        return u32::MAX;
    }
    if rest == 0 {
        return low / divisor;
    }
    // Hides the number of rounds from the compiler, which would unroll them.
    let mut rounds = black_box(u32::BITS);
    while rounds > 0 {
        rounds -= 1;
        let carried = rest >> 31 == 1;
        rest = rest << 1 | low >> 31;
        low <<= 1;
        if carried || rest >= divisor {
            rest = rest.wrapping_sub(divisor);
            low |= 1;
        }
    }
    low
}

#[cfg(test)]
mod tests {
    use super::div_u64_by_u32;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn it_equals_the_division_of_the_language(
            numerator: u64,
            divisor: u32,
            bits in 0..64_u32,
            divisor_bits in 0..32_u32,
        ) {
            let (numerator, divisor) = (numerator >> bits, divisor >> divisor_bits);
            let expected = numerator.checked_div(u64::from(divisor)).map_or(u32::MAX, |whole| {
                u32::try_from(whole).unwrap_or(u32::MAX)
            });
            prop_assert_eq!(div_u64_by_u32(numerator, divisor), expected);
        }
    }

    #[test]
    fn the_edges_hold() {
        assert_eq!(div_u64_by_u32(0, 1), 0);
        assert_eq!(div_u64_by_u32(0, 0), u32::MAX);
        assert_eq!(div_u64_by_u32(u64::from(u32::MAX), 1), u32::MAX);
        const MAX: u32 = u32::MAX;
        assert_eq!(div_u64_by_u32((u64::from(MAX) << 32) - 1, MAX), MAX);
        assert_eq!(div_u64_by_u32(u64::from(MAX - 1) << 32, MAX), MAX - 1);
    }
}
