//! f32 kernels of the tick, each with its error bound and cost.
//!
//! Only additions, multiplications, one division and integer operations on the bits, in a fixed order and never fused:
//! every machine gives the same bits. They call no libm, whose `sinf` computes in software f64 on a Cortex-M4F. Random start
//! values and quality figures, outside the tick, use libm.

/// 1.5 · 2²³: adding it rounds to the nearest integer and leaves that integer in the lowest bits of the mantissa.
const ROUND: f32 = 12_582_912.0;
const SIGN: u32 = 0x8000_0000;

/// Largest |x| for which [`sin_cos`] states an error, rad.
pub const LARGEST_ANGLE: f32 = 1000.0;

/// Sine and cosine of one angle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SinCos {
    /// Sine.
    pub sin: f32,
    /// Cosine.
    pub cos: f32,
}

/// Directions in one turn whose sine and cosine are known.
const DIRECTIONS: usize = 64;
/// Directions in a quarter turn.
const IN_QUARTER: f32 = (DIRECTIONS / 4) as f32;

/// Sine and cosine of `x`, rad.
///
/// With k the integer nearest to x / δ, δ = 2π/64, and r = x − k δ in two steps (Cody and Waite 1980, chapter 8), the
/// sum formulas turn the known direction k δ by the small angle r, |r| ≤ π/64:
///
/// ```text
/// sin r = r + S r³,  cos r = 1 + C r²,    sin x = sin kδ + (cos kδ sin r + sin kδ C r²),    cos x likewise
/// ```
/// Absolute error: ≤ 1.2e-7 for |x| ≤ 2π, ≤ 5e-7 for |x| ≤ 1000. NaN and ±∞ give NaN. Beyond 1000 the result loses
/// digits: callers keep within [`LARGEST_ANGLE`].
/// Cost: 11 multiplications, 9 additions, no branch.
#[inline(always)]
pub fn sin_cos(x: f32) -> SinCos {
    const INV_STEP: f32 = core::f32::consts::FRAC_2_PI * IN_QUARTER;
    // 10 significant bits: k · HIGH is exact for |k| ≤ 2¹⁴.
    const HIGH: f32 = 9.814_453e-2;
    const LOW: f32 = 3.023_917_5e-5;

    let rounded = x * INV_STEP + ROUND;
    // −k, not k: `rounded - ROUND` would be compiled as the sum with −ROUND, one constant more to load.
    let minus_k = ROUND - rounded;
    let r = (x + minus_k * HIGH) + minus_k * LOW;
    turned(rounded, r)
}

/// Sine and cosine of `x` quarter turns: of the angle x π/2.
///
/// Nothing is lost by taking whole steps away, so the angle may be many turns: a phase that is first multiplied into
/// quarter turns keeps the relative error of that product and no more.
///
/// Absolute error: ≤ 1.2e-7 for |x| ≤ 2¹⁸. What is beyond, ±∞ and NaN give NaN.
/// Cost: 9 multiplications, 7 additions, one comparison.
#[inline(always)]
pub fn sin_cos_quarters(x: f32) -> SinCos {
    // Adding this leaves x in sixteenths, rounded, in the lowest bits; beyond 2¹⁸ it would no longer.
    const ROUND_STEP: f32 = ROUND / IN_QUARTER;
    let x = if x.abs() <= 262_144.0 { x } else { f32::NAN };
    let rounded = x + ROUND_STEP;
    let r = (x - (rounded - ROUND_STEP)) * core::f32::consts::FRAC_PI_2;
    turned(rounded, r)
}

/// Sine and cosine of k δ + r, k in the lowest bits of `rounded`, |r| ≤ π/64.
#[inline(always)]
fn turned(rounded: f32, r: f32) -> SinCos {
    // Minimax of the absolute error over |r| ≤ π/64: 3.1e-10 and 4.2e-8.
    const S: f32 = -1.666_492_2e-1;
    const C: f32 = -4.999_168e-1;

    let z = r * r;
    let sin_r = r + r * z * S;
    let cos_r_less_1 = z * C;
    let known = KNOWN[rounded.to_bits() as usize % DIRECTIONS];
    SinCos {
        sin: (known.cos * sin_r + known.sin * cos_r_less_1) + known.sin,
        cos: (known.cos * cos_r_less_1 - known.sin * sin_r) + known.cos,
    }
}

