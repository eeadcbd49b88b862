//! Scalars and vectors whose types carry which entries are 0 or ±1.
//!
//! IEEE arithmetic lets no compiler drop `x · 0` (x may be ∞) or `x + 0` (x may be −0). A [`Term`] carries that knowledge
//! beside the value: once the recursions over the joints are unrolled and inlined, its kind is a constant everywhere, the
//! branches on it vanish, and the right angles and zero lengths of an arm cost nothing.

use core::ops::{Add, Mul, Neg, Sub};

/// Compile-time knowledge about a scalar.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Zero,
    One,
    MinusOne,
    Any,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Term {
    value: f32,
    kind: Kind,
}

impl Term {
    pub(super) const ZERO: Self = Self {
        value: 0.0,
        kind: Kind::Zero,
    };
    pub(super) const ONE: Self = Self {
        value: 1.0,
        kind: Kind::One,
    };
    const MINUS_ONE: Self = Self {
        value: -1.0,
        kind: Kind::MinusOne,
    };

    /// A number only known when the program runs.
    #[inline(always)]
    pub(super) const fn variable(value: f32) -> Self {
        Self {
            value,
            kind: Kind::Any,
        }
    }

    /// A number known while compiling.
    #[inline(always)]
    pub(super) const fn constant(value: f32) -> Self {
        if value == 0.0 {
            Self::ZERO
        } else if value == 1.0 {
            Self::ONE
        } else if value == -1.0 {
            Self::MINUS_ONE
        } else {
            Self::variable(value)
        }
    }

    #[inline(always)]
    pub(super) const fn value(self) -> f32 {
        self.value
    }
}

impl Neg for Term {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        match self.kind {
            Kind::Zero => Self::ZERO,
            Kind::One => Self::MINUS_ONE,
            Kind::MinusOne => Self::ONE,
            Kind::Any => Self::variable(-self.value),
        }
    }
}

impl Add for Term {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        match (self.kind, other.kind) {
            (Kind::Zero, _) => other,
            (_, Kind::Zero) => self,
            _ => Self::variable(self.value + other.value),
        }
    }
}

impl Sub for Term {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        match (self.kind, other.kind) {
            (Kind::Zero, _) => -other,
            (_, Kind::Zero) => self,
            _ => Self::variable(self.value - other.value),
        }
    }
}

impl Mul for Term {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        match (self.kind, other.kind) {
            (Kind::Zero, _) | (_, Kind::Zero) => Self::ZERO,
            (Kind::One, _) => other,
            (_, Kind::One) => self,
            (Kind::MinusOne, _) => -other,
            (_, Kind::MinusOne) => -self,
            _ => Self::variable(self.value * other.value),
        }
    }
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Vector(pub(super) [Term; 3]);

impl Vector {
    pub(super) const ZERO: Self = Self([Term::ZERO; 3]);
    /// The joint axis in its own frame.
    pub(super) const Z: Self = Self([Term::ZERO, Term::ZERO, Term::ONE]);

    /// A vector known while compiling.
    #[inline(always)]
    pub(super) const fn constant(v: [f32; 3]) -> Self {
        Self([
            Term::constant(v[0]),
            Term::constant(v[1]),
            Term::constant(v[2]),
        ])
    }

    #[inline(always)]
    pub(super) fn dot(self, other: Self) -> Term {
        let ([a, b, c], [x, y, z]) = (self.0, other.0);
        a * x + b * y + c * z
    }

    #[inline(always)]
    pub(super) fn cross(self, other: Self) -> Self {
        let ([a, b, c], [x, y, z]) = (self.0, other.0);
        Self([b * z - c * y, c * x - a * z, a * y - b * x])
    }

    #[inline(always)]
    pub(super) fn scale(self, factor: Term) -> Self {
        let [x, y, z] = self.0;
        Self([x * factor, y * factor, z * factor])
    }
}

impl Add for Vector {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        let ([a, b, c], [x, y, z]) = (self.0, other.0);
        Self([a + x, b + y, c + z])
    }
}

/// A 3 × 3 matrix of terms, row by row.
#[derive(Clone, Copy, Debug)]
pub(super) struct Matrix(pub(super) [Vector; 3]);

impl Matrix {
    pub(super) const ZERO: Self = Self([Vector::ZERO; 3]);

    #[inline(always)]
    pub(super) fn times(self, v: Vector) -> Vector {
        let [x, y, z] = self.0;
        Vector([x.dot(v), y.dot(v), z.dot(v)])
    }

    #[inline(always)]
    pub(super) fn transposed_times(self, v: Vector) -> Vector {
        let [x, y, z] = self.0;
        let [a, b, c] = v.0;
        x.scale(a) + y.scale(b) + z.scale(c)
    }
}
