use crate::drives::{Contradiction, DriveProfile, Protocol, Scale};
use crate::safety::SafetyLimits;
use foretorque::arm::{Arm, JointLimits};
use foretorque::learning::LearnerConfig;
use foretorque::math::sqrt;
use serde::{Deserialize, Serialize};

/// Periods of the loop that are admissible, s.
const PERIODS_S: (f32, f32) = (0.0005, 0.01);
pub(super) const BUSES: u8 = 2;

/// One joint on a bus.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct BusJoint {
    /// Codec of its drive.
    pub drive: DriveProfile,
    /// Bus, from 0.
    pub bus: u8,
    /// Stiffness, N·m/rad at the joint.
    pub kp: f32,
    /// Damping, N·m·s/rad at the joint.
    pub kd: f32,
}

/// Drives and period of the loop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BusConfig<const N: usize> {
    /// Period, s.
    pub period_s: f32,
    /// Joints, base to tool.
    pub joints: [BusJoint; N],
}

impl<const N: usize> BusConfig<N> {
    /// Checks the profile in itself and against the arm.
    ///
    /// Errors: the first contradiction, with joint, field and both values.
    pub fn check<A: Arm<N, P>, const P: usize>(&self) -> Result<(), Contradiction> {
        let (least, most) = PERIODS_S;
        for (against, bound, kept) in [
            ("the shortest period", least, self.period_s >= least),
            ("the longest period", most, self.period_s <= most),
        ] {
            if !kept {
                let period = self.period_s;
                return Err(Contradiction::new("period_s", period, against, bound));
            }
        }
        for (index, joint) in self.joints.iter().enumerate() {
            let checked = self.check_joint(index, joint, A::limits().get(index));
            checked.map_err(|error| error.of(index))?;
        }
        Ok(())
    }

    fn check_joint(
        &self,
        index: usize,
        joint: &BusJoint,
        limits: Option<&JointLimits>,
    ) -> Result<(), Contradiction> {
        joint.drive.check()?;
        if joint.bus >= BUSES {
            let (bus, last) = (joint.bus.into(), f32::from(BUSES - 1));
            return Err(Contradiction::new("bus", bus, "the last bus", last));
        }
        let same = |other: &BusJoint| {
            let (own, other_drive) = (&joint.drive, &other.drive);
            let mask = match (own.protocol, other_drive.protocol) {
                // They reply with the low half byte of their id.
                (Protocol::Damiao(_), Protocol::Damiao(_))
                    if own.host_id == other_drive.host_id =>
                {
                    0xf
                }
                _ => u16::MAX,
            };
            other.bus == joint.bus && (own.id ^ other_drive.id) & mask == 0
        };
        if let Some(before) = self.joints.iter().take(index).position(same) {
            let (id, against) = (joint.drive.id.into(), "the id in the replies of joint");
            return Err(Contradiction::new("id", id, against, before as f32 + 1.0));
        }
        limits.map_or(Ok(()), |limits| joint.check_against(limits))
    }

    /// Limits of the arm, the torque tightened to the profile's.
    pub fn safety_limits<A: Arm<N, P>, const P: usize>(&self) -> SafetyLimits<N> {
        let mut limits = SafetyLimits::for_arm::<A, P>(micros(self.period_s));
        for (torque, joint) in limits.torque.iter_mut().zip(&self.joints) {
            *torque = torque.min(joint.drive.torque_limit);
        }
        let ends = limits.lowest.iter_mut().zip(limits.highest.iter_mut());
        for ((lowest, highest), joint) in ends.zip(&self.joints) {
            *lowest -= joint.position_resolution();
            *highest += joint.position_resolution();
        }
        limits
    }

    /// Configuration of the learner: the resolution of the reported torques adds to its noise.
    pub fn learner<A: Arm<N, P>, const P: usize>(&self) -> LearnerConfig<N, P> {
        let mut config = LearnerConfig::for_arm::<A>(self.period_s);
        let joints = self.joints.iter().zip(A::limits());
        // Rounding to steps of one has a variance of 1/12.
        let variances = joints.map(|(joint, limits)| {
            let step = joint.drive.torque_resolution() / limits.torque;
            step * step / 12.0
        });
        let coarsest = variances.fold(0.0, f32::max);
        config.noise = sqrt(config.noise * config.noise + coarsest);
        config
    }
}