/// Sine and cosine of k δ.
static KNOWN: [SinCos; DIRECTIONS] = {
    let mut known = [SinCos { sin: 0.0, cos: 1.0 }; DIRECTIONS];
    let mut k = 0;
    while k < DIRECTIONS {
        known[k] = SinCos {
            sin: direction_sin(k),
            cos: direction_sin(k + DIRECTIONS / 4),
        };
        k += 1;
    }
    known
};

/// sin k δ, from its Taylor series in f64 about the nearest half turn.
const fn direction_sin(k: usize) -> f32 {
    let half = DIRECTIONS / 2;
    let turned = k % DIRECTIONS;
    let (past, sign) = if turned < half {
        (turned, 1.0)
    } else {
        (turned - half, -1.0)
    };
    // sin is symmetric about a quarter turn: |angle| ≤ π/2.
    let nearest = if past <= half / 2 { past } else { half - past };
    let angle = nearest as f64 * (core::f64::consts::TAU / DIRECTIONS as f64);
    let (mut term, mut sum, mut n) = (angle, angle, 1.0);
    while n < 12.0 {
        term *= -angle * angle / ((2.0 * n) * (2.0 * n + 1.0));
        sum += term;
        n += 1.0;
    }
    (sign * sum) as f32
}

/// `exp(−x²)`.
///
/// Relative error ≤ 2e-7 + 6e-8 x². Down to e⁻⁸⁷, where it stays: finite and positive for every x. NaN gives NaN.
/// Cost: 11 multiplications, 9 additions, one comparison.
#[inline(always)]
pub fn gaussian(x: f32) -> f32 {
    let exponent = -(x * x);
    exp(if exponent < SMALLEST_EXPONENT {
        SMALLEST_EXPONENT
    } else {
        exponent
    })
}

const SMALLEST_EXPONENT: f32 = -87.0;

/// e to the power of `x`, which lies between −87 and 88 or is NaN: relative error ≤ 2e-7.
///
/// With k the integer nearest to x / ln 2 and r = x − k ln 2, `eˣ = 2ᵏ eʳ`.
#[inline(always)]
fn exp(x: f32) -> f32 {
    // 15 bits behind the point: k · HIGH is exact for |k| ≤ 127.
    const LN_2_HIGH: f32 = 0.693_145_75;
    const LN_2_LOW: f32 = 1.428_606_8e-6;
    // Minimax of the relative error over |r| ≤ ln 2 / 2: 3.1e-9.
    const E: [f32; 5] = [
        4.999_999_3e-1,
        1.666_652e-1,
        4.166_839e-2,
        8.368_75e-3,
        1.381_45e-3,
    ];

    let rounded = x * core::f32::consts::LOG2_E + ROUND;
    let k = rounded - ROUND;
    let r = (x - k * LN_2_HIGH) - k * LN_2_LOW;
    let tail = E[0] + r * (E[1] + r * (E[2] + r * (E[3] + r * E[4])));
    let mantissa = 1.0 + (r + r * r * tail);
    // The low bits of `rounded` are k; 127 + k is the biased exponent of 2ᵏ.
    let power = f32::from_bits(rounded.to_bits().wrapping_add(127) << 23);
    mantissa * power
}

/// Hyperbolic tangent of `x`.
///
/// `tanh x = (1 − e) / (1 + e)` with `e = exp(−2x)` taken at |x|, so that e ≤ 1.
///
/// Absolute error ≤ 1.5e-7; odd, never beyond ±1. NaN gives NaN. Arguments below 1e-8 give zero.
/// Cost: 11 multiplications, 11 additions, one division, one comparison.
#[inline]
pub fn tanh(x: f32) -> f32 {
    let bits = x.to_bits();
    // Beyond 9.02 the result rounds to 1; the comparison lets NaN through.
    let magnitude = x.abs();
    let magnitude = if magnitude > 10.0 { 10.0 } else { magnitude };
    let e = exp(-2.0 * magnitude);
    let tanh = (1.0 - e) / (1.0 + e);
    f32::from_bits(tanh.to_bits() | (bits & SIGN))
}

