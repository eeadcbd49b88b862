//! The table of the friction columns: one entry for each term of joint friction that is linear in its parameter.
//!
//! Regressor, tick, estimator, prior, parameter bank and identification read their lists of columns here. A new column is a
//! new entry.

use super::Real;
use crate::arm::JointLimits;
use core::ops::{Index, IndexMut};

/// Arguments of the basis functions of one joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrictionPoint<T> {
    /// Joint velocity, rad/s.
    pub qd: T,
    /// Smoothed sign of the velocity, `tanh(qd / SIGN_WIDTH)`.
    pub sign: T,
    /// Torque that the gear carries, N·m ([`friction_load`](super::friction_load)).
    pub load: T,
    /// Sine of the cogging phase z q; 0 without cogging.
    pub cogging_sin: T,
    /// Cosine of the cogging phase z q; 0 without cogging.
    pub cogging_cos: T,
}

/// Prior standard deviation of the parameter of a column.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FrictionPrior {
    /// Part of the joint's torque limit.
    Torque(f32),
    /// Part of the joint's torque limit at its velocity limit.
    TorqueAtFullSpeed(f32),
    /// One value for every joint, in the unit of the parameter.
    Fixed(f32),
}

impl FrictionPrior {
    /// Standard deviation for a joint with `limits`, in the unit of the parameter.
    pub const fn deviation(self, limits: &JointLimits) -> f32 {
        match self {
            Self::Torque(part) => part * limits.torque,
            Self::TorqueAtFullSpeed(part) => part * limits.torque / limits.velocity,
            Self::Fixed(deviation) => deviation,
        }
    }
}

/// Bound of the parameter of a column that keeps friction dissipative.
///
/// Assumes: the basis of a column with a bound is odd in the speed, that of one without does not depend on it, and only
/// [`FrictionColumn::Load`] depends on the load, in proportion to its size. The tick derives from this the columns beyond the
/// learnt range (`feedforward/model.rs`).
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FrictionBound {
    /// Not negative.
    NotNegative,
    /// Not below minus this part of the Coulomb torque. All such parts together are at most 1.
    CoulombPart(f32),
    /// None: the column does not dissipate.
    None,
}

/// Properties of a friction column.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrictionProperties {
    /// Short name, as in a parameter bank.
    pub symbol: &'static str,
    /// Unit of the parameter.
    pub unit: &'static str,
    /// Name of the column set of identification to which the column belongs.
    pub set: &'static str,
    /// Number of its kind in a parameter bank; never changed, never used again.
    pub bank_kind: u8,
    /// Prior standard deviation.
    pub prior: FrictionPrior,
    /// Sign constraint.
    pub bound: FrictionBound,
    /// Changes with temperature, grease and wear: the estimator adds process noise, in proportion to the mean square of the
    /// parameter if it has a bound.
    pub random_walk: bool,
}

/// Width of the Stribeck peak, rad/s.
pub const STRIBECK_WIDTH: f64 = 0.09;
/// Velocity at which shear thinning has halved its torque, rad/s.
pub const SHEAR_WIDTH: f64 = 0.6;