impl BusJoint {
    fn check_against(&self, limits: &JointLimits) -> Result<(), Contradiction> {
        let drive = &self.drive;
        let most = limits.torque;
        if drive.torque_limit > most {
            let (limit, against) = (drive.torque_limit, "the torque of the arm");
            return Err(Contradiction::new("torque_limit", limit, against, most));
        }
        for (field, gain) in [("kp", self.kp), ("kd", self.kd)] {
            if !(gain >= 0.0 && gain.is_finite()) {
                return Err(Contradiction::new(field, gain, "the least value", 0.0));
            }
        }
        let ranges = drive.protocol.largest();
        let square = drive.gear * drive.gear;
        for (field, gain, against, most) in [
            ("kp", self.kp, "the largest kp of the frame", ranges.kp),
            ("kd", self.kd, "the largest kd of the frame", ranges.kd),
        ] {
            if gain > most * square {
                return Err(Contradiction::new(field, gain, against, most * square));
            }
        }
        let (low, high) = limits.position;
        let travel = (low - drive.zero).abs().max((high - drive.zero).abs());
        let (travels, moves) = (
            "the travel of the arm from its zero",
            "the velocity of the arm",
        );
        for (field, range, against, least) in [
            ("range of position", ranges.position, travels, travel),
            ("range of velocity", ranges.velocity, moves, limits.velocity),
        ] {
            let reach = range / drive.gear;
            if reach < least {
                return Err(Contradiction::new(field, reach, against, least));
            }
        }
        Ok(())
    }

    /// Step of the reported position, rad; 0 where the reply is finer than an encoder.
    pub fn position_resolution(&self) -> f32 {
        let ranges = self.drive.protocol.ranges();
        ranges.map_or(0.0, |it| 2.0 * it.position / 65535.0 / self.drive.gear)
    }

    /// The drive reports a limit in the place of the scale of its torque.
    pub(super) fn reports_limit(&self) -> bool {
        matches!(
            self.drive.protocol,
            Protocol::CyberGear(_) | Protocol::RobStride(_)
        )
    }

    /// Scale of the profile, in the unit in which the drive reports it.
    pub(super) fn scale(&self, scale: Scale) -> Option<f32> {
        let ranges = self.drive.protocol.ranges();
        match (self.drive.protocol, scale) {
            (Protocol::Odrive(odrive), Scale::Torque) => Some(odrive.torque_scale),
            (Protocol::Cia402(cia402), Scale::Torque) => Some(cia402.rated_torque),
            (_, Scale::Position) => ranges.map(|ranges| ranges.position),
            (_, Scale::Velocity) => ranges.map(|ranges| ranges.velocity),
            // These report a limit, which the loop must not exceed, and not the scale of the frame.
            (Protocol::CyberGear(_) | Protocol::RobStride(_), Scale::Torque) => {
                Some(self.drive.torque_limit / self.drive.gear)
            }
            (_, Scale::Torque) => ranges.map(|ranges| ranges.torque),
        }
    }
}

/// A period, s, in µs.
pub(super) fn micros(period_s: f32) -> u32 {
    (period_s * 1e6 + 0.5) as u32
}

/// Periods in a time, rounded up.
pub(super) fn periods(time_s: f32, period_s: f32) -> u16 {
    (time_s / period_s) as u16 + 1
}

/// Joints in an order in which the buses take turns; those without a drive come first.
pub(super) fn alternating<const N: usize>(joints: &[Option<BusJoint>; N]) -> [u8; N] {
    // The place of a joint on its own bus, then the bus.
    let place = |joint: usize| {
        let bus = joints.get(joint).copied().flatten().map(|joint| joint.bus);
        let before = joints.iter().take(joint).flatten();
        let before = before.filter(|other| Some(other.bus) == bus).count();
        bus.map(|bus| (before, bus))
    };
    let mut order = [0; N];
    for joint in 0..N {
        let key = |joint| (place(joint), joint);
        let rank = (0..N).filter(|&other| key(other) < key(joint)).count();
        if let Some(slot) = order.get_mut(rank) {
            *slot = joint as u8;
        }
    }
    order
}
