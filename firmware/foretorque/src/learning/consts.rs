//! Constants, and arithmetic for constants made by the compiler.

/// Standard gravity, by which torque limits are converted to masses, m/s².
pub(super) const GRAVITY: f32 = 9.81;

/// Square root by Newton's method, for constant evaluation only.
///
/// Limits: converged for 1e-12 to 1e12; 0 gives 1e-9.
pub(super) const fn sqrt(square: f32) -> f32 {
    let mut guess = 1.0;
    let mut step = 0;
    while step < 30 {
        guess = 0.5 * (guess + square / guess);
        step += 1;
    }
    guess
}
