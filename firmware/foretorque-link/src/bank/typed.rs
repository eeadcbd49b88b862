//! Conversion between the self-describing bank and the typed set of one arm.

use super::column::{ColumnId, ColumnKind, id, rigid_columns};
use super::{ActivationKind, BankError, Column, JointBounds, NetworkShape, ParameterBank};
use super::{MAX_COLUMNS, MAX_JOINTS, MAX_WEIGHTS};
use crate::wire::Name;
use foretorque::arm::Arm;
use foretorque::dynamics::{FRICTION_COLUMNS, FrictionParameters};
use foretorque::feedforward::{FeedForwardConfig, NETWORK_BOUND};
use foretorque::learning::{
    JointNetwork, LearnerConfig, NETWORK_HIDDEN, NETWORK_INPUTS, ParameterSet, StartDeviations,
};
use heapless::Vec;

/// Seed of the random hidden layers of an untrained bank.
pub const NETWORK_SEED: u32 = 1;

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
        const {
            assert!(N <= MAX_JOINTS);
            assert!(P + FRICTION_COLUMNS * N <= MAX_COLUMNS);
            assert!(N * JointNetwork::WEIGHTS <= MAX_WEIGHTS);
        }
        let config = LearnerConfig::<N, P>::for_arm::<A>(1e-3);
        let rigid = rigid_columns::<A, N, P>().zip(config.rigid_sigma);
        let friction = friction_columns(&config.friction_sigma);
        let columns = rigid.chain(friction).map(|(id, deviation)| Column {
            id,
            value: 0.0,
            deviation,
        });
        let bounds = A::limits().iter().zip(slew_nm_s::<A, N, P>());
        let bounds = bounds.map(|(limits, slew_nm_s)| JointBounds {
            torque_nm: limits.torque,
            slew_nm_s,
            network_share: NETWORK_BOUND,
        });
        self.arm_hash = A::hash();
        self.arm = name(A::name());
        fill(&mut self.columns, columns);
        fill(&mut self.drive_gains_nm_a, core::iter::repeat_n(0.0, N));
        self.network = shape::<N>();
        self.weights.clear();
        fill(&mut self.limits, bounds);
    }

    /// Writes the values of `set` into the bank and leaves all else unchanged. Columns that the bank lacks are added, with
    /// the standard deviations of [`nominal`](Self::nominal), so that nothing learnt is lost.
    #[inline(never)]
    pub fn refresh<A: Arm<N, P>, const N: usize, const P: usize>(
        &mut self,
        set: &ParameterSet<N, P>,
    ) {
        let config = LearnerConfig::<N, P>::for_arm::<A>(1e-3);
        let rigid = set.rigid.as_slice().iter().copied().zip(config.rigid_sigma);
        let rigid = rigid_columns::<A, N, P>().zip(rigid);
        let friction =
            friction_columns(&set.friction).zip(friction_columns(&config.friction_sigma));
        let friction = friction.map(|((id, value), (_, deviation))| (id, (value, deviation)));
        for (id, (value, deviation)) in rigid.chain(friction) {
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
        self.check_columns::<A, N, P>()?;
        let mut set = ParameterSet::nominal::<A>(NETWORK_SEED);
        for (place, (id, value)) in rigid_columns::<A, N, P>()
            .zip(set.rigid.as_mut_slice())
            .enumerate()
        {
            *value = self
                .column(id)
                .ok_or(BankError::MissingColumn(place as u8))?
                .value;
        }
        for (joint, friction) in set.friction.iter_mut().enumerate() {
            let columns = ColumnKind::FRICTION.map(|kind| self.value(id(kind, joint)));
            *friction = FrictionParameters(columns);
        }
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
        let config = LearnerConfig::<N, P>::for_arm::<A>(1e-3);
        let mut start = StartDeviations::PRIOR;
        let rigid = rigid_columns::<A, N, P>().zip(config.rigid_sigma);
        let friction = friction_columns(&config.friction_sigma);
        let parts = start.rigid.iter_mut();
        let parts = parts.chain(start.friction.as_flattened_mut());
        for ((id, prior), part) in rigid.chain(friction).zip(parts) {
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
                Some(&gain) if gain.is_finite() && gain >= 0.0 => gain,
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
        let mut config = FeedForwardConfig::for_arm::<A, P>(period_s);
        let widest_nm_s = slew_nm_s::<A, N, P>();
        let joints = config.limits.iter_mut().zip(&mut config.slew_per_tick);
        for (joint, ((limits, slew), widest)) in joints.zip(widest_nm_s).enumerate() {
            let error = BankError::Limit(joint as u8);
            let bounds = self.limits.get(joint).ok_or(error)?;
            let torque = bounds.torque_nm > 0.0 && bounds.torque_nm <= limits.torque;
            let rate = bounds.slew_nm_s > 0.0 && bounds.slew_nm_s <= widest;
            if !torque || !rate || bounds.network_share != NETWORK_BOUND {
                return Err(error);
            }
            limits.torque = bounds.torque_nm;
            *slew = bounds.slew_nm_s * period_s;
        }
        config.validate().map_err(|_| BankError::Limit(0))?;
        Ok(config)
    }

    fn value(&self, id: ColumnId) -> f32 {
        self.column(id).map_or(0.0, |column| column.value)
    }

    /// Checks that every column is known, finite and not repeated.
    fn check_columns<A: Arm<N, P>, const N: usize, const P: usize>(&self) -> Result<(), BankError> {
        for (place, column) in self.columns.iter().enumerate() {
            let friction =
                ColumnKind::FRICTION.contains(&column.id.kind) && usize::from(column.id.joint) < N;
            let known = friction || rigid_columns::<A, N, P>().any(|id| id == column.id);
            let first = self.columns.iter().position(|other| other.id == column.id) == Some(place);
            if !known || !first {
                return Err(BankError::UnknownColumn(place as u8));
            }
            let deviation = column.deviation.is_finite() && column.deviation >= 0.0;
            if !column.value.is_finite() || !deviation {
                return Err(BankError::Column(place as u8));
            }
        }
        Ok(())
    }
}

/// Largest rate of the torque of this firmware, N × N·m/s.
fn slew_nm_s<A: Arm<N, P>, const N: usize, const P: usize>() -> [f32; N] {
    // The largest change in a tick of one second.
    FeedForwardConfig::for_arm::<A, P>(1.0).slew_per_tick
}

/// Friction columns of all joints with their values.
fn friction_columns<const N: usize>(
    friction: &[FrictionParameters; N],
) -> impl Iterator<Item = (ColumnId, f32)> {
    let joints = friction.iter().enumerate();
    joints.flat_map(|(joint, friction)| {
        let columns = ColumnKind::FRICTION.into_iter().zip(friction.0);
        columns.map(move |(kind, value)| (id(kind, joint), value))
    })
}

/// Network shape of this firmware.
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
