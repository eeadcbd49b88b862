use crate::math::tanh;

/// Activation function of a hidden unit.
///
/// The slope is computed from the unit's *output*, which back-propagation has at hand, never from its input: all three
/// activations below allow it, and it saves the second evaluation.
pub trait Activation: Copy + core::fmt::Debug + PartialEq + 'static {
    /// Output of a unit whose weighted input is `x`.
    fn value(x: f32) -> f32;
    /// Derivative of the output with respect to the weighted input, where the output is `y`.
    fn slope(y: f32) -> f32;
}

/// `max(0, x)`.  [paper eq. 19]
///
/// The slope at the kink is taken as zero. A not-a-number stays one: a fault must not hide behind a comparison.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Relu;

impl Activation for Relu {
    fn value(x: f32) -> f32 {
        if x < 0.0 { 0.0 } else { x }
    }

    fn slope(y: f32) -> f32 {
        if y > 0.0 { 1.0 } else { 0.0 }
    }
}

/// `1 / (1 + exp(-x))`, computed as `(1 + tanh(x / 2)) / 2`, which cannot overflow.  [paper eq. 18]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sigmoid;

impl Activation for Sigmoid {
    fn value(x: f32) -> f32 {
        0.5 + 0.5 * tanh(0.5 * x)
    }

    fn slope(y: f32) -> f32 {
        y * (1.0 - y)
    }
}

/// `tanh(x)`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tanh;

impl Activation for Tanh {
    fn value(x: f32) -> f32 {
        tanh(x)
    }

    fn slope(y: f32) -> f32 {
        1.0 - y * y
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn slope_error<A: Activation>(x: f64, exact: fn(f64) -> f64) -> f64 {
        let step = 1e-5;
        let difference = (exact(x + step) - exact(x - step)) / (2.0 * step);
        (f64::from(A::slope(A::value(x as f32))) - difference).abs()
    }

    #[test]
    fn slopes_are_the_derivatives_of_the_textbook_functions() {
        for k in -40..=40 {
            let x = f64::from(k) * 0.15 + 0.01;
            assert!(slope_error::<Relu>(x, |x| x.max(0.0)) < 1e-6, "relu at {x}");
            assert!(
                slope_error::<Sigmoid>(x, |x| 1.0 / (1.0 + (-x).exp())) < 1e-6,
                "sigmoid at {x}"
            );
            assert!(slope_error::<Tanh>(x, f64::tanh) < 1e-6, "tanh at {x}");
        }
    }

    #[test]
    fn bounded_activations_stay_bounded_for_any_finite_input() {
        for x in [-f32::MAX, -1e3, -0.0, 0.0, 1e3, f32::MAX] {
            assert!((0.0..=1.0).contains(&Sigmoid::value(x)), "sigmoid at {x}");
            assert!((-1.0..=1.0).contains(&Tanh::value(x)), "tanh at {x}");
        }
    }
}
