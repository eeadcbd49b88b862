//! Conversion between the self-describing bank and the typed set of one arm.

use super::{ActivationKind, BankError, Column, JointBounds, NetworkShape, ParameterBank, columns};
use super::{MAX_COLUMNS, MAX_JOINTS, MAX_WEIGHTS, NETWORK_SEED};
use crate::copy;
use crate::wire::Name;
use foretorque::arm::Arm;
use foretorque::dynamics::{FRICTION_COLUMNS, Pose, friction_under, rnea_of};
use foretorque::feedforward::FeedForwardConfig;
use foretorque::joint::{JointMotion, JointVector};
use foretorque::learning::{
    JointNetwork, LearnerConfig, LinearParameters, NETWORK_HIDDEN, NETWORK_INPUTS, ParameterSet,
    StartDeviations,
};
use heapless::Vec;

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
    /// The bank before any identification: rigid body of the description, no friction, networks with zero output, unknown
    /// drive gains, limits of the arm, standard deviations of [`LearnerConfig::for_arm`].
    pub fn nominal<A: Arm<N, P>, const N: usize, const P: usize>() -> Self {
        Self::from_set::<A, N, P>(&ParameterSet::nominal::<A>(NETWORK_SEED))
    }

    /// The bank of `set`, with all else as in [`nominal`](Self::nominal).
    pub fn from_set<A: Arm<N, P>, const N: usize, const P: usize>(
        set: &ParameterSet<N, P>,
    ) -> Self {
        let mut bank = Self::empty();
        bank.describe::<A, N, P>();
        bank.refresh::<A, N, P>(set);
        bank
    }

    /// Sets everything as in [`nominal`](Self::nominal), with all values zero.
    #[inline(never)]
    pub(crate) fn describe<A: Arm<N, P>, const N: usize, const P: usize>(&mut self) {
        const { assert!(N <= MAX_JOINTS && P + FRICTION_COLUMNS * N <= MAX_COLUMNS) }
        const { assert!(N * JointNetwork::WEIGHTS <= MAX_WEIGHTS) }
        let deviations = LearnerConfig::<N, P>::for_arm::<A>(1e-3).sigma;
        let columns = columns::<A, N, P>();
        let columns = columns.iter().zip(slots::<A, N, P>(&deviations));
        let columns = columns.map(|(&id, &deviation)| Column {
            id,
            value: 0.0,
            deviation,
        });
        self.arm_hash = A::hash();
        self.arm = name(A::name());
        fill(&mut self.columns, columns);
        fill(&mut self.drive_gains_nm_a, core::iter::repeat_n(0.0, N));
        self.network = shape::<N>();
        self.weights.clear();
        fill(
            &mut self.limits,
            JointBounds::widest::<A, N, P>().into_iter(),
        );
    }

    /// Writes the values of `set` into the bank and leaves all else unchanged. Columns that the bank lacks are added, with
    /// the standard deviations of [`nominal`](Self::nominal), so that nothing learnt is lost.
    #[inline(never)]
    pub fn refresh<A: Arm<N, P>, const N: usize, const P: usize>(
        &mut self,
        set: &ParameterSet<N, P>,
    ) {
        let deviations = LearnerConfig::<N, P>::for_arm::<A>(1e-3).sigma;
        let linear = LinearParameters::of(set);
        let values = slots::<A, N, P>(&linear).zip(slots::<A, N, P>(&deviations));
        for (&id, (&value, &deviation)) in columns::<A, N, P>().iter().zip(values) {
            match self.columns.iter_mut().find(|column| column.id == id) {
                Some(column) => column.value = value,
                None => {
                    // The capacity suffices for every column of the arm, each once.
                    let _ = self.columns.push(Column {
                        id,
                        value,
                        deviation,
                    });
                }
            }
        }
        self.weights.clear();
        for layer in set.network.iter().flat_map(JointNetwork::layers) {
            // The capacity suffices for every network of the arm.
            let _ = self.weights.extend_from_slice(layer);
        }
    }

    /// Values and standard deviations of the columns; those that the bank lacks are zero.
    ///
    /// Errors: the first column that is foreign, repeated, not usable, or missing from the rigid body.
    #[inline(never)]
    pub(crate) fn linear<A: Arm<N, P>, const N: usize, const P: usize>(
        &self,
    ) -> Result<[LinearParameters<N, P>; 2], BankError> {
        let mut linear = [LinearParameters::filled(0.0); 2];
        let mut found = [false; MAX_COLUMNS];
        let columns = columns::<A, N, P>();
        for (place, column) in self.columns.iter().enumerate() {
            let mut known = columns.iter();
            let index = known.position(|&id| id == column.id);
            let first = index.and_then(|index| found.get_mut(index));
            match first {
                Some(found) if !*found => *found = true,
                _ => return Err(BankError::UnknownColumn(place as u8)),
            }
            let usable = column.value.is_finite() && column.deviation.is_finite();
            if !usable || column.deviation < 0.0 {
                return Err(BankError::Column(place as u8));
            }
            for (linear, value) in linear.iter_mut().zip([column.value, column.deviation]) {
                let LinearParameters { friction, rigid } = linear;
                let rigid = rigid.iter_mut().take(A::index().count);
                let mut slots = rigid.chain(friction.as_flattened_mut());
                if let Some(slot) = index.and_then(|index| slots.nth(index)) {
                    *slot = value;
                }
            }
        }
        match found.iter().take(A::index().count).position(|found| !found) {
            Some(place) => Err(BankError::MissingColumn(place as u8)),
            None => Ok(linear),
        }
    }

    /// The typed set of the bank. Friction columns that it lacks are zero.
    ///
    /// Errors: the first reason why the bank does not fit `A`.
    pub fn set<A: Arm<N, P>, const N: usize, const P: usize>(
        &self,
    ) -> Result<ParameterSet<N, P>, BankError> {
        if self.arm_hash != A::hash() {
            return Err(BankError::WrongArm {
                found: self.arm_hash,
            });
        }
        let [linear, _] = self.linear::<A, N, P>()?;
        let mut set = ParameterSet::zero();
        linear.write(&mut set);
        if self.network != shape::<N>() || self.weights.len() != N * JointNetwork::WEIGHTS {
            return Err(BankError::NetworkShape);
        }
        if let Some(place) = self.weights.iter().position(|weight| !weight.is_finite()) {
            return Err(BankError::Weight(place as u16));
        }
        let mut weights = self.weights.iter();
        for network in &mut set.network {
            for slot in network.layers_mut().into_iter().flatten() {
                *slot = weights.next().copied().unwrap_or_default();
            }
        }
        Ok(set)
    }

    /// Standard deviations of the columns, from which learning starts; those of the prior where the bank lacks a column.
    #[inline(never)]
    pub fn start_deviations<A: Arm<N, P>, const N: usize, const P: usize>(
        &self,
    ) -> StartDeviations<N, P> {
        let prior = LearnerConfig::<N, P>::for_arm::<A>(1e-3).sigma;
        let mut start = StartDeviations::PRIOR;
        let parts = start.rigid.iter_mut().take(A::index().count);
        let parts = parts.chain(start.friction.as_flattened_mut());
        let priors = slots::<A, N, P>(&prior).zip(parts);
        for (&id, (&prior, part)) in columns::<A, N, P>().iter().zip(priors) {
            if let Some(column) = self.column(id) {
                *part = StartDeviations::<N, P>::part(column.deviation, prior);
            }
        }
        start
    }

    /// Drive gain of every joint, N·m/A; 0 is unknown. Errors: [`BankError::DriveGain`].
    pub fn drive_gains<const N: usize>(&self) -> Result<[f32; N], BankError> {
        let mut gains = [0.0; N];
        for (joint, gain) in gains.iter_mut().enumerate() {
            *gain = match self.drive_gains_nm_a.get(joint) {
                Some(&gain) if (0.0..=f32::MAX).contains(&gain) => gain,
                _ => return Err(BankError::DriveGain(joint as u8)),
            };
        }
        Ok(gains)
    }

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