macro_rules! friction_columns {
    ($(
        $(#[$doc:meta])*
        $column:ident {
            basis: |$x:ident| $basis:expr,
            $($property:ident: $value:expr,)*
        }
    )*) => {
        /// A friction column of a joint, in the order of every row and of [`FrictionParameters`].
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum FrictionColumn {
            $($(#[$doc])* $column,)*
        }

        /// Number of friction columns of one joint.
        pub const FRICTION_COLUMNS: usize = [$(FrictionColumn::$column),*].len();

        impl FrictionColumn {
            /// All columns in their order.
            pub const ALL: [Self; FRICTION_COLUMNS] = [$(Self::$column),*];

            /// Properties of the column.
            pub const fn properties(self) -> FrictionProperties {
                match self {
                    $(Self::$column => FrictionProperties { $($property: $value,)* },)*
                }
            }
        }

        impl FrictionParameters {
            /// Friction torque Σ parameter × column, N·m, added in the order of the columns.
            ///
            /// * `columns` [`FrictionPoint::columns`]
            ///
            /// Cost: one multiply-add for each column.
            #[inline(always)]
            pub const fn torque(&self, columns: &[f32; FRICTION_COLUMNS]) -> f32 {
                // Written out for the tick. The sum begins at −0: −0 + x is x.
                -0.0 $(+ self.term(FrictionColumn::$column, columns))*
            }
        }

        impl<T: Real> FrictionPoint<T> {
            /// Value of every basis function: the torque for each unit of its parameter.
            ///
            /// Cost in f32: one [`gaussian`](crate::math::gaussian), one division, 6 multiplications.
            #[inline(always)]
            pub fn columns(&self) -> [T; FRICTION_COLUMNS] {
                [$({ let $x = self; $basis }),*]
            }
        }
    };
}

friction_columns! {
    /// Viscous friction.
    Viscous {
        basis: |x| x.qd,
        symbol: "Fv",
        unit: "N·m·s/rad",
        set: "coulomb-viscous",
        bank_kind: 11,
        prior: FrictionPrior::TorqueAtFullSpeed(0.1),
        bound: FrictionBound::NotNegative,
        random_walk: true,
    }
    /// Coulomb friction.
    Coulomb {
        basis: |x| x.sign,
        symbol: "Fc",
        unit: "N·m",
        set: "coulomb-viscous",
        bank_kind: 12,
        prior: FrictionPrior::Torque(0.03),
        bound: FrictionBound::NotNegative,
        random_walk: true,
    }
    /// Stribeck peak.
    ///
    /// With viscous friction, Coulomb friction and shear thinning beside it, 0.09 rad/s meets a peak of 0.08 to 0.10 rad/s
    /// to within 6 % of its height from 0.05 rad/s on, one of 0.07 or 0.12 rad/s to within 14 %.
    Stribeck {
        basis: |x| x.sign * x.qd.over(STRIBECK_WIDTH).gaussian(),
        symbol: "Fs",
        unit: "N·m",
        set: "stribeck",
        bank_kind: 18,
        prior: FrictionPrior::Torque(0.01),
        bound: FrictionBound::CoulombPart(0.5),
        random_walk: true,
    }
    /// Shear thinning of the lubricant: friction of slow motion beside Coulomb and viscous friction, half gone at
    /// 0.6 rad/s. Negative where friction grows ever less with speed.
    ///
    /// On a real UR5 it reaches from tenths of a rad/s to more than one; the width of the column matters little there.
    ShearThinning {
        basis: |x| {
            let ratio = x.qd.over(SHEAR_WIDTH);
            x.sign / (T::ONE + ratio * ratio)
        },
        symbol: "Fb",
        unit: "N·m",
        set: "stribeck",
        bank_kind: 19,
        prior: FrictionPrior::Torque(0.012),
        bound: FrictionBound::CoulombPart(0.5),
        random_walk: true,
    }
    /// Friction under load: teeth and bearings are pressed together.
    ///
    /// A larger prior deviation makes payloads harder to estimate.
    Load {
        basis: |x| x.sign * x.load.abs(),
        symbol: "Fl",
        unit: "1",
        set: "load",
        bank_kind: 20,
        prior: FrictionPrior::Fixed(0.013),
        bound: FrictionBound::NotNegative,
        random_walk: false,
    }
    /// Constant torque of the drive: the zero of its current sensor, which drifts with the temperature; a dress pack.
    Offset {
        basis: |_x| T::ONE,
        symbol: "Fo",
        unit: "N·m",
        set: "offset",
        bank_kind: 15,
        prior: FrictionPrior::Torque(0.015),
        bound: FrictionBound::None,
        random_walk: true,
    }
    /// Cogging in phase with the sine.
    CoggingSine {
        basis: |x| x.cogging_sin,
        symbol: "Gs",
        unit: "N·m",
        set: "cogging",
        bank_kind: 16,
        prior: FrictionPrior::Torque(0.005),
        bound: FrictionBound::None,
        random_walk: false,
    }
    /// Cogging in phase with the cosine.
    CoggingCosine {
        basis: |x| x.cogging_cos,
        symbol: "Gc",
        unit: "N·m",
        set: "cogging",
        bank_kind: 17,
        prior: FrictionPrior::Torque(0.005),
        bound: FrictionBound::None,
        random_walk: false,
    }
}

/// Friction of one joint, linear in its parameters; indexed by [`FrictionColumn`].
///
/// ```
/// use foretorque::dynamics::{FrictionColumn, FrictionParameters};
/// let friction = FrictionParameters::NONE
///     .with(FrictionColumn::Viscous, 12.0)
///     .with(FrictionColumn::Coulomb, 7.0);
/// assert_eq!(friction[FrictionColumn::Coulomb], 7.0);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrictionParameters(pub [f32; FRICTION_COLUMNS]);

impl FrictionParameters {
    /// No friction.
    pub const NONE: Self = Self([0.0; FRICTION_COLUMNS]);

    /// These parameters with `value` for `column`.
    #[must_use]
    pub const fn with(mut self, column: FrictionColumn, value: f32) -> Self {
        self.0[column as usize] = value;
        self
    }

    /// Torque of one column, N·m.
    #[inline(always)]
    const fn term(&self, column: FrictionColumn, columns: &[f32; FRICTION_COLUMNS]) -> f32 {
        let parameter = self.0[column as usize];
        match column {
            // Its column is 1.
            FrictionColumn::Offset => parameter,
            _ => parameter * columns[column as usize],
        }
    }
}

impl Index<FrictionColumn> for FrictionParameters {
    type Output = f32;

    #[inline(always)]
    fn index(&self, column: FrictionColumn) -> &f32 {
        &self.0[column as usize]
    }
}

impl IndexMut<FrictionColumn> for FrictionParameters {
    #[inline(always)]
    fn index_mut(&mut self, column: FrictionColumn) -> &mut f32 {
        &mut self.0[column as usize]
    }
}

/// Number of columns with `random_walk`, and of columns with a bound.
const COUNTS: [usize; 2] = {
    let (mut counts, mut part, mut k) = ([0; 2], 0.0, 0);
    while k < FRICTION_COLUMNS {
        let column = FrictionColumn::ALL[k].properties();
        counts[0] += column.random_walk as usize;
        counts[1] += !matches!(column.bound, FrictionBound::None) as usize;
        if let FrictionBound::CoulombPart(more) = column.bound {
            part += more;
        }
        k += 1;
    }
    assert!(part <= 1.0, "the parts of the Coulomb torque exceed it");
    counts
};

/// The columns that follow a random walk.
pub const RANDOM_WALK_COLUMNS: [FrictionColumn; COUNTS[0]] = {
    let (mut columns, mut next, mut k) = ([FrictionColumn::ALL[0]; COUNTS[0]], 0, 0);
    while k < FRICTION_COLUMNS {
        if FrictionColumn::ALL[k].properties().random_walk {
            columns[next] = FrictionColumn::ALL[k];
            next += 1;
        }
        k += 1;
    }
    columns
};

/// The cogging columns, periodic in the position; only on joints with cogging cycles.
pub const COGGING_COLUMNS: [FrictionColumn; 2] =
    [FrictionColumn::CoggingSine, FrictionColumn::CoggingCosine];

/// Bounds of friction that dissipates at every velocity and load: `Σ a_k p_k >= 0` over the parameters p for each row a.
///
/// Sufficient, column by column: [`FrictionBound`].
pub const DISSIPATION_BOUNDS: [[f32; FRICTION_COLUMNS]; COUNTS[1]] = {
    let (mut bounds, mut next, mut k) = ([[0.0; FRICTION_COLUMNS]; COUNTS[1]], 0, 0);
    while k < FRICTION_COLUMNS {
        match FrictionColumn::ALL[k].properties().bound {
            FrictionBound::NotNegative => {
                bounds[next][k] = 1.0;
                next += 1;
            }
            FrictionBound::CoulombPart(part) => {
                bounds[next][FrictionColumn::Coulomb as usize] = part;
                bounds[next][k] = 1.0;
                next += 1;
            }
            FrictionBound::None => {}
        }
        k += 1;
    }
    bounds
};

/// Prior standard deviations of the friction of a joint; 0 for cogging where the drive has none.
///
/// * `cogging_cycles` cogging periods in one turn of the joint
pub const fn friction_prior(limits: &JointLimits, cogging_cycles: f32) -> FrictionParameters {
    let (mut sigma, mut k) = (FrictionParameters::NONE, 0);
    while k < FRICTION_COLUMNS {
        sigma.0[k] = FrictionColumn::ALL[k].properties().prior.deviation(limits);
        k += 1;
    }
    if cogging_cycles > 0.0 {
        return sigma;
    }
    let [sine, cosine] = COGGING_COLUMNS;
    (sigma.0[sine as usize], sigma.0[cosine as usize]) = (0.0, 0.0);
    sigma
}
