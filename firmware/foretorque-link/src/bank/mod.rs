//! Parameter bank: one versioned, checksummed format for file, wire and store.
//!
//! `"FTPB"`, format version, postcard of [`ParameterBank`], CRC-32. A bank lists its columns by identity. Friction columns
//! that it lacks are zero.

mod typed;

use crate::wire::{CRC, Name};
use core::fmt;
use foretorque::arm::{Arm, LINK_PARAMETERS, most_parameters};
pub use foretorque::dynamics::MAX_JOINTS;
use foretorque::dynamics::{FRICTION_COLUMNS, FrictionColumn};
use foretorque::feedforward::{FeedForwardConfig, NETWORK_BOUND};
use heapless::Vec;
use postcard::ser_flavors::Slice;
use postcard::ser_flavors::crc::CrcModifier;
use serde::{Deserialize, Serialize};
pub use typed::Parameters;
pub(crate) use typed::{config as feed_forward_config, name, slots};

/// Seed of the random hidden layers of an untrained bank.
pub const NETWORK_SEED: u32 = 1;
/// Most linear columns: base parameters and friction of eight joints. A larger number does not change the format.
pub const MAX_COLUMNS: usize = most_parameters(MAX_JOINTS) + MAX_JOINTS * FRICTION_COLUMNS;
/// Most network weights.
pub const MAX_WEIGHTS: usize = 256;

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

impl TryFrom<u8> for ColumnKind {
    type Error = &'static str;

    fn try_from(number: u8) -> Result<Self, &'static str> {
        let kind = Self(number);
        let known = number <= ROTOR
            || Self::FRICTION.contains(&kind)
            || RETIRED.iter().any(|(retired, _)| *retired == number);
        known.then_some(kind).ok_or("no kind of column")
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
    let mut push = |kind, joint: usize| {
        let joint = joint as u8;
        _ = columns.push(ColumnId { kind, joint });
    };
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

/// One linear parameter.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Column {
    /// Quantity and joint.
    pub id: ColumnId,
    /// Value, in the unit of its kind.
    pub value: f32,
    /// Standard deviation, in the same unit.
    pub deviation: f32,
}

/// Activation of the hidden layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ActivationKind {
    /// Rectifier, eq. 19.
    Relu,
    /// Sigmoid, eq. 18.
    Sigmoid,
    /// Hyperbolic tangent.
    Tanh,
}

/// Shape of the network of one joint.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct NetworkShape {
    /// Activation of the hidden layer.
    pub activation: ActivationKind,
    /// Inputs.
    pub inputs: u8,
    /// Hidden units.
    pub hidden: u8,
    /// Outputs.
    pub outputs: u8,
    /// Number of such networks, side by side.
    pub blocks: u8,
}

impl NetworkShape {
    pub(crate) const NONE: Self = Self {
        activation: ActivationKind::Relu,
        inputs: 0,
        hidden: 0,
        outputs: 0,
        blocks: 0,
    };
}

/// Limits of one joint, inside those of the arm.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct JointBounds {
    /// Largest torque, N·m.
    pub torque_nm: f32,
    /// Largest rate of the torque, N·m/s.
    pub slew_nm_s: f32,
    /// Largest share of the network, as a part of the arm's torque limit.
    pub network_share: f32,
}

impl JointBounds {
    /// Zeros, before any bank.
    const ZERO: Self = Self {
        torque_nm: 0.0,
        slew_nm_s: 0.0,
        network_share: 0.0,
    };

    /// Limits of this firmware, which a bank may only tighten.
    pub(crate) fn widest<A: Arm<N, P>, const N: usize, const P: usize>() -> [Self; N] {
        // The largest change in a tick of one second.
        let slew = FeedForwardConfig::<N>::for_arm::<A, P>(1.0).slew_per_tick;
        let mut bounds = [Self::ZERO; N];
        for (bounds, (limits, &slew_nm_s)) in bounds.iter_mut().zip(A::limits().iter().zip(&slew)) {
            *bounds = Self {
                torque_nm: limits.torque,
                slew_nm_s,
                network_share: NETWORK_BOUND,
            };
        }
        bounds
    }
}

/// All parameters of one arm.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ParameterBank {
    /// Identity of the arm.
    #[serde(with = "postcard::fixint::le")]
    pub arm_hash: u32,
    /// Name of the arm.
    pub arm: Name,
    /// Linear parameters: rigid body, then friction.
    pub columns: Vec<Column, MAX_COLUMNS>,
    /// Drive gain of every joint, N·m/A; 0 is unknown.
    pub drive_gains_nm_a: Vec<f32, MAX_JOINTS>,
    /// Shape of the networks.
    pub network: NetworkShape,
    /// Weights, network by network: hidden weights (all that leave one input together), hidden thresholds, output
    /// weights (all that leave one hidden unit together), output thresholds.
    pub weights: Vec<f32, MAX_WEIGHTS>,
    /// Limits of every joint.
    pub limits: Vec<JointBounds, MAX_JOINTS>,
}