/// Hyperbolic tangents of `x`, 5 `x` and 15 `x`.
///
/// `tanh kx = (1 − eᵏ) / (1 + eᵏ)` with `e = exp(−2x)` taken at |x|: one exponential for the three.
///
/// Absolute error ≤ 1.5e-7, 5e-7 and 1.5e-6: that of e, as often as e is a factor. Odd, never beyond ±1. NaN gives NaN.
/// Cost: 15 multiplications, 15 additions, three divisions, one comparison.
#[inline(always)]
pub fn tanh_1_5_15(x: f32) -> [f32; 3] {
    let sign = x.to_bits() & SIGN;
    let magnitude = x.abs();
    // As in `tanh`: the comparison lets NaN through.
    let magnitude = if magnitude > 10.0 { 10.0 } else { magnitude };
    let e = exp(-2.0 * magnitude);
    let squared = e * e;
    let fifth = squared * squared * e;
    let fifteenth = fifth * fifth * fifth;
    [e, fifth, fifteenth].map(|e| {
        let tanh = (1.0 - e) / (1.0 + e);
        f32::from_bits(tanh.to_bits() | sign)
    })
}

/// Integer nearest to `x`, halves away from zero; saturates, and is 0 for NaN.
// Has many callers, which share one copy.
#[inline(never)]
pub fn nearest(x: f32) -> i32 {
    // Beyond 2^23 every f32 is an integer, and adding a half could round to the neighbour.
    let half = if x.abs() < 8_388_608.0 { 0.5_f32 } else { 0.0 };
    // The cast truncates and saturates.
    (x + half.copysign(x)) as i32
}

