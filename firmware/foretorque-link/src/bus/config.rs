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
#[serde(deny_unknown_fields)]
pub struct BusJoint {
    /// Codec of its drive.
    pub drive: DriveProfile,
    /// Bus, from 0.
    #[serde(default)]
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
        // A reply to the identifier of a drive would be a command to it.
        let host = |other: &BusJoint| {
            let hosted = !matches!(
                joint.drive.protocol,
                Protocol::Odrive(_) | Protocol::Cia402(_)
            );
            hosted && other.bus == joint.bus && other.drive.id == joint.drive.host_id
        };
        if let Some(other) = self.joints.iter().position(host) {
            let (id, against) = (joint.drive.host_id.into(), "the id of the drive of joint");
            return Err(Contradiction::new(
                "host_id",
                id,
                against,
                other as f32 + 1.0,
            ));
        }
        limits.map_or(Ok(()), |limits| joint.check_against(limits))
    }

    /// Limits of the arm, the torque tightened to the profile's.
    pub fn safety_limits<A: Arm<N, P>, const P: usize>(&self) -> SafetyLimits<N> {
        let mut limits = SafetyLimits::for_arm::<A, P>(micros(self.period_s));
        limits.limit_torques(&self.joints.map(|joint| joint.drive.torque_limit));
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

#[cfg(test)]
mod tests {
    use crate::bank::Parameters;
    use crate::bus::tests::{RANGES, config, controller};
    use crate::bus::{BusConfig, BusController};
    use crate::drives::{Moteus, Protocol, Ranges, Resolution};
    use foretorque::arm::ur5::Ur5;

    #[test]
    fn limits_of_the_parameters_are_those_of_the_drives() {
        let mut parameters = Parameters::nominal::<Ur5>();
        parameters.bounds[1].torque_nm = 7.0;
        let controller = BusController::<Ur5, 6, 40>::new(config(), &parameters).unwrap();
        let limits = controller
            .config()
            .joints
            .map(|joint| joint.drive.torque_limit);
        assert_eq!(limits[1], 7.0);
        assert_eq!(limits[2], config().joints[2].drive.torque_limit);
        parameters.bounds[1].torque_nm = 1e4;
        assert!(BusController::<Ur5, 6, 40>::new(config(), &parameters).is_err());
    }

    #[test]
    fn contradictions_name_joint_field_and_both_values() {
        fn moteus(config: &mut BusConfig<6>, gear: f32, torque_limit: f32) {
            let drive = &mut config.joints[3].drive;
            (drive.gear, drive.torque_limit) = (gear, torque_limit);
            drive.protocol = Protocol::Moteus(Moteus {
                kp: 4e3,
                kd: 200.0,
                watchdog_s: 0.1,
                resolution: Resolution::Int16,
            });
        }
        let corruptions: [fn(&mut BusConfig<6>); 13] = [
            |c| moteus(c, 9.0, 28.0),
            |c| moteus(c, 0.05, 28.0),
            |c| moteus(c, 0.5, 28.0),
            |c| c.period_s = 1e-4,
            |c| c.joints[1].drive.torque_limit = 180.0,
            |c| {
                let torque = 20.0;
                c.joints[2].drive.protocol = Protocol::Damiao(Ranges { torque, ..RANGES });
            },
            |c| c.joints[5].drive.id = 4,
            |c| c.joints[5].drive.id = 20,
            |c| c.joints[1].drive.host_id = 3,
            |c| c.joints[0].bus = 2,
            |c| c.joints[0].kp = 6000.0,
            |c| c.joints[5].drive.gear = 10.0,
            |c| c.joints[4].kd = f32::NAN,
        ];
        let refusals = [
            "joint 4: range of position 2.28",
            "joint 4: torque_limit 28 contradicts the largest value 16.38",
            "joint 4: kp 300 contradicts the largest kp of the frame 159.1",
            "period_s 0.0001 contradicts the shortest period 0.0005",
            "joint 2: torque_limit 180 contradicts the torque of the arm 150",
            "joint 3: torque_limit 28 contradicts the largest value 20",
            "joint 6: id 4 contradicts the id in the replies of joint 4",
            "joint 6: id 20 contradicts the id in the replies of joint 4",
            "joint 2: host_id 3 contradicts the id of the drive of joint 3",
            "joint 1: bus 2 contradicts the last bus 1",
            "joint 1: kp 6000 contradicts the largest kp of the frame 5000",
            "joint 6: range of position 1.25 contradicts the travel of the arm from its zero 6.38",
            "joint 5: kd NaN contradicts the least value 0",
        ];
        for (named, corrupt) in refusals.into_iter().zip(corruptions) {
            let mut config = config();
            corrupt(&mut config);
            let message = controller(config).err().expect(named).to_string();
            assert!(message.starts_with(named), "{message}");
        }
    }

    #[test]
    fn the_resolution_of_the_reported_torque_is_noise_of_the_learner() {
        let fine = foretorque::learning::LearnerConfig::<6, 40>::for_arm::<Ur5>(2e-3);
        let coarse = config().learner::<Ur5, 40>();
        // ±200 N·m in 4095 steps on a joint of 28 N·m.
        let step = 400.0 / 4095.0 / 28.0;
        let expected = (0.01_f32 * 0.01 + step * step / 12.0).sqrt();
        assert!((coarse.noise - expected).abs() < 1e-6 && coarse.noise > fine.noise);
    }
}
