use super::{BankError, JointBounds, MAX_COLUMNS, NETWORK_SEED, ParameterBank};
use crate::copy;
use core::fmt;
use foretorque::arm::{Arm, LINK_PARAMETERS};
use foretorque::dynamics::{FRICTION_COLUMNS, FrictionColumn, Pose, friction_under, rnea_of};
use foretorque::feedforward::FeedForwardConfig;
use foretorque::joint::{JointMotion, JointVector};
use foretorque::learning::{ParameterSet, StartDeviations};
use heapless::Vec;
use serde::{Deserialize, Serialize};

/// Quantity that a column of the linear model multiplies, as the number that a bank holds.
///
/// 0 to 9 are the standard parameters of a link (eq. 14), 10 is the reflected rotor inertia, the friction columns have
/// [`bank_kind`](foretorque::dynamics::FrictionProperties::bank_kind). Numbers are only ever added.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "u8")]
pub struct ColumnKind(u8);

const LINK_SYMBOLS: [&str; LINK_PARAMETERS] = [
    "m", "mx", "my", "mz", "Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz",
];
const ROTOR: u8 = LINK_PARAMETERS as u8;
/// Stribeck peaks of 0.07 and 0.14 rad/s: decoded, but no longer in the model.
const RETIRED: [(u8, &str); 2] = [(13, "Fsn"), (14, "Fsw")];

const _: () = {
    let mut k = 0;
    while k < FRICTION_COLUMNS {
        let kind = FrictionColumn::ALL[k].properties().bank_kind;
        assert!(kind > ROTOR && kind != RETIRED[0].0 && kind != RETIRED[1].0);
        k += 1;
    }
};

impl ColumnKind {
    /// Reflected rotor inertia, kg·m².
    pub const ROTOR: Self = Self(ROTOR);

    /// Friction columns of a joint in the order of [`FrictionColumn::ALL`].
    const FRICTION: [Self; FRICTION_COLUMNS] = {
        let mut kinds = [Self::ROTOR; FRICTION_COLUMNS];
        let mut k = 0;
        while k < FRICTION_COLUMNS {
            kinds[k] = Self::friction(FrictionColumn::ALL[k]);
            k += 1;
        }
        kinds
    };

    /// A friction column.
    pub const fn friction(column: FrictionColumn) -> Self {
        Self(column.properties().bank_kind)
    }

    /// Short name; empty for a number that is no kind.
    fn symbol(self) -> &'static str {
        let number = usize::from(self.0);
        let friction = || {
            let place = Self::FRICTION.iter().position(|&kind| kind == self)?;
            Some(FrictionColumn::ALL.get(place)?.properties().symbol)
        };
        let retired = || RETIRED.iter().find(|(kind, _)| *kind == self.0);
        match LINK_SYMBOLS.get(number) {
            Some(symbol) => symbol,
            None if self == Self::ROTOR => "Ia",
            None => friction()
                .or(retired().map(|(_, symbol)| *symbol))
                .unwrap_or(""),
        }
    }
}

/// A number that is no kind of column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NoColumnKind;

impl fmt::Display for NoColumnKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("no kind of column")
    }
}

impl TryFrom<u8> for ColumnKind {
    type Error = NoColumnKind;

    fn try_from(number: u8) -> Result<Self, NoColumnKind> {
        let kind = Self(number);
        let known = number <= ROTOR
            || Self::FRICTION.contains(&kind)
            || RETIRED.iter().any(|(retired, _)| *retired == number);
        known.then_some(kind).ok_or(NoColumnKind)
    }
}

/// Identity of a column: kind, and joint from 0. Displayed as `Izz1`, `mx2`, `Ia3`, `Fv1`: joints from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ColumnId {
    /// Quantity that the column multiplies.
    pub kind: ColumnKind,
    /// Joint or link, from 0.
    pub joint: u8,
}

impl fmt::Display for ColumnId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}{}", self.kind.symbol(), u16::from(self.joint) + 1)
    }
}