/// Linear parameters in the order of [`columns`]. An arm that is read at run time may have fewer base parameters than `P`.
pub(crate) fn slots<A: Arm<N, P>, const N: usize, const P: usize>(
    linear: &LinearParameters<N, P>,
) -> impl Iterator<Item = &f32> {
    let rigid = linear.rigid.iter().take(A::index().count);
    rigid.chain(linear.friction.as_flattened())
}

fn shape<const N: usize>() -> NetworkShape {
    NetworkShape {
        activation: ActivationKind::Relu,
        inputs: NETWORK_INPUTS as u8,
        hidden: NETWORK_HIDDEN as u8,
        outputs: 1,
        blocks: N as u8,
    }
}

/// The front of `text` that fits a name.
pub(crate) fn name(text: &str) -> Name {
    let mut name = Name::new();
    for letter in text.chars() {
        if name.push(letter).is_err() {
            break;
        }
    }
    name
}

/// Replaces the content of `vector` by the first `M` items. Collecting into a `heapless::Vec` would panic on one more.
fn fill<T, const M: usize>(vector: &mut Vec<T, M>, items: impl Iterator<Item = T>) {
    vector.clear();
    for item in items {
        if vector.push(item).is_err() {
            break;
        }
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

pub(crate) fn config<A: Arm<N, P>, const N: usize, const P: usize>(
    bounds: &[JointBounds],
    period_s: f32,
) -> Result<FeedForwardConfig<N>, BankError> {
    let mut config = FeedForwardConfig::for_arm::<A, P>(period_s);
    let widest = JointBounds::widest::<A, N, P>();
    for (joint, widest) in widest.into_iter().enumerate() {
        let error = BankError::Limit(joint as u8);
        let bounds = bounds.get(joint).ok_or(error)?;
        let torque = bounds.torque_nm > 0.0 && bounds.torque_nm <= widest.torque_nm;
        let rate = bounds.slew_nm_s > 0.0 && bounds.slew_nm_s <= widest.slew_nm_s;
        if !torque || !rate || bounds.network_share != widest.network_share {
            return Err(error);
        }
        config.limit_torque(joint, bounds.torque_nm);
        config.slew_per_tick[joint] = bounds.slew_nm_s * period_s;
    }
    config.validate().map_err(|_| BankError::Limit(0))?;
    Ok(config)
}
