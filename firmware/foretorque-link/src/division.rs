//! Division of 64 by 32 bits. The compiler's routine for 64 by 64 bits takes 0.9 kB of flash.

use core::hint::black_box;

/// The whole part of `numerator / divisor`; `u32::MAX` where it is larger than that, or `divisor` is zero.
///
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