/// The columns of an arm in their order: inertial ones link by link, rotor inertias, then friction joint by joint.
#[inline(never)]
pub fn columns<A: Arm<N, P>, const N: usize, const P: usize>() -> Vec<ColumnId, MAX_COLUMNS> {
    let mut columns = Vec::new();
    // The capacity suffices for every arm.
    let mut push = |kind, joint| _ = columns.push(id(kind, joint));
    let links = A::columns();
    for (joint, link) in links.iter().enumerate() {
        for (kind, there) in (0..).map(ColumnKind).zip(link.inertial) {
            if there {
                push(kind, joint);
            }
        }
    }
    for (joint, _) in links.iter().enumerate().filter(|(_, link)| link.rotor) {
        push(ColumnKind::ROTOR, joint);
    }
    for joint in 0..N {
        for kind in ColumnKind::FRICTION {
            push(kind, joint);
        }
    }
    columns
}

const fn id(kind: ColumnKind, joint: usize) -> ColumnId {
    ColumnId {
        kind,
        joint: joint as u8,
    }
}

/// Parameters of a bank that the tick uses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parameters<const N: usize, const P: usize> {
    /// Model and networks.
    pub set: ParameterSet<N, P>,
    /// Standard deviations from which learning starts.
    pub start: StartDeviations<N, P>,
    /// Drive gains, N × N·m/A; 0 is unknown.
    pub gains: [f32; N],
    /// Limits of every joint.
    pub bounds: [JointBounds; N],
}

impl<const N: usize, const P: usize> Parameters<N, P> {
    /// Zeros, before any bank.
    pub const fn zero() -> Self {
        Self {
            set: ParameterSet::zero(),
            start: StartDeviations {
                friction: [[0; FRICTION_COLUMNS]; N],
                rigid: [0; P],
            },
            gains: [0.0; N],
            bounds: [JointBounds::ZERO; N],
        }
    }

    /// Parameters of [`ParameterBank::nominal`].
    pub fn nominal<A: Arm<N, P>>() -> Self {
        Self {
            set: ParameterSet::nominal::<A>(NETWORK_SEED),
            start: StartDeviations::PRIOR,
            gains: [0.0; N],
            bounds: JointBounds::widest::<A, N, P>(),
        }
    }
}

impl ParameterBank {
    /// Configuration of ticks of `period_s`, s: the arm's limits, tightened by those of the bank.
    ///
    /// Errors: [`BankError::Limit`] where torque or slew limit is not positive or exceeds [`FeedForwardConfig::for_arm`], or
    /// the bound of the network differs from that of this firmware.
    pub fn feed_forward_config<A: Arm<N, P>, const N: usize, const P: usize>(
        &self,
        period_s: f32,
    ) -> Result<FeedForwardConfig<N>, BankError> {
        config::<A, N, P>(&self.limits, period_s)
    }

    /// Everything of the bank that the tick uses, checked.
    ///
    /// Errors: the first reason why the bank does not fit `A`.
    #[inline(never)]
    pub fn parameters<A: Arm<N, P>, const N: usize, const P: usize>(
        &self,
    ) -> Result<Parameters<N, P>, BankError> {
        let set = self.set::<A, N, P>()?;
        let gains = self.drive_gains()?;
        self.feed_forward_config::<A, N, P>(1e-3)?;
        plausible::<A, N, P>(&set)?;
        let mut bounds = [JointBounds::ZERO; N];
        copy(&mut bounds, &self.limits);
        Ok(Parameters {
            set,
            start: self.start_deviations::<A, N, P>(),
            gains,
            bounds,
        })
    }
}

/// Poses in which a bank is compared with the description: more equations than any joint has parameters.
const POSES: u32 = 16;
/// Largest difference from the description, and largest friction, in units of the torque limit.
const LARGEST_DIFFERENCE: f32 = 0.75;
/// Largest linear parameter in units of the largest torque limit, in its own SI unit.
const LARGEST_PARAMETER: f32 = 10.0;
/// Largest speed of the poses, rad/s: half of one turn a second. Descriptions without real limits have 100 rad/s, where no drive
/// has the torque.
const SPEED: f32 = core::f32::consts::PI;
/// Acceleration of the poses, rad/s².
const ACCELERATION: f32 = 5.0;