errors! {
    /// Reason why a parameter bank is refused.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
    #[cfg_attr(feature = "defmt", derive(defmt::Format))]
    pub enum BankError {
        NotABank = "not a parameter bank";
        Version(version: u8) = "parameter bank of format version {version}";
        Checksum = "parameter bank with a wrong checksum";
        /// (Unknown columns, or too many; its checksum is right.)
        Malformed = "parameter bank with unreadable content";
        /// (More entries than the format holds, or bytes than the buffer.)
        TooLong = "parameter bank too long";
        WrongArm {
            /// Identity of the arm in the bank.
            #[serde(with = "postcard::fixint::le")]
            found: u32
        } = "parameter bank for another arm ({found:08x})";
        MissingColumn(place: u8) = "base column {place} is missing";
        UnknownColumn(place: u8) = "column {place} is foreign or there twice";
        /// (Value or deviation is not finite, or the deviation is negative.)
        Column(place: u8) = "column {place} is not a usable number";
        /// (Or with another activation or number of weights.)
        NetworkShape = "network of another shape";
        Weight(place: #[serde(with = "postcard::fixint::le")] u16) = "network weight {place} is not finite";
        /// (Missing, negative or not finite.)
        DriveGain of joint = "drive gain of joint {joint} is not usable";
        /// (Or missing.)
        Limit of joint = "limits of joint {joint} are not usable";
        /// (In a test pose it is not near that of the description, or beyond the limit.)
        Implausible of joint = "torque of joint {joint} is not plausible for the arm";
    }
}

const MAGIC: [u8; 4] = *b"FTPB";
const VERSION: u8 = 1;
const PREFIX: usize = MAGIC.len() + 1;
const CRC_BYTES: usize = 4;

impl ParameterBank {
    /// Version of the bytes.
    pub const FORMAT_VERSION: u8 = VERSION;

    /// Largest serialised bank, in bytes.
    pub const MAX_BYTES: usize = PREFIX
        + (4 + 1 + 24)
        + (1 + 10 * MAX_COLUMNS)
        + (1 + 4 * MAX_JOINTS)
        + 5
        + (2 + 4 * MAX_WEIGHTS)
        + (1 + 12 * MAX_JOINTS)
        + CRC_BYTES;

    /// The serialised bank, at the front of `buffer`.
    ///
    /// Errors: [`BankError::TooLong`]; cannot fail with [`MAX_BYTES`](Self::MAX_BYTES) of buffer.
    pub fn encode<'r>(&self, buffer: &'r mut [u8]) -> Result<&'r [u8], BankError> {
        let flavor = CrcModifier::new(Slice::new(buffer), CRC.digest());
        postcard::serialize_with_flavor(&(MAGIC, VERSION, self), flavor)
            .map(|bytes: &mut [u8]| &*bytes)
            .map_err(|_| BankError::TooLong)
    }

    /// Decodes the bank that is all of `bytes`. Its values are checked by [`set`](Self::set).
    ///
    /// Errors: in this order, [`NotABank`](BankError::NotABank), [`Version`](BankError::Version),
    /// [`Checksum`](BankError::Checksum), [`Malformed`](BankError::Malformed).
    pub fn decode(bytes: &[u8]) -> Result<Self, BankError> {
        let mut bank = Self::empty();
        bank.decode_into(bytes)?;
        Ok(bank)
    }

    /// Decodes in place as [`decode`](Self::decode); after an error the content is undefined.
    pub fn decode_into(&mut self, bytes: &[u8]) -> Result<(), BankError> {
        let rest = bytes.strip_prefix(&MAGIC).ok_or(BankError::NotABank)?;
        let &version = rest.first().ok_or(BankError::NotABank)?;
        if version != VERSION {
            return Err(BankError::Version(version));
        }
        let (content, checksum) = bytes
            .split_last_chunk::<CRC_BYTES>()
            .ok_or(BankError::NotABank)?;
        if CRC.checksum(content) != u32::from_le_bytes(*checksum) {
            return Err(BankError::Checksum);
        }
        let body = content.get(PREFIX..).ok_or(BankError::NotABank)?;
        // The fields in the order in which `Serialize` writes them.
        let (arm_hash, rest) = next::<[u8; 4]>(body)?;
        let (arm, rest) = next::<Name>(rest)?;
        let rest = list(&mut self.columns, rest)?;
        let rest = list(&mut self.drive_gains_nm_a, rest)?;
        let (network, rest) = next::<NetworkShape>(rest)?;
        let rest = list(&mut self.weights, rest)?;
        let rest = list(&mut self.limits, rest)?;
        (self.arm_hash, self.arm, self.network) = (u32::from_le_bytes(arm_hash), arm, network);
        rest.is_empty().then_some(()).ok_or(BankError::Malformed)
    }

    /// The column with this identity.
    pub fn column(&self, id: ColumnId) -> Option<&Column> {
        self.columns.iter().find(|column| column.id == id)
    }

    /// An empty bank, for no arm.
    pub const fn empty() -> Self {
        Self {
            arm_hash: 0,
            arm: Name::new(),
            columns: Vec::<Column, MAX_COLUMNS>::new(),
            drive_gains_nm_a: Vec::new(),
            network: NetworkShape::NONE,
            weights: Vec::<f32, MAX_WEIGHTS>::new(),
            limits: Vec::<JointBounds, MAX_JOINTS>::new(),
        }
    }
}

fn next<'b, T: Deserialize<'b>>(bytes: &'b [u8]) -> Result<(T, &'b [u8]), BankError> {
    postcard::take_from_bytes(bytes).map_err(|_| BankError::Malformed)
}

/// Reads a list item by item; returns the bytes that follow it.
fn list<'b, T: Deserialize<'b>, const M: usize>(
    vector: &mut Vec<T, M>,
    bytes: &'b [u8],
) -> Result<&'b [u8], BankError> {
    vector.clear();
    let (length, mut rest) = next::<u32>(bytes)?;
    for _ in 0..length {
        let (item, behind) = next(rest)?;
        vector.push(item).map_err(|_| BankError::Malformed)?;
        rest = behind;
    }
    Ok(rest)
}

#[cfg(test)]
mod tests;
