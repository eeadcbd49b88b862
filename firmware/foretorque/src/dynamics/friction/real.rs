//! Arithmetic of the friction columns, in f32 and f64.

use crate::math;
use core::ops::{Add, Div, Mul};

/// Arithmetic of the basis functions: f32 with the kernels of [`math`] in the tick, f64 with libm in identification.
pub trait Real: Copy + Add<Output = Self> + Mul<Output = Self> + Div<Output = Self> {
    /// 1.
    const ONE: Self;
    /// `self / width`.
    fn over(self, width: f64) -> Self;
    /// `exp(−self²)`.
    fn gaussian(self) -> Self;
    /// Absolute value.
    fn abs(self) -> Self;
}

impl Real for f32 {
    const ONE: Self = 1.0;

    #[inline(always)]
    fn over(self, width: f64) -> Self {
        // The reciprocal is a constant after inlining: no division in the tick.
        self * (1.0 / width as f32)
    }

    #[inline(always)]
    fn gaussian(self) -> Self {
        math::gaussian(self)
    }

    #[inline(always)]
    fn abs(self) -> Self {
        f32::abs(self)
    }
}

impl Real for f64 {
    const ONE: Self = 1.0;

    fn over(self, width: f64) -> Self {
        self / width
    }

    fn gaussian(self) -> Self {
        libm::exp(-(self * self))
    }

    fn abs(self) -> Self {
        f64::abs(self)
    }
}