/// Checks that the torques of `set` are those of an arm like the described one: per parameter, and in poses that cover range
/// and half the speed of every joint, at most [`SPEED`], the first at rest and stretched out.
///
/// Errors: [`BankError::Implausible`] with the joint. Cost: [`POSES`] recursions of both sets.
#[inline(never)]
fn plausible<A: Arm<N, P>, const N: usize, const P: usize>(
    set: &ParameterSet<N, P>,
) -> Result<(), BankError> {
    let largest = A::limits().iter().fold(0.0, |m: f32, l| m.max(l.torque));
    for (joint, friction) in set.friction.iter().enumerate() {
        let mut parameters = friction.0.iter();
        if parameters.any(|value| value.abs() > LARGEST_PARAMETER * largest) {
            return Err(BankError::Implausible(joint as u8));
        }
    }
    let described = A::nominal();
    let mut motion = JointMotion::zero();
    for pose in 0..POSES {
        let there = Pose::of::<A, P>(&motion.q).ok_or(BankError::Implausible(0))?;
        let mut rigid = [JointVector::zeros(); 2];
        let sets = [&set.rigid, described];
        rnea_of::<A, N, P, 2>(sets, &there.angles, &motion, &mut rigid);
        let [mine, theirs] = rigid;
        let JointMotion { q, qd, .. } = &motion;
        let friction = friction_under::<A, N, P>(&set.friction, q, qd, &there.load);
        let torques = mine.iter().zip(theirs.iter()).zip(friction.iter());
        for (joint, (((mine, theirs), friction), limits)) in torques.zip(A::limits()).enumerate() {
            let bound = LARGEST_DIFFERENCE * limits.torque;
            // Written so that NaN is refused.
            if !((mine - theirs).abs() <= bound && friction.abs() <= bound) {
                return Err(BankError::Implausible(joint as u8));
            }
        }
        let axes = motion.q.iter_mut().zip(motion.qd.iter_mut());
        let axes = axes.zip(motion.qdd.iter_mut()).zip(A::limits());
        for (joint, (((q, qd), qdd), limits)) in axes.enumerate() {
            let (low, high) = limits.position;
            let number = 3 * (pose * N as u32 + joint as u32);
            *q = low + (high - low) * fraction(number);
            *qd = limits.velocity.min(2.0 * SPEED) * (fraction(number + 1) - 0.5);
            *qdd = 2.0 * ACCELERATION * (fraction(number + 2) - 0.5);
        }
    }
    Ok(())
}

/// Hash of `number`, from 0 to 1.
fn fraction(number: u32) -> f32 {
    let mixed = number.wrapping_add(1).wrapping_mul(0x9E37_79B9);
    let mixed = (mixed ^ mixed >> 16).wrapping_mul(0x85EB_CA6B);
    ((mixed ^ mixed >> 13) >> 8) as f32 * (1.0 / 16_777_216.0)
}

/// Configuration of ticks of `period_s` within `bounds`.
pub(crate) fn config<A: Arm<N, P>, const N: usize, const P: usize>(
    bounds: &[JointBounds],
    period_s: f32,
) -> Result<FeedForwardConfig<N>, BankError> {
    let mut config = FeedForwardConfig::for_arm::<A, P>(period_s);
    let widest = JointBounds::widest::<A, N, P>();
    let joints = config.limits.iter_mut().zip(&mut config.slew_per_tick);
    for (joint, ((limits, slew), widest)) in joints.zip(widest).enumerate() {
        let error = BankError::Limit(joint as u8);
        let bounds = bounds.get(joint).ok_or(error)?;
        let torque = bounds.torque_nm > 0.0 && bounds.torque_nm <= widest.torque_nm;
        let rate = bounds.slew_nm_s > 0.0 && bounds.slew_nm_s <= widest.slew_nm_s;
        if !torque || !rate || bounds.network_share != widest.network_share {
            return Err(error);
        }
        limits.torque = bounds.torque_nm;
        *slew = bounds.slew_nm_s * period_s;
    }
    config.validate().map_err(|_| BankError::Limit(0))?;
    Ok(config)
}
