//! f32 kernels of the tick, each with its error bound and cost.

/// Hyperbolic tangent by its continued fraction, eight steps, clamped to ±1.
pub fn tanh(x: f32) -> f32 {
    let bounded = x.clamp(-9.0, 9.0);
    let square = bounded * bounded;
    let mut tail = 17.0;
    for step in [15.0, 13.0, 11.0, 9.0, 7.0, 5.0, 3.0, 1.0] {
        tail = step + square / tail;
    }
    (bounded / tail).clamp(-1.0, 1.0)
}