/// Square root of `x`.
///
/// `y ≈ 1/√x` from the halved exponent, three steps `y ← y (3 − x y²) / 2` (Newton), `√x = x y`.
///
/// Relative error ≤ 3e-7 for normal positive x. Zero and what is no positive number give 0; +∞ gives NaN.
/// Cost: 13 multiplications, 3 subtractions, no division.
#[inline(always)]
pub fn sqrt(x: f32) -> f32 {
    // NaN is not positive either.
    if x > 0.0 {
        let half = 0.5 * x;
        // The constant makes the first guess good to 3.5 % on all mantissas.
        let mut y = f32::from_bits(0x5f37_59df_u32.wrapping_sub(x.to_bits() >> 1));
        for _ in 0..3 {
            y *= 1.5 - half * y * y;
        }
        x * y
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Largest `error` over every `stride`-th number from `from` to `to`.
    fn worst(error: impl Fn(f32) -> f64, from: f32, to: f32, stride: usize) -> f64 {
        let numbers = (from.to_bits()..=to.to_bits()).step_by(stride);
        numbers.map(f32::from_bits).map(error).fold(0.0, f64::max)
    }

    /// Largest absolute error of `pair` up to `limit`, both signs.
    ///
    /// * `angle` rad, of its argument
    fn worst_pair(
        pair: fn(f32) -> SinCos,
        angle: fn(f32) -> f64,
        limit: f32,
        stride: usize,
    ) -> f64 {
        let error = |x: f32| {
            let (pair, (sin, cos)) = (pair(x), angle(x).sin_cos());
            (f64::from(pair.sin) - sin)
                .abs()
                .max((f64::from(pair.cos) - cos).abs())
        };
        worst(|x| error(x).max(error(-x)), 0.0, limit, stride)
    }

    #[test]
    fn sin_cos_keeps_its_bound_within_one_turn_and_up_to_a_thousand() {
        for (limit, stride, bound) in [(core::f32::consts::TAU, 331, 1.2e-7), (1000.0, 337, 5e-7)] {
            let worst = worst_pair(sin_cos, f64::from, limit, stride);
            assert!(worst <= bound, "{worst:e} up to {limit}");
        }
    }

    /// Minutes: by hand, with `cargo test --release -p foretorque --lib -- --ignored every_float`.
    #[test]
    #[ignore = "2.2e9 values"]
    fn sin_cos_keeps_its_bound_at_every_float_within_one_turn() {
        let worst = worst_pair(sin_cos, f64::from, core::f32::consts::TAU, 1);
        assert!(worst <= 1.2e-7, "{worst:e}");
    }

    #[test]
    fn quarters_keep_their_bound_over_many_turns() {
        // Whole turns are taken away exactly; the rest is small enough for π to be exact enough.
        let angle = |x| f64::from(x % 4.0) * core::f64::consts::FRAC_PI_2;
        let worst = worst_pair(sin_cos_quarters, angle, 262_144.0, 331);
        assert!(worst <= 1.2e-7, "{worst:e}");
        for x in [262_144.5, -1e9, f32::INFINITY, f32::NAN] {
            let pair = sin_cos_quarters(x);
            assert!(pair.sin.is_nan() && pair.cos.is_nan());
        }
    }

    #[test]
    fn what_is_no_number_gives_no_number() {
        for x in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            let pair = sin_cos(x);
            assert!(pair.sin.is_nan() && pair.cos.is_nan());
        }
        assert!(exp(f32::NAN).is_nan() && tanh(f32::NAN).is_nan());
    }

    #[test]
    fn exp_keeps_its_relative_bound() {
        let mut worst = 0.0_f64;
        for step in -86_999..=87_999 {
            let x = step as f32 * 1e-3;
            let truth = f64::from(x).exp();
            worst = worst.max((f64::from(exp(x)) / truth - 1.0).abs());
        }
        assert!(worst <= 2e-7, "{worst:e}");
    }

    #[test]
    fn a_gaussian_is_even_finite_and_keeps_its_relative_bound() {
        for step in 0..=932 {
            let x = step as f32 * 1e-2;
            let square = f64::from(x).powi(2);
            let error = (f64::from(gaussian(x)) * square.exp() - 1.0).abs();
            assert!(error <= 2e-7 + 6e-8 * square, "{error:e} at {x}");
            assert_eq!(gaussian(-x), gaussian(x));
        }
        assert!(
            gaussian(f32::INFINITY) > 0.0
                && gaussian(f32::MAX) < 1e-37
                && gaussian(f32::NAN).is_nan()
        );
    }

    #[test]
    fn sqrt_keeps_its_relative_bound() {
        let error = |x: f32| (f64::from(sqrt(x)) / f64::from(x).sqrt() - 1.0).abs();
        let worst = worst(error, f32::MIN_POSITIVE, f32::MAX, 3331);
        assert!(worst <= 3e-7, "{worst:e}");
        assert_eq!([0.0, -1.0, f32::NAN].map(sqrt), [0.0; 3]);
    }

    #[test]
    fn tanh_keeps_its_bound_and_is_odd() {
        let error = |x: f32| {
            assert_eq!(tanh(-x), -tanh(x));
            assert!(tanh(x) <= 1.0);
            (f64::from(tanh(x)) - f64::from(x).tanh()).abs()
        };
        let worst = worst(error, 0.0, 100.0, 331);
        assert!(worst <= 1.5e-7, "{worst:e}");
        assert_eq!(tanh(f32::INFINITY), 1.0);
    }

    #[test]
    fn three_tanh_of_one_exponential_keep_their_bounds_and_are_odd() {
        let mut worst = [0.0_f64; 3];
        for bits in (0..=100.0_f32.to_bits()).step_by(331) {
            let x = f32::from_bits(bits);
            let three = tanh_1_5_15(x);
            for ((worst, tanh), k) in worst.iter_mut().zip(three).zip([1.0, 5.0, 15.0]) {
                *worst = worst.max((f64::from(tanh) - (k * f64::from(x)).tanh()).abs());
                assert!(tanh <= 1.0);
            }
            assert_eq!(tanh_1_5_15(-x), three.map(|tanh| -tanh));
        }
        let bounds = [1.5e-7, 5e-7, 1.5e-6];
        assert!((0..3).all(|k| worst[k] <= bounds[k]), "{worst:?}");
        assert_eq!(tanh_1_5_15(f32::INFINITY), [1.0; 3]);
        assert!(tanh_1_5_15(f32::NAN).iter().all(|tanh| tanh.is_nan()));
    }
}
